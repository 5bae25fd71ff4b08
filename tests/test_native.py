"""Libraries as the package uses them: Open3D without its web server, kernels without Python's lock."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from vntoolkit.native import njit

SCRIPT = """
import sys
from vntoolkit.libraries import import_open3d
o3d = import_open3d()
assert "dash" not in sys.modules
box = o3d.geometry.TriangleMesh.create_box()
for _ in range(2):
    figure = o3d.visualization.get_plotly_fig([box])
    assert len(figure.data) == 1
assert o3d.visualization.draw_plotly.__module__ == "open3d.visualization.draw_plotly"
"""


def test_plots_of_open3d_are_imported_when_called() -> None:
    subprocess.run([sys.executable, "-c", SCRIPT], check=True)


def test_a_kernel_does_not_hold_up_the_threads_that_read_and_write() -> None:
    kernel = njit(lambda x: x + 1)
    assert kernel.targetoptions["nogil"]
    assert kernel(1) == 2


QUADRATICS = """
import hashlib
import numpy as np
from vntoolkit.geometry.slope_grid import RayGrid
from vntoolkit.shadows.contributions import flat, numbers_of
from vntoolkit.shadows.surface import SurfaceOptions, model_of, quadratics_kernel
h, w = 40, 67
rng = np.random.default_rng(7)
cosines = rng.uniform(0.1, 1.0, (h, w, 3)).astype(np.float32)
labels = rng.integers(0, 8, (h, w)).astype(np.uint8)
slopes, prior = rng.normal(size=(2, 2, h, w)).astype(np.float32)
rays = RayGrid(*np.array([30.0, 20.0, 0.01, 0.01], np.float32))
out = np.zeros((8, h, w), np.float32)
lights = numbers_of(rng.normal(size=(3, 3)))
quadratics_kernel(
    flat(cosines), labels, cosines[..., 0].copy(), slopes, prior, lights, rays,
    model_of(SurfaceOptions(), final=False), out[:6], out[6:],
)
print(hashlib.sha256(out.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_the_first_process_rounds_as_those_do_that_find_its_kernels(tmp_path: Path) -> None:
    """Machine code that is loaded from the cache is optimised once more, which may change no digit."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (
        subprocess.run(
            [sys.executable, "-c", QUADRATICS], check=True, env=environment, capture_output=True, text=True
        ).stdout
        for _ in range(2)
    )
    assert first == second


UNCHANGED = """
import os
before = dict(os.environ)
import vntoolkit as vt
import numpy as np
assert dict(os.environ) == before
from vntoolkit.threads import _openblas, one_blas_thread, thread_policy
from vntoolkit import solvers
assert dict(os.environ) == before
def counts():
    return {library[name.format("get")]() for library, name in _openblas()}
for library, name in _openblas():
    library[name.format("set")](2)
with thread_policy():
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
    assert counts() == {1}
assert dict(os.environ) == before
assert counts() == {2}
with one_blas_thread():
    assert counts() == {1}
assert counts() == {2}
"""


def test_the_callers_process_is_left_as_it_was() -> None:
    """Importing changes no environment; what a verb changes while it runs is put back."""
    environment = {name: value for name, value in os.environ.items() if "THREAD" not in name}
    subprocess.run([sys.executable, "-c", UNCHANGED], check=True, env=environment)

"""Libraries as the package uses them: Open3D without its web server, kernels without Python's lock."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from vntoolkit.native import njit

SCRIPT = """
import sys
from vntoolkit.native import import_open3d
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
    kernel = njit(cache=True)(lambda x: x + 1)
    assert kernel.targetoptions["nogil"]
    assert kernel(1) == 2


@pytest.mark.parametrize(("layer", "may"), [("omp", True), ("workqueue", False)])
def test_loops_overlap_only_where_the_threads_can_take_it(layer: str, may: bool) -> None:
    """numba's own layer ends a process in which two threads run parallel loops at once."""
    script = f"from vntoolkit.native import loops_may_overlap; assert loops_may_overlap() is {may}"
    subprocess.run(
        [sys.executable, "-c", script], check=True, env={**os.environ, "NUMBA_THREADING_LAYER": layer}
    )


BONDS = """
import hashlib
import numpy as np
from vntoolkit.shadows.graph_cut import bonds_of_light
cosines = np.random.default_rng(7).uniform(0.1, 1.0, (40, 67, 3)).astype(np.float32)
bonds = np.stack(bonds_of_light(cosines, 0, np.zeros((40, 67), np.int32), 0.5, 0.6))
bonds[0, :, -1] = bonds[1, -1] = 0.0
print(hashlib.sha256(bonds.tobytes()).hexdigest())
"""


def test_the_first_process_rounds_as_those_do_that_find_its_kernels(tmp_path: Path) -> None:
    """A parallel loop with `fastmath`: run as it was compiled, it would differ in a few last bits."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    first, second = (
        subprocess.run(
            [sys.executable, "-c", BONDS], check=True, env=environment, capture_output=True, text=True
        ).stdout
        for _ in range(2)
    )
    assert first == second

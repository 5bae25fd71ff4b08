"""Compile the loops that every run needs, once, so that no first command waits for them.

python scripts/compile_loops.py        # one to two minutes of processor time; 3 s where all is compiled

A ball and three small frames of a dancer go the usual way: simulate, calibrate, reconstruct, track. The
machine code stays in numba's cache, beside the sources.
"""

import contextlib
import io
import tempfile
from pathlib import Path

import vntoolkit as vt


def main() -> None:
    """Go the usual way on small frames, in a folder that is thrown away."""
    with tempfile.TemporaryDirectory() as name, contextlib.redirect_stdout(io.StringIO()):
        folder = Path(name)
        vt.simulate("sphere", out=folder / "ball", frames="0", size="320x240")
        vt.calibrate_sphere(folder / "ball" / "capture.mkv", out=folder / "rig.json")
        vt.simulate("spandex", out=folder / "dancer", frames="0:3", size="320x240")
        result = folder / "result"
        vt.reconstruct(folder / "dancer" / "capture.mkv", rig=folder / "rig.json", out=result, distance=5)
        vt.track(result)


if __name__ == "__main__":
    main()

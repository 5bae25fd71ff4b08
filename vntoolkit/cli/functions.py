"""The verbs as functions: the names, options and defaults of the command line, dashes as underscores.

A call is bound by the same parser as a typed command, so that both take the same values and refuse the same.
"""

import os
from collections.abc import Iterable, Mapping
from enum import Enum
from pathlib import Path
from typing import Any, TypeAlias

from cyclopts import CycloptsError

from vntoolkit.cli import run_verb
from vntoolkit.cli.messages import line_from_usage_error
from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import MeshSequence
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.io.rigs import read_rig
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.opened_result import OpenedResult, open_result

PathLike: TypeAlias = str | os.PathLike[str]


def simulate(scene: str, *, out: PathLike, **options: Any) -> Path:
    """Render a synthetic capture with ground truth; return the folder `out`.

    options: every flag of `vntoolkit simulate --help`, such as frames="0:10", size="320x240", jobs=2.
    Raises `VntError` with one line.
    """
    _run(["simulate"], [scene], {"out": out, **options})
    return Path(out)


def calibrate_sphere(source: PathLike, *, out: PathLike, **options: Any) -> Rig:
    """Calibrate on a matte ball; write the rig to `out` and return it.

    options: every flag of `vntoolkit calibrate sphere --help`, such as mask, background, transfer, camera.
    """
    return _calibrate("sphere", source, out, options)


def calibrate_board(source: PathLike, *, out: PathLike, **options: Any) -> Rig:
    """Calibrate on the printed board; write the rig to `out` and return it.

    options: every flag of `vntoolkit calibrate board --help`, such as square_mm=15.9, degree=2.
    """
    return _calibrate("board", source, out, options)


def calibrate_head(source: PathLike, *, out: PathLike, **options: Any) -> Rig:
    """Calibrate on a bare head that turns; write the rig to `out` and return it.

    options: every flag of `vntoolkit calibrate head --help`, such as camera="rig.json", report="head.html".
    """
    return _calibrate("head", source, out, options)


def calibrate_lights(source: PathLike, *, out: PathLike, **options: Any) -> Rig:
    """Compute a rig from known light directions; write it to `out` and return it.

    options: every flag of `vntoolkit calibrate lights --help`, such as like="capture.mkv", lights=(0, 1, 2).
    """
    return _calibrate("lights", source, out, options)


def calibrate_presses(source: PathLike, *, out: PathLike, **options: Any) -> Rig:
    """Calibrate a tactile sensor on presses of a ball; write the rig to `out` and return it.

    options: every flag of `vntoolkit calibrate presses --help`, such as background="gel.png",
    ball_radius_mm=2.0, pixel_mm=0.03.
    """
    return _calibrate("presses", source, out, options)


def reconstruct(source: PathLike, *, rig: PathLike, out: PathLike, **options: Any) -> OpenedResult:
    """Compute normals, depth and meshes from footage and a rig file; return the result, opened for reading.

    options: every flag of `vntoolkit reconstruct --help`, such as mask="mask.png", distance=5.0,
    shadows="none", frames="0:100:2", jobs=4, overwrite=True. Raises `FatalFinding` where footage and rig
    cannot belong together; allow=("transfer",) goes on all the same.
    """
    _run(["reconstruct"], [source], {"rig": rig, "out": out, **options})
    return open_result(Path(out))


def track(folder: PathLike, *, out: PathLike | None = None, **options: Any) -> MeshSequence:
    """Register all frames of a reconstruction to one mesh; return the moving mesh.

    options: every flag of `vntoolkit track --help`, such as seams="seams.json", template=10, method="flow".
    """
    _run(["track"], [folder], {"out": out, **options})
    return read_mesh_sequence(Path(folder) / "track" if out is None else Path(out))


def dress(folder: PathLike, *, motion: PathLike, out: PathLike, **options: Any) -> Path:
    """Put a tracked garment on an animated skeleton; return the name of the file written.

    folder: what `track` wrote. options: every flag of `vntoolkit dress --help`, such as preview=True.
    """
    _run(["dress"], [folder], {"motion": motion, "out": out, **options})
    return Path(out)


def export(folder: PathLike, *, to: str, **options: Any) -> None:
    """Convert a reconstruction to the format of another program: "ply", "obj", "usd", "glb", "points", …

    options: every flag of `vntoolkit export --help`, such as out="cloth.usdc", units="cm", up="z".
    """
    _run(["export"], [folder], {"to": to, **options})


def _calibrate(kind: str, source: PathLike, out: PathLike, options: Mapping[str, Any]) -> Rig:
    _run(["calibrate", kind], [source], {"out": out, **options})
    return read_rig(Path(out))


def _run(verb: list[str], sources: list[PathLike], options: Mapping[str, Any]) -> None:
    words = [word for name, value in options.items() for word in _words(name, value)]
    try:
        run_verb([*verb, *words, "--", *[os.fspath(source) for source in sources]])
    except CycloptsError as error:
        raise BadInput(line_from_usage_error(error)) from error


def _words(name: str, value: Any) -> list[str]:
    """Return an option as it would be typed; None is left out."""
    flag = f"--{name.replace('_', '-')}"
    if value is None:
        return []
    if isinstance(value, bool):
        return [f"{flag}={str(value).lower()}"]
    if isinstance(value, Enum):
        return [f"{flag}={value.name.lower().replace('_', '-')}"]
    if isinstance(value, Iterable) and not isinstance(value, str | bytes | os.PathLike):
        return [flag, *map(str, value)]
    return [f"{flag}={os.fspath(value) if isinstance(value, os.PathLike) else value}"]

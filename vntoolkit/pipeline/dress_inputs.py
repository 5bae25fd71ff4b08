"""What `dress` reads: motion capture by its suffix, and the folder that `track` wrote."""

from __future__ import annotations

from pathlib import Path

from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh_sequence import MeshSequence
from vntoolkit.geometry.motion import Motion
from vntoolkit.io.motion_asf import AmcOptions, read_asf_amc
from vntoolkit.io.motion_bvh import read_bvh
from vntoolkit.io.sequences import read_mesh_sequence


def read_motion(path: Path | str, skeleton: Path | str | None = None) -> Motion:
    """Read `.bvh`, or `.amc` with its `.asf` (by default the one of the same name, or the only one there)."""
    path = Path(path)
    match path.suffix.lower():
        case ".bvh":
            return read_bvh(path)
        case ".amc":
            return read_asf_amc(Path(skeleton) if skeleton else _skeleton_beside(path), path, AmcOptions())
        case suffix:
            raise BadInput(f"{path}: expected a motion in .bvh or .amc, got {suffix or 'no suffix'}")


def _skeleton_beside(path: Path) -> Path:
    """Find the skeleton of an AMC file: same name, else the longest name that begins the motion's."""
    candidates = [
        file
        for file in sorted(path.parent.glob("*.[aA][sS][fF]"))
        if path.stem.lower().startswith(file.stem.lower())
    ]
    if not candidates:
        raise BadInput(f"{path}: no skeleton (.asf) of that name beside it; name one with --skeleton")
    return max(candidates, key=lambda file: len(file.stem))


def read_tracked_cloth(folder: Path | str) -> MeshSequence:
    """Open the registered mesh that `track` left in a folder (or the folder `track` itself)."""
    folder = Path(folder)
    if not folder.is_dir():
        raise BadInput(f"{folder}: expected a folder written by `vntoolkit track`")
    inside = folder / "track"
    if not inside.is_dir() and not (folder / "sequence.json").exists():
        raise BadInput(f"{folder}: holds no registered mesh: run `vntoolkit track {folder}` first")
    return read_mesh_sequence(inside if inside.is_dir() else folder)

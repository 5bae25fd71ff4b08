"""The folder that a reconstruction writes: its files, its manifest, and hashes of what it read."""

import contextlib
import hashlib
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import vntoolkit
from vntoolkit.errors import VntError
from vntoolkit.io.atomic import write_text
from vntoolkit.io.files import require_file, sha256_of_file
from vntoolkit.io.results.folder import FolderKind
from vntoolkit.io.results.frame_log import FRAMES_NAME, FrameLog
from vntoolkit.io.results.manifest import (
    FRAME_FILES,
    MANIFEST_NAME,
    Manifest,
    read_manifest,
    request_of_manifest,
)
from vntoolkit.io.rigs import SourceEntry, text_from_model
from vntoolkit.libraries import open3d_distribution

_LIBRARIES = ("numpy", "scipy", "numba", "opencv-contrib-python-headless", "av", "OpenEXR")


def write_manifest(folder: Path | str, manifest: Manifest) -> None:
    """Write reconstruction.json into `folder`, atomically."""
    write_text(Path(folder) / MANIFEST_NAME, text_from_model(manifest))


def hashed(files: tuple[Path, ...] | list[Path]) -> list[SourceEntry]:
    """Return name and SHA-256 of each file, in order."""
    return [SourceEntry(file=path.name, sha256=sha256_of_file(require_file(path))) for path in files]


def entry_of_files(name: Path, files: tuple[Path, ...]) -> SourceEntry:
    """Return one entry for an input of one file or many: of many, the SHA-256 of their names and SHA-256s."""
    entries = hashed(files)
    if len(entries) == 1:
        return entries[0]
    listed = "".join(f"{entry.sha256}  {entry.file}\n" for entry in entries)
    return SourceEntry(file=name.name, sha256=hashlib.sha256(listed.encode()).hexdigest())


def library_versions() -> dict[str, str]:
    """Return the versions of the program, Python and the libraries that shape results."""
    versions = {"vntoolkit": vntoolkit.__version__, "python": platform.python_version()}
    for name in _LIBRARIES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "absent"
    distribution, its_version = open3d_distribution()
    return {**versions, distribution: its_version}


def _numbers_of_run(folder: Path) -> set[int]:
    numbers = set(FrameLog(folder).entries())
    with contextlib.suppress(VntError):  # a manifest that is no longer readable
        numbers.update(range(read_manifest(folder).input.frame_count))
    return numbers


RECONSTRUCTION = FolderKind(
    verb="reconstruct",
    holds="results",
    record=MANIFEST_NAME,
    files=(FRAMES_NAME, "contact.csv", "mask_suggested.png"),
    frames={name: (suffix,) for name, suffix in FRAME_FILES.items()},
    read=lambda path: read_manifest(path.parent),
    text=text_from_model,
    request=request_of_manifest,
    numbers=_numbers_of_run,
)

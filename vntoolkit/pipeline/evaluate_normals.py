"""Two normal maps, or two folders of them, compared frame by frame in constant memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.diagnosis.consistency import warn_of_flipped_axes
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.angular_error import (
    AngleHistogram,
    AngularError,
    angular_error_map,
    summarise_angles,
)
from vntoolkit.io.conventions import NormalConvention
from vntoolkit.io.maps_and_meshes.maps import read_normal_map

_SUFFIXES = (".exr", ".png", ".tif", ".tiff")


@dataclass(frozen=True, kw_only=True)
class NormalPair:
    """Two files of one frame, and its name."""

    name: str
    measured: Path
    reference: Path


@dataclass(frozen=True, kw_only=True, eq=False)
class NormalsComparison:
    """All frames. overall: over all pixels of all frames. curve_deg: (1000,) angles by rank. worst: name of
    the frame with the largest mean, its map of angles (h, w) in degrees and where they are valid.
    """

    overall: AngularError
    frames: dict[str, AngularError]
    curve_deg: FloatArray
    worst: str
    worst_deg: FloatArray
    worst_mask: Mask


def pairs_of(measured: Path, reference: Path) -> list[NormalPair]:
    """Pair two files, or the files of two folders by their names.

    A folder may be that of `reconstruct` or `simulate`; then its normals are taken. Raises `BadInput` where
    nothing pairs up.
    """
    if not measured.is_dir() and not reference.is_dir():
        return [NormalPair(name=measured.stem, measured=measured, reference=reference)]
    if not (measured.is_dir() and reference.is_dir()):
        raise BadInput(f"{measured}, {reference}: give two files or two folders, not one of each")
    ours, theirs = _maps_in(measured), _maps_in(reference)
    names = [name for name in ours if name in theirs]
    if not names:
        raise BadInput(
            f"{measured} holds {len(ours)} normal maps and {reference} {len(theirs)}, none of one name: "
            "files are paired by their names without suffix"
        )
    return [NormalPair(name=name, measured=ours[name], reference=theirs[name]) for name in names]


def compare_normal_files(
    pairs: list[NormalPair],
    conventions: tuple[NormalConvention | None, NormalConvention | None] = (None, None),
    on_frame: Callable[[str], None] = lambda name: None,
) -> NormalsComparison:
    """Compare pairs one at a time. conventions: of the measured and the reference files, None for as stated.

    Raises `BadInput`, with the files, for maps of different size or without a common valid pixel.
    """
    histogram, frames = AngleHistogram(), {}
    worst, worst_mean = None, -1.0
    for name, angles, both in _angle_maps(pairs, conventions):
        frames[name] = summarise_angles(angles[both])
        histogram.add(angles[both])
        if frames[name].mean_deg > worst_mean:
            worst, worst_mean = (name, angles, both), frames[name].mean_deg
        on_frame(name)
    if worst is None:
        raise BadInput("evaluate normals: no pair of maps was given")
    overall = next(iter(frames.values())) if len(frames) == 1 else histogram.summary()
    return NormalsComparison(
        overall=overall,
        frames=frames,
        curve_deg=histogram.values(),
        worst=worst[0],
        worst_deg=worst[1],
        worst_mask=worst[2],
    )


def _angle_maps(
    pairs: list[NormalPair], conventions: tuple[NormalConvention | None, NormalConvention | None]
) -> Iterator[tuple[str, FloatArray, Mask]]:
    for pair in pairs:
        measured = read_normal_map(pair.measured, convention=conventions[0])
        reference = read_normal_map(pair.reference, convention=conventions[1])
        warn_of_flipped_axes(pair.measured, measured)
        warn_of_flipped_axes(pair.reference, reference)
        try:
            angles, both = angular_error_map(measured, reference)
        except BadInput as problem:
            raise BadInput(f"{pair.measured}, {pair.reference}: {problem}") from problem
        yield pair.name, angles, both


def _maps_in(folder: Path) -> dict[str, Path]:
    inner = next((folder / part for part in ("normals", "truth/normals") if (folder / part).is_dir()), folder)
    files = sorted(path for path in inner.iterdir() if path.suffix.lower() in _SUFFIXES)
    return {path.stem: path for path in files}

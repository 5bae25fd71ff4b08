"""Depth errors of every integrator, on analytic surfaces and on real scanned objects."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.checks import require_same_size, require_some
from vntoolkit.diagnosis.consistency import warn_of_flipped_axes
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.depth_error import disc_with_hole, peaks, tear
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.integration.options import IntegrationOptions, Integrator
from vntoolkit.io.files import read_text
from vntoolkit.io.maps_and_meshes.arrays import read_npz
from vntoolkit.io.maps_and_meshes.label_images import read_mask
from vntoolkit.io.maps_and_meshes.maps import read_normal_map

TEAR_STEEPNESS = 1.0
_OBJECT_FILES = ("normal_map.png", "mask.png", "K.txt", "depth_gt.npz")


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceError:
    """Depth errors of one integrator on one surface, in percent of its range, free offset removed.

    numbers: largest and rms after the mean is removed, mean after the median is. distances_percent: (h, w),
    0 outside mask.
    """

    surface: str
    integrator: str
    numbers: dict[str, float]
    distances_percent: FloatArray
    mask: Mask


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceCase:
    """A surface to integrate: its name, true depth, normals and mask, and the integrator."""

    surface: str
    is_torn: bool
    depth: FloatArray
    normal_map: NormalMap
    integrator: Integrator

    def measure(self) -> SurfaceError:
        """Integrate and compare."""
        height, width = self.depth.shape
        camera = Camera.orthographic(width=width, height=height)
        found = DepthIntegrator(camera, IntegrationOptions(integrator=self.integrator)).integrate(
            self.normal_map
        )
        difference = np.where(found.mask, found.depth.astype(np.float64) - self.depth, 0.0)
        range_percent = float(np.ptp(self.depth[found.mask])) / 100.0
        centred = np.abs(difference - np.median(difference[found.mask])) / range_percent
        return SurfaceError(
            surface=self.surface,
            integrator=self.integrator.value,
            numbers=depth_error_percent(found, self.depth),
            distances_percent=np.where(found.mask, centred, 0.0),
            mask=found.mask,
        )


@dataclass(frozen=True, kw_only=True)
class ObjectError:
    """Absolute depth errors in millimetres on a real object, free scale set by the median."""

    name: str
    integrator: str
    pixels: int
    mean_mm: float
    median_mm: float


def surface_cases(size: int) -> list[SurfaceCase]:
    """Smooth hills, whole and on a disc with a hole, and a torn surface, each by what can integrate it."""
    if size < 16:
        raise BadInput(f"evaluate integration: expected surfaces of at least 16 pixels, got {size}")
    hills, torn = peaks(size), tear(size, TEAR_STEEPNESS)
    full: Mask = np.ones((size, size), dtype=np.bool_)
    plans = [
        (f"hills {size}", False, hills, full, tuple(Integrator)),
        (
            f"hills on a disc with a hole {size}",
            False,
            hills,
            disc_with_hole(size),
            (Integrator.POISSON, Integrator.DISCONTINUITY),
        ),
        (f"torn {size}", True, torn, full, tuple(Integrator)),
    ]
    return [
        SurfaceCase(
            surface=name,
            is_torn=is_torn,
            depth=depth,
            normal_map=NormalMap(normals_in_camera=normals, mask=mask),
            integrator=integrator,
        )
        for name, is_torn, (depth, normals), mask, integrators in plans
        for integrator in integrators
    ]


def depth_error_percent(found: DepthMap, truth: FloatArray) -> dict[str, float]:
    """Return mean, rms and largest error over the mask in percent of the range, free offset removed."""
    difference = (found.depth.astype(np.float64) - truth)[found.mask]
    range_percent = float(np.ptp(truth[found.mask])) / 100.0
    centred = difference - difference.mean()
    return {
        "mean": float(np.abs(difference - np.median(difference)).mean()) / range_percent,
        "rms": float(np.sqrt((centred**2).mean())) / range_percent,
        "largest": float(np.abs(centred).max()) / range_percent,
    }


def objects_in(folder: Path) -> list[Path]:
    """Return the folders of objects with known depth. Raises `BadInput` where there is none."""
    found = [
        path
        for path in sorted(folder.iterdir() if folder.is_dir() else ())
        if all((path / name).exists() for name in _OBJECT_FILES)
    ]
    if not found:
        raise BadInput(f"{folder}: holds no folder with {', '.join(_OBJECT_FILES)}")
    return found


def read_object(folder: Path) -> tuple[Camera, NormalMap, FloatArray]:
    """Read camera, normals and true depth (h, w) in mm, NaN where unknown, of one real object."""
    mask = read_mask(folder / "mask.png")
    normal_map = read_normal_map(folder / "normal_map.png", mask=mask)
    warn_of_flipped_axes(folder / "normal_map.png", normal_map)
    height, width = mask.shape
    matrix = _read_matrix(folder / "K.txt")
    camera = Camera(model=CameraModel.PINHOLE, width=width, height=height, matrix=matrix)
    truth = read_npz(folder / "depth_gt.npz", "depth_gt").astype(np.float64)
    require_same_size(truth, f"{folder / 'depth_gt.npz'}", mask, "the mask")
    return camera, normal_map, truth


def _read_matrix(path: Path) -> FloatArray:
    words = read_text(path).split()
    try:
        return np.array([float(word) for word in words]).reshape(3, 3)
    except ValueError as error:
        raise BadInput(
            f"{path}: expected the 9 numbers of a 3 × 3 camera matrix, got {len(words)} words"
        ) from error


def real_object_errors(
    folder: Path, integrators: tuple[Integrator, ...] = (Integrator.POISSON, Integrator.DISCONTINUITY)
) -> list[ObjectError]:
    """Integrate one real object by each integrator and compare with the scanned depth."""
    camera, normal_map, truth = read_object(folder)
    seen = normal_map.mask & np.isfinite(truth)
    require_some(seen, f"{folder}: pixels with normal and depth")
    errors = []
    for integrator in integrators:
        options = IntegrationOptions(integrator=integrator)
        found = DepthIntegrator(camera, options).integrate(normal_map).depth[seen]
        distances = np.abs(found * np.median(truth[seen] / found) - truth[seen])
        errors.append(
            ObjectError(
                name=folder.name,
                integrator=integrator.value,
                pixels=int(seen.sum()),
                mean_mm=float(distances.mean()),
                median_mm=float(np.median(distances)),
            )
        )
    return errors

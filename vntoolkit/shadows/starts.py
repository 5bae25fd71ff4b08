"""The surface from the better of two starts.

Where two lights arrive the energy has two valleys, as the quadratic of `two_lights` has two roots. A smooth
continuation of the lit surroundings and the roots chosen by continuity lead into one each; every shadow keeps
the one whose surface returns the light that is seen.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels, Weight
from vntoolkit.geometry.camera import Camera
from vntoolkit.photometry.frame import ALL_LIT, count_lit
from vntoolkit.shadows.lengths import TOWARDS_VIEWER, lengths_of
from vntoolkit.shadows.normal_noise import slope_noise
from vntoolkit.shadows.shares import LightShares
from vntoolkit.shadows.surface import Surface, solve_surface
from vntoolkit.shadows.surface_options import SurfaceOptions
from vntoolkit.shadows.two_lights import continue_with_two_lights

_LARGEST_MISFIT = 25.0  # χ² of one pixel beyond which it says no more about its region


def surface_from_either_start(
    measured: LightShares,
    labels: VisibilityLabels,
    albedo: FloatArray,
    mask: Mask,
    *,
    trust: Weight,
    camera: Camera | None,
    options: SurfaceOptions,
) -> Surface:
    """Solve the surface of a frame, coarse to fine.

    albedo: (h, w), that of the surroundings. trust: (h, w), beyond that of `measured`.
    """
    by_lights = np.asarray(options.trust_by_lights, dtype=np.float32)[count_lit(labels)]
    measured = replace(measured, trust=(measured.trust * trust * by_lights).astype(np.float32))
    options = _with_measured_noise(options, measured, mask & (labels == ALL_LIT))
    return _coarse_to_fine(measured, labels, albedo, mask, camera, options, options.large_iterations)


def _coarse_to_fine(
    measured: LightShares,
    labels: VisibilityLabels,
    albedo: FloatArray,
    mask: Mask,
    camera: Camera | None,
    options: SurfaceOptions,
    last_iterations: int,
) -> Surface:
    """Compare the starts on a small image; go on from the better one at twice the size, and so on."""
    if mask.size <= options.start_pixels:
        return _better_start(measured, labels, albedo, mask, camera, options)
    small, small_mask = measured.shrunk(mask, 2)
    size = small_mask.shape[::-1]
    start = _coarse_to_fine(
        small, cv2.resize(labels, size, interpolation=cv2.INTER_NEAREST).astype(np.uint8),
        np.asarray(cv2.resize(albedo, size, interpolation=cv2.INTER_AREA)), small_mask,
        None if camera is None else camera.scaled(0.5), options, options.middle_iterations,
    )  # fmt: skip
    return _solver(measured, labels, albedo, mask, camera)(
        first_normals=measured.normals,
        start=_enlarged(start, mask, 2),
        options=replace(options, iterations=last_iterations),
    )


def _with_measured_noise(options: SurfaceOptions, measured: LightShares, full: Mask) -> SurfaceOptions:
    found = slope_noise(measured.normals, full)
    if found is None:
        return options
    measured_noise = max(options.noise_per_slope * found, options.least_noise)
    return replace(options, noise=min(options.noise, measured_noise))


def _solver(
    measured: LightShares,
    labels: VisibilityLabels,
    albedo: FloatArray,
    mask: Mask,
    camera: Camera | None,
) -> partial[Surface]:
    own = np.where(mask & (labels == ALL_LIT), measured.length, albedo)
    return partial(
        solve_surface, measured.relative_to(own), labels, measured.lights, mask,
        weight=measured.trust, camera=camera,
    )  # fmt: skip


def _better_start(
    measured: LightShares,
    labels: VisibilityLabels,
    albedo: FloatArray,
    mask: Mask,
    camera: Camera | None,
    options: SurfaceOptions,
) -> Surface:
    solve = _solver(measured, labels, albedo, mask, camera)
    smooth: Surface = solve(first_normals=measured.normals, options=options)
    shadow = mask & (labels != ALL_LIT)
    if not shadow.any():
        return smooth
    relative = measured.relative_to(albedo)
    roots, decided = continue_with_two_lights(measured.normals, relative, labels, measured.lights, mask)
    rooted: Surface = solve(first_normals=roots, guessed=decided, options=options)
    better = _better_regions(rooted.misfit, smooth.misfit, shadow)
    if not better.any():
        return smooth
    base = rooted if 2 * np.count_nonzero(better) > np.count_nonzero(shadow) else smooth
    merged = np.where(better[..., None], rooted.normals, smooth.normals)
    return solve(first_normals=measured.normals, start=replace(base, normals=merged), options=options)


def _better_regions(first: FloatArray, second: FloatArray, shadow: Mask) -> Mask:
    """Connected regions of `shadow` in which `first` sums to less than `second`."""
    _, region = cv2.connectedComponents(shadow.astype(np.uint8), connectivity=4)
    saved = np.minimum(second, _LARGEST_MISFIT) - np.minimum(first, _LARGEST_MISFIT)
    gain = np.bincount(region[shadow], weights=saved[shadow], minlength=int(region.max()) + 1)
    return shadow & (gain > 0)[region]


def _enlarged(surface: Surface, mask: Mask, factor: int) -> Surface:
    """The same surface on a grid `factor` times finer; depth counts pixels, so it grows too."""
    size = mask.shape[::-1]

    def enlarge(image: FloatArray) -> FloatArray:
        return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_LINEAR), dtype=np.float32)

    normals = enlarge(surface.normals.astype(np.float32))
    length = lengths_of(normals)
    normals = np.where(length > 1e-3, normals / np.maximum(length, 1e-3), TOWARDS_VIEWER)
    return Surface(
        normals=normals.astype(np.float32),
        depth=np.ascontiguousarray(enlarge(surface.depth) * np.float32(factor)),
        agreement=enlarge(surface.agreement),
        misfit=enlarge(surface.misfit),
    )

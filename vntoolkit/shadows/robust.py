"""Shadow detection against a surface: a light is missing where the surface should return more of it.

Start: lights whose share is too small for the surrounding albedo are doubted. Then alternate: solve the
surface from the lights that are not doubted (`surface`), predict each light's share on it, compare with the
share measured, and cut (`graph_cut`). A pixel that is dark in all three lights alike is dark paint; paint
that changes faster than `AlbedoOptions` allows is told from shadow by that.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.checks import require_in_range
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.photometry.frame import labels_from_lit
from vntoolkit.shadows.albedo import AlbedoOptions, albedo_from_lit
from vntoolkit.shadows.albedo_evidence import AlbedoEvidenceOptions, evidence_from_albedo
from vntoolkit.shadows.cast_edges import CastEdgeOptions, lit_beyond_half
from vntoolkit.shadows.dark_level import DarkLevelOptions, largest_dark_share
from vntoolkit.shadows.graph_cut import bonds_of_light, lit_by_cut
from vntoolkit.shadows.lengths import all_of_three, largest_of_three, median_of_three
from vntoolkit.shadows.outline import OutlineOptions, turned_from_lights
from vntoolkit.shadows.shares import LightShares
from vntoolkit.shadows.sharpening import SharpeningOptions, sharpened_shares
from vntoolkit.shadows.surface import solve_surface
from vntoolkit.shadows.surface_options import SurfaceOptions

_STRONGEST_EVIDENCE = 4.0
_SMALLEST_ALBEDO = 1e-3


@dataclass(frozen=True, kw_only=True)
class RobustOptions:
    """The robust detector's parameters; a share is 1 where a surface of the local albedo faces the light.

    first_share: lights with a smaller share are doubted at the start. dark_level: below which share a light
    is missing. paint_part: a pixel with less than this part of all three predicted shares is dark paint if
    paint_share of them, at least, is measured. tolerance_dark, tolerance_bright: change of a share that
    counts as one unit of evidence, where none is predicted, and what the predicted share adds to it.
    smoothness: price of a change of label between neighbours, in units of evidence. contrast: see
    `bonds_of_light`. rounds: alternations. working_pixels: larger frames are shrunk towards this size for the
    alternation; the last cut has the frame's own size. persistence: weight of the previous frame's
    evidence, 0 to 1. sharpening: of the shares that the last cut judges. albedo_evidence: what the albedo
    adds to it. cast_edge: where a cast shadow ends. outline: the last pixels before the figure's outline.
    albedo, surface: how both are estimated in every round.
    """

    first_share: float = 0.2
    dark_level: DarkLevelOptions = field(default_factory=DarkLevelOptions)
    paint_part: float = 0.5
    paint_share: float = 0.12
    tolerance_dark: float = 0.04
    tolerance_bright: float = 0.05
    smoothness: float = 0.5
    contrast: float = 0.6
    rounds: int = 3
    working_pixels: int = 100_000
    persistence: float = 0.25
    sharpening: SharpeningOptions = field(default_factory=SharpeningOptions)
    albedo_evidence: AlbedoEvidenceOptions = field(default_factory=AlbedoEvidenceOptions)
    cast_edge: CastEdgeOptions = field(default_factory=CastEdgeOptions)
    outline: OutlineOptions = field(default_factory=OutlineOptions)
    albedo: AlbedoOptions = field(default_factory=AlbedoOptions)
    surface: SurfaceOptions = field(
        default_factory=lambda: SurfaceOptions(iterations=3, noise=0.08, smoothness=1.5)
    )

    def __post_init__(self) -> None:
        for name in ("first_share", "paint_part", "paint_share", "persistence"):
            require_in_range(getattr(self, name), 0.0, 1.0, f"robust shadow detector: {name}")
        positive = 0 < self.tolerance_dark < np.inf and 0 < self.contrast < np.inf
        not_negative = 0 <= self.tolerance_bright < np.inf and 0 <= self.smoothness < np.inf
        if min(self.rounds, self.working_pixels) < 1 or not (positive and not_negative):
            raise BadInput("robust shadow detector: rounds, tolerances and contrast must be positive")


def lit_by_surface(
    measured: LightShares,
    mask: Mask,
    options: RobustOptions | None = None,
    camera: Camera | None = None,
    memory: FloatArray | None = None,
) -> tuple[npt.NDArray[np.bool_], FloatArray]:
    """Return (h, w, 3) which lights arrive, and the (h, w, 3) evidence that the next frame may remember."""
    options = options or RobustOptions()
    factor = _shrinking(mask, options)
    small, small_mask = (measured, mask) if factor == 1 else measured.shrunk(mask, factor)
    small_camera = None if camera is None else camera.scaled(1.0 / factor)
    normals, albedo = _surface_by_rounds(small, small_mask, options, small_camera)
    normals, albedo = _enlarged(normals, mask.shape), _enlarged(albedo, mask.shape)
    predicted = normals @ measured.directions.T.astype(np.float32)
    raw = measured.shares(albedo)
    shares = _without_paint(raw, predicted, options)
    sharp = _without_paint(sharpened_shares(raw, mask, options.sharpening), predicted, options)
    evidence = _evidence(sharp, predicted, albedo, mask, options)
    evidence += evidence_from_albedo(measured, sharp, predicted, albedo, mask, options.albedo_evidence)
    evidence = np.clip(evidence, -_STRONGEST_EVIDENCE, _STRONGEST_EVIDENCE)
    if memory is not None and memory.shape == evidence.shape:
        evidence = (1 - options.persistence) * evidence + options.persistence * memory
    turned = turned_from_lights(normals, shares, measured.directions, mask, factor, options.outline)
    lit = _cut(evidence, shares, mask, options) & ~turned
    return lit_beyond_half(lit, shares, predicted, mask, options.cast_edge), evidence


def _surface_by_rounds(
    measured: LightShares, mask: Mask, options: RobustOptions, camera: Camera | None
) -> tuple[FloatArray, FloatArray]:
    """Alternate between surface and labels; return the normals (h, w, 3) and the albedo."""
    lit = _first_doubts(measured, mask, options)
    normals, albedo = measured.normals, measured.length
    for i in range(options.rounds):
        full = all_of_three(lit) & mask
        albedo = albedo_from_lit(measured.length, full, options.albedo)
        surface = solve_surface(
            measured.relative_to(np.where(full, measured.length, albedo)), labels_from_lit(lit),
            measured.lights, mask, first_normals=measured.normals, weight=measured.trust, camera=camera,
            options=options.surface,
        )  # fmt: skip
        normals = surface.normals.astype(np.float32)
        if i + 1 < options.rounds:
            predicted = normals @ measured.directions.T.astype(np.float32)
            shares = _without_paint(measured.shares(albedo), predicted, options)
            lit = _cut(_evidence(shares, predicted, albedo, mask, options), shares, mask, options)
    return normals, albedo


def _cut(
    evidence: FloatArray, shares: FloatArray, mask: Mask, options: RobustOptions
) -> npt.NDArray[np.bool_]:
    lit = np.empty(shares.shape, dtype=np.bool_)
    for k in range(3):
        bonds = bonds_of_light(shares, k, mask, options.smoothness, options.contrast)
        lit[..., k] = lit_by_cut(evidence[..., k], bonds, mask)
    return lit


def _shrinking(mask: Mask, options: RobustOptions) -> int:
    return max(1, round(float(np.sqrt(mask.size / options.working_pixels))))


def _enlarged(image: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    if image.shape[:2] == shape:
        return image
    return np.asarray(cv2.resize(image, shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _first_doubts(measured: LightShares, mask: Mask, options: RobustOptions) -> npt.NDArray[np.bool_]:
    inside = measured.length[mask]
    typical = float(np.median(inside)) if inside.size else 1.0
    albedo: FloatArray = np.full(mask.shape, max(typical, _SMALLEST_ALBEDO), dtype=np.float32)
    lit = np.ones((*mask.shape, 3), dtype=np.bool_)
    for _ in range(3):  # albedo and doubts settle each other
        shares = measured.shares(albedo)
        lit = shares > options.first_share
        brightest = largest_of_three(shares)[..., None]
        paint = all_of_three(~lit)[..., None] & (brightest > options.paint_share)
        lit |= paint & (shares > options.first_share * brightest)
        albedo = albedo_from_lit(measured.length, all_of_three(lit) & mask, options.albedo)
    return lit


def _without_paint(shares: FloatArray, predicted: FloatArray, options: RobustOptions) -> FloatArray:
    """Undo dark paint: where all three lights are missing alike, it is the albedo that is off."""
    part = shares / np.maximum(predicted, options.tolerance_dark)
    typical = median_of_three(part)
    paint = all_of_three(part < options.paint_part) & (typical > options.paint_share)
    return shares / np.where(paint, np.maximum(typical, _SMALLEST_ALBEDO), 1.0)[..., None]


def _evidence(
    shares: FloatArray, predicted: FloatArray, albedo: FloatArray, mask: Mask, options: RobustOptions
) -> FloatArray:
    """(h, w, 3), positive where more is measured than a shadow returns."""
    level, grain = largest_dark_share(shares, predicted, albedo, mask, options.dark_level)
    unit = np.hypot(options.tolerance_dark + options.tolerance_bright * np.maximum(predicted, 0.0), grain)
    return np.clip((shares - level) / unit, -_STRONGEST_EVIDENCE, _STRONGEST_EVIDENCE)

"""The subject in the reflectance that its tracked surface carries, frame by frame."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter

from vntoolkit.arrays import FloatArray, IntArray, Mask
from vntoolkit.errors import BadCapture
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.io.maps_and_meshes.arrays import map_npy
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.materials.mixtures import MaterialLabels
from vntoolkit.materials.paint import without_paint
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.pipeline.texture import AGREES_PX, texels_of
from vntoolkit.pipeline.tracked_folder import (
    REFLECTANCE_NAME,
    TrackSource,
    open_track_source,
    read_track_record,
)

_LEAST_PAINT = 0.05  # spread of log ρ along the line of paint: with less a material is of one colour
_FEATHER_PX = 5  # over which the surface's reflectance takes over from that of the materials


@dataclass(frozen=True, kw_only=True)
class TrackedReflectance:
    """Where reflectances of a tracked surface are: a reconstruction, its tracks with reflectance.npy.

    unit: length of a normal of the calibration material in the reconstruction. sha256: of reflectance.npy.
    frames: number of frames that told it. seen: share of the vertices that they show. lines, spreads: of
    each material, as of `SurfaceReflectance`.
    """

    result: Path
    track: Path
    unit: float
    sha256: str
    frames: int
    seen: float
    lines: tuple[tuple[float, float, float], ...]
    spreads: tuple[float, ...]

    @property
    def is_painted(self) -> tuple[bool, ...]:
        """Of each material, whether its paint varies: only there normals change."""
        return tuple(spread > _LEAST_PAINT for spread in self.spreads)

    def described(self) -> str:
        """How far paint varies, in words."""
        if not any(self.is_painted):
            spread = ", ".join(f"{s:.0%}" for s in self.spreads)
            return (
                f"paint varies by {spread} (less than {_LEAST_PAINT:.0%} is one colour): the normals are as "
                "before"
            )
        varied = ", ".join(
            f"{s:.0%}" for s, painted in zip(self.spreads, self.is_painted, strict=True) if painted
        )
        return f"paint varies by {varied} in {sum(self.is_painted)} of {len(self.spreads)} materials"


class PaintedSurface:
    """Takes frames to one material with the reflectances of a tracked surface."""

    def __init__(self, known: TrackedReflectance, response: LightResponse) -> None:
        record, self._sequence = read_track_record(known.track), read_mesh_sequence(known.track)
        self._rows = {number: row for row, number in enumerate(record["frames"][: len(self._sequence)])}
        self._lost_px = record["lost_px"]
        self._source: TrackSource = open_track_source(known.result)
        self._rho = np.exp(np.asarray(map_npy(known.track / REFLECTANCE_NAME), dtype=np.float64))
        self._response, self._split, self._unit = response, response.contributions_from_rgb, known.unit
        self._is_painted = np.array(known.is_painted)
        self._lines = np.array(known.lines)
        self.turned_deg: FloatArray | None = None  # by paint that was taken out last

    def mask(self, number: int) -> Mask:
        """Return (h, w), the pixels that have normals in the reconstruction. Raises `BadCapture`."""
        if not self._source.folder.has(number, "normals"):
            raise BadCapture(f"frame {number}: has no normals in {self._source.folder.root}")
        return self._source.normals(number).mask

    def relit(
        self, filmed: LinearFrame, by_materials: LinearFrame, number: int, materials: MaterialLabels | None
    ) -> LinearFrame:
        """Return the frame as it would be with the calibration material everywhere.

        filmed: the frame as it is. by_materials: in one material, as far as materials tell: it stays where
        the tracked surface is not, or is lost, and on materials that are not painted. materials: (h, w),
        their numbers. What the track puts beside its place by a part of a pixel is taken out as
        the paint of a single frame is.
        """
        rho, share = self.reflectance(number)
        rgb = (filmed.rgb @ self._split.T / rho) @ np.linalg.inv(self._split).T
        labels = np.zeros(share.shape, np.uint8) if materials is None else materials
        share = share * self._is_painted[labels]
        plain = self._corrected(replace(filmed, rgb=rgb.astype(np.float32)), labels, share > 0)
        rgb = by_materials.rgb + share[..., None] * (self._unit * plain.rgb - by_materials.rgb)
        return LinearFrame(rgb=rgb.astype(np.float32), clipped=filmed.clipped, number=filmed.number)

    def _corrected(self, frame: LinearFrame, labels: MaterialLabels, mask: Mask) -> LinearFrame:
        """Return a frame without the paint that the surface's reflectances leave, as one frame tells it."""
        seen = frame, labels, mask, self._response, np.ones_like(self._lines), self._lines
        frame, self.turned_deg, _ = without_paint(*seen, self._source.camera)
        return frame

    def reflectance(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Return (h, w, 3), 1 beside the surface, and (h, w), how far it counts, 0 to 1."""
        camera = self._source.camera
        shape = (camera.height, camera.width)
        rho, share = np.ones((*shape, 3)), np.zeros(shape)
        row = self._rows.get(number)
        if row is None or not self._source.has(number):
            return rho, share
        faces = self._sequence.template.faces
        vertices = np.array(self._sequence.vertices[row], dtype=np.float64)
        texels = texels_of(camera.project(vertices), faces, shape, vertices[:, 2])
        uncertainty = self._sequence.uncertainty_px
        known = (
            np.ones(len(vertices))
            if uncertainty is None
            else (uncertainty[row] <= self._lost_px).astype(np.float64)
        )
        _, depth_map = self._source.maps(number)
        is_there = texels.of_vertices(known, faces) > 1.0 - 1e-9
        depth = texels.of_vertices(vertices[:, 2], faces)
        is_there &= _agrees(depth_map, depth, texels.places, camera.matrix[0, 0], camera.is_perspective)
        rho.reshape(-1, 3)[texels.places] = texels.of_vertices(self._rho, faces)
        share.ravel()[texels.places] = is_there
        return rho, share * uniform_filter(share, _FEATHER_PX)


def _agrees(
    depth_map: DepthMap, depth: FloatArray, places: IntArray, focal_px: float, is_perspective: bool
) -> Mask:
    """Return (t,): whether the depth of the tracks is that of the frame, so that nothing is in between."""
    pixel = (depth if is_perspective else 1.0) / focal_px
    return np.asarray(np.abs(depth_map.depth.ravel()[places] - depth) < AGREES_PX * pixel)

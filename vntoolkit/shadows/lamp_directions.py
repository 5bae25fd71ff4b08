"""Where the lamps stand, told by the colours of what they do not reach.

M holds directions and colours of the lamps as one product. Where a channel sees more than one lamp, its row
of M lies between their directions. But where lamp k is missing, whatever the surface, the others mix
M⁻¹ (r − a) in the plane that is orthogonal to lamp k's direction: its normal is the direction.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Mask, Matrix3, Points2, Vector3, VisibilityLabels
from vntoolkit.errors import BadRig
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.spread import robust_deviation

_FEWEST_PIXELS = 30
_MOST_PIXELS = 2_000  # evenly spread: more tell nothing new
_ROUNDS = 8  # of the robust fit
_TUNING = 2.0  # standard deviations from the plane at which a colour counts a quarter
SURE_DEG = 4.0  # standard deviation of a direction: M's rows of a camera that mixes lamps are off by 4 to 9
_LEAST_OFFSET = 0.02  # of a colour, off its plane: what near lamps, half-light and interreflection leave


@dataclass(frozen=True, kw_only=True, eq=False)
class LampDirections:
    """Directions of three lamps under one response.

    rows: (3, 3), row k is orthogonal to the colours of all lamps but k. deviations: (3,), standard deviations
    of the directions in radians, infinite where a lamp is not known.
    """

    response: LightResponse
    rows: Matrix3
    deviations: Vector3

    @property
    def central(self) -> Matrix3:
        """(3, 3), row k = unit vector to lamp k, in the camera frame, under the response at its centre."""
        lamps: Matrix3 = self.rows @ self.response.matrix
        return lamps / np.linalg.norm(lamps, axis=1, keepdims=True)

    @cached_property
    def separated(self) -> LightResponse:
        """The response at its centre with the lamps' colours, as far as their directions are sure.

        A channel stands for each other lamp. Without colours where none is sure, or they mix each other's.
        """
        sure = self.deviations < np.radians(SURE_DEG)
        if self.response.light_colours is not None or not sure.any():
            return self.response.central
        rows = np.where(sure[:, None], self.rows, np.eye(3))
        try:
            return replace(self.response.central, light_colours=np.linalg.inv(rows).T)
        except BadRig:
            return self.response.central

    def at(self, lamp: int, positions_px: Points2) -> FloatArray:
        """Return unit vectors (n, 3) from the surface at pixels (n, 2) to a lamp, in the camera frame."""
        matrices, _ = self.response.at(positions_px)
        towards: FloatArray = np.einsum("i,nij->nj", self.rows[lamp], matrices)
        return towards / np.linalg.norm(towards, axis=1, keepdims=True)


def directions_from_shadows(
    level: LinearFrame, labels: VisibilityLabels, response: LightResponse, mask: Mask
) -> LampDirections:
    """Return the lamps' directions: by their colours where these are known, else by what lies in shadow.

    level: the frame as the response at its centre forms it. labels: (h, w), bit k set where lamp k arrives.
    """
    if response.light_colours is not None:
        return LampDirections(response=response, rows=response.contributions_from_rgb, deviations=np.zeros(3))
    return directions_from_unlit(unlit_by_lamp(level, labels, response, mask), response)


def unlit_by_lamp(
    level: LinearFrame, labels: VisibilityLabels, response: LightResponse, mask: Mask
) -> list[FloatArray]:
    """Return for each lamp M⁻¹ (r − a), (n, 3), of pixels that it does not reach but another does.

    Arguments as for `directions_from_shadows`. Those of several frames may be joined.
    """
    found: list[FloatArray] = []
    for k in range(3):
        pixels = _inside(labels, np.uint8(1 << k), mask)
        pixels = pixels[:: 1 + len(pixels) // _MOST_PIXELS]
        found.append((level.rgb.reshape(-1, 3)[pixels] - response.ambient) @ response.inverse.T)
    return found


def directions_from_unlit(unlit: Sequence[FloatArray], response: LightResponse) -> LampDirections:
    """Return the normals of the planes that what the lamps do not reach lies in, as the lamps' directions.

    unlit: for each lamp (n, 3), of `unlit_by_lamp`; of few, nothing is told.
    """
    rows, deviations = np.eye(3), np.full(3, np.inf)
    for k, vectors in enumerate(unlit):
        if len(vectors) >= _FEWEST_PIXELS:
            direction, deviations[k] = _normal_of_plane(vectors)
            rows[k] = response.inverse.T @ direction
    return LampDirections(response=response, rows=rows, deviations=deviations)


def _inside(labels: VisibilityLabels, bit: np.uint8, mask: Mask) -> IntArray:
    """Return flat indices of pixels that one lamp does not reach but another does; so their neighbours."""
    alike = mask & (labels & bit == 0) & (labels != 0)
    inner = cv2.erode(alike.astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0.0)
    return np.flatnonzero(inner)


def _normal_of_plane(vectors: FloatArray) -> tuple[Vector3, float]:
    """Return the normal of the plane through 0 of vectors (n, 3), towards the viewer, and its deviation."""
    vectors = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-9)
    weight = np.ones(len(vectors))
    for _ in range(_ROUNDS):
        squares, axes = np.linalg.eigh((vectors * weight[:, None]).T @ vectors)
        off = vectors @ axes[:, 0]
        scale = max(_TUNING * robust_deviation(off), 1e-6)
        weight = 1.0 / (1.0 + (off / scale) ** 2) ** 2
    across, along, longest = np.sqrt(np.maximum(squares, 0.0))
    deviation = np.hypot(across, _LEAST_OFFSET * longest) / max(along, 1e-9)
    normal = axes[:, 0] * -np.copysign(1.0, axes[2, 0])
    return normal, float(deviation)

"""The light response, r = M n + a: constant or varying over the image, as the forward model and inverted."""

from dataclasses import dataclass, field, replace

import numpy as np

from vntoolkit.arrays import FloatArray, Int64Array, Matrix3, Vector3
from vntoolkit.checks import set_arrays
from vntoolkit.errors import BadRig

_LARGEST_CONDITION_NUMBER = 1e4  # beyond it one grey level of noise turns a normal by tens of degrees
_FAINTEST = 1e-12  # of M: no sensor resolves it; squares of M and M⁻¹ stay within single precision
HIGHEST_DEGREE = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class LightResponse:
    """M and ambient light (equation 1, and the 3×4 model of Section IV as matrix plus ambient).

    matrix: (3, 3), rows are the channels R, G, B, columns the normal's x, y, z in the camera frame; the
    calibration material's albedo is a factor of it. ambient: (3,) colour that does not depend on the normal.
    light_colours: (3, 3), row k = colour c_k of light k, or None where not known; then
    matrix = Σ_k c_k l_kᵀ and `light_directions` gives the rows l_k. light_doubts_deg: (3,) standard
    deviations of these directions, where shadows on a subject told them; None for exact. variation: how M and
    ambient change over the image, or None where they do not; with it, `matrix` and everything derived from it
    hold at its centre.
    """

    matrix: Matrix3
    ambient: Vector3 = field(default_factory=lambda: np.zeros(3))
    light_colours: Matrix3 | None = None
    light_doubts_deg: Vector3 | None = None
    variation: "ResponseVariation | None" = None

    def __post_init__(self) -> None:
        shapes = {"matrix": (3, 3), "ambient": (3,), "light_colours": (3, 3), "light_doubts_deg": (3,)}
        set_arrays(self, shapes, called="light response: {}", dtype=np.float64, error=BadRig)
        brightest = float(np.abs(self.matrix).max())
        if 0 < brightest < _FAINTEST or brightest > 1 / _FAINTEST:
            raise BadRig(
                f"light response: the largest number of M is {brightest:.0e}: expected about 1, the light of "
                "a surface as a share of full scale; calibrate again"
            )
        condition = self.condition_number
        if not condition < _LARGEST_CONDITION_NUMBER:
            raise BadRig(
                f"light response: M is singular (condition number {condition:.3g}): the three lights must "
                "differ in colour and must not lie in one plane with the surface; calibrate again"
            )
        colours = self.light_colours
        if colours is not None and not np.linalg.cond(colours) < _LARGEST_CONDITION_NUMBER:
            raise BadRig(
                "light response: the light colours are mixtures of each other, so that no colour tells the "
                "lights apart; calibrate again"
            )

    def at(self, positions_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """M (..., 3, 3) and ambient (..., 3) at pixels (..., 2)."""
        shape = np.shape(positions_px)[:-1]
        if self.variation is None:
            return np.broadcast_to(self.matrix, (*shape, 3, 3)), np.broadcast_to(self.ambient, (*shape, 3))
        monomials = self.variation.monomials(positions_px)
        matrices = self.matrix + np.tensordot(monomials, self.variation.matrices, axes=1)
        return matrices, self.ambient + monomials @ self.variation.ambients

    @property
    def is_of_changes(self) -> bool:
        """Whether M is a gel's: a surface that faces the camera adds nothing to the colour at rest."""
        return bool(np.allclose(self.matrix[:, 2], self.ambient, rtol=1e-9, atol=0.0))

    @property
    def central(self) -> "LightResponse":
        """The response at the centre of the variation, the same for all pixels."""
        return self if self.variation is None else replace(self, variation=None)

    @property
    def condition_number(self) -> float:
        """Ratio of M's largest to its smallest singular value."""
        singular = np.linalg.svd(self.matrix, compute_uv=False)
        return float(singular[0] / singular[2]) if singular[2] > 0 else float("inf")

    @property
    def inverse(self) -> Matrix3:
        """M⁻¹, (3, 3)."""
        return np.linalg.inv(self.matrix)

    @property
    def contributions_from_rgb(self) -> Matrix3:
        """(3, 3) matrix that splits a colour into the contributions of the three lights.

        Identity if the light colours are unknown: then each channel stands for one light.
        """
        if self.light_colours is None:
            return np.eye(3)
        return np.linalg.inv(self.light_colours.T)

    @property
    def direction_names(self) -> tuple[str, str, str]:
        """What the rows of `light_directions` belong to: lights, or channels where these are all we know."""
        if self.light_colours is None:
            return ("red channel", "green channel", "blue channel")
        return ("light 0", "light 1", "light 2")

    @property
    def lights(self) -> Matrix3:
        """(3, 3), row k = direction of light k times its strength, so contribution k is row k · n."""
        return self.contributions_from_rgb @ self.matrix

    @property
    def light_directions(self) -> Matrix3:
        """(3, 3), row k = unit vector from the surface towards light k.

        Where the light colours are not known, the direction of M's row k, of which channel k sees most: a
        mixture of the lights' directions, hence closer to the other two, as far as the channel sees several.
        """
        lights = self.lights
        return lights / np.linalg.norm(lights, axis=1, keepdims=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class ResponseVariation:
    """Polynomials of the pixel position (u, v), without their constant terms, which the response holds.

    M(u, v) = M + Σ_k x^i y^j matrices[k] with (i, j) = powers[k], and likewise for the ambient light, where
    x = (u − centre_u) / scale and y = (v − centre_v) / scale. (u, v) is a pixel of the image without lens
    distortion. powers: (k, 2), 1 ≤ i + j ≤ 3. matrices: (k, 3, 3). ambients: (k, 3). centre_px: (2,).
    scale_px: half the longer side of the image, so that x and y stay within ±1.
    """

    powers: Int64Array
    matrices: FloatArray
    ambients: FloatArray
    centre_px: FloatArray
    scale_px: float

    def __post_init__(self) -> None:
        called = "response variation: {}"
        set_arrays(self, {"powers": (None, 2)}, called=called, dtype=np.int64, error=BadRig)
        count = len(self.powers)
        shapes = {"matrices": (count, 3, 3), "ambients": (count, 3), "centre_px": (2,)}
        set_arrays(self, shapes, called=called, dtype=np.float64, error=BadRig)
        total = self.powers.sum(axis=1)
        if count < 1 or self.powers.min() < 0 or total.min() < 1 or total.max() > HIGHEST_DEGREE:
            raise BadRig(f"response variation: expected powers of total degree 1 to {HIGHEST_DEGREE}")
        if len(np.unique(self.powers, axis=0)) < count:
            raise BadRig("response variation: a monomial is listed twice")
        if not (np.isfinite(self.scale_px) and self.scale_px > 0):
            raise BadRig(f"response variation: expected a positive scale in pixels, got {self.scale_px:g}")

    def monomials(self, positions_px: FloatArray) -> FloatArray:
        """Return x^i y^j, (..., k), at positions (..., 2)."""
        xy = (np.asarray(positions_px, dtype=np.float64) - self.centre_px) / self.scale_px
        powers = [np.ones_like(xy)]  # by multiplication, in a tenth of the time of **
        for _ in range(HIGHEST_DEGREE):
            powers.append(powers[-1] * xy)
        return np.stack([powers[i][..., 0] * powers[j][..., 1] for i, j in self.powers.tolist()], axis=-1)


def powers_to_degree(degree: int) -> Int64Array:
    """All (i, j) with 1 ≤ i + j ≤ degree, (k, 2), by rising degree."""
    return np.array(
        [(total - j, j) for total in range(1, degree + 1) for j in range(total + 1)], dtype=np.int64
    ).reshape(-1, 2)


def rgb_from_normals(normals_in_camera: FloatArray, response: LightResponse) -> FloatArray:
    """Equation 1: r = M n (+ ambient), where all three lights reach the surface.

    normals_in_camera: (..., 3); of an image (h, w, 3) where the response varies over it. Returns (..., 3)
    linear RGB.
    """
    normals = np.asarray(normals_in_camera)
    if response.variation is None:
        return normals @ response.matrix.T + response.ambient
    matrices, ambients = response.at(_positions(None, normals))
    return np.asarray((matrices @ normals[..., None])[..., 0] + ambients)


def scaled_normals_from_rgb(
    rgb: FloatArray, response: LightResponse, positions_px: FloatArray | None = None
) -> FloatArray:
    """Equation 1 solved for the normal times the relative albedo: M⁻¹(r − a), (..., 3).

    rgb: (..., 3), whose precision counts. positions_px: (..., 2), which only a response that varies over the
    image needs; default: the pixels of an image (h, w, 3).
    """
    if response.variation is None:
        kind = np.result_type(rgb, np.float32)
        with np.errstate(invalid="ignore", over="ignore"):  # colours that are not finite stay so
            return np.asarray((rgb - response.ambient.astype(kind)) @ response.inverse.T.astype(kind))
    matrices, ambients = response.at(_positions(positions_px, rgb))
    return np.asarray(np.linalg.solve(matrices, (rgb - ambients)[..., None])[..., 0])


def _positions(positions_px: FloatArray | None, values: FloatArray) -> FloatArray:
    if positions_px is not None:
        return positions_px
    v, u = np.indices(values.shape[:2])
    return np.stack([u, v], axis=-1).astype(np.float64)


# How M changes over the picture where lamps stand near: directions turn, and light falls off with distance. A
# lamp in the direction l, at the distance d from the surface at the picture's centre, has at a place δ beside
# it, to first order in δ / d, the direction times strength l + (3 l (l·δ) − δ) / d.


def changes_of_near_lamps(response: LightResponse) -> FloatArray:
    """Return how M changes a step to the right and a step down, for each lamp, (2, 3, 3, 3).

    A step as long as the lamp is far. Element [axis, lamp] is (3, 3), a change of M.
    """
    directions = response.light_directions
    strengths = np.linalg.norm(response.lights, axis=1)[:, None]
    changes = strengths * (3 * directions.T[:2, :, None] * directions - np.eye(3)[:2, None])  # (2, lamp, 3)
    return np.einsum("ik,akj->akij", np.linalg.inv(response.contributions_from_rgb), changes)


def with_near_lamps(
    response: LightResponse,
    nearness: float | FloatArray,
    size: tuple[int, int],
    centre_px: FloatArray | None = None,
) -> LightResponse:
    """Return the response of one place with the change over the picture that near lamps make.

    nearness: half of the picture's larger side, at the surface, over the lamps' distance, one of all or (3,)
    of each. size: width and height of the picture in pixels. centre_px: (u, v) of the place, None for the
    picture's centre.
    """
    of_each = np.broadcast_to(nearness, 3)
    variation = ResponseVariation(
        powers=powers_to_degree(1),
        matrices=np.einsum("k,akij->aij", of_each, changes_of_near_lamps(response)),
        ambients=np.zeros((2, 3)),
        centre_px=(np.array(size) - 1) / 2 if centre_px is None else centre_px,
        scale_px=max(size) / 2,
    )
    return replace(response, variation=variation)

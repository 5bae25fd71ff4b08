"""The membrane's motion is found by dots and by texture, told in the right units, and lost where unseen."""

from collections.abc import Callable
from functools import cache

import cv2
import numpy as np
import pytest

from vntoolkit.tactile.dots import DotFilter
from vntoolkit.tactile.motion import Membrane, MembraneMotion
from vntoolkit.tactile.motion_maps import motion_over_picture

HEIGHT, WIDTH, CENTRE, CONTACT_PX = 200, 240, np.array([118.0, 97.0]), 34.0
MATRIX = np.array([[0.4, 0.1, -0.42], [-0.2, 0.35, -0.45], [-0.15, -0.35, -0.5]])
V, U = np.indices((HEIGHT, WIDTH)).astype(np.float64)
PLACES = np.stack([U, V], axis=-1)
Motion = Callable[[np.ndarray], np.ndarray]


def around(places: np.ndarray, reach_px: float) -> np.ndarray:
    """1 in contact, beyond it falling to 0."""
    away = np.maximum(np.linalg.norm(places - CENTRE, axis=-1) - CONTACT_PX, 0.0)
    return np.exp(-((away / reach_px) ** 2))[..., None]


def stick(share: float) -> Motion:
    return lambda places: share * np.array([6.0, -4.0]) * around(places, 30.0)


def shear(share: float) -> Motion:
    return lambda p: share * 0.12 * (p - CENTRE)[..., ::-1] * np.array([1.0, 0.0]) * around(p, 25.0)


def twist(share: float) -> Motion:
    def moved(places: np.ndarray) -> np.ndarray:
        angle = np.radians(9.0 * share) * around(places, 25.0)[..., 0]
        x, y = np.moveaxis(places - CENTRE, -1, 0)
        turned = np.stack([np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y], -1)
        return turned - (places - CENTRE)

    return moved


def slip(share: float) -> Motion:
    """The material comes along at first, and then stays, while the contact goes on: see `ball_of`."""
    return stick(min(share, 0.3))


def ball_of(name: str, share: float) -> np.ndarray:
    """Where the ball is that presses, (u, v); it slips 14 pixels."""
    return CENTRE + (np.array([14.0, 0.0]) * share if name == "slip" else 0.0)


def texture(rng: np.random.Generator, dots: bool) -> np.ndarray:
    """Paint of a gel with a margin of 20 pixels: printed dots, or a grain of two percent."""
    shape = (HEIGHT + 40, WIDTH + 40)
    if not dots:
        grain = cv2.GaussianBlur(rng.normal(size=shape), (0, 0), 1.5)
        return 1.0 + 0.02 * grain / grain.std()
    v, u = np.indices(shape)
    return np.where(np.hypot((u + 8) % 16 - 8, (v + 8) % 16 - 8) < 2.5, 0.35, 1.0)


def frame(rng: np.random.Generator, paint: np.ndarray, motion: Motion, ball: np.ndarray | None) -> np.ndarray:
    """What the camera sees of a gel whose material has moved, with a ball pressed in at a place."""
    rest = PLACES.copy()
    for _ in range(16):  # x = X + u(X); u changes by less than half of a step of x
        rest = PLACES - motion(rest)
    u, v = (np.asarray(rest[..., k] + 20, np.float32) for k in range(2))
    seen = cv2.remap(cv2.GaussianBlur(paint, (0, 0), 0.7).astype(np.float32), u, v, cv2.INTER_CUBIC)
    sine = np.zeros((HEIGHT, WIDTH, 2))
    if ball is not None:
        away = np.linalg.norm(PLACES - ball, axis=-1)
        slope = 0.55 * np.minimum(away / CONTACT_PX, np.exp(-np.maximum(away / CONTACT_PX - 1, 0) / 0.4))
        sine = slope[..., None] * (PLACES - ball) / np.maximum(away, 1e-9)[..., None]
    normals = np.concatenate([sine, -np.sqrt(1 - (sine**2).sum(-1, keepdims=True))], axis=-1)
    rgb = seen[..., None] * (normals @ MATRIX.T) + rng.normal(0, 0.003, (HEIGHT, WIDTH, 3))
    return (np.round(255 * np.clip(rgb, 0, 1)) / 255).astype(np.float32)


@cache
def followed(name: str, dots: bool) -> tuple[Membrane, MembraneMotion, Motion, np.ndarray]:
    """A gel and its motion after ten frames, the true motion, and where the ball is."""
    rng = np.random.default_rng(3)
    paint, kind = texture(rng, dots), globals()[name]
    untouched = frame(rng, paint, kind(0.0), None)
    membrane, motion = Membrane(untouched, DotFilter(untouched).dots), None
    for share in np.linspace(0.1, 1.0, 10):
        picture = membrane.picture(frame(rng, paint, kind(share), ball_of(name, share)))
        motion = membrane.follow(picture, motion)
    assert motion is not None
    return membrane, motion, kind(1.0), ball_of(name, 1.0)


@pytest.mark.parametrize("dots", [True, False], ids=["dots", "texture"])
@pytest.mark.parametrize("name", ["stick", "shear", "twist", "slip"])
def test_the_material_is_followed_to_half_a_pixel(name: str, dots: bool) -> None:
    membrane, motion, true, _ = followed(name, dots)
    error = np.linalg.norm(membrane.displacement_at_rest(motion) - true(PLACES), axis=-1)[12:-12, 12:-12]
    assert np.median(error) < 0.5
    assert np.percentile(error, 95) < 2.0
    places = motion.rest_px[motion.found]
    own = np.linalg.norm(motion.displacement_px[motion.found] - true(places), axis=-1)
    assert np.percentile(own, 95) < 1.0
    assert motion.found.mean() > 0.8
    assert (own < motion.error_px[motion.found]).mean() > 0.7  # nine of ten are meant


def test_every_third_dot_is_predicted_by_the_others() -> None:
    rng, kind = np.random.default_rng(5), twist
    paint = texture(rng, True)
    v, u = np.indices(paint.shape)
    number = np.round(u / 16) + np.round(v / 16)
    hidden = np.where(number % 3 == 0, 1.0, paint)
    untouched = frame(rng, hidden, kind(0.0), None)
    membrane = Membrane(untouched, DotFilter(untouched).dots)
    motion = membrane.follow(membrane.picture(frame(rng, hidden, kind(0.5), CENTRE)))
    motion = membrane.follow(membrane.picture(frame(rng, hidden, kind(1.0), CENTRE)), motion)
    rows, columns = np.nonzero((number % 3 == 0) & (u % 16 == 0) & (v % 16 == 0))
    places = np.column_stack([columns, rows]) - 20.0
    places = places[((places > 16) & (places < [WIDTH - 17, HEIGHT - 17])).all(axis=1)]
    told = membrane.displacement_at_rest(motion)[tuple(places.astype(int).T[::-1])]
    assert np.median(np.linalg.norm(told - kind(1.0)(places), axis=1)) < 1.0


def test_shear_twist_and_their_fields_have_units_and_signs() -> None:
    v, u = np.indices((HEIGHT, WIDTH))
    contact = np.hypot(u - CENTRE[0], v - CENTRE[1]) < CONTACT_PX
    membrane, motion, _, _ = followed("stick", True)
    told = motion_over_picture(membrane, motion, contact, 0.1)
    assert told.shear_mm == pytest.approx((0.6, -0.4), abs=0.05)
    assert abs(told.twist_deg) < 1.0
    assert told.displacement_mm.shape == (HEIGHT, WIDTH, 2)
    membrane, motion, _, _ = followed("twist", True)
    told = motion_over_picture(membrane, motion, contact, 0.1)
    assert told.twist_deg == pytest.approx(9.0, abs=1.0)
    inner = np.hypot(u - CENTRE[0], v - CENTRE[1]) < 0.6 * CONTACT_PX
    assert np.median(told.curl_deg[inner]) == pytest.approx(9.0, abs=1.5)
    assert abs(np.median(told.divergence[inner])) < 0.03
    assert motion_over_picture(membrane, motion, np.zeros_like(contact), 0.1).shear_mm is None


def test_growth_is_divergence() -> None:
    def grown(places: np.ndarray) -> np.ndarray:
        return 0.04 * (places - CENTRE)

    rng = np.random.default_rng(7)
    paint = texture(rng, True)
    untouched = frame(rng, paint, stick(0.0), None)
    membrane = Membrane(untouched, DotFilter(untouched).dots)
    motion = membrane.follow(membrane.picture(frame(rng, paint, grown, None)))
    told = motion_over_picture(membrane, motion, np.zeros((HEIGHT, WIDTH), bool), 0.1)
    assert np.median(told.divergence) == pytest.approx(1.04**2 - 1, abs=0.02)


def test_what_is_covered_is_lost_and_what_is_no_gel_has_no_points() -> None:
    rng = np.random.default_rng(2)
    paint = texture(rng, True)
    untouched = frame(rng, paint, stick(0.0), None)
    membrane = Membrane(untouched, DotFilter(untouched).dots)
    picture = membrane.picture(frame(rng, np.ones_like(paint), stick(0.0), None))
    assert not membrane.follow(picture).found.any()
    blank = Membrane(np.full((40, 40, 3), 0.5, np.float32), np.zeros((40, 40), bool))
    assert not blank.follow(blank.picture(np.full((40, 40, 3), 0.5, np.float32))).found.any()
    tiny = Membrane(np.full((8, 8, 3), 0.5, np.float32), np.eye(8, dtype=bool))
    assert not tiny.is_followable
    nothing = motion_over_picture(tiny, tiny.follow(tiny.picture(tiny.untouched)), np.eye(8, dtype=bool), 0.1)
    assert not nothing.seen.any()

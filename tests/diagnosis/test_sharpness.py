"""Blur is measured at the subject's outline, within a tenth, and not where the surface only turns away."""

import cv2
import numpy as np
import pytest

from vntoolkit.diagnosis.sharpness import colour_is_interpolated, findings_from_sharpness, fit_sharpness
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.simulation.nuisances import mosaic_from_rgb, rgb_from_mosaic

SIZE, FINER = 240, 6
LIGHTS = np.array([[0.5, 0.1, -0.85], [-0.4, 0.45, -0.8], [-0.1, -0.5, -0.85]])


def finely(shade):
    """Return light (1440, 1440, 3) that `shade` makes of places x, y in pixels from the picture's centre."""
    y, x = (np.mgrid[: SIZE * FINER, : SIZE * FINER] + 0.5) / FINER - SIZE / 2
    return shade(x, y).astype(np.float32)


def sheet(x, y, turn=0.4):
    """A bent sheet whose borders run at an angle, before the dark."""
    along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    bend = 0.2 * np.sin(x / 25) + 0.15 * np.cos(y / 20)
    light = np.stack([0.5 + 0.25 * c * bend for c in (1.0, -0.6, 0.4)], axis=-1)
    return light * ((np.abs(along) < 80) & (np.abs(across) < 60))[..., None]


def ball(x, y):
    """A ball, whose light falls towards its outline."""
    square = (x**2 + y**2) / 90**2
    z = np.sqrt(np.maximum(1 - square, 0))
    light = np.maximum(np.stack([x / 90, y / 90, -z], axis=-1) @ LIGHTS.T, 0)
    return 0.7 * light * (square < 1)[..., None]


def filmed(fine, rng, blur_px=0.5, kernel=None, noise=0.004):
    """Return a frame: the lens's blur, then pixels that add up the light on them, then noise."""
    if kernel is not None:
        fine = cv2.filter2D(fine, -1, kernel)
    fine = cv2.GaussianBlur(fine, (0, 0), blur_px * FINER)
    light = cv2.resize(fine, (SIZE, SIZE), interpolation=cv2.INTER_AREA)
    return LinearFrame(rgb=np.clip(light + rng.normal(0, noise, light.shape), 0, 1).astype(np.float32))


def names(frame):
    seen = fit_sharpness([frame])
    return [] if seen is None else [finding.check for finding in findings_from_sharpness(seen)]


@pytest.mark.parametrize("blur_px", [0.5, 1.0, 2.0, 3.0])
def test_blur_is_measured_within_a_tenth_or_a_fifteenth_of_a_pixel(rng, blur_px):
    seen = fit_sharpness([filmed(finely(sheet), rng, blur_px)])
    assert seen is not None
    assert seen.blur_px == pytest.approx(blur_px, rel=0.1, abs=0.07)
    assert seen.widest_px == pytest.approx(seen.blur_px, rel=0.1)
    assert [finding.check for finding in findings_from_sharpness(seen)] == (["blur"] if blur_px > 1.5 else [])


def test_a_surface_that_turns_away_is_not_blurred(rng):
    """The light of a ball falls over more pixels than any blur here; blur shows all the same."""
    assert not names(filmed(finely(ball), rng))
    assert names(filmed(finely(ball), rng, 2.0)) == ["blur"]


def test_motion_blurs_across_its_direction_only(rng):
    path = np.full((1, 6 * FINER), 1 / (6 * FINER), np.float32)
    seen = fit_sharpness([filmed(finely(lambda x, y: sheet(x, y, 0.1)), rng, kernel=path)])
    assert seen is not None
    assert seen.blur_px < 1.5 < seen.widest_px
    assert seen.widest_px == pytest.approx(6 / np.sqrt(12), rel=0.3)
    assert "expose shorter" in findings_from_sharpness(seen)[0].text


def test_sharpening_is_told_from_a_smaller_picture_and_from_noise(rng):
    frame = filmed(finely(sheet), rng)
    light = np.asarray(frame.rgb)
    mask = light - cv2.GaussianBlur(light, (0, 0), 1.0)
    assert names(LinearFrame(rgb=np.clip(light + mask, 0, 1))) == ["sharpening"]
    for smaller in (cv2.INTER_AREA, cv2.INTER_LANCZOS4):
        assert not names(LinearFrame(rgb=np.clip(cv2.resize(light, (160, 160), interpolation=smaller), 0, 1)))
    assert not names(filmed(finely(sheet), rng, noise=0.03))


def test_sharpening_makes_the_background_darker_beside_a_ball(rng):
    """Light that falls towards the outline hides a bright rim; the background shows a dark one."""
    dark = filmed(finely(lambda x, y: ball(x, y) + 0.02), rng)
    light = np.asarray(dark.rgb)
    rim = light - cv2.GaussianBlur(light, (0, 0), 1.0)
    assert not names(dark)
    assert names(LinearFrame(rgb=np.clip(light + rim, 0, 1))) == ["sharpening"]
    blurred = cv2.GaussianBlur(light, (0, 0), 1.0)
    assert not names(LinearFrame(rgb=blurred))


def test_a_mosaic_is_told_from_noise_and_from_blur(rng):
    light = np.asarray(filmed(finely(sheet), rng, noise=0.0).rgb)
    noisy = np.clip(light + rng.normal(0, 0.01, light.shape), 0, 1).astype(np.float32)
    assert colour_is_interpolated(LinearFrame(rgb=rgb_from_mosaic(mosaic_from_rgb(noisy))))
    assert not colour_is_interpolated(LinearFrame(rgb=noisy))
    assert not colour_is_interpolated(LinearFrame(rgb=cv2.GaussianBlur(noisy, (0, 0), 0.7)))


def test_nothing_is_said_without_an_outline(rng):
    """A surface that fills the picture, noise, and an outline that is clipped."""
    bent = finely(
        lambda x, y: 0.5 + 0.2 * np.stack([np.sin(x / 25), np.cos(y / 20), np.sin(y / 30)], axis=-1)
    )
    assert fit_sharpness([filmed(bent, rng, 2.0)]) is None
    assert fit_sharpness([LinearFrame(rgb=rng.random((SIZE, SIZE, 3)).astype(np.float32))]) is None
    frame = filmed(finely(sheet), rng, 2.0)
    clipped = LinearFrame(rgb=frame.rgb, clipped=np.asarray(frame.rgb).max(axis=2) > 0.3)
    assert fit_sharpness([clipped]) is None
    seen = fit_sharpness([frame], mask=np.asarray(frame.rgb).max(axis=2) > 0.2)
    assert seen is not None
    assert seen.blur_px == pytest.approx(2.0, rel=0.1)

"""A Bayer pattern: it is seen in the picture, and what it left out is interpolated from light."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tests.materials.test_likeliest_light import COLOURS, DIRECTIONS, NOISE, RESPONSE, dome, errors_deg
from vntoolkit.arrays import FloatArray
from vntoolkit.materials.mosaic import red_of_mosaic
from vntoolkit.materials.pixels import ANY, Seams, near_seams
from vntoolkit.materials.relighting import relit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.simulation.nuisances import mosaic_from_rgb, rgb_from_mosaic

LEVEL = 1 / 255
YARNS = np.array([[0.57, 0.46, 0.31], [0.87, 0.28, 0.24]])
PATTERNS = [(row, column) for row in (0, 1) for column in (0, 1)]
SEAMS = Seams(blur_px=1.0, tolerance=0.02**2, steps=0.015**2, noise=NOISE)


def through_mosaic(rgb: FloatArray, red: tuple[int, int]) -> FloatArray:
    """What a camera makes of light (h, w, 3) where each pixel measures one colour; red: where it is first."""
    (row, column), (h, w) = red, rgb.shape[:2]
    wide = np.pad(rgb, ((row, 0), (column, 0), (0, 0)), "reflect").astype(np.float32)
    return rgb_from_mosaic(mosaic_from_rgb(wide))[-h:, -w:]


def cloth(labels: FloatArray, noise: float = LEVEL) -> tuple[FloatArray, FloatArray]:
    """Light (h, w, 3) of a knitted dome in two yarns, through a lens, with noise; and its normals."""
    normals, _ = dome(labels.shape[0])
    v, u = np.indices(labels.shape)
    normals[..., 0] += 0.15 * np.sin(2.1 * v) * np.sin(1.7 * u)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    light = gaussian_filter(
        np.maximum(normals @ DIRECTIONS.T, 0.0) * YARNS[labels] @ COLOURS, (0.6, 0.6, 0.0)
    )
    return light + np.random.default_rng(0).normal(0.0, noise, light.shape), normals


@pytest.mark.parametrize("red", PATTERNS)
def test_every_pattern_is_seen_in_eight_bits(red: tuple[int, int]) -> None:
    _, mask = dome()
    rgb, _ = cloth((np.indices(mask.shape)[1] // 12 % 2).astype(np.uint8))
    seen = np.rint(through_mosaic(rgb, red) * 255) / np.float32(255)
    assert red_of_mosaic(seen.astype(np.float32), mask) == red


def test_pixels_that_measured_all_colours_have_no_pattern() -> None:
    _, mask = dome()
    rgb, _ = cloth((np.indices(mask.shape)[1] // 12 % 2).astype(np.uint8))
    assert red_of_mosaic(rgb.astype(np.float32), mask) is None
    assert red_of_mosaic(through_mosaic(rgb, (0, 0)), mask & (np.indices(mask.shape)[0] < 8)) is None


@pytest.mark.parametrize("red", PATTERNS)
def test_light_on_the_calibration_material_stays_as_it_was_interpolated(red: tuple[int, int]) -> None:
    _, mask = dome(101)
    rgb, _ = cloth(np.zeros(mask.shape, np.uint8))
    frame = LinearFrame(through_mosaic(rgb, red))
    seams = SEAMS._replace(steps=ANY, tolerance=ANY, red=red)
    labels, rho = np.zeros(mask.shape, np.uint8), np.array([[1.0, 1.0, 1.0], YARNS[1]])
    for box in (None, (slice(10, 77), slice(7, 90))):
        inside = np.zeros_like(mask) if box else mask
        inside[box or ...] = mask[box or ...]
        found = relit(frame, RESPONSE, labels, rho, seams=seams, mask=inside, box=box).rgb
        assert np.abs(found - frame.rgb)[2:-2, 2:-2][inside[2:-2, 2:-2]].max() < 1e-4


@pytest.mark.parametrize("red", PATTERNS)
def test_light_on_a_print_is_more_exact_when_it_is_interpolated_after_the_division(
    red: tuple[int, int],
) -> None:
    _, mask = dome()
    v, u = np.indices(mask.shape)
    labels = ((u + v // 3) // 12 % 2).astype(np.uint8)
    rgb, normals = cloth(labels, noise=0.3 * LEVEL)
    frame = LinearFrame(through_mosaic(rgb, red))
    inner = mask & (np.hypot(v - 59.5, u - 59.5) < 50)
    beside, within = inner & near_seams(labels, 2), inner & ~near_seams(labels, 4) & (labels == 1)
    as_seen, as_measured = (
        errors_deg(
            relit(frame, RESPONSE, labels, YARNS, seams=SEAMS._replace(red=each), mask=mask), normals, mask
        )
        for each in (None, red)
    )
    assert as_measured[beside].mean() < 0.8 * as_seen[beside].mean()
    assert as_measured[within].mean() < as_seen[within].mean()

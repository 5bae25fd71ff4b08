"""Heights, filters, curvature and roughness on surfaces whose values are known."""

import io

import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit
from vntoolkit.inspection.curvature import curvature, signed_picture
from vntoolkit.inspection.heights import HeightMap, heights_from_depth
from vntoolkit.inspection.roughness import roughness, surface_file

HEIGHT, WIDTH = 160, 240
V, U = np.mgrid[:HEIGHT, :WIDTH].astype(float)
EVERYWHERE = np.ones((HEIGHT, WIDTH), bool)
ROUND = (U - 120) ** 2 / 110**2 + (V - 80) ** 2 / 70**2 < 1


def sine(amplitude: float, wavelength: float, mask: np.ndarray = EVERYWHERE) -> HeightMap:
    return HeightMap(heights=amplitude * np.sin(2 * np.pi * U / wavelength), mask=mask, pitch=(1.0, 1.0))


@pytest.mark.parametrize("perspective", [False, True], ids=["orthographic", "perspective"])
def test_heights_over_a_tilted_plane_lose_its_tilt_and_keep_lengths(perspective: bool) -> None:
    """A step of 0.002 on a plane tilted by 20 degrees; the pitch is that along the plane."""
    camera = Camera.orthographic(width=WIDTH, height=HEIGHT, pixels_per_unit=1000.0)
    if perspective:
        camera = Camera.pinhole(width=WIDTH, height=HEIGHT, focal_px=2000.0)
    rays = camera.unproject(camera.pixel_grid(), np.ones((HEIGHT, WIDTH)))
    normal = np.array([np.sin(0.35), 0.0, -np.cos(0.35)])
    step = np.where(
        np.abs(U - 119.5) // 20 % 2 == 1, 0.001, -0.001
    )  # alike on both sides: no tilt of its own
    if perspective:
        depth = (2.0 * normal[2] + step) / (rays @ normal)
    else:
        depth = (2.0 * normal[2] + step - rays[..., 0] * normal[0]) / normal[2]
    depth_map = DepthMap(depth=depth.astype(np.float32), mask=EVERYWHERE, unit=LengthUnit.METRE)
    found = heights_from_depth(depth_map, camera, factor=1000.0)
    apart = found.heights[step > 0].mean() - found.heights[step < 0].mean()
    assert apart == pytest.approx(2.0, abs=0.01)
    assert found.pitch[0] == pytest.approx(1.0 / np.cos(0.35), rel=0.02)
    assert found.pitch[1] == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize("mask", [EVERYWHERE, ROUND], ids=["everywhere", "round"])
def test_half_of_the_amplitude_passes_at_the_cutoff(mask: np.ndarray) -> None:
    inner = ROUND & (np.abs(U - 120) < 60) & (np.abs(V - 80) < 40)
    waves = sine(1.0, 20.0, mask)
    for cutoff in (10.0, 20.0, 40.0):
        low = waves.part(longest=None, shortest=cutoff).heights[inner]
        high = waves.part(longest=cutoff, shortest=None).heights[inner]
        assert np.abs(high).max() == pytest.approx(1 - 0.5 ** ((cutoff / 20.0) ** 2), abs=0.01)
        assert np.abs(low).max() == pytest.approx(0.5 ** ((cutoff / 20.0) ** 2), abs=0.01)


def test_a_slope_over_the_rim_of_the_mask_leaves_no_relief() -> None:
    slope = HeightMap(heights=0.3 * U - 0.2 * V, mask=ROUND, pitch=(1.0, 1.0))
    assert np.abs(slope.part(longest=30.0, shortest=None).heights).max() < 1e-4


def test_a_ball_has_one_curvature_whatever_is_printed_on_it_and_a_dent_has_its_negative() -> None:
    camera, radius = Camera.orthographic(width=WIDTH, height=HEIGHT), 100.0
    centre = np.array([120.0, 80.0, 300.0])
    inside = (U - 120) ** 2 + (V - 80) ** 2 < 60**2
    for sign in (1.0, -1.0):
        rise = np.sqrt(np.where(inside, radius**2 - (U - 120) ** 2 - (V - 80) ** 2, 1.0))
        points = camera.points_from_depth(300.0 - sign * rise)
        points -= points[80, 120] - np.array([120.0, 80.0, points[80, 120][2]])
        normals = sign * (points - centre) / radius
        mean, gaussian, known = curvature(points, normals, inside)
        assert known.sum() > 0.9 * inside.sum()
        np.testing.assert_allclose(mean[known], sign / radius, rtol=1e-6)
        np.testing.assert_allclose(gaussian[known], 1 / radius**2, rtol=1e-6)


def test_a_cylinder_has_no_gaussian_curvature() -> None:
    angle = (U - 120) / 100.0
    normals = np.stack([np.sin(angle), 0 * U, -np.cos(angle)], axis=-1)
    points = np.stack([100 * np.sin(angle), V, -100 * np.cos(angle)], axis=-1)
    mean, gaussian, known = curvature(points, normals, EVERYWHERE)
    np.testing.assert_allclose(mean[known], 0.005, rtol=1e-6)
    assert np.abs(gaussian[known]).max() < 1e-12


def test_roughness_of_a_sine_by_iso_25178() -> None:
    """Sa = 2A/π, Sq = A/√2, Sz = 2A, no skewness, a kurtosis of 3/2; sampled 48 times a period."""
    found = roughness(sine(1.5, 48.0))
    assert found["Sa"] == pytest.approx(2 * 1.5 / np.pi, rel=2e-3)
    assert found["Sq"] == pytest.approx(1.5 / np.sqrt(2), rel=1e-3)
    assert found["Sz"] == pytest.approx(3.0, rel=1e-3)
    assert found["Ssk"] == pytest.approx(0.0, abs=1e-6)
    assert found["Sku"] == pytest.approx(1.5, rel=1e-3)


def test_what_is_not_measured_counts_for_no_roughness() -> None:
    waves = sine(1.5, 24.0, (U < 120) | (V < 80))
    spoilt = HeightMap(heights=np.where(waves.mask, waves.heights, 99.0), mask=waves.mask, pitch=waves.pitch)
    assert roughness(spoilt)["Sq"] == pytest.approx(1.5 / np.sqrt(2), rel=5e-3)


@pytest.mark.parametrize("kind", ["sur", "x3p"])
def test_height_files_come_back_with_their_gaps_and_lengths(kind: str) -> None:
    from surfalize import Surface

    heights = HeightMap(heights=sine(0.01, 24.0).heights, mask=ROUND, pitch=(0.05, 0.04))
    read = Surface.load(io.BytesIO(surface_file(heights, kind, micrometres=1000.0)), format=f".{kind}")
    assert (read.step_x, read.step_y) == (pytest.approx(50.0), pytest.approx(40.0))
    assert np.ptp(read.data[ROUND]) == pytest.approx(20.0, rel=1e-2)
    assert np.isnan(read.data[~ROUND]).all()


def test_a_line_has_lengths_and_gaps() -> None:
    waves = HeightMap(heights=0.5 * U, mask=U != 60, pitch=(0.1, 0.2))
    lengths, heights = waves.along((0, 10), (100, 10))
    assert lengths[-1] == pytest.approx(10.0)
    np.testing.assert_allclose(heights[:50], 0.5 * np.arange(50))
    assert np.isnan(heights[60])
    assert np.isfinite(heights[62])
    for start, end in (((0, 0), (240, 0)), ((-1, 0), (5, 5)), ((5, 5), (5, 5))):
        with pytest.raises(BadInput, match="line: expected two pixels"):
            waves.along(start, end)


def test_pixels_on_a_line_are_no_surface() -> None:
    camera = Camera.orthographic(width=WIDTH, height=HEIGHT)
    for mask in (V == 80, (V == 80) & (U == 3)):
        with pytest.raises(BadInput, match="heights: expected a surface, got pixels on a line"):
            heights_from_depth(DepthMap(depth=np.where(mask, 1.0, 0), mask=mask), camera)


def test_signs_have_colours() -> None:
    picture = signed_picture(np.array([[1.0, -1.0, 0.0, 9.0]]), np.array([[True, True, True, False]]))
    assert picture[0, 0, 0] > picture[0, 0, 2]
    assert picture[0, 1, 2] > picture[0, 1, 0]
    assert picture[0, 2].tolist() == [255, 255, 255]
    assert picture[0, 3].tolist() == [128, 128, 128]

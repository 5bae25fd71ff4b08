"""A drawn ball, found or masked, gives its response back under both cameras."""

import numpy as np
import pytest

from tests.attached_shadow import shaded_rgb_from_normals
from vntoolkit.calibration.ball_outline import Circle, find_ball_outline, outline_from_mask
from vntoolkit.calibration.sphere import fit_response_to_sphere, sphere_normals
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

WIDTH, HEIGHT = 240, 180
DIRECTIONS = np.array([[0.6, 0.0, -0.8], [-0.36, 0.48, -0.8], [-0.36, -0.48, -0.8]])
COLOURS = np.array([[0.5, 0.05, 0.02], [0.06, 0.6, 0.1], [0.0, 0.1, 0.4]])
RESPONSE = LightResponse(matrix=COLOURS.T @ DIRECTIONS, light_colours=COLOURS)
OVERSAMPLING = 4


def draw_ball(camera: Camera, centre: np.ndarray, radius: float, rng, background: float = 0.01):
    """Ray-cast a ball (centre and radius in the camera frame), averaged over subpixels; frame and mask."""
    steps = (np.arange(OVERSAMPLING) + 0.5) / OVERSAMPLING - 0.5
    total, cover = np.zeros((camera.height, camera.width, 3)), np.zeros((camera.height, camera.width))
    for du in steps:
        for dv in steps:
            pixels = camera.pixel_grid() + np.array([du, dv])
            near = camera.unproject(pixels, np.ones(pixels.shape[:2]))
            if camera.is_perspective:
                direction, origin = near / np.linalg.norm(near, axis=-1, keepdims=True), np.zeros(3)
            else:
                direction, origin = np.array([0.0, 0, 1]), near - [0, 0, 1]
            along = np.sum((centre - origin) * direction, axis=-1)
            gap = radius**2 - (np.sum((centre - origin) ** 2, axis=-1) - along**2)
            hit = gap > 0
            point = origin + (along - np.sqrt(np.maximum(gap, 0)))[..., None] * direction
            colour = shaded_rgb_from_normals((point - centre) / radius, RESPONSE)
            total += np.where(hit[..., None], colour, background)
            cover += hit
    rgb = total / OVERSAMPLING**2 + rng.normal(0, 0.002, total.shape)
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(cover.shape, bool))
    return frame, cover >= OVERSAMPLING**2 / 2


ORTHOGRAPHIC = Camera.orthographic(width=WIDTH, height=HEIGHT)
PINHOLE = Camera.pinhole(width=WIDTH, height=HEIGHT, focal_px=300)
BALLS = {
    "orthographic": (ORTHOGRAPHIC, np.array([10.3, -4.6, 200.0]), 70.4),
    "perspective": (PINHOLE, np.array([0.12, -0.05, 1.0]), 0.2),
}


@pytest.mark.parametrize("with_mask", [True, False])
@pytest.mark.parametrize("camera_name", list(BALLS))
def test_ball_gives_the_response(rng, camera_name, with_mask) -> None:
    camera, centre, radius = BALLS[camera_name]
    frame, mask = draw_ball(camera, centre, radius, rng)
    result = fit_response_to_sphere(frame, camera, mask if with_mask else None)
    # half a pixel of outline on a radius of 60 to 70 pixels is half a degree
    np.testing.assert_allclose(result.fit.response.matrix, RESPONSE.matrix, atol=0.012)
    assert result.fit.quality.residual_deg < 0.8
    assert result.fit.quality.cone_deg > 40
    assert result.fit.quality.method == "sphere"
    assert np.nanmedian(result.residual_deg) == pytest.approx(result.fit.quality.residual_deg, abs=0.02)


def test_normals_of_a_perspective_ball_are_those_of_the_ray_cast(rng) -> None:
    camera, centre, radius = BALLS["perspective"]
    turn = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    # the outline: points of the ball whose normals are square to the viewing ray
    distance = np.linalg.norm(centre)
    axis = centre / distance
    across = np.cross(axis, [0, 1, 0.0])
    across /= np.linalg.norm(across)
    ring = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * np.cross(axis, across)
    sine = radius / distance
    points = centre + radius * (np.sqrt(1 - sine**2) * ring - sine * axis)
    outline = Circle(centre_px=np.zeros(2), radius_px=1.0, points_px=camera.project(points), arc=1.0)
    normal_map = sphere_normals(outline, camera)
    rays = camera.unproject(camera.pixel_grid(), np.ones((HEIGHT, WIDTH)))
    v, u = np.nonzero(normal_map.mask)
    on_ball = centre + radius * normal_map.normals_in_camera[v, u]
    np.testing.assert_allclose(on_ball / on_ball[:, 2:], rays[v, u], atol=1e-5)


def test_outline_is_found_to_a_fraction_of_a_pixel_in_spite_of_a_neighbour(rng) -> None:
    camera, centre, radius = BALLS["orthographic"]
    frame, mask = draw_ball(camera, centre, radius, rng)
    rgb = frame.rgb.copy()
    rgb[150:, 100:140] = 0.3  # a stand that touches the ball
    found = find_ball_outline(LinearFrame(rgb=rgb, clipped=frame.clipped))
    truth = camera.project(centre)
    np.testing.assert_allclose(found.centre_px, truth, atol=0.4)
    assert found.radius_px == pytest.approx(radius, abs=0.4)
    masked = outline_from_mask(mask)
    np.testing.assert_allclose(masked.centre_px, truth, atol=0.2)
    assert masked.radius_px == pytest.approx(radius, abs=0.3)


def test_refusals(rng) -> None:
    camera, centre, radius = BALLS["orthographic"]
    frame, mask = draw_ball(camera, centre, radius, rng)
    stripes = np.zeros_like(frame.rgb)
    stripes[20:160, 100:110] = 0.5
    grey = np.repeat(frame.rgb[..., :1], 3, axis=2)

    def of(rgb, clipped=frame.clipped):
        return LinearFrame(rgb=rgb, clipped=clipped)

    for error, line, *given in (
        (BadCalibration, "black", of(np.zeros_like(frame.rgb)), camera),
        (BadCalibration, "clipped", of(np.ones_like(frame.rgb), ~frame.clipped), camera),
        (BadCalibration, "no ball found", of(stripes), camera),
        (BadCalibration, "not a circle", frame, camera, stripes[..., 0] > 0),
        (BadInput, "mask: expected shape 180 × 240", frame, camera, mask[:-1]),
        (BadInput, "mask is empty", frame, camera, np.zeros_like(mask)),
        (BadCalibration, "singular", of(grey), camera, mask),
        (
            BadCalibration,
            r"mask lies beside the ball by \(-9, -?0\) pixels",
            frame,
            camera,
            np.roll(mask, 9, 1),
        ),
    ):
        with pytest.raises(error, match=line):
            fit_response_to_sphere(*given)
    fit_response_to_sphere(frame, camera, np.roll(mask, 1, axis=1))  # a mask by hand


def test_a_shiny_ball_is_named(rng) -> None:
    camera, centre, radius = BALLS["orthographic"]
    _, mask = draw_ball(camera, centre, radius, rng)
    normals = sphere_normals(outline_from_mask(mask), camera).normals_in_camera
    halfway = DIRECTIONS + np.array([0, 0, -1])
    halfway /= np.linalg.norm(halfway, axis=1, keepdims=True)
    spots = np.maximum(normals @ halfway.T, 0) ** 400 * 0.9  # each lamp's mirror image
    rgb = np.where(mask[..., None], spots + rng.normal(0, 0.001, spots.shape), 0.0)
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(mask.shape, bool))
    with pytest.raises(BadCalibration, match="shiny"):
        fit_response_to_sphere(frame, camera, mask)

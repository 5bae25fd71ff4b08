import cv2
import numpy as np
import pytest

from tests.evaluation.seen_cylinder import cylinder_normals
from vntoolkit.errors import BadInput, SolverFailed
from vntoolkit.evaluation.angular_error import compare_normals
from vntoolkit.evaluation.cylinder import silhouette_from_image
from vntoolkit.evaluation.cylinder_fit import fit_cylinder
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap

PINHOLE = Camera.pinhole(width=480, height=360, focal_px=1350)
RADIUS, HALF_LENGTH = 0.32, 0.55
ORTHOGRAPHIC = Camera.orthographic(width=320, height=240, pixels_per_unit=170)


def trace(
    camera: Camera, axis: np.ndarray, centre: np.ndarray, pixels: np.ndarray | None = None
) -> NormalMap:
    """Ray-trace the side of a finite cylinder in its own frame, where it is x² + y² = r²."""
    pixels = camera.pixel_grid() if pixels is None else pixels
    frame, _ = np.linalg.qr(np.stack([axis, [0.3, 0.5, 0.7], [0.9, 0.1, 0.2]], axis=1))
    object_from_camera = frame[:, [1, 2, 0]].T
    near, far = (
        (camera.unproject(pixels, np.full(pixels.shape[:2], z)) - centre) @ object_from_camera.T
        for z in (4.0, 6.5)
    )
    step = far - near
    pairs = ((step, step), (near, step), (near, near))
    a, b, c = ((first[..., :2] * second[..., :2]).sum(-1) for first, second in pairs)
    under_root = b**2 - a * (c - RADIUS**2)
    point = near + ((-b - np.sqrt(np.maximum(under_root, 0))) / a)[..., None] * step
    hit = (under_root > 0) & (np.abs(point[..., 2]) < HALF_LENGTH)
    normals = point * [1, 1, 0] / RADIUS @ object_from_camera
    return NormalMap(normals_in_camera=np.where(hit[..., None], normals, 0), mask=hit)


def cover(camera: Camera, axis: np.ndarray, centre: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Share of each pixel inside; on the outline, of a random place in each of 144 squares in it."""
    grid = camera.pixel_grid()

    def inside(pixels: np.ndarray) -> np.ndarray:
        return trace(camera, axis, centre, pixels).mask | caps(camera, axis, centre, pixels)

    share = inside(grid).astype(float)
    window = np.ones((3, 3))
    outline = cv2.dilate(share, window) != cv2.erode(share, window)
    corners = np.stack(np.meshgrid(np.arange(12), np.arange(12)), axis=-1).reshape(-1, 2)
    in_square = rng.uniform(0, 1, (int(outline.sum()), len(corners), 2))
    places = grid[outline][:, None] + (corners + in_square) / 12 - 0.5
    share[outline] = inside(places).mean(axis=1)
    return share


def caps(camera: Camera, axis: np.ndarray, centre: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Where rays meet one of the two flat ends."""
    near, far = (camera.unproject(pixels, np.full(pixels.shape[:2], z)) - centre for z in (4.0, 6.5))
    step = far - near
    met = np.zeros(pixels.shape[:2], bool)
    for end in (-HALF_LENGTH, HALF_LENGTH):
        share = (end - near @ axis) / (step @ axis)
        point = near + share[..., None] * step
        met |= np.linalg.norm(point - end * axis, axis=-1) < RADIUS
    return met


def poses(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    made = []
    for t in np.linspace(0, 1, count):
        axis = np.array([0.5 * np.sin(5 * t), 1.0, 0.6 * np.cos(4 * t)])
        made.append(
            (axis / np.linalg.norm(axis), np.array([0.1 * np.sin(6 * t), 0.05 * np.cos(7 * t), 5 + 0.3 * t]))
        )
    return made


@pytest.mark.parametrize(
    "camera",
    [
        pytest.param(PINHOLE, marks=pytest.mark.slow, id="pinhole"),
        pytest.param(ORTHOGRAPHIC, marks=pytest.mark.slow, id="orthographic"),
    ],
)
def test_pose_and_radius_are_found_under_noise_and_wrong_normals(camera, rng):
    truths = poses(3)
    frames = []
    for axis, centre in truths:
        exact = trace(camera, axis, centre)
        noisy = exact.normals_in_camera + 0.08 * rng.normal(size=exact.normals_in_camera.shape)
        wrong = rng.random(exact.mask.shape) < 0.2
        noisy[wrong] = [0.3, -0.4, -0.8]
        noisy /= np.linalg.norm(noisy, axis=-1, keepdims=True)
        coverage = cover(camera, axis, centre, rng)
        frames.append((NormalMap(normals_in_camera=noisy, mask=exact.mask), coverage))
    fit = fit_cylinder(frames, camera, rng)
    for pose, (axis, centre) in zip(fit, truths, strict=True):
        across = np.rad2deg(np.arccos(min(1.0, abs(pose.axis @ axis))))
        assert across < (0.15 if camera.is_perspective else 0.3)
        nearest = centre - (centre @ axis) * axis
        if camera.is_perspective:
            assert np.linalg.norm(pose.centre) * RADIUS == pytest.approx(np.linalg.norm(nearest), rel=0.01)
        else:
            assert pose.radius == pytest.approx(RADIUS, rel=0.01)


@pytest.mark.slow
def test_normals_of_the_fit_are_those_of_the_traced_cylinder(rng: np.random.Generator) -> None:
    axis, centre = poses(3)[1]
    exact = trace(PINHOLE, axis, centre)
    fit = fit_cylinder([(exact, exact.mask)], PINHOLE, rng)
    error = compare_normals(cylinder_normals(fit[0], PINHOLE), exact)
    assert error.median_deg < 0.3  # contour points are good to a quarter pixel on 45 px of radius


def test_refusals(rng: np.random.Generator) -> None:
    axis, centre = poses(3)[1]
    exact = trace(PINHOLE, axis, centre)
    empty = NormalMap(normals_in_camera=exact.normals_in_camera, mask=np.zeros_like(exact.mask))
    with pytest.raises(BadInput, match=r"frame 0 has 0 valid normals, at least [0-9]+ are needed"):
        fit_cylinder([(empty, exact.mask)], PINHOLE, rng)
    line = NormalMap(normals_in_camera=np.tile([0, 0, -1.0], (1, 300, 1)), mask=np.ones((1, 300), bool))
    thin = Camera.pinhole(width=300, height=1, focal_px=400.0)
    with pytest.raises(BadInput, match="frame 0 has no usable silhouette"):
        fit_cylinder([(line, line.mask)], thin, rng)
    with pytest.raises(BadInput, match="cylinder: the sequence has no frame"):
        fit_cylinder([], PINHOLE, rng)
    flat = np.zeros_like(exact.normals_in_camera)
    flat[..., 2] = -1
    with pytest.raises(SolverFailed, match="frame 0 shows a plane"):
        fit_cylinder([(NormalMap(normals_in_camera=flat, mask=exact.mask), exact.mask)], PINHOLE, rng)


def test_a_silhouette_survives_noise_and_dark_sides(rng: np.random.Generator) -> None:
    axis, centre = poses(3)[1]
    exact = trace(PINHOLE, axis, centre)
    shade = np.clip(exact.normals_in_camera @ [-0.5, 0, -0.8], 0, 1) + 0.03
    rgb = np.where(exact.mask, shade, 0)[..., None] * [0.5, 0.4, 0.3] + 0.002 * rng.normal(size=(360, 480, 3))
    found = silhouette_from_image(rgb.astype(np.float32))
    assert np.mean((found > 0.5) ^ exact.mask) < 0.003
    with pytest.raises(BadInput, match="nothing is brighter"):
        silhouette_from_image(np.zeros((50, 60, 3), np.float32))

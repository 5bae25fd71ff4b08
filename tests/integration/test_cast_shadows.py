"""Steps of depth told by cast shadows."""

import numpy as np
import pytest

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.integration.cast_shadows import DepthSteps, steps_from_shadows
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.integration.slopes import rays_from_camera
from vntoolkit.options.depth import IntegrationOptions, Integrator

SHAPE = (60, 90)
EDGE = 40  # column where the far plane begins
KNOWN = np.array([0.0, np.inf, np.inf])


def orthographic() -> Camera:
    return Camera(model=CameraModel.ORTHOGRAPHIC, width=SHAPE[1], height=SHAPE[0], matrix=np.eye(3))


def lamp_from_left(tangent: float) -> FloatArray:
    lamp = np.array([-tangent, 0.0, -1.0])
    return lamp / np.linalg.norm(lamp)


def flat_normals(mask: Mask) -> FloatArray:
    normals = np.zeros((*mask.shape, 3), np.float32)
    normals[mask] = (0.0, 0.0, -1.0)
    return normals


def shadowed(first: int, last: int) -> VisibilityLabels:
    """Lamp 0 missing in columns first to last - 1."""
    labels = np.full(SHAPE, 7, np.uint8)
    labels[:, first:last] = 6
    return labels


def found(
    labels: VisibilityLabels, lamp: FloatArray, mask: Mask, camera: Camera, normals: FloatArray | None = None
) -> DepthSteps | None:
    def lamp_at(_: int, positions: FloatArray) -> FloatArray:
        return np.broadcast_to(lamp, (len(positions), 3))

    normals = flat_normals(mask) if normals is None else normals
    normal_map = NormalMap(normals_in_camera=normals, mask=mask)
    return steps_from_shadows(normal_map, labels, lamp_at, KNOWN, rays_from_camera(camera))


@pytest.mark.parametrize("integrator", [Integrator.POISSON, Integrator.DISCONTINUITY])
@pytest.mark.parametrize("tangent", [0.3, 0.6])
def test_plane_lies_as_far_behind_as_its_shadow_is_long(tangent: float, integrator: Integrator) -> None:
    mask, camera = np.ones(SHAPE, np.bool_), orthographic()
    length = 12
    steps = found(shadowed(EDGE, EDGE + length), lamp_from_left(tangent), mask, camera)
    assert steps is not None
    normal_map = NormalMap(normals_in_camera=flat_normals(mask), mask=mask)
    options = IntegrationOptions(integrator=integrator)
    depth = DepthIntegrator(camera, options).integrate(normal_map, steps).depth
    step = depth[:, EDGE + length :].mean() - depth[:, :EDGE].mean()
    assert step == pytest.approx(length / tangent, abs=0.02 * length / tangent)
    assert np.abs(np.diff(depth[:, EDGE:], axis=1)).max() < 0.5
    assert np.ptp(DepthIntegrator(camera, options).integrate(normal_map).depth) < 1e-3  # normals alone


def test_slopes_within_a_shadow_are_no_step() -> None:
    """A ramp that rises towards the lamp behind the rim makes the shadow shorter by what it rises."""
    mask, camera, lamp = np.ones(SHAPE, np.bool_), orthographic(), lamp_from_left(0.5)
    normals = flat_normals(mask)
    slope = 0.4  # depth grows to the right, so that the surface faces the lamp on the left less
    normals[:, EDGE:] = np.array([slope, 0.0, -1.0]) / np.hypot(slope, 1.0)
    steps = found(shadowed(EDGE, EDGE + 10), lamp, mask, camera, normals)
    assert steps is not None
    # the ray falls by 2 per pixel, the surface by .4
    np.testing.assert_allclose(np.abs(steps.steps), 10 * (2.0 - slope), rtol=0.01)


def test_shadow_that_runs_over_the_outline_is_at_least_as_long_as_it_is_seen() -> None:
    mask = np.ones(SHAPE, np.bool_)
    mask[:, EDGE + 8 :] = False
    steps = found(shadowed(EDGE, SHAPE[1]), lamp_from_left(0.5), mask, orthographic())
    assert steps is not None
    assert 14.0 <= np.abs(steps.steps).min() <= np.abs(steps.steps).max() <= 16.0


def test_surface_that_turns_from_the_lamp_and_back_is_no_step() -> None:
    """A trough whose far wall faces the lamp: all of the dark is explained by slopes."""
    mask, camera = np.ones(SHAPE, np.bool_), orthographic()
    lamp, steep = lamp_from_left(1.0), 1.5
    normals = flat_normals(mask)
    down, up = slice(EDGE - 10, EDGE), slice(EDGE, EDGE + 5)
    normals[:, down] = np.array([steep, 0.0, -1.0]) / np.hypot(steep, 1.0)  # falls by 15 in 10 pixels
    # the ray falls by 1 a pixel: it meets the floor 5 pixels on
    steps = found(shadowed(EDGE - 10, EDGE + 5), lamp, mask, camera, normals)
    assert steps is None, f"{up} is in the trough's own shadow"


def test_lamp_that_is_not_known_tells_nothing() -> None:
    mask = np.ones(SHAPE, np.bool_)
    labels = shadowed(EDGE, EDGE + 12)
    labels[labels == 6] = 5  # of lamp 1
    assert found(labels, lamp_from_left(0.5), mask, orthographic()) is None


def test_shadow_by_mistake_hardly_moves_what_lies_around_it() -> None:
    """A dark blot of 8 pixels on a plane, taken for a shadow."""
    mask, camera = np.ones(SHAPE, np.bool_), orthographic()
    labels = np.full(SHAPE, 7, np.uint8)
    labels[26:34, 40:48] = 6
    steps = found(labels, lamp_from_left(0.4), mask, camera)
    assert steps is not None
    normal_map = NormalMap(normals_in_camera=flat_normals(mask), mask=mask)
    depth = DepthIntegrator(camera).integrate(normal_map, steps).depth
    around = np.ones(SHAPE, np.bool_)
    around[20:40, 34:54] = False
    assert np.ptp(depth[around]) < 1.0  # where the shadow says 20


def test_perspective_rays_lead_to_the_lamp() -> None:
    """Two planes seen by a wide lens; the shadow's end is computed in space."""
    height, width, focal, near, far = 60, 90, 80.0, 1.0, 1.12
    matrix = np.array([[focal, 0.0, 44.5], [0.0, focal, 29.5], [0.0, 0.0, 1.0]])
    camera = Camera(model=CameraModel.PINHOLE, width=width, height=height, matrix=matrix)
    lamp = np.array([-0.8, 0.1, -1.0]) / np.linalg.norm([-0.8, 0.1, -1.0])
    # the rim: the column EDGE - 0.5 of the near plane
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    points = np.stack([(u - 44.5) / focal, (v - 29.5) / focal, np.ones_like(u)], axis=-1) * far
    at_near = points + lamp * ((near - far) / lamp[2])
    seen_at = at_near[..., 0] / near * focal + 44.5
    is_far = u >= EDGE
    labels = np.full((height, width), 7, np.uint8)
    labels[is_far & (seen_at < EDGE - 0.5)] = 6
    mask = np.ones((height, width), np.bool_)
    steps = found(labels, lamp, mask, camera)
    assert steps is not None
    normal_map = NormalMap(normals_in_camera=flat_normals(mask), mask=mask)
    depth = DepthIntegrator(camera).integrate(normal_map, steps).depth
    ratio = np.median(depth[:, EDGE + 10 :]) / np.median(depth[:, :EDGE])
    assert ratio - 1.0 == pytest.approx(far / near - 1.0, rel=0.15)


def test_border_along_the_light_is_no_rim() -> None:
    """A shadow's side, where what throws it ends out of sight: the lit plane beside it is the same plane."""
    mask, camera = np.ones(SHAPE, np.bool_), orthographic()
    labels = shadowed(EDGE, EDGE + 12)
    labels[30:] = 7  # lit below; the lamp stands on the left and a little below
    lamp = np.array([-0.5, 0.1, -1.0]) / np.linalg.norm([-0.5, 0.1, -1.0])
    steps = found(labels, lamp, mask, camera)
    assert steps is not None
    rims = ~steps.down
    assert np.all(steps.columns[rims] == EDGE - 1)
    assert np.count_nonzero(~rims) <= 1  # in the corner both are near

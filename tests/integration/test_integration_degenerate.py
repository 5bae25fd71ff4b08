"""Frames that ask for nothing, trust nothing, hold what is no number, or fall into a thousand parts."""

import tracemalloc

import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.evaluation.depth_error import peaks
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.integration import integrate
from vntoolkit.integration.integrate import DepthAnchor, DepthIntegrator
from vntoolkit.options.depth import IntegrationOptions, Integrator

SIZE = 48
EVERYWHERE = np.ones((SIZE, SIZE), dtype=bool)
CERTAIN = np.ones((SIZE, SIZE), dtype=np.float32)


def integrator_of(integrator: Integrator) -> DepthIntegrator:
    return DepthIntegrator(
        Camera.orthographic(width=SIZE, height=SIZE), IntegrationOptions(integrator=integrator)
    )


@pytest.mark.parametrize("weight", [None, CERTAIN], ids=["alike", "weighted"])
@pytest.mark.parametrize("integrator", [Integrator.POISSON, Integrator.DISCONTINUITY])
def test_a_flat_frame_is_flat_whatever_came_before(integrator, weight) -> None:
    flat = np.tile(np.float32([0, 0, -1]), (SIZE, SIZE, 1))
    keeps = integrator_of(integrator)
    keeps.integrate(NormalMap(normals_in_camera=peaks(SIZE)[1], mask=EVERYWHERE, weight=weight))
    found = keeps.integrate(NormalMap(normals_in_camera=flat, mask=EVERYWHERE, weight=weight))
    assert np.abs(found.depth).max() < 1e-6


@pytest.mark.parametrize("integrator", [Integrator.POISSON, Integrator.DISCONTINUITY])
def test_a_seam_of_no_confidence_does_not_part_the_surface_that_it_was_let_into(integrator, monkeypatch):
    monkeypatch.setattr(integrate, "_LEAST_WEIGHT", 0.0)
    plane = np.tile(np.float32([0.6, 0.0, -0.8]), (SIZE, SIZE, 1))
    weight = CERTAIN.copy()
    weight[:, 24] = 0.0
    normal_map = NormalMap(normals_in_camera=plane, mask=EVERYWHERE, weight=weight)
    depth = integrator_of(integrator).integrate(normal_map).depth
    assert np.allclose(np.diff(depth, axis=1), 0.75, atol=1e-3)


@pytest.mark.parametrize("integrator", list(Integrator))
def test_a_normal_that_is_no_number_is_refused_in_the_domain_only(integrator) -> None:
    normals = np.array(peaks(SIZE)[1])
    normals[3, 3] = np.nan
    with pytest.raises(BadInput, match="NaN or infinite"):
        integrator_of(integrator).integrate(NormalMap(normals_in_camera=normals, mask=EVERYWHERE))
    if integrator in (Integrator.POISSON, Integrator.DISCONTINUITY):
        mask = EVERYWHERE.copy()
        mask[3, 3] = False
        depth = integrator_of(integrator).integrate(NormalMap(normals_in_camera=normals, mask=mask)).depth
        assert np.isfinite(depth).all()


def test_anchoring_a_thousand_parts_takes_no_image_for_each() -> None:
    size = 400
    v, u = np.indices((size, size))
    mask = (v % 10 < 8) & (u % 10 < 8)  # 1600 parts of 64 pixels, as few as are anchored
    depth = np.where(mask, 5.0 + 0.001 * (v // 10) + 0.002 * u, 0.0)
    reference = DepthMap(depth=np.where(mask, 7.0 + 0.002 * u, 0.0), mask=mask, unit=LengthUnit.METRE)
    anchor = DepthAnchor(reference)
    tracemalloc.start()
    found = anchor.align(DepthMap(depth=depth, mask=mask, unit=LengthUnit.METRE))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert np.allclose(found.depth, reference.depth)
    assert peak < 20 * depth.nbytes


@pytest.mark.parametrize("perspective", [False, True], ids=["orthographic", "perspective"])
@pytest.mark.parametrize("spoilt", [[1, 1, -1], [0, 0, 0]], ids=["behind", "no length"])
@pytest.mark.parametrize("integrator", [Integrator.POISSON, Integrator.DISCONTINUITY])
def test_normals_that_no_camera_sees_are_left_out_and_said(integrator, spoilt, perspective, caplog) -> None:
    """Depth around them is that of the map whose mask leaves them out."""
    normals, seen = np.array(peaks(SIZE)[1]), EVERYWHERE.copy()
    seen[20:24, 10:30] = False
    without = NormalMap(normals_in_camera=normals, mask=seen)
    normals[20:24, 10:30] *= np.float32(spoilt)
    camera = Camera.orthographic(width=SIZE, height=SIZE)
    if perspective:
        camera = Camera.pinhole(width=SIZE, height=SIZE, focal_px=4.0 * SIZE)
    options = IntegrationOptions(integrator=integrator)
    expected = DepthIntegrator(camera, options).integrate(without)
    assert not caplog.records
    found = DepthIntegrator(camera, options).integrate(NormalMap(normals_in_camera=normals, mask=EVERYWHERE))
    assert (found.mask == seen).all()
    np.testing.assert_allclose(found.depth[seen], expected.depth[seen], atol=1e-9)  # sums of threads
    assert "80 of 2304 normals turn away from the camera or have no length" in caplog.text


def test_a_wide_lens_sees_normals_that_point_along_its_axis() -> None:
    """At 45 degrees from the axis a wall that runs away from the viewer is visible, though n_z is above 0."""
    camera = Camera.pinhole(width=SIZE, height=SIZE, focal_px=0.5 * SIZE)
    wall = np.tile(np.float32([-0.9994, 0.0, 0.0349]), (SIZE, SIZE, 1))
    behind = DepthIntegrator(camera)._unseen(wall)
    assert not behind[:, 30:].any()
    assert behind[:, :24].all()

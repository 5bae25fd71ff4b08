"""Frames that ask for nothing, trust nothing, hold what is no number, or fall into a thousand parts."""

import tracemalloc

import numpy as np
import pytest
from analytic_surfaces import peaks

from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.integration.integrate import DepthAnchor, DepthIntegrator
from vntoolkit.options.depth import IntegrationOptions, Integrator

SIZE = 48
EVERYWHERE = np.ones((SIZE, SIZE), dtype=bool)
CERTAIN = np.ones((SIZE, SIZE), dtype=np.float32)


def integrator_of(integrator: Integrator, **options: float) -> DepthIntegrator:
    return DepthIntegrator(
        Camera.orthographic(width=SIZE, height=SIZE), IntegrationOptions(integrator=integrator, **options)
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
def test_a_seam_of_no_confidence_does_not_part_the_surface_that_it_was_let_into(integrator) -> None:
    plane = np.tile(np.float32([0.6, 0.0, -0.8]), (SIZE, SIZE, 1))
    weight = CERTAIN.copy()
    weight[:, 24] = 0.0
    normal_map = NormalMap(normals_in_camera=plane, mask=EVERYWHERE, weight=weight)
    depth = integrator_of(integrator, least_weight=0.0).integrate(normal_map).depth
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

"""Depth of a simulated face whose chin throws a shadow on the neck."""

from dataclasses import replace

import numpy as np
import pytest

from vntoolkit.arrays import FloatArray
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.options.reconstruction import MaterialSearch, Product, ReconstructOptions
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene


def errors_px(found: DepthMap, truth: DepthMap, focal_px: float) -> FloatArray:
    """Differences of depth in pixels, as a pixel is long at the subject."""
    both = found.mask & truth.mask
    errors = focal_px * np.log(found.depth[both] / truth.depth[both])
    return errors - np.median(errors)


@pytest.mark.slow
@pytest.mark.parametrize("with_colours", [True, False])
def test_neck_lies_behind_the_chin_by_what_the_shadow_says(with_colours: bool) -> None:
    scene = build_scene("face", SceneOptions(width=480, height=360, seed=163))
    rendered = render_frame(scene, 0)
    response = true_response(scene, Nuisances())
    if not with_colours:  # as a board's rig: the lamps' directions are found in the shadows
        response = replace(response, light_colours=None)
    rig = Rig(camera=scene.camera, response=response)
    processor = FrameProcessor(rig, ReconstructOptions(to=Product.DEPTH, materials=MaterialSearch.CALIBRATED))
    frame = EncodedFrame(values=rendered.linear.rgb, bits=16, number=0, name="face")
    result = processor.process(frame, rendered.truth.normals.mask)
    assert result.depth_map is not None
    focal = float(scene.camera.matrix[0, 0])
    by_normals = DepthIntegrator(processor.camera).integrate(result.normal_map)
    before = errors_px(by_normals, rendered.truth.depth, focal)
    after = errors_px(result.depth_map, rendered.truth.depth, focal)
    assert np.abs(after).mean() < 0.9 * np.abs(before).mean()
    assert np.percentile(after, 5) > 0.6 * np.percentile(before, 5)  # the neck is that much too near

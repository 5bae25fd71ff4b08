import numpy as np
import pytest

from vntoolkit.evaluation.angular_error import compare_normals
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.simulation.image_formation import true_response, true_varying_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene

NEAR = Nuisances().only("near_lights")


def test_it_takes_the_error_of_near_lights_away() -> None:
    scene = build_scene("sphere", SceneOptions(width=160, height=120))
    shot = render_frame(scene, 0, nuisances=NEAR)
    truth = shot.truth.normals
    one, varying = (
        compare_normals(normals_from_frame(shot.linear, response, truth.mask), truth).median_deg
        for response in (true_response(scene, NEAR), true_varying_response(scene, NEAR))
    )
    assert varying < 0.35 * one  # what is left is depth: M is that of a plane


def test_it_is_the_true_response_at_the_centre_and_under_parallel_light() -> None:
    scene = build_scene("sphere", SceneOptions(width=160, height=120))
    found, _ = true_varying_response(scene, NEAR).at(np.array([79.5, 59.5]))
    assert found == pytest.approx(true_response(scene, NEAR).matrix, abs=2e-3)
    parallel = true_varying_response(scene, Nuisances.none())
    assert parallel.variation is None

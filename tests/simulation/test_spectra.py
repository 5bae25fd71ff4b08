"""Spectra: lamps overlap, channels cross-talk, M is the sum of the lights' parts."""

from dataclasses import replace

import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.options.simulation import Lighting, Nuisances, SceneOptions
from vntoolkit.simulation.image_formation import (
    exposure_of_scene,
    light_colour,
    light_colours_of,
    response_matrix,
    true_response,
)
from vntoolkit.simulation.lights import (
    CAMERA_DISTANCE_M,
    WAVELENGTHS_NM,
    Lights,
    camera_sensitivities,
    coloured_lamps,
    rgb_pigments,
    studio_centre,
    studio_lights,
    white_lamp,
)
from vntoolkit.simulation.scene import build_scene

ONE = np.ones_like(WAVELENGTHS_NM)


def test_each_lamp_is_strongest_in_its_own_channel_and_seen_by_all():
    colours = np.array([light_colour(lamp, ONE) for lamp in coloured_lamps()])
    assert np.diag(colours) == pytest.approx(1.0)
    off = colours[~np.eye(3, dtype=bool)]
    assert off.min() > 0.01
    assert off.max() < 0.5


def test_integral_over_wavelength_equals_a_fine_quadrature():
    fine = np.linspace(WAVELENGTHS_NM[0], WAVELENGTHS_NM[-1], 20001)
    lamp, pigment, sensors = coloured_lamps()[1], rgb_pigments()[1], camera_sensitivities()
    at = [np.interp(fine, WAVELENGTHS_NM, curve) for curve in (lamp, pigment, *sensors)]
    expected = [np.trapezoid(at[0] * at[1] * sensor, fine) for sensor in at[2:]]
    assert light_colour(lamp, pigment) == pytest.approx(expected, rel=0.01)


def test_white_lamp_is_white_to_the_camera_and_nowhere_dark():
    assert light_colour(white_lamp(), ONE) == pytest.approx(np.ones(3))
    assert white_lamp().min() > 0


def test_pigments_add_up_to_white_and_never_below_zero():
    assert rgb_pigments().sum(axis=0) == pytest.approx(1.0)
    assert rgb_pigments().min() > -1e-3


def test_m_is_the_sum_over_the_lights_and_splits_back():
    scene = build_scene("sphere", SceneOptions())
    response = true_response(scene, Nuisances())
    exposure = exposure_of_scene(scene, Nuisances())
    single = [
        response_matrix(light_colours_of(scene, exposure)[[k]], exposure.directions[[k]]) for k in range(3)
    ]
    assert response.matrix == pytest.approx(sum(single))
    assert response.light_directions == pytest.approx(exposure.directions)
    assert np.linalg.norm(response.matrix, axis=1).max() == pytest.approx(scene.exposure_level)
    assert response.condition_number < 20


def test_without_crosstalk_a_channel_sees_one_light():
    colours = true_response(build_scene("sphere", SceneOptions()), Nuisances().without("crosstalk"))
    assert np.count_nonzero(colours.light_colours) == 3
    assert np.all(np.diag(colours.light_colours) > 0)


def test_studio_is_the_paper_s():
    lights = studio_lights()
    towards = lights.positions - studio_centre()
    distance = np.linalg.norm(towards, axis=1)
    assert np.all(np.abs(distance - CAMERA_DISTANCE_M) < 0.5)
    unit = towards / distance[:, None]
    apart = np.rad2deg(np.arccos([unit[0] @ unit[1], unit[1] @ unit[2], unit[2] @ unit[0]]))
    assert np.all(np.abs(apart - 30) < 4)
    assert abs(np.linalg.det(unit)) > 0.1


def test_a_white_light_alone_takes_its_place():
    scene = build_scene("sphere", SceneOptions(lighting=Lighting.WHITE_2))
    assert len(scene.lights) == 1
    assert scene.lights.positions[0] == pytest.approx(studio_lights().positions[1])
    assert scene.lights.bits == (1,)
    assert scene.lights.spectra[0] == pytest.approx(white_lamp())


def test_no_light_or_too_many_are_refused():
    lights = studio_lights()
    with pytest.raises(BadInput, match="expected 1 to 3 of them, got 0"):
        replace(lights, positions=np.zeros((0, 3)), spectra=np.zeros((0, len(ONE))), bits=())
    with pytest.raises(BadInput, match="without negative power"):
        Lights(positions=lights.positions, spectra=-lights.spectra, ambient_spectrum=ONE)

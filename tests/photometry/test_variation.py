"""A response that varies over the image: polynomials, their file, levelling, inversion at each pixel."""

from dataclasses import replace

import numpy as np
import pytest

from vntoolkit.errors import BadRig
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.rigs import RIG_VERSION, rig_from_text, text_from_rig
from vntoolkit.normals.inversion import normals_from_frame, relative_albedo_from_frame
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.levelling import Leveller
from vntoolkit.photometry.response import (
    LightResponse,
    ResponseVariation,
    powers_to_degree,
    rgb_from_normals,
    scaled_normals_from_rgb,
)
from vntoolkit.photometry.rig import Rig

MATRIX = np.array([[0.4, 0.1, -0.42], [-0.2, 0.35, -0.45], [-0.15, -0.35, -0.5]])
COLOURS = np.array([[0.6, 0.1, 0.05], [0.08, 0.5, 0.1], [0.1, 0.15, 0.55]])  # of the three lights
HEIGHT, WIDTH = 60, 90


def varying(degree: int = 3, size: float = 0.04) -> LightResponse:
    rng = np.random.default_rng(3)
    powers = powers_to_degree(degree)
    variation = ResponseVariation(
        powers=powers,
        matrices=rng.normal(0, size, (len(powers), 3, 3)),
        ambients=rng.normal(0, size / 4, (len(powers), 3)),
        centre_px=np.array([(WIDTH - 1) / 2, (HEIGHT - 1) / 2]),
        scale_px=WIDTH / 2,
    )
    return LightResponse(matrix=MATRIX, ambient=np.array([0.05, 0.04, 0.03]), variation=variation)


def normals_of(rng: np.random.Generator) -> np.ndarray:
    normals = np.concatenate([rng.normal(0, 0.2, (HEIGHT, WIDTH, 2)), -np.ones((HEIGHT, WIDTH, 1))], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def test_a_term_adds_its_monomial_at_every_pixel() -> None:
    response = LightResponse(
        matrix=MATRIX,
        variation=ResponseVariation(
            powers=np.array([[1, 2]]),
            matrices=np.ones((1, 3, 3)),
            ambients=2 * np.ones((1, 3)),
            centre_px=np.array([10.0, 20.0]),
            scale_px=5.0,
        ),
    )
    matrices, ambients = response.at(np.array([[10.0, 20.0], [15.0, 30.0]]))
    np.testing.assert_allclose(matrices[0], MATRIX)
    np.testing.assert_allclose(matrices[1], MATRIX + 1.0 * 2.0**2)
    np.testing.assert_allclose(ambients, [[0, 0, 0], [8, 8, 8]])
    assert response.central.variation is None


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_inversion_undoes_the_forward_model_at_every_pixel(degree: int, rng) -> None:
    response, truth = varying(degree), normals_of(rng)
    rgb = rgb_from_normals(truth, response)
    np.testing.assert_allclose(scaled_normals_from_rgb(rgb, response), truth, atol=1e-10)
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(rgb.shape[:2], bool))
    result = normals_from_frame(frame, response)
    assert result.mask.all()
    np.testing.assert_allclose(result.normals_in_camera, truth, atol=2e-5)  # float32 colours through M⁻¹
    np.testing.assert_allclose(result.weight, 1, atol=1e-4)
    central = normals_from_frame(frame, response.central)
    assert np.abs(central.normals_in_camera - truth).max() > 0.05  # what the variation is for


def test_a_variation_of_nothing_changes_nothing(rng) -> None:
    response = varying(3, 0.0)
    frame = LinearFrame(
        rgb=rgb_from_normals(normals_of(rng), response.central).astype(np.float32),
        clipped=np.zeros((HEIGHT, WIDTH), bool),
    )
    a, b = normals_from_frame(frame, response), normals_from_frame(frame, response.central)
    np.testing.assert_allclose(a.normals_in_camera, b.normals_in_camera, atol=1e-6)
    assert relative_albedo_from_frame(frame, response) == pytest.approx(
        relative_albedo_from_frame(frame, response.central), rel=1e-6
    )


def test_levelling_makes_one_response_serve(rng) -> None:
    response, truth = varying(2), normals_of(rng)
    rgb = rgb_from_normals(truth, response).astype(np.float32)
    level = Leveller(response, rgb.shape[:2]).frame(
        LinearFrame(rgb=rgb, clipped=np.zeros(rgb.shape[:2], bool))
    )
    np.testing.assert_allclose(level.rgb, rgb_from_normals(truth, response.central), atol=1e-5)


def test_levelling_by_strength_leaves_a_missing_light_missing(rng) -> None:
    response, truth = replace(varying(2), light_colours=COLOURS), normals_of(rng)
    v, u = np.indices(truth.shape[:2])
    matrices, ambients = response.at(np.stack([u, v], axis=-1))
    lights = response.contributions_from_rgb @ matrices
    shares = np.einsum("vukc,vuc->vuk", lights, truth)
    shares[..., 1] = 0.0
    rgb = (shares @ COLOURS + ambients).astype(np.float32)
    frame = LinearFrame(rgb=rgb, clipped=np.zeros(rgb.shape[:2], bool))
    leveller = Leveller(response, rgb.shape[:2])

    def contributions(levelled: LinearFrame) -> np.ndarray:
        return (levelled.rgb - response.ambient) @ response.contributions_from_rgb.T

    by_strength = contributions(leveller.frame_by_strength(frame))
    part = np.s_[3:9, 5:11]
    assert np.allclose(contributions(leveller.part_by_strength(frame, part)), by_strength[part], atol=1e-6)
    for level in (leveller.frame, leveller.frame_by_strength):
        of_part = level(frame, part).rgb
        np.testing.assert_allclose(of_part[part], level(frame).rgb[part], atol=1e-6)
        assert np.count_nonzero(of_part) == of_part[part].size
    central = np.linalg.norm(response.lights, axis=1)
    expected = shares * central / np.linalg.norm(lights, axis=-1)
    np.testing.assert_allclose(by_strength, expected, atol=1e-5)
    assert (
        np.abs(by_strength[..., 1]).max() < 1e-5 < np.abs(contributions(leveller.frame(frame))[..., 1]).max()
    )


def test_the_rig_file_keeps_the_variation_and_old_files_read() -> None:
    camera = Camera.orthographic(width=WIDTH, height=HEIGHT)
    rig = Rig(camera=camera, response=varying(2))
    text = text_from_rig(rig)
    assert '"version": 2' in text
    again = rig_from_text(text).response.variation
    assert again is not None
    assert rig.response.variation is not None
    np.testing.assert_array_equal(again.powers, rig.response.variation.powers)
    np.testing.assert_array_equal(again.matrices, rig.response.variation.matrices)
    np.testing.assert_array_equal(again.ambients, rig.response.variation.ambients)
    plain = text_from_rig(Rig(camera=camera, response=rig.response.central))
    assert '"version": 1' in plain
    assert rig_from_text(plain).response.variation is None
    with pytest.raises(BadRig, match=f"is of version {RIG_VERSION + 1}"):
        rig_from_text(plain.replace('"version": 1', f'"version": {RIG_VERSION + 1}'))


def test_m_of_a_place_stays_with_it_when_the_camera_zooms() -> None:
    wide, far = (Camera.pinhole(width=WIDTH, height=HEIGHT, focal_px=f) for f in (100.0, 250.0))
    rig = Rig(camera=wide, response=varying())
    point = np.array([0.2, -0.1, 3.0])
    one, other = (each.response.at(each.camera.project(point[None])[0]) for each in (rig, rig.through(far)))
    np.testing.assert_allclose(one[0], other[0], rtol=1e-9)
    np.testing.assert_allclose(one[1], other[1], rtol=1e-9)
    flat = Camera.orthographic(width=WIDTH, height=HEIGHT)
    assert Rig(camera=wide, response=LightResponse(matrix=MATRIX)).through(flat).camera is flat
    with pytest.raises(BadRig, match="calibrate with --focal-px or --camera"):
        rig.through(flat)

"""Reflectance of vertices over many frames: the mean of what the frames tell, the sure ones most."""

import numpy as np
import pytest

from tests.materials.test_materials import DIRECTIONS
from vntoolkit.pipeline.refine_albedo import SurfaceLooks, mean_surface_reflectance

MELANIN = np.array([0.30, 0.62, 1.15])
FRAMES, VERTICES = 6, 400


def looks_of(rng: np.random.Generator, off_deg: np.ndarray) -> tuple[SurfaceLooks, np.ndarray]:
    """How vertices with freckles looked in frames whose normals are off by some degrees (f,); their paint."""
    paint = -rng.random(VERTICES)[:, None] * MELANIN
    normals = rng.normal([0.0, 0.0, -1.0], [0.3, 0.3, 0.0], (FRAMES, VERTICES, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    light = np.exp(paint) * (normals @ DIRECTIONS.T)
    found = normals + np.radians(off_deg)[:, None, None] * rng.normal(size=normals.shape)
    looks = SurfaceLooks(
        contributions=light.astype(np.float32), seen=light.min(axis=2) > 0.02,
        normals=(found / np.linalg.norm(found, axis=2, keepdims=True)).astype(np.float32),
        error_deg=np.broadcast_to(2.0 * off_deg[:, None], light.shape[:2]).astype(np.float32),
        materials=np.zeros(VERTICES, np.int64), logs=np.zeros((VERTICES, 3)),
    )  # fmt: skip
    return looks, paint


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_frames_that_know_their_normals_tell_the_reflectance(rng: np.random.Generator) -> None:
    looks, paint = looks_of(rng, np.zeros(FRAMES))
    found = mean_surface_reflectance(looks, DIRECTIONS)
    told = looks.seen.any(axis=0)
    np.testing.assert_allclose(found.logs[told], paint[told], atol=1e-4)
    assert float(found.lines[0] @ MELANIN / np.linalg.norm(MELANIN)) > 0.999


def test_many_frames_err_less_than_one_and_sure_ones_count_most(rng: np.random.Generator) -> None:
    alike, paint = looks_of(rng, np.full(FRAMES, 5.0))
    told = alike.seen.all(axis=0)
    many = mean_surface_reflectance(alike, DIRECTIONS).logs - paint
    light, arrives = alike.contributions[0], np.maximum(alike.normals[0] @ DIRECTIONS.T, 0.1)
    one = np.log(light / arrives) - paint
    assert rms(many[told]) < 0.6 * rms(one[told])
    one_sure, paint = looks_of(rng, np.array([1.0, *np.full(FRAMES - 1, 20.0)]))
    told = one_sure.seen.all(axis=0)
    found = mean_surface_reflectance(one_sure, DIRECTIONS).logs - paint
    assert rms(found[told]) < rms(many[told])


def test_a_vertex_that_no_frame_shows_has_the_reflectance_of_its_material(rng: np.random.Generator) -> None:
    looks, _ = looks_of(rng, np.zeros(FRAMES))
    looks.seen[:, :10] = False
    assert not mean_surface_reflectance(looks, DIRECTIONS).logs[:10].any()


@pytest.mark.parametrize("strength", [0.0, 1.0])
def test_the_spread_of_paint_tells_one_colour_from_many(rng: np.random.Generator, strength: float) -> None:
    looks, paint = looks_of(rng, np.full(FRAMES, 0.5))
    light = looks.contributions * np.exp((strength - 1.0) * paint)
    plain = SurfaceLooks(
        contributions=light.astype(np.float32), seen=looks.seen, normals=looks.normals,
        error_deg=looks.error_deg, materials=looks.materials, logs=looks.logs,
    )  # fmt: skip
    spread = mean_surface_reflectance(plain, DIRECTIONS).spreads[0]
    assert (spread > 0.2) == bool(strength)
    assert strength or spread < 0.03

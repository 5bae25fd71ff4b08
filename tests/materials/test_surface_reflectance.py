"""Reflectance of a surface's vertices over many frames: paint is told from relief; plain stays plain."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from tests.materials.test_materials import DIRECTIONS, angles_deg, dome
from vntoolkit.materials.surface_reflectance import (
    SurfaceLooks,
    SurfaceReflectance,
    fit_surface_reflectance,
)

MELANIN = np.array([0.30, 0.62, 1.15])
TURNS_DEG = np.linspace(-12.0, 12.0, 7)


def bumpy_dome(rng: np.random.Generator, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Normals (size, size, 3) with relief finer than the dome, and its mask."""
    normals, mask = dome(size)
    for axis in (0, 1):
        normals[..., axis] += 0.5 * gaussian_filter(rng.normal(size=(size, size)), 2.5)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True), mask


def looks_of(
    paint: np.ndarray, rng: np.random.Generator, size: int
) -> tuple[SurfaceLooks, np.ndarray, np.ndarray]:
    """How a dome of log reflectance (size, size, 3) looks while it turns; its normals (n, 3); what is lit."""
    normals, mask = bumpy_dome(rng, size)
    vertex = np.full((size, size), -1)
    vertex[mask] = np.arange(mask.sum())
    pairs = [(vertex[:, :-1], vertex[:, 1:]), (vertex[:-1], vertex[1:])]
    edges = np.concatenate(
        [np.stack([a.ravel(), b.ravel()], 1)[(a >= 0).ravel() & (b >= 0).ravel()] for a, b in pairs]
    )
    n = normals[mask]
    turns = [Rotation.from_euler("yx", [turn, 0.4 * turn], degrees=True).as_matrix() for turn in TURNS_DEG]
    arrives = np.stack([n @ turn.T @ DIRECTIONS.T for turn in turns])
    lamps = np.exp(paint[mask]) * arrives + rng.normal(0.0, 0.004, arrives.shape)
    seen = (arrives > 0.1).all(axis=2) & (lamps > 0.01).all(axis=2)
    looks = SurfaceLooks(
        contributions=lamps.astype(np.float32), seen=seen,
        turns=np.stack([np.broadcast_to(turn, (len(n), 3, 3)) for turn in turns]).astype(np.float32),
        edges=edges, materials=np.zeros(len(n), np.int64), logs=np.zeros((len(n), 3)),
    )  # fmt: skip
    return looks, n, seen.all(axis=0)


def error_deg(looks: SurfaceLooks, logs: np.ndarray, normals: np.ndarray, lit: np.ndarray) -> float:
    """Mean error of the normals of the middle frame, which is the template's pose."""
    middle = looks.contributions[len(TURNS_DEG) // 2] / np.exp(logs)
    found = middle @ np.linalg.inv(DIRECTIONS).T
    return float(angles_deg(found / np.linalg.norm(found, axis=1, keepdims=True), normals)[lit].mean())


def freckles(rng: np.random.Generator, size: int) -> np.ndarray:
    spots = gaussian_filter((rng.random((size, size)) < 0.02).astype(float), 1.2)
    return -(spots / spots.max())[..., None] * MELANIN


def test_freckles_stop_being_relief(rng: np.random.Generator) -> None:
    looks, normals, lit = looks_of(freckles(rng, 90), rng, 90)
    found = fit_surface_reflectance(looks, DIRECTIONS)
    before, after = (error_deg(looks, logs, normals, lit) for logs in (looks.logs, found.logs))
    assert before > 2.0
    assert after < 0.35 * before
    along = float(found.lines[0] @ MELANIN / np.linalg.norm(MELANIN))
    assert along > 0.98  # the footage tells the pigment's line


def test_lips_of_another_pigment_stop_being_relief(rng: np.random.Generator) -> None:
    v, u = np.indices((90, 90))
    lips = ((u - 45) / 20) ** 2 + ((v - 60) / 8) ** 2 < 1
    paint = np.where(lips[..., None], np.log([0.73, 0.46, 0.56]), 0.0) + freckles(rng, 90)
    looks, normals, lit = looks_of(gaussian_filter(paint, (0.7, 0.7, 0)), rng, 90)
    found = fit_surface_reflectance(looks, DIRECTIONS)
    inside = lit & lips[dome(90)[1]]
    before, after = (error_deg(looks, logs, normals, inside) for logs in (looks.logs, found.logs))
    assert before > 10.0
    assert after < 0.5 * before


def test_relief_in_one_colour_stays(rng: np.random.Generator) -> None:
    looks, normals, lit = looks_of(np.zeros((90, 90, 3)), rng, 90)
    found = fit_surface_reflectance(looks, DIRECTIONS)
    before, after = (error_deg(looks, logs, normals, lit) for logs in (looks.logs, found.logs))
    assert after < before + 0.1
    assert found.spreads[0] < 0.02


@pytest.mark.parametrize("frames", [1, 3])
def test_few_frames_tell_freckles_too(rng: np.random.Generator, frames: int) -> None:
    looks, normals, lit = looks_of(freckles(rng, 90), rng, 90)
    middle = len(TURNS_DEG) // 2
    kept = slice(middle - frames // 2, middle + frames // 2 + 1)
    few = SurfaceLooks(
        contributions=looks.contributions[kept], seen=looks.seen[kept], turns=looks.turns[kept],
        edges=looks.edges, materials=looks.materials, logs=looks.logs,
    )  # fmt: skip
    found: SurfaceReflectance = fit_surface_reflectance(few, DIRECTIONS)
    assert error_deg(looks, found.logs, normals, lit) < 0.6 * error_deg(looks, looks.logs, normals, lit)

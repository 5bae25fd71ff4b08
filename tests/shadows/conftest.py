"""A little stage: height fields that throw shadows on themselves under three lights, with all truth known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels
from vntoolkit.photometry.frame import LinearFrame, labels_from_lit
from vntoolkit.photometry.response import LightResponse


@dataclass(frozen=True)
class Stage:
    """What is true of one rendered height field (orthographic camera, depth in pixels)."""

    frame: LinearFrame
    response: LightResponse
    labels: VisibilityLabels
    normals: FloatArray
    depth: FloatArray
    mask: Mask


DIRECTIONS = np.array([[-0.55, -0.25, -0.8], [0.55, -0.25, -0.8], [0.0, 0.62, -0.78]])
DIRECTIONS = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
CROSSTALK = np.array([[0.9, 0.12, 0.04], [0.1, 0.8, 0.15], [0.08, 0.2, 0.75]])


def bumps(size: tuple[int, int] = (120, 160), lift: float = 1.0) -> FloatArray:
    """Depth of a gently curved plane with three steep round hills; hills are nearer."""
    v, u = np.mgrid[: size[0], : size[1]].astype(float)
    scale = size[1] / 160.0
    depth = 0.0006 / scale * ((u - size[1] / 2) ** 2 + (v - size[0] / 2) ** 2)
    for cu, cv, radius, height in ((45, 42, 14, 36), (112, 45, 16, 42), (75, 92, 13, 32)):
        squared = ((u - cu * scale) ** 2 + (v - cv * scale) ** 2) / (radius * scale) ** 2
        depth -= lift * height * scale * np.exp(-squared)
    return depth


def normals_of(depth: FloatArray) -> FloatArray:
    dv, du = np.gradient(depth)
    normals = np.stack([du, dv, -np.ones_like(depth)], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def reached(depth: FloatArray, normals: FloatArray, light: FloatArray) -> npt.NDArray[np.bool_]:
    """March towards the light over the height field, by half pixels."""
    h, w = depth.shape
    v, u = np.mgrid[:h, :w].astype(float)
    lit = normals @ light > 0
    per_pixel = light / np.hypot(light[0], light[1])
    for step in np.arange(1.0, 90.0, 0.5):
        x, y = u + per_pixel[0] * step, v + per_pixel[1] * step
        inside = (x >= 0) & (x <= w - 1) & (y >= 0) & (y <= h - 1)
        i, j = np.clip(np.rint(y), 0, h - 1).astype(int), np.clip(np.rint(x), 0, w - 1).astype(int)
        lit &= ~(inside & (depth[i, j] < depth + per_pixel[2] * step - 0.35))
    return lit


def build(
    depth: FloatArray, *, noise: float = 0.004, crosstalk: bool = False, albedo: FloatArray | float = 0.8
) -> Stage:
    normals = normals_of(depth)
    lit = np.stack([reached(depth, normals, light) for light in DIRECTIONS], axis=-1)
    cosines = np.maximum(normals @ DIRECTIONS.T, 0.0) * lit
    colours = CROSSTALK if crosstalk else np.diag([0.9, 0.85, 0.8])
    rgb = np.broadcast_to(np.asarray(albedo), depth.shape)[..., None] * (cosines @ colours)
    rgb = rgb + np.random.default_rng(5).normal(0.0, noise, rgb.shape)
    response = LightResponse(matrix=colours.T @ DIRECTIONS, light_colours=colours if crosstalk else None)
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(depth.shape, bool))
    return Stage(frame, response, labels_from_lit(lit), normals, depth, np.ones(depth.shape, bool))


@pytest.fixture(scope="session")
def stage() -> Stage:
    return build(bumps())


@pytest.fixture(scope="session")
def stage_with_crosstalk() -> Stage:
    return build(bumps(), crosstalk=True)


@pytest.fixture(scope="session")
def build_stage() -> Callable[..., Stage]:
    return build


@pytest.fixture(scope="session")
def steep_stage() -> Stage:
    """Hills so steep that their shadows end on flat ground, in crosstalk."""
    return build(bumps(lift=1.5), crosstalk=True)

"""Real one-shot captures with a reference: the same scene's normals from many lights.

FOLDER holds `coloured_light/` (three photographs stacked as R, G, B), `photometric_stereo/` (twelve lights of
the same statues, a chrome and a grey ball) and `faces/` (sixty-four flashes of the same faces).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.visibility import labels_from_lit

CAPTURES = ("buddha", "cat", "yaleB01", "yaleB02")
STATUE_LIGHTS = (0, 4, 10)
STEEPEST_FLASH_DEG = 60.0


@dataclass(frozen=True)
class ReferencedCapture:
    """A frame, its light response, and the many-light normals, labels and mask."""

    frame: LinearFrame
    response: LightResponse
    normals: np.ndarray
    labels: np.ndarray
    mask: np.ndarray


def read_capture(folder: Path, name: str) -> ReferencedCapture:
    """Read one of `CAPTURES`."""
    return _face(folder, name) if name.startswith("yale") else _statue(folder, name)


def normals_from_many_lights(
    images: np.ndarray, lights: np.ndarray, darkest: float, rounds: int = 8
) -> tuple[np.ndarray, np.ndarray]:
    """Least squares without shadow (< 0.6 of the prediction) and gloss (> 1.3): normals and albedo."""
    use = (images > darkest) & (images < 0.995)
    scaled = np.zeros((*images.shape[1:], 3))
    for i in range(rounds + 1):
        if i:
            predicted = np.einsum("kc,hwc->khw", lights, scaled)
            albedo = np.linalg.norm(scaled, axis=-1)
            use = (images > darkest) & (images < 0.995) & (predicted > 0.1 * albedo)
            use &= (images > 0.6 * predicted) & (images < 1.3 * np.maximum(predicted, 0.02))
        weight = use.astype(float)
        normal_matrix = np.einsum("khw,ki,kj->hwij", weight, lights, lights) + 1e-9 * np.eye(3)
        right = np.einsum("khw,khw,ki->hwi", weight, images, lights)
        solved = np.linalg.solve(normal_matrix, right[..., None])[..., 0]
        scaled = np.where((use.sum(axis=0) >= 3)[..., None], solved, scaled)
    albedo = np.linalg.norm(scaled, axis=-1)
    return scaled / np.maximum(albedo, 1e-9)[..., None], albedo


def _capture(rgb: np.ndarray, matrix: np.ndarray, lights: np.ndarray, reference, mask) -> ReferencedCapture:
    normals, albedo = reference
    predicted = np.einsum("kc,hwc->hwk", lights, normals) * albedo[..., None]
    labels = labels_from_lit((rgb > 0.5 * predicted) & (predicted > 0))
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=(rgb >= 0.999).any(axis=-1))
    mask = mask & (albedo > 1e-6)
    return ReferencedCapture(frame, LightResponse(matrix=matrix), normals, labels, mask)


def _statue(folder: Path, name: str) -> ReferencedCapture:
    """Directions from the chrome ball, strengths and M from the grey one."""
    stereo, coloured = folder / "photometric_stereo", folder / "coloured_light"
    ball, inside = _ball(_mask(coloured / "gray_sphere.mask.png"))
    matrix = np.array([_fit(ball, c, inside) for c in np.moveaxis(_rgb(coloured / "gray_sphere.png"), 2, 0)])
    grey = [_fit(ball, _grey(stereo / f"gray/gray.{k}.png"), inside) for k in range(12)]
    lights = _chrome_directions(stereo) * np.linalg.norm(grey, axis=1, keepdims=True)
    images = np.array([_grey(stereo / f"{name}/{name}.{k}.png") for k in range(12)])
    reference = normals_from_many_lights(images, lights, darkest=0.015)
    mask = _mask(coloured / f"{name}.mask.png")
    return _capture(_rgb(coloured / f"{name}.png"), matrix, lights[list(STATUE_LIGHTS)], reference, mask)


def _face(folder: Path, name: str) -> ReferencedCapture:
    """Directions from the file names; strengths so that the flashes agree with each other."""
    images, lights = [], []
    for path in sorted((folder / "faces" / name).glob("*.pgm")):
        azimuth, elevation = (np.deg2rad(float(x)) for x in re.findall(r"[AE]([+-]\d+)", path.stem))
        light = [
            -np.sin(azimuth) * np.cos(elevation),
            -np.sin(elevation),
            -np.cos(azimuth) * np.cos(elevation),
        ]
        if -light[2] > np.cos(np.deg2rad(STEEPEST_FLASH_DEG)):
            images.append(_grey(path))
            lights.append(light)
    flashes, directions = np.array(images), np.array(lights)
    normals, albedo = normals_from_many_lights(flashes, directions, darkest=0.03)
    predicted = np.einsum("kc,hwc->khw", directions, normals) * albedo
    lit = (predicted > 0.05) & (flashes > 0.6 * predicted) & (flashes < 0.99)
    part = flashes / np.maximum(predicted, 1e-6)
    directions *= np.array([np.median(p[x]) for p, x in zip(part, lit, strict=True)])[:, None]
    rgb = _rgb(folder / f"coloured_light/face_{name}.png")
    stacked = [int(np.abs(flashes - rgb[..., c]).mean(axis=(1, 2)).argmin()) for c in range(3)]
    reference = normals_from_many_lights(flashes, directions, darkest=0.03)
    whole = np.ones(rgb.shape[:2], bool)
    return _capture(rgb, directions[stacked], directions[stacked], reference, whole)


def _ball(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    v, u = np.nonzero(mask)
    radius = (np.ptp(u) + np.ptp(v) + 2) / 4
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]].astype(float)
    x, y = (x - (u.min() + u.max()) / 2) / radius, (y - (v.min() + v.max()) / 2) / radius
    rest = 1 - x**2 - y**2
    return np.stack([x, y, -np.sqrt(np.maximum(rest, 0))], axis=-1), (rest > 0) & mask


def _fit(normals: np.ndarray, image: np.ndarray, inside: np.ndarray) -> np.ndarray:
    lit = inside & (image > 0.08) & (image < 0.99)
    for _ in range(6):
        light = np.linalg.lstsq(normals[lit], image[lit], rcond=None)[0]
        lit = inside & (image > 0.05) & (np.abs(image - normals @ light) < 0.05)
    return light


def _chrome_directions(stereo: Path) -> np.ndarray:
    normals, inside = _ball(_mask(stereo / "chrome/chrome.mask.png"))
    view, directions = np.array([0, 0, -1.0]), []
    for k in range(12):
        image = np.where(inside, _grey(stereo / f"chrome/chrome.{k}.png"), 0)
        v, u = np.nonzero(image > 0.97 * image.max())
        normal = normals[round(v.mean()), round(u.mean())]
        directions.append(2 * (normal @ view) * normal - view)
    return np.array(directions)


def _rgb(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_COLOR)[..., ::-1] / 255.0


def _grey(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return (image if image.ndim == 2 else image.mean(axis=-1)) / 255.0


def _mask(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) > 127

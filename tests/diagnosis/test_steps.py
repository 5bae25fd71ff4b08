"""What changes at once is named with its lamp and its frame, and steady footage of what moves is silent."""

from pathlib import Path

import numpy as np
import pytest

from tests.faults.simulated_captures import random_response
from vntoolkit.diagnosis.steps import Steps, steps_of
from vntoolkit.diagnosis.subject import survey_of
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.mattes import Mattes
from vntoolkit.photometry.response import LightResponse, rgb_from_normals

H, W, COUNT = 90, 120, 12


def _film(seed: int) -> np.ndarray:
    """Return frames (n, h, w, 3) of a cloth that waves and drifts before a black backdrop."""
    rng = np.random.default_rng([seed, 77])
    response = random_response(rng)
    waves = [
        (rng.uniform(0, np.pi), rng.uniform(30, 80), rng.uniform(0, 6), rng.uniform(-0.4, 0.4))
        for _ in range(5)
    ]
    drift, v, u = rng.uniform(-1.5, 1.5, 2), *np.mgrid[:H, :W].astype(float)
    frames = []
    for t in range(COUNT):
        x, y = u - drift[0] * t - W / 2, v - drift[1] * t - H / 2
        inside = (np.abs(x) < 0.38 * W + 3 * np.sin(y / 9)) & (np.abs(y) < 0.4 * H)
        slopes = np.zeros((H, W, 2))
        for angle, length, phase, speed in waves:
            along = np.array([np.cos(angle), np.sin(angle)])
            turn = 2 * np.pi / length * (x * along[0] + y * along[1]) + phase + speed * t
            slopes += 0.22 * np.cos(turn)[..., None] * along
        normals = np.concatenate([slopes, -np.ones((H, W, 1))], axis=-1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        light = np.clip(rgb_from_normals(normals, response), 0, None) * inside[..., None]
        frames.append(np.clip(light + rng.normal(0, 0.004, light.shape), 0, 1))
    return np.stack(frames)


def _steps(folder: Path, frames: np.ndarray, response: LightResponse | None = None) -> Steps:
    for number, light in enumerate(frames):
        write_png(folder / f"f{number:02d}.png", np.rint(light * 255).astype(np.uint8))
    capture = open_capture(folder)
    return steps_of(survey_of(capture, Mattes(), capture.present), response)


SEEDS = range(8)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_lamp_that_is_dimmed_is_named_with_its_first_frame(seed: int, tmp_path: Path) -> None:
    frames = _film(seed)
    lamp = seed % 3
    frames[6:, ..., lamp] *= 0.5
    steps = _steps(tmp_path, frames)
    (found,) = steps.findings
    name = ("red", "green", "blue")[lamp]
    assert f"the {name} lamp" in found.problem
    assert "from frame 6 on" in found.problem
    assert set(steps.alike) in ({*range(6)}, {*range(6, 12)})


def test_the_angle_that_a_dimmed_lamp_turns_normals_by_is_told(tmp_path: Path) -> None:
    frames = _film(3)
    response = random_response(np.random.default_rng([3, 77]))
    inverse = np.linalg.inv(response.matrix)
    lit = frames[5].max(axis=-1) > 0.3 * frames.max()
    true = frames[5][lit] @ inverse.T
    false = frames[5][lit] * [1, 1, 0.5] @ inverse.T
    frames[6:, ..., 2] *= 0.5
    cosines = (true * false).sum(1) / np.linalg.norm(true, axis=1) / np.linalg.norm(false, axis=1)
    (found,) = _steps(tmp_path, frames, response).findings
    told = float(found.measured.split("turns normals by ")[1].split()[0])
    assert told == pytest.approx(np.degrees(np.median(np.arccos(cosines))), abs=2.0)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_lamp_that_is_out_in_one_frame_is_named(seed: int, tmp_path: Path) -> None:
    frames = _film(seed)
    lamp, at = (seed + 1) % 3, 3 + seed % 6
    frames[at, ..., lamp] *= 0.1
    steps = _steps(tmp_path, frames)
    (found,) = steps.findings
    assert f"in frame {at} alone" in found.problem
    assert at not in steps.alike
    assert len(steps.alike) == COUNT - 1


@pytest.mark.parametrize("seed", SEEDS)
def test_a_picture_that_is_mirrored_midway_is_named(seed: int, tmp_path: Path) -> None:
    frames = _film(seed)
    frames[7:] = frames[7:, :, ::-1]
    steps = _steps(tmp_path, frames)
    assert any("mirrored from frame 7 on" in finding.problem for finding in steps.findings)
    assert set(steps.alike) == {*range(7)}


@pytest.mark.parametrize("seed", SEEDS)
def test_channels_that_were_filmed_a_frame_apart_are_named(seed: int, tmp_path: Path) -> None:
    frames = _film(seed)
    frames[1:, ..., 0] = frames[:-1, ..., 0].copy()
    found = _steps(tmp_path, frames[1:]).findings
    assert any("the red channel was filmed a frame" in finding.problem for finding in found)


@pytest.mark.parametrize("seed", range(8, 24))
def test_a_surface_that_moves_under_steady_lamps_is_silent(seed: int, tmp_path: Path) -> None:
    steps = _steps(tmp_path, _film(seed))
    assert steps.findings == []
    assert steps.alike == list(range(COUNT))

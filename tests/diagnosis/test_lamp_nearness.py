"""How near lamps stand is told by the lengths, within its error, and never where they are far."""

import re

import cv2
import numpy as np
import pytest

from tests.faults.simulated_captures import random_response
from vntoolkit.diagnosis.evidence import evidence_from_frames
from vntoolkit.diagnosis.inspection import examine_capture
from vntoolkit.diagnosis.lamp_nearness import Nearness, fit_nearness
from vntoolkit.diagnosis.white_balance import check_changing_gains
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse, rgb_from_normals, with_near_lamps
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer

H, W = 150, 200
CAMERA = Camera.orthographic(width=W, height=H)


def _relief(rng):
    """Normals (h, w, 3) of waves within some 35 degrees of the camera."""
    v, u = np.mgrid[:H, :W].astype(float)
    depth = np.zeros((H, W))
    for _ in range(6):
        angle, length = rng.uniform(0, np.pi), rng.uniform(30, 60)
        k = 2 * np.pi / length
        depth += 0.25 / k * np.cos(k * (u * np.cos(angle) + v * np.sin(angle)) + rng.uniform(0, 6))
    slope_v, slope_u = np.gradient(depth)
    normals = np.stack([slope_u, slope_v, -np.ones_like(depth)], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _seen(normals, response, nearness, rng, vignetting=0.0):
    """Light (h, w, 3) of relief under point lamps: exact, where the fit is of first order."""
    v, u = np.mgrid[:H, :W].astype(float)
    place = np.stack([(u - (W - 1) / 2) / (W / 2), (v - (H - 1) / 2) / (W / 2), np.zeros((H, W))], axis=-1)
    light = np.zeros((H, W, 3))
    colours = np.linalg.inv(response.contributions_from_rgb)  # column k: the colour of light k
    for k, (lamp, direction) in enumerate(zip(response.lights, response.light_directions, strict=True)):
        towards = direction - nearness * place
        distance = np.linalg.norm(towards, axis=-1, keepdims=True)
        shade = np.linalg.norm(lamp) * (normals * towards / distance**3).sum(axis=-1)
        light += np.clip(shade, 0, None)[..., None] * colours[:, k]
    light *= 1 - vignetting * (place[..., :2] ** 2).sum(axis=-1)[..., None]
    return np.clip(light + rng.normal(0, 0.003, light.shape), 0, 1)


def seen_under_lamps(seed, nearness, vignetting=0.0):
    """Return light (h, w, 3), the response of the picture's centre, and the true normals."""
    rng = np.random.default_rng([seed, 41])
    response, normals = random_response(rng), _relief(rng)
    scale = 0.6 / rgb_from_normals(normals, response).max()
    response = LightResponse(matrix=scale * response.matrix, light_colours=response.light_colours)
    return _seen(normals, response, nearness, rng, vignetting), response, normals


def _fitted(seed, nearness, vignetting):
    light, response, normals = seen_under_lamps(seed, nearness, vignetting)
    frame = LinearFrame(rgb=light.astype(np.float32))
    evidence = evidence_from_frames([frame], Rig(camera=CAMERA, response=response), Transfer())
    found = fit_nearness(evidence)
    assert found is not None
    return found, frame, response, normals


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("nearness", "vignetting"), [(0.0, 0.0), (0.0, 0.3), (0.12, 0.0), (0.12, 0.3)])
def test_nearness_is_measured_within_its_error_and_far_lamps_are_left_alone(seed, nearness, vignetting):
    found, frame, response, normals = _fitted(seed, nearness, vignetting)
    assert abs(found.value - nearness) < 2 * found.error
    if not nearness:
        assert found.established == 0
        return
    assert 0.5 * nearness < found.established < 1.3 * nearness

    def error_deg(with_response):
        read = normals_from_frame(frame, with_response)
        cosine = (read.normals_in_camera * normals).sum(axis=-1)[read.mask]
        return float(np.degrees(np.median(np.arccos(np.clip(cosine, -1, 1)))))

    assert error_deg(with_near_lamps(response, found.established, (W, H))) < 0.6 * error_deg(response)


def test_what_lies_within_two_errors_is_not_established():
    assert Nearness(value=0.04, error=0.02).established == 0
    assert Nearness(value=-0.2, error=0.02).established == 0
    assert 0.95 < Nearness(value=0.2, error=0.02).established / 0.2 < 1


def test_what_a_lamp_does_not_reach_tells_nothing():
    """Shadows of one lamp on one side of the picture look like a lamp that is near on the other."""
    light, response, _ = seen_under_lamps(2, 0.12)
    split = response.contributions_from_rgb
    of_lamps = light @ split.T
    of_lamps[::3, : W // 2, 0] = 0.0
    shadowed = of_lamps @ np.linalg.inv(split).T
    rig, found = Rig(camera=CAMERA, response=response), []
    for seen in (light, shadowed):
        frame = LinearFrame(rgb=seen.astype(np.float32))
        found.append(fit_nearness(evidence_from_frames([frame], rig, Transfer())))
    assert abs(found[1].value - found[0].value) < found[0].error


def test_paint_beside_seams_is_left_out():
    """What is unusable beside a pixel does not reach it by the blur."""
    light, response, _ = seen_under_lamps(2, 0.12)
    rig, unusable = Rig(camera=CAMERA, response=response), np.zeros((H, W), bool)
    unusable[:, ::9] = unusable[::9] = True
    found = []
    for wrong in (light, 0.3 * light):
        seen = np.where(unusable[..., None], wrong, light).astype(np.float32)
        frame = LinearFrame(rgb=seen, clipped=unusable)
        found.append(fit_nearness(evidence_from_frames([frame], rig, Transfer())))
    assert found[0] == found[1]
    assert found[0].established > 0.06


def test_colours_that_drift_do_not_hide_near_lamps(tmp_path):
    _, response, _ = seen_under_lamps(1, 0.12)
    for number, red in enumerate((1.0, 1.1)):  # the surface moves: what stands still tells drift otherwise
        rng = np.random.default_rng(number)
        light = _seen(_relief(rng), response, 0.12, rng)
        stored = np.rint(65535 * 0.9 * light * [red, 1, 1]).clip(0, 65535).astype(np.uint16)
        write_png(tmp_path / f"{number}.png", stored)
    examined = examine_capture(open_capture(tmp_path), Rig(camera=CAMERA, response=response))
    assert "drift" in [finding.check for finding in examined.findings]
    assert examined.nearness > 0.06


@pytest.mark.parametrize("seed", [3, 6, 10])
def test_a_surface_that_comes_nearer_to_its_lamps_has_no_drifting_colours(seed):
    rng, response = np.random.default_rng(seed), random_response(np.random.default_rng(seed + 50))
    frames = [
        LinearFrame(rgb=_seen(_relief(rng), response, nearness, rng).astype(np.float32), number=number)
        for number, nearness in enumerate((0.0, 0.3, 0.0))
    ]
    rig = Rig(camera=CAMERA, response=response)
    assert check_changing_gains(evidence_from_frames(frames, rig, Transfer())) == []


def test_a_rig_whose_m_varies_already_is_not_asked():
    response = with_near_lamps(random_response(np.random.default_rng(3)), 0.1, (W, H))
    frame = LinearFrame(rgb=np.full((H, W, 3), 0.5, np.float32))
    evidence = evidence_from_frames([frame], Rig(camera=CAMERA, response=response), Transfer())
    assert fit_nearness(evidence) is None


def test_faces_under_far_lamps_are_left_alone(real_data):
    """Photographs of skin under one flash each: gloss and light between parts are no near lamps."""
    rng = np.random.default_rng(3)
    for folder in sorted((real_data / "faces").iterdir()):
        lamps, photographs = [], []
        for path in sorted(folder.glob("*.pgm")):
            named = re.search(r"A([+-]\d+)E([+-]\d+)", path.name)
            if named is None or abs(int(named[1])) > 50 or abs(int(named[2])) > 45:
                continue
            around, up = np.deg2rad(int(named[1])), np.deg2rad(int(named[2]))
            lamps.append([-np.sin(around) * np.cos(up), -np.sin(up), -np.cos(around) * np.cos(up)])
            photographs.append(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) / 255)
        height, width = photographs[0].shape
        v, u = np.mgrid[:height, :width]
        face = ((u - width / 2) / (0.4 * width)) ** 2 + ((v - height / 2) / (0.44 * height)) ** 2 < 1
        for _ in range(12):
            three = rng.choice(len(lamps), 3, replace=False)
            matrix = 0.6 * np.array(lamps)[three]
            if np.linalg.cond(matrix) > 10:
                continue
            light = np.stack([photographs[k] for k in three], axis=-1)
            frame = LinearFrame(rgb=np.minimum(light, 1).astype(np.float32))
            rig = Rig(
                camera=Camera.orthographic(width=width, height=height), response=LightResponse(matrix=matrix)
            )
            found = fit_nearness(evidence_from_frames([frame], rig, Transfer(), face))
            assert found is None or not found.established, (folder.name, three)

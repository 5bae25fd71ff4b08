"""Mistakes that ruin normals without failing are named, nine times of ten at least, and never invented."""

import logging

import numpy as np
import pytest

from tests.faults.simulated_captures import H, W, simulate_capture
from vntoolkit.__main__ import main
from vntoolkit.calibration.fit import fit_response
from vntoolkit.diagnosis.axes import warn_of_flipped_axes
from vntoolkit.diagnosis.inspection import examine_capture, inspect_capture
from vntoolkit.diagnosis.rig_checks import check_coverage
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.maps import read_normal_map, write_normal_map
from vntoolkit.io.maps_and_meshes.masks import write_mask
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.io.rigs import write_rig
from vntoolkit.options.simulation import Nuisances, RenderOptions, SceneOptions
from vntoolkit.photometry.response import rgb_from_normals
from vntoolkit.photometry.rig import FitQuality, Rig
from vntoolkit.photometry.transfer import Transfer, encoded_from_linear
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene

FAULTS, CLEAN = 10, 20


def _stored(folder, frames, curve="linear", bits=8):
    """Write linear frames (k, h, w, 3) as PNG."""
    folder.mkdir(exist_ok=True)
    full = 2**bits - 1
    for number, frame in enumerate(frames):
        encoded = encoded_from_linear(np.clip(frame, 0, 1), Transfer.from_text(curve))
        write_png(
            folder / f"{number}.png", np.rint(encoded * full).astype(np.uint8 if bits == 8 else np.uint16)
        )
    return folder


def _findings(folder, rig, mask=None):
    capture = open_capture(folder, CaptureOptions(transfer=rig.transfer))
    return examine_capture(capture, rig, mask).findings


def _found(tmp_path, spoil, text, **simulation):
    """Return in how many of ten simulated captures, spoilt by `spoil`, the only finding has this text."""
    hits = 0
    for seed in range(FAULTS):
        capture = simulate_capture(seed, **simulation)
        frames, curve = spoil(capture.frames, np.random.default_rng(seed))
        findings = _findings(_stored(tmp_path / str(seed), frames, curve), capture.rig, capture.subject)
        hits += len(findings) == 1 and text in findings[0].text
    return hits


@pytest.mark.slow
def test_swapped_red_and_blue_are_found(tmp_path):
    assert _found(tmp_path, lambda f, _: (f[..., ::-1], "linear"), "red and blue exchanged") >= 9


@pytest.mark.slow
@pytest.mark.parametrize("curve", ["srgb", "bt709", "gamma:2.2"])
def test_gamma_footage_read_as_linear_is_found(tmp_path, curve):
    assert _found(tmp_path, lambda f, _: (f, curve), "give --transfer") >= 9


@pytest.mark.slow
def test_white_balance_changed_since_calibration_is_found(tmp_path):
    def spoil(frames, rng):
        gains = np.array([rng.uniform(1.1, 1.35), 1.0, rng.uniform(0.75, 0.95)])
        return frames * (gains if rng.random() < 0.5 else gains[::-1]), "linear"

    assert _found(tmp_path, spoil, "the white balance looks changed since calibration") >= 9


@pytest.mark.slow
@pytest.mark.parametrize("what", ["exposure", "white balance"])
def test_drift_while_filming_is_found_on_the_static_part(tmp_path, what):
    def spoil(frames, rng):
        last = rng.uniform(1.05, 1.2) ** np.array([1, 1, 1] if what == "exposure" else [1, 0, -1])
        steps = np.linspace(0, 1, len(frames))[:, None]
        return frames * (last**steps)[:, None, None, :], "linear"

    text = f"the camera's {what} drifts"
    hits = 0
    for seed in range(FAULTS):
        capture = simulate_capture(seed, count=6, backdrop=True)
        frames, curve = spoil(capture.frames, np.random.default_rng(seed))
        folder = _stored(tmp_path / str(seed), frames, curve)
        found = inspect_capture(folder, rig=capture.rig, mask=capture.subject).findings
        hits += any(text in finding.text for finding in found)
    assert hits >= 9


def _pairs_in_cone(rng, cone_deg, response, noise=0.003):
    tilt = np.deg2rad(cone_deg) * np.sqrt(rng.uniform(0, 1, 2000))
    azimuth = rng.uniform(0, 2 * np.pi, 2000)
    normals = np.stack(
        [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)], axis=1
    )
    return normals, rgb_from_normals(normals, response) + rng.normal(0, noise, (2000, 3))


def test_a_rig_fitted_on_a_narrow_cone_is_found_and_a_wide_one_is_not(rng, caplog):
    for seed in range(FAULTS + CLEAN):
        response = simulate_capture(seed).rig.response
        narrow = seed < FAULTS
        cone = rng.uniform(5, 18) if narrow else rng.uniform(25, 70)
        caplog.clear()
        fit = fit_response(*_pairs_in_cone(rng, cone, response))
        rig = Rig(camera=simulate_capture(seed).rig.camera, response=fit.response, quality=fit.quality)
        assert bool(check_coverage(rig)) == narrow
        assert any("tilt the target further" in record.message for record in caplog.records) == narrow


@pytest.mark.slow
def test_a_flipped_green_axis_is_found(tmp_path, caplog):
    for seed in range(FAULTS):
        capture = simulate_capture(seed)
        turned = capture.normals * [1, -1, 1]
        write_normal_map(tmp_path / "n.png", NormalMap(normals_in_camera=turned, mask=capture.subject))
        caplog.clear()
        warn_of_flipped_axes("n.png", read_normal_map(tmp_path / "n.png"))
        assert "the green axis looks flipped" in caplog.text


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sphere", "cylinder", "jacket", "spandex"])
def test_rendered_normal_maps_are_the_right_way_up(name, caplog):
    scene = build_scene(name, SceneOptions(width=120, height=90))
    for index in sorted({min(n, scene.frame_count - 1) for n in (0, 7, 14)}):
        truth = render_frame(scene, index, options=RenderOptions(samples=1)).truth
        warn_of_flipped_axes("n.png", truth.normals)
    assert "looks flipped" not in caplog.text


@pytest.mark.slow
def test_twenty_clean_captures_raise_nothing(tmp_path, caplog):
    """Half fill the picture, half have a backdrop; 8 and 16 bits, three levels of noise, three curves."""
    for seed in range(CLEAN):
        curve = ("linear", "srgb", "bt709")[seed % 3]
        capture = simulate_capture(
            100 + seed, count=6, backdrop=seed % 2 == 0, noise=(0.001, 0.003, 0.006)[seed % 3]
        )
        folder = _stored(tmp_path / str(seed), capture.frames, curve, bits=8 if seed % 4 < 2 else 16)
        rig = Rig(
            camera=capture.rig.camera, response=capture.rig.response, transfer=Transfer.from_text(curve)
        )
        for mask in (capture.subject, None):
            assert _findings(folder, rig, mask) == []
        noisy = capture.normals + np.random.default_rng(seed).normal(0, 0.02, capture.normals.shape)
        noisy /= np.linalg.norm(noisy, axis=-1, keepdims=True)
        warn_of_flipped_axes("n.png", NormalMap(normals_in_camera=noisy, mask=capture.subject))
    assert "looks flipped" not in caplog.text


def test_the_commands_say_it(tmp_path, capsys, caplog):
    capture = simulate_capture(3, count=2)
    quality = FitQuality(method="board", residual_deg=1, condition_number=3, samples=99, cone_deg=8)
    rig = Rig(camera=capture.rig.camera, response=capture.rig.response, quality=quality)
    write_rig(tmp_path / "rig.json", rig)
    write_mask(tmp_path / "mask.png", np.ones((H, W), dtype=bool))
    source = str(_stored(tmp_path / "swapped", capture.frames[..., ::-1]))
    common = [source, "--rig", str(tmp_path / "rig.json"), "--mask", str(tmp_path / "mask.png")]
    out = str(tmp_path / "out")
    with caplog.at_level(logging.WARNING):
        assert main(["reconstruct", *common, "--out", out, "--to", "normals"]) == 1
        assert "red and blue exchanged" in capsys.readouterr().err
        assert not (tmp_path / "out").exists()
        assert main(["reconstruct", *common, "--out", out, "--to", "normals", "--allow", "matrix"]) == 0
    kept = read_manifest(out).known.findings
    assert [entry.level for entry in kept if entry.check == "matrix"] == ["fatal"]
    for text in ("red and blue exchanged", "the rig was fitted on normals within 8 degrees"):
        assert text in caplog.text
    assert main(["reconstruct", *common, "--out", out, "--allow", "rumours"]) == 1
    assert "--allow rumours: expected a check's name" in capsys.readouterr().err
    assert main(["doctor", *common]) == 1
    assert "red and blue exchanged" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sphere", "cylinder", "jacket", "spandex", "head_turn"])
def test_rendered_scenes_raise_nothing(tmp_path, name):
    """Clean renderings, with the rig of their truth and the mask of their subject."""
    scene = build_scene(name, SceneOptions(width=200, height=150))
    clean = Nuisances.none()
    for index in sorted({min(n, scene.frame_count - 1) for n in (0, 6, 12, 18)}):
        frame = render_frame(scene, index, nuisances=clean, options=RenderOptions(samples=1))
        folder = _stored(tmp_path / f"{name}{index}", [frame.linear.rgb], bits=16)
        rig = Rig(camera=scene.camera, response=true_response(scene, clean))
        assert _findings(folder, rig, frame.truth.normals.mask) == []

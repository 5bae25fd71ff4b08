"""A wall that counts as subject is told by its bounds, and a mask of the subject is proposed."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.pipeline.conftest import RIG, dome_light
from vntoolkit.__main__ import main
from vntoolkit.diagnosis.backdrop import Backdrop, backdrop_in
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.io.rigs import write_rig

SHAPE = (90, 120)


def _map(seed: int, subject_deg: float, wall_deg: float, hole_deg: float | None = None):
    """Return a map of a disc before a wall, with bounds that scatter, and where the disc is."""
    rng = np.random.default_rng([seed, 5])
    v, u = np.indices(SHAPE)
    middle = rng.uniform(35, 55), rng.uniform(45, 75)
    away = np.hypot(v - middle[0], u - middle[1])
    subject = away < 26
    errors = np.where(subject, subject_deg, wall_deg) * np.exp(rng.normal(0, 0.2, SHAPE))
    if hole_deg is not None:
        errors[away < 6] = hole_deg
    seen = rng.random(SHAPE) < 0.9
    normals = np.where(seen[..., None], [0.0, 0.0, -1.0], 0.0).astype(np.float32)
    return NormalMap(normals_in_camera=normals, mask=seen, error_deg=errors.clip(0, 180)), subject


@pytest.mark.parametrize("seed", range(6))
def test_a_dim_wall_is_told_from_the_subject_with_its_shadows(seed: int) -> None:
    normal_map, subject = _map(seed, 4.0, 60.0, hole_deg=70.0)
    found = backdrop_in(normal_map)
    assert found is not None
    assert (found.subject & subject).sum() / (found.subject | subject).sum() > 0.9
    assert found.subject_deg == pytest.approx(4, rel=0.2)
    assert found.region_deg == pytest.approx(60, rel=0.2)
    assert "--mask" in found.finding.remedy


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(("subject_deg", "wall_deg"), [(4.0, 4.0), (40.0, 40.0), (3.0, 8.0)])
def test_bounds_that_are_alike_or_small_name_no_wall(seed: int, subject_deg: float, wall_deg: float) -> None:
    assert backdrop_in(_map(seed, subject_deg, wall_deg)[0]) is None


def test_wide_bounds_within_a_masked_subject_name_no_wall() -> None:
    normal_map, subject = _map(0, 4.0, 60.0, hole_deg=70.0)
    alone = NormalMap(
        normals_in_camera=np.where((normal_map.mask & subject)[..., None], normal_map.normals_in_camera, 0),
        mask=normal_map.mask & subject,
        error_deg=normal_map.error_deg,
    )
    assert backdrop_in(alone) is None


def test_dark_hair_that_only_a_rim_joins_to_the_border_is_no_wall() -> None:
    v, u = np.indices(SHAPE)
    mask = (np.hypot(v - 45, u - 60) < 30) | ((np.abs(u - 60) < 15) & (v > 45))
    rim = mask & ~(cv2.erode(mask.astype(np.uint8), np.ones((7, 7), np.uint8), borderValue=1) > 0)
    errors = np.where(rim | (v < 40), 70.0, 3.0 + 0.05 * v)
    normals = np.where(mask[..., None], [0.0, 0.0, -1.0], 0.0).astype(np.float32)
    assert backdrop_in(NormalMap(normals_in_camera=normals, mask=mask, error_deg=errors)) is None


def test_a_subject_that_hardly_entered_is_no_wall(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What only the worst frame shows does not stand behind the subject in all frames."""
    whole = np.rint(255 * dome_light().clip(0, 1)).astype(np.uint8)
    entering = whole // 3
    entering[:, 32:] = 0
    (tmp_path / "in").mkdir()
    for number, picture in enumerate((whole, entering)):
        write_png(tmp_path / "in" / f"{number}.png", picture)
    write_rig(tmp_path / "rig.json", RIG)
    subject = whole.any(axis=2)
    parted = Backdrop(subject=subject, share=0.5, subject_deg=4.0, region_deg=60.0)

    def found_in_part(normal_map: NormalMap) -> Backdrop | None:
        return parted if normal_map.mask.sum() < 0.8 * subject.sum() else None

    command = ["reconstruct", str(tmp_path / "in"), "--rig", str(tmp_path / "rig.json"), "--to", "normals"]
    for judged, expected in ((found_in_part, []), (lambda _: parted, ["backdrop"])):
        monkeypatch.setattr("vntoolkit.diagnosis.backdrop.backdrop_in", judged)
        assert main([*command, "--out", str(tmp_path / "out"), "--overwrite"]) == 0
        manifest = read_manifest(tmp_path / "out")
        assert [each.check for each in manifest.findings if each.check == "backdrop"] == expected


@pytest.mark.slow
@pytest.mark.parametrize("name", ["buddha", "cat"])
def test_the_wall_behind_real_statues_is_named_with_a_mask(name, real_data, tmp_path):
    folder, rig = real_data / "coloured_light", str(tmp_path / "rig.json")
    ball = ["calibrate", "sphere", str(folder / "gray_sphere.png"), "--transfer", "linear", "--out", rig]
    assert main([*ball, "--mask", str(folder / "gray_sphere.mask.png")]) == 0
    out = tmp_path / "out"
    command = ["reconstruct", str(folder / f"{name}.png"), "--rig", rig, "--to", "normals", "--out"]
    assert main([*command, str(out)]) == 0
    manifest = read_manifest(out)
    (found,) = [each for each in manifest.findings if each.check == "backdrop"]
    assert "mask_suggested.png" in found.text
    proposed, true = (
        cv2.imread(str(path), 0) > 127 for path in (out / "mask_suggested.png", folder / f"{name}.mask.png")
    )
    assert (proposed & true).sum() / (proposed | true).sum() > 0.85
    masked = tmp_path / "masked"
    assert main([*command, str(masked), "--mask", str(out / "mask_suggested.png")]) == 0
    assert not [each for each in read_manifest(masked).findings if each.check == "backdrop"]

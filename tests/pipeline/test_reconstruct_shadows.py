"""Footage with shadows through the whole run: labels on disk, less error, bytes that no worker changes."""

from pathlib import Path

import numpy as np
import pytest

from tests.pipeline.conftest import DomeCapture
from tests.pipeline.test_reconstruct import digest, job_of
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.label_images import read_labels
from vntoolkit.io.maps_and_meshes.maps import read_normal_map
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import Product
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.reconstruct import reconstruct

FRAMES = 12
SHADOWED_LIGHT = 2


def shadow(number: int) -> np.ndarray:
    """A square of cast shadow that wanders over the dome."""
    dark = np.zeros((48, 64), bool)
    dark[18:28, 24 + number // 2 : 36 + number // 2] = True
    return dark


@pytest.fixture(scope="module")
def shadowed_capture(dome_capture: DomeCapture, tmp_path_factory: pytest.TempPathFactory) -> DomeCapture:
    """The dome, its light responses apart by channel, one light blocked over the square."""
    folder = tmp_path_factory.mktemp("shadowed")
    matrix = np.array([[0.28, 0.16, -0.62], [-0.28, 0.16, -0.62], [0.0, -0.33, -0.6]])
    for number in range(FRAMES):
        rgb = np.maximum(dome_capture.normals[number] @ matrix.T, 0.0)
        rgb[..., SHADOWED_LIGHT][shadow(number)] = 0.0
        write_png(folder / f"f{number:02d}.png", np.round(rgb.clip(0, 1) * 65535).astype(np.uint16))
    rig = Rig(camera=dome_capture.rig.camera, response=LightResponse(matrix=matrix))
    return DomeCapture(str(folder), rig, dome_capture.normals, dome_capture.masks)


@pytest.fixture(scope="module")
def robust_run(shadowed_capture: DomeCapture, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("robust")
    reconstruct(job_of(shadowed_capture, out, to=Product.NORMALS, shadows=ShadowMethod.ROBUST))
    return out


def test_labels_are_written_and_right(shadowed_capture: DomeCapture, robust_run: Path) -> None:
    for number in (0, 5, FRAMES - 1):
        labels = read_labels(robust_run / f"shadows/{number:06d}.png")
        found = (labels >> SHADOWED_LIGHT) & 1 == 0
        true = shadow(number) & shadowed_capture.masks[number]
        assert (found & true).sum() / (found | true).sum() > 0.9
        others = labels[shadowed_capture.masks[number]] & (7 - (1 << SHADOWED_LIGHT))
        assert (others == 7 - (1 << SHADOWED_LIGHT)).mean() > 0.99
    manifest = read_manifest(robust_run)
    assert manifest.outputs == ["normals", "shadows"]
    assert manifest.options["shadows"] == "robust"


def test_normals_under_the_shadow_are_recovered(shadowed_capture, robust_run, tmp_path):
    plain_run = tmp_path / "plain"
    reconstruct(job_of(shadowed_capture, plain_run, to=Product.NORMALS))
    for number in (0, FRAMES - 1):
        dark, mask = shadow(number), shadowed_capture.masks[number]
        angles = {}
        for run in (robust_run, plain_run):
            found = read_normal_map(run / f"normals/{number:06d}.exr").normals_in_camera
            angles[run] = angles_deg(found, shadowed_capture.normals[number])
        assert angles[robust_run][dark & mask].mean() < 0.2 * angles[plain_run][dark & mask].mean()
        lit = mask & ~dark
        assert angles[robust_run][lit].mean() < angles[plain_run][lit].mean() + 0.2


def test_the_same_bytes_from_two_workers(shadowed_capture, robust_run, tmp_path):
    job = job_of(shadowed_capture, tmp_path, to=Product.NORMALS, shadows=ShadowMethod.ROBUST)
    reconstruct(job, jobs=2)
    assert digest(tmp_path) == digest(robust_run)

"""A small capture of a moving dome under three coloured lights, with its rig and truth."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from vntoolkit.__main__ import main
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.results.manifest import Manifest, read_manifest
from vntoolkit.io.rigs import write_rig
from vntoolkit.photometry.response import LightResponse, rgb_from_normals
from vntoolkit.photometry.rig import Rig

SIZE = (48, 64)
RESPONSE = LightResponse(
    matrix=np.array([[0.35, -0.02, -0.5], [-0.17, 0.3, -0.48], [-0.15, -0.28, -0.52]]),
)


RIG = Rig(camera=Camera.orthographic(width=SIZE[1], height=SIZE[0]), response=RESPONSE)


@dataclass(frozen=True)
class DomeCapture:
    source: str
    rig: Rig
    normals: list[np.ndarray]
    masks: list[np.ndarray]


def dome_normals(centre_u: float) -> tuple[np.ndarray, np.ndarray]:
    v, u = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    x, y = (u - centre_u) / 40, (v - 23.5) / 40
    mask = x**2 + y**2 < 0.2
    z = -np.sqrt(np.maximum(1 - x**2 - y**2, 0.1))
    normals = np.stack([x, y, z], -1)
    return np.where(mask[..., None], normals / np.linalg.norm(normals, axis=-1, keepdims=True), 0), mask


def write_dome_capture(folder: Path, count: int = 20) -> DomeCapture:
    normals, masks = [], []
    for number in range(count):
        n, mask = dome_normals(31.5 + 0.3 * number)
        light = dome_light(31.5 + 0.3 * number)
        write_png(folder / f"f{number}.png", np.round(light * 65535).astype(np.uint16))
        normals.append(n)
        masks.append(mask)
    return DomeCapture(str(folder), RIG, normals, masks)


def dome_light(centre_u: float = 31.5) -> np.ndarray:
    normals, mask = dome_normals(centre_u)
    return np.where(mask[..., None], rgb_from_normals(normals, RESPONSE), 0).clip(0, 1)


def to_normals(folder: Path, source: Path, *more: str) -> list[str]:
    """Write the dome's rig beside the results, and return the command that makes its normals."""
    write_rig(folder / "rig.json", RIG)
    command = f"reconstruct {source} --rig {folder}/rig.json --to normals --shadows none --out {folder}/out"
    return [*command.split(), *more]


@pytest.fixture(scope="session")
def dome_capture(tmp_path_factory: pytest.TempPathFactory) -> DomeCapture:
    return write_dome_capture(tmp_path_factory.mktemp("dome"))


def reconstructed_twice(folder: Path, lights: list[np.ndarray], rig: Rig) -> tuple[Manifest, Manifest]:
    """Return the manifests of a run over frames of linear light, and of the same that makes one again."""
    frames = folder / "frames"
    frames.mkdir()
    for k, light in enumerate(lights):
        write_png(frames / f"{k}.png", np.rint(light * 65535).astype(np.uint16))
    write_rig(folder / "rig.json", rig)
    command = ["reconstruct", str(frames), "--rig", str(folder / "rig.json"), "--out", str(folder / "out")]
    command += ["--to", "normals", "--shadows", "none", "--materials", "calibrated"]
    manifests = []
    for _ in range(2):
        assert main(command) == 0
        manifests.append(read_manifest(folder / "out"))
        (folder / "out/normals/000000.exr").unlink()
    return manifests[0], manifests[1]

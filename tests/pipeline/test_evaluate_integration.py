import json
from pathlib import Path

import numpy as np
import pytest

from vntoolkit.cli.evaluate import evaluate_integration
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.depth_error import peaks
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.maps_and_meshes.maps import write_normal_map
from vntoolkit.io.maps_and_meshes.masks import write_mask
from vntoolkit.pipeline.evaluate import objects_in, real_object_errors


def test_every_integrator_is_judged(tmp_path: Path) -> None:
    evaluate_integration(size=48, out=tmp_path)
    rows = json.loads((tmp_path / "integration.json").read_text())["surfaces"]
    means = {(row["surface"], row["integrator"]): row["mean"] for row in rows}
    assert all(mean < 0.5 for (surface, _), mean in means.items() if surface.startswith("hills"))
    torn = {integrator: mean for (surface, integrator), mean in means.items() if surface.startswith("torn")}
    assert torn["discontinuity"] < 0.1 * torn["poisson"]
    assert (tmp_path / "integration_map.png").exists()


def test_an_object_with_known_depth_is_measured(tmp_path: Path) -> None:
    size, focal = 64, 400.0
    relief, _ = peaks(size)
    depth = 700.0 + 3.0 * relief  # mm
    v, u = (np.mgrid[:size, :size] - (size - 1) / 2) / focal
    points = np.stack([u * depth, v * depth, depth], axis=-1)
    normals = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    folder = tmp_path / "hills"
    folder.mkdir()
    mask = np.ones((size, size), dtype=bool)
    write_normal_map(folder / "normal_map.png", NormalMap(normals_in_camera=normals, mask=mask))
    write_mask(folder / "mask.png", mask)
    middle = (size - 1) / 2
    np.savetxt(folder / "K.txt", [[focal, 0, middle], [0, focal, middle], [0, 0, 1]])
    np.savez(folder / "depth_gt.npz", depth_gt=depth)
    errors = real_object_errors(objects_in(tmp_path)[0])
    assert {e.integrator for e in errors} == {"poisson", "discontinuity"}
    assert all(error.mean_mm < 0.02 * np.ptp(depth) for error in errors)


def test_a_folder_without_objects_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"holds no folder with normal_map\.png"):
        objects_in(tmp_path)

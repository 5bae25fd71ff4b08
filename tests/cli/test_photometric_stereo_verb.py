"""Photographs under one lamp each become normals, a folder that `integrate` reads, and errors that hold."""

import numpy as np
import pytest

from vntoolkit.cli import run_verb
from vntoolkit.cli.photometric_stereo import photometric_stereo
from vntoolkit.errors import BadInput
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.masks import write_mask
from vntoolkit.photometry.fit_quality import angles_deg

SIZE, COUNT, NOISE = 64, 12, 0.004


def ball():
    v, u = (np.mgrid[:SIZE, :SIZE] - 31.5) / 28.0
    mask = u * u + v * v < 0.8
    z = -np.sqrt(np.where(mask, 1 - u * u - v * v, 1.0))
    return np.stack([u, v, z], axis=-1) * mask[..., None], mask


def photographs(folder, rng, signs=(1.0, -1.0, -1.0)):
    """Twelve lamps around the axis, 16-bit grey with noise, shadows clamped and a highlight; lights.txt."""
    normals, mask = ball()
    turn = 2 * np.pi * np.arange(COUNT) / COUNT
    lights = np.stack([0.5 * np.cos(turn), 0.5 * np.sin(turn), -np.ones(COUNT)], axis=1)
    lights /= np.linalg.norm(lights, axis=1, keepdims=True)
    folder.mkdir(exist_ok=True)
    for k, light in enumerate(lights):
        grey = 0.7 * np.maximum(normals @ light, 0) + rng.normal(scale=NOISE, size=mask.shape)
        between = light + np.array([0, 0, -1])
        half = normals @ (between / np.linalg.norm(between))
        grey = np.clip(grey + 0.3 * (half > 0.995), 0, 1) * mask
        write_png(folder / f"{k}.png", np.rint(65535 * grey).astype(np.uint16))
    write_mask(folder / "mask.png", mask)
    np.savetxt(folder / "lights.txt", lights * signs)
    return normals, mask


def test_normals_their_errors_and_what_integrate_makes_of_them(tmp_path, rng):
    normals, mask = photographs(tmp_path / "photographs", rng)
    folder, out = tmp_path / "photographs", tmp_path / "solved"
    found = photometric_stereo(folder, lights=folder / "lights.txt", out=out)
    assert found.mask.sum() > 0.98 * mask.sum()
    both = found.mask & mask
    angles = angles_deg(found.normals_in_camera[both], normals[both])
    assert angles.mean() < 0.5
    assert 0.8 < np.mean(angles < found.error_deg[both]) < 0.99
    run_verb(["integrate", str(out), "--out", str(tmp_path / "result"), "--to", "depth"])
    assert (tmp_path / "result" / "depth" / "000000.exr").exists()


def test_wrong_axes_of_the_lamps_are_named(tmp_path, rng):
    folder = tmp_path / "photographs"
    photographs(folder, rng, signs=(1.0, 1.0, 1.0))
    with pytest.raises(BadInput, match="towards the viewer, got z < 0 in most: multiply"):
        photometric_stereo(folder, lights=folder / "lights.txt", out=tmp_path / "out")


def test_lamps_and_photographs_that_do_not_belong_together(tmp_path, rng):
    photographs(tmp_path / "photographs", rng)
    folder = tmp_path / "photographs"
    (folder / "11.png").unlink()
    with pytest.raises(BadInput, match=r"holds 11 photographs, .* 12 lamps; expected one photograph a lamp"):
        photometric_stereo(folder, lights=folder / "lights.txt", out=tmp_path / "out")
    write_png(folder / "11.png", np.full((9, 9), 40000, np.uint16))
    with pytest.raises(BadInput, match="is of another size than"):
        photometric_stereo(folder, lights=folder / "lights.txt", out=tmp_path / "out")


def test_a_folder_without_lamps_asks_for_them(tmp_path):
    with pytest.raises(BadInput, match=r"light_directions\.txt in it; give --lights for other folders"):
        photometric_stereo(tmp_path, out=tmp_path / "out")

"""Photographs under one white lamp each to normals, in a folder as DiLiGenT's and `integrate` reads."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import Array, Float32Array, FloatArray, Mask, Points
from vntoolkit.diagnosis.axes import warn_of_flipped_axes
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.footage.sequence import find_capture_files
from vntoolkit.io.light_files import KnownLights, read_lights
from vntoolkit.io.maps_and_meshes.maps import write_normal_map
from vntoolkit.io.maps_and_meshes.masks import read_mask, write_mask
from vntoolkit.normals.photometric_stereo import StereoResult, solve_photometric_stereo
from vntoolkit.options.normal_maps import PhotometricStereoArguments
from vntoolkit.photometry.transfer import Transfer, linear_from_encoded
from vntoolkit.spread import NINE_OF_TEN_IN_PLANE

_FEWEST_VALID = 0.05  # of the subject: fewer have a normal only where lamps and photographs do not match


def photometric_stereo(asked: PhotometricStereoArguments) -> NormalMap:
    """Compute normals with their expected errors, and write normals, mask and albedo."""
    folder = Path(asked.folder)
    if asked.lights is None and not (folder / "light_directions.txt").exists():
        raise BadInput(
            f"{folder}: expected DiLiGenT's light_directions.txt in it; give --lights for other folders"
        )
    lights = read_lights(asked.lights or folder)
    if np.mean(lights.directions[:, 2] > 0) > 0.5:
        raise BadInput(
            f"{lights.files[0]}: expected lamps as x right, y up, z towards the viewer, got z < 0 in most: "
            "multiply them by 1 1 -1, or by 1 -1 -1 where y points down too"
        )
    beside = folder / "mask.png"
    mask_file = asked.mask or (beside if beside.exists() else None)
    mask = None if mask_file is None else read_mask(mask_file)
    stack = _stack_of(folder, lights, asked.curve)
    result = solve_photometric_stereo(stack, lights.directions, mask)
    normal_map = replace(result.normal_map, error_deg=expected_error_deg(stack, lights.directions, result))
    _require_valid(normal_map, mask, lights.files[0])
    warn_of_flipped_axes(lights.files[0], normal_map)
    _write(Path(asked.out), normal_map, result.albedo)
    return normal_map


def expected_error_deg(images: FloatArray, lights: Points, result: StereoResult) -> Float32Array:
    """Return the angle (h, w) in degrees that nine of ten normals stay within, from the samples' residuals.

    images: (k, h, w). lights: (k, 3). Samples that the fit left out are told by the share that it kept: the
    residuals of the others are the smallest. Three samples leave no residual; there the median pixel's is
    taken.
    """
    normal_map, albedo = result.normal_map, result.albedo
    at = np.flatnonzero(normal_map.mask)
    count, scale = len(lights), albedo.ravel()[at]
    samples = np.asarray(images).reshape(count, -1)[:, at] / scale
    weight = normal_map.weight
    used = np.full(len(at), count) if weight is None else np.rint(count * weight.ravel()[at]).astype(int)
    normals = normal_map.normals_in_camera.reshape(-1, 3)[at]
    squares = np.sort((samples - lights @ normals.T) ** 2, axis=0)
    kept = np.take_along_axis(np.cumsum(squares, axis=0), used[None] - 1, axis=0)[0]
    variance: FloatArray = np.where(used > 3, kept / np.maximum(used - 3, 1), np.nan)
    variance = np.where(np.isnan(variance), np.nanmedian(variance) if (used > 3).any() else 0.0, variance)
    # along the normal an error is one of albedo: half of the rest is that of each direction across it
    covariance = np.linalg.inv(lights.T @ lights)
    across = np.trace(covariance) - np.einsum("ni,ij,nj->n", normals, covariance, normals)
    sigma = np.sqrt(variance * 0.5 * across * count / used)
    error = np.zeros(normal_map.shape, np.float32)
    error.ravel()[at] = np.degrees(NINE_OF_TEN_IN_PLANE * sigma)
    return error


def _stack_of(folder: Path, lights: KnownLights, curve: Transfer | None) -> Array:
    """Return grey images (k, h, w), linear, each divided by its lamp's intensity."""
    files = lights.images or find_capture_files(folder).files
    if len(files) != len(lights.directions):
        raise BadInput(
            f"{folder}: holds {len(files)} photographs, {lights.files[0]} {len(lights.directions)} "
            "lamps; expected one photograph a lamp, in the order of their names"
        )
    images = []
    for number, path in enumerate(progress.counted(files, "photographs", len(files))):
        samples = read_image(path)
        full = 1.0 if samples.dtype == np.float32 else np.iinfo(samples.dtype).max
        values: FloatArray = samples / np.float32(full)
        if curve is not None:
            values = linear_from_encoded(values, curve)
        if lights.intensities is not None:
            values = values / lights.intensities[number].astype(np.float32)
        images.append(np.asarray(values.mean(axis=2), np.float32))
        if images[-1].shape != images[0].shape:
            raise BadInput(
                f"{path}: is of another size than {files[0]}; expected one camera that stood still"
            )
    return np.stack(images)


def _require_valid(normal_map: NormalMap, mask: Mask | None, lights: Path) -> None:
    inside = np.ones(normal_map.shape, np.bool_) if mask is None else mask
    share = float(normal_map.mask[inside].mean()) if inside.any() else 0.0
    if share < _FEWEST_VALID:
        raise BadInput(
            f"{lights}: {share:.1%} of the subject's pixels have a normal; expected lamps as x right, y up, "
            "z towards the viewer, a row a photograph in the order of their names: check axes and order"
        )


def _write(out: Path, normal_map: NormalMap, albedo: Float32Array) -> None:
    """Write the folder: normals with errors (EXR), as DiLiGenT's (MAT, PNG), mask and albedo."""
    from scipy.io import savemat

    out.mkdir(parents=True, exist_ok=True)
    write_normal_map(out / "normals.exr", normal_map)
    write_normal_map(out / "normal.png", normal_map)
    write_mask(out / "mask.png", normal_map.mask)
    brightest = float(albedo.max()) or 1.0
    write_png(out / "albedo.png", np.rint(65535 * np.clip(albedo / brightest, 0, 1)).astype(np.uint16))
    with atomic_path(out / "Normal_est.mat") as temporary:
        stored = normal_map.normals_in_camera * np.array([1.0, -1.0, -1.0])
        savemat(temporary, {"Normal_est": stored}, appendmat=False)

"""Depth rests where the subject does; noise is averaged over time and motion is not."""

from pathlib import Path

import numpy as np
import pytest

from tests.pipeline.conftest import RESPONSE, DomeCapture, dome_normals
from tests.pipeline.test_reconstruct import digest, job_of
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit
from vntoolkit.integration.integrate import DepthAnchor, DepthIntegrator
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.maps_and_meshes.maps import read_depth_map
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.options.reconstruction import Product
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import rgb_from_normals
from vntoolkit.pipeline.reconstruct import reconstruct
from vntoolkit.pipeline.smoothing import smoothed_frames, smoothed_over_time


def noisy_depths(rng, sigma: float, count: int, arm_from: int | None = None) -> list[DepthMap]:
    """A dome at rest; from frame `arm_from` on a steep ridge is attached to it at the left."""
    camera = Camera.orthographic(width=64, height=48)
    integrator = DepthIntegrator(camera)
    depths = []
    for number in range(count):
        normals, mask = dome_normals(40.0)
        if arm_from is not None and number >= arm_from:
            arm = np.zeros_like(mask)
            arm[20:28, 2:32] = True
            arm &= ~mask
            normals = np.where(arm[..., None], np.array([0.6, 0.0, -0.8]), normals)
            mask = mask | arm
        rgb = np.where(mask[..., None], rgb_from_normals(normals, RESPONSE), 0)
        rgb = (rgb + rng.normal(0, sigma, rgb.shape)).astype(np.float32)
        frame = LinearFrame(rgb=rgb, clipped=np.zeros(mask.shape, bool))
        depths.append(integrator.integrate(normals_from_frame(frame, RESPONSE, mask)))
    return depths


def test_depth_at_rest_flickers_no_more_than_the_noise_itself(rng) -> None:
    depths = noisy_depths(rng, 0.004, 24)
    anchor = DepthAnchor(depths[0])
    aligned = np.array([anchor.align(d).depth for d in depths[1:]])
    mask = depths[0].mask
    flicker = aligned.std(axis=0)[mask]
    offsets = np.median(aligned[:, mask] - aligned[:, mask].mean(axis=0), axis=1)
    # One frame's noise leaves an error of the depth's shape; the offset must add nothing to speak of.
    truth = noisy_depths(rng, 0.0, 1)[0].depth
    shape_error = np.array([(d.depth - truth)[mask].std() for d in depths]).mean()
    assert offsets.std() < 0.3 * shape_error
    assert 0.5 * shape_error < np.sqrt((flicker**2).mean()) < 1.25 * shape_error


def test_an_arm_that_enters_does_not_push_the_body_back(rng) -> None:
    depths = noisy_depths(rng, 0.002, 6, arm_from=3)
    body = depths[0].mask
    loose = [float(np.median(d.depth[body])) for d in depths]
    anchor = DepthAnchor(depths[0])
    tied = [float(np.median(anchor.align(d).depth[body])) for d in depths]
    assert abs(loose[3] - loose[2]) > 0.5  # pixels: the mean takes the arm in
    assert np.ptp(tied) < 0.05


def test_each_part_is_tied_alone_and_parts_that_are_new_stay() -> None:
    mask = np.zeros((40, 60), bool)
    mask[5:35, 2:20] = mask[5:35, 22:40] = True
    ramp = np.indices(mask.shape)[1].astype(float)
    reference = DepthMap(depth=np.where(mask, ramp, 0), mask=mask)
    grown = mask.copy()
    grown[5:35, 45:58] = True
    moved = ramp.copy()
    moved[:, :21] += 7
    moved[:, 21:42] -= 3
    aligned = DepthAnchor(reference).align(DepthMap(depth=np.where(grown, moved, 0), mask=grown))
    np.testing.assert_allclose(aligned.depth[mask], ramp[mask])
    np.testing.assert_allclose(aligned.depth[:, 45:58][5:35], ramp[5:35, 45:58])
    free = DepthMap(depth=np.where(mask, 1 + ramp, 0), mask=mask, unit=LengthUnit.FREE)
    twice = DepthMap(depth=2 * free.depth, mask=mask, unit=LengthUnit.FREE)
    np.testing.assert_allclose(DepthAnchor(free).align(twice).depth, free.depth)


def test_smoothing_averages_what_rests_and_leaves_what_moves(rng) -> None:
    picture = np.full((3, 50, 80, 3), 30000.0)
    for t in range(3):
        picture[t, 10:40, 20 + 10 * t : 30 + 10 * t] = 60000  # a bar that jumps by its own width
    noisy = np.round(picture + rng.normal(0, 600, picture.shape)).astype(np.uint16)
    out = smoothed_over_time(noisy[0], noisy[1], noisy[2], 16, 0.05)
    rest = np.ones((50, 80), bool)
    rest[10:40, 20:50] = False
    ratio = (out[rest] - picture[1][rest]).std() / (noisy[1][rest] - picture[1][rest]).std()
    assert 1 / np.sqrt(3) - 0.02 < ratio < 0.75  # three frames at best; alike ones count more
    bar = out[10:40, 30:40].astype(float)
    assert abs(bar.mean() - 60000) < 60
    np.testing.assert_array_equal(out[10:40, 30:40], noisy[1][10:40, 30:40])
    clipped = np.full((1, 1, 3), 255, np.uint8)
    dark = np.full((1, 1, 3), 250, np.uint8)
    assert (smoothed_over_time(dark, clipped, dark, 8, 0.5) == 65535).all()


@pytest.mark.slow
def test_smoothed_frames_do_not_depend_on_the_blocks(dome_capture: DomeCapture, tmp_path: Path) -> None:
    capture = open_capture(dome_capture.source)
    whole = {f.number: f.values for f in smoothed_frames(capture, range(20), 0.02)}
    assert sorted(whole) == list(range(20))
    for block in (range(3), range(3, 4), range(4, 20), range(0, 20, 7)):
        parts = list(smoothed_frames(capture, block, 0.02))
        assert [f.number for f in parts] == list(block)
        for frame in parts:
            np.testing.assert_array_equal(frame.values, whole[frame.number])
    one, two = tmp_path / "one", tmp_path / "two"
    reconstruct(job_of(dome_capture, one, to=Product.DEPTH, smoothing=0.02))
    reconstruct(job_of(dome_capture, two, to=Product.DEPTH, smoothing=0.02), jobs=2)
    assert digest(one) == digest(two)
    assert read_manifest(one).known.reference_frame == 0


def test_the_reference_stays_when_a_run_goes_further(dome_capture: DomeCapture, tmp_path: Path) -> None:
    tied = tmp_path / "tied"
    reconstruct(job_of(dome_capture, tied, to=Product.DEPTH))
    first = read_depth_map(tied / "depth/000000.exr")
    last = read_depth_map(tied / "depth/000019.exr")
    both = first.mask & last.mask
    assert abs(np.median((last.depth - first.depth)[both])) < 1e-4

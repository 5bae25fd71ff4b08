"""Live mode: frames in time, the oldest dropped when it is too much, results those of the stages."""

import contextlib
import os
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.pipeline.conftest import RESPONSE, RIG, dome_light, dome_normals
from vntoolkit.__main__ import main
from vntoolkit.cli.live import _keys
from vntoolkit.errors import BadCapture, BadInput, CannotWrite, NoSubject, VntError
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.footage.video import write_video
from vntoolkit.io.rigs import write_rig
from vntoolkit.live.capture import CameraSource, FileSource, LatencyMeter, LiveRecorder, LiveRun, TimedFrame
from vntoolkit.live.frames import (
    FrameView,
    LiveProcessor,
    LiveResult,
    exposure_warnings,
    reduced,
)
from vntoolkit.options.depth import IntegrationOptions, Integrator
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import MaterialSearch, Product, ReconstructOptions
from vntoolkit.pipeline.frame_processor import FrameProcessor


def dome_picture(background: float = 0.0) -> np.ndarray:
    return np.round((dome_light() + background).clip(0, 1) * 255).astype(np.uint8)


def encoded(values: np.ndarray, number: int = 0) -> EncodedFrame:
    return EncodedFrame(values=values, bits=8, number=number, name=f"frame {number}")


class Source:
    """Gives frames at once, or when it is told."""

    name, width, height, frame_rate_hz, skipped = "source", 64, 48, 30.0, 0

    def __init__(self, frames: list[EncodedFrame], gate: threading.Event | None = None) -> None:
        self._frames, self._gate = frames, gate

    def frames(self):
        for frame in self._frames:
            yield TimedFrame(frame=frame, arrived_s=time.perf_counter())
        if self._gate is not None:
            self._gate.set()


def test_shadows_are_found_live_as_in_a_run() -> None:
    values = dome_picture()
    values[18:30, 24:32, 2] //= 16  # the blue lamp is missing
    options = ReconstructOptions(
        to=Product.NORMALS, shadows=ShadowMethod.ROBUST, materials=MaterialSearch.CALIBRATED
    )
    expected = FrameProcessor(RIG, options, with_errors=False).process(encoded(values)).normal_map
    found = LiveProcessor(RIG, shadows=ShadowMethod.ROBUST).process(encoded(values)).normal_map
    np.testing.assert_array_equal(found.normals_in_camera, expected.normals_in_camera)
    plain = LiveProcessor(RIG).process(encoded(values)).normal_map
    assert np.abs(plain.normals_in_camera - expected.normals_in_camera).max() > 0.1


def test_a_file_plays_at_its_own_speed(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mkv", [dome_picture()] * 8, 25.0)
    timed = [t.arrived_s for t in FileSource(open_capture(tmp_path / "a.mkv")).frames()]
    np.testing.assert_allclose(np.diff(timed), 0.04, atol=1e-6)  # when due, even where decoding is late


class SlowCapture:
    """Eighty frames at 50 a second, of which the third takes half a second to decode."""

    name = "slow"

    class info:
        width, height, frame_rate_hz = 64, 48, 50.0

    def __len__(self) -> int:
        return 80

    def encoded_frames(self, start: int = 0):
        for number in range(start, 80):
            if number == 2:
                time.sleep(0.5)
            yield encoded(dome_picture(), number)


def test_a_file_that_decodes_too_slowly_skips_frames_and_counts_them() -> None:
    source = FileSource(SlowCapture())
    numbers = [timed.frame.number for timed in source.frames()]
    assert numbers[:2] == [0, 1]
    assert numbers[2] >= 25  # half a second later
    assert source.skipped == 80 - len(numbers)
    run = LiveRun(FileSource(SlowCapture()), LiveProcessor(RIG), lambda r, t: None)
    figures = run.run()
    assert figures.arrived == 80
    assert figures.dropped == 80 - figures.processed > 0


def test_the_newest_frames_are_worked_on_and_the_others_counted() -> None:
    all_there = threading.Event()
    source = Source([encoded(dome_picture(), n) for n in range(10)], all_there)
    seen: list[int] = []

    def on_result(result: LiveResult, timed: TimedFrame) -> None:
        all_there.wait(30)  # the first frame takes as long as the nine others need to arrive
        seen.append(result.number)

    figures = LiveRun(source, LiveProcessor(RIG), on_result).run()
    assert seen[-2:] == [8, 9]
    assert len(seen) <= 3
    assert figures.arrived == 10
    assert figures.processed == len(seen)
    assert figures.dropped == 10 - len(seen)
    assert figures.arrival_hz > figures.rate_hz
    assert f"{figures.dropped} of 10 dropped" in figures.line()


def test_a_file_that_is_not_in_real_time_loses_nothing() -> None:
    source = Source([encoded(dome_picture(), n) for n in range(12)])
    seen: list[int] = []
    arrived: list[int] = []
    run = LiveRun(
        source,
        LiveProcessor(RIG),
        lambda result, timed: seen.append(result.number),
        lambda timed: arrived.append(timed.frame.number),
        wait_for_all=True,
    )
    assert run.run().dropped == 0
    assert seen == arrived == list(range(12))


def test_recent_frames_tell_how_dark_a_frame_without_a_subject_is() -> None:
    rig = replace(RIG, response=replace(RESPONSE, matrix=RESPONSE.matrix / 6))
    bright, dim = encoded(dome_picture(), 0), encoded(dome_picture() // 30, 1)
    alone, after = LiveProcessor(rig).begin, LiveProcessor(rig).begin
    assert alone(dim)[0].normal_map.mask.any()
    after(bright)
    with pytest.raises(NoSubject, match="far darker than before"):
        after(dim)
    for _ in range(3):  # lamps that stay dim are believed
        with contextlib.suppress(NoSubject):
            after(dim)
    assert after(dim)[0].normal_map.mask.any()


def test_black_frames_fail_alone_and_a_source_that_never_gave_any_raises() -> None:
    black = np.zeros((48, 64, 3), np.uint8)
    source = Source([encoded(black, 0), encoded(dome_picture(), 1)])
    figures = LiveRun(source, LiveProcessor(RIG), lambda r, t: None, wait_for_all=True).run()
    assert (figures.failed, figures.processed) == (1, 1)
    told: list[str] = []
    dark = Source([encoded(black)])
    run = LiveRun(dark, LiveProcessor(RIG), lambda r, t: None, on_failure=lambda p, t: told.append(str(p)))
    with pytest.raises(VntError, match="no "):  # not one frame had normals
        run.run()
    assert len(told) == 1

    class Unplugged(Source):
        def frames(self):
            raise BadCapture("camera 0: gives no frames any more")
            yield

    with pytest.raises(BadCapture, match="no frames any more"):
        LiveRun(Unplugged([]), LiveProcessor(RIG), lambda r, t: None).run()
    with pytest.raises(BadCapture, match="cannot be opened"):
        CameraSource(97)


def test_results_are_those_of_the_dome_and_depth_keeps_its_offset() -> None:
    processor = LiveProcessor(RIG)
    truth, mask = dome_normals(31.5)
    first = processor.process(encoded(dome_picture()))
    inside = first.normal_map.mask & mask
    cosine = np.sum(first.normal_map.normals_in_camera * truth, axis=2)[inside]
    assert np.rad2deg(np.arccos(np.clip(cosine, -1, 1))).max() < 2.0  # 8 bits
    covered = dome_picture()
    covered[:20] = 0  # a hand before the upper part
    second = processor.process(encoded(covered))
    both = first.depth_map.mask & second.depth_map.mask
    assert abs(np.median((second.depth_map.depth - first.depth_map.depth)[both])) < 1e-3


def test_depth_is_least_squares_where_halves_of_a_dome_do_not_meet() -> None:
    """To find the jump takes several times as long."""
    values = dome_picture()
    values[:, 32:] = np.roll(values[:, 32:], 12, axis=0)
    processor = LiveProcessor(RIG, depth_px=64)
    found = processor.process(encoded(values))
    default = DepthIntegrator(processor.depth_camera).integrate(found.normal_map)
    poisson = IntegrationOptions(integrator=Integrator.POISSON)
    smooth = DepthIntegrator(processor.depth_camera, poisson).integrate(found.normal_map)
    inside = found.depth_map.mask
    np.testing.assert_allclose(found.depth_map.depth[inside], smooth.depth[inside], atol=1e-6)
    assert np.abs(default.depth - smooth.depth)[inside].max() > 1  # pixel


def test_depth_of_half_the_size_is_the_same_surface() -> None:
    whole = LiveProcessor(RIG, depth_px=64)
    half = LiveProcessor(RIG, depth_px=32)
    large, small = (p.process(encoded(dome_picture())) for p in (whole, half))
    assert large.normal_map.shape == small.normal_map.shape == (48, 64)
    assert small.depth_map.shape == (half.depth_camera.height, half.depth_camera.width) == (24, 32)
    means = large.depth_map.depth.reshape(24, 2, 32, 2).mean(axis=(1, 3))
    inside = large.depth_map.mask.reshape(24, 2, 32, 2).all(axis=(1, 3)) & small.depth_map.mask
    assert inside.sum() > 150
    apart = (small.depth_map.depth - means)[inside]
    relief = np.ptp(means[inside])
    assert relief > 3  # pixels: lengths do not shrink with the picture
    assert np.abs(apart - np.median(apart)).max() < 0.02 * relief


def test_warming_up_leaves_nothing_behind() -> None:
    fresh, warm = LiveProcessor(RIG), LiveProcessor(RIG)
    warm.warm_up(encoded(np.full((48, 64, 3), 128, np.uint8)))
    warm.warm_up(encoded(np.zeros((48, 64, 3), np.uint8)))
    for number in range(2):
        first, second = (
            fresh.process(encoded(dome_picture(), number)),
            warm.process(encoded(dome_picture(), number)),
        )
        np.testing.assert_array_equal(first.normal_map.normals_in_camera, second.normal_map.normals_in_camera)
        np.testing.assert_array_equal(first.depth_map.depth, second.depth_map.depth)


def test_crop_rectification_and_background_give_the_same_normals() -> None:
    rig = RIG
    plain = LiveProcessor(rig).process(encoded(dome_picture())).normal_map
    wide = np.zeros((80, 100, 3), np.uint8)
    wide[10:58, 20:84] = dome_picture(0.1)
    empty = np.zeros((80, 100, 3), np.uint8)
    empty[10:58, 20:84] = round(0.1 * 255)
    crop = FrameView(crop=(20, 10, 64, 48))
    cropped = LiveProcessor(rig, crop, background=encoded(empty)).process(encoded(wide)).normal_map
    inside = plain.mask & cropped.mask
    assert inside.sum() > 0.9 * plain.mask.sum()
    np.testing.assert_allclose(cropped.normals_in_camera[inside], plain.normals_in_camera[inside], atol=0.02)
    same = Rectification(corners_px=(0, 0, 64, 0, 0, 48, 64, 48), width_mm=6.4, height_mm=4.8, pixel_mm=0.1)
    rectified = LiveProcessor(rig, replace(crop, rectification=same), background=encoded(empty))
    result = rectified.process(encoded(wide)).normal_map
    np.testing.assert_allclose(result.normals_in_camera[inside], cropped.normals_in_camera[inside], atol=1e-4)
    with pytest.raises(BadInput, match="does not lie within the 64×48 picture"):
        FrameView(crop=(30, 0, 64, 48)).require_inside(64, 48)


def test_exposure_is_warned_of() -> None:
    picture = dome_picture()
    assert exposure_warnings(encoded(picture)) == ()
    assert "dark" in exposure_warnings(encoded(picture // 30))[0]
    bright = picture.copy()
    bright[:10] = 255
    assert "clipped" in exposure_warnings(encoded(bright))[0]


def test_recordings_are_lossless_and_one_file_each(tmp_path: Path, rng) -> None:
    recorder = LiveRecorder(tmp_path / "new", 30.0)
    pictures = [rng.integers(0, 256, (48, 64, 3), dtype=np.uint8) for _ in range(7)]
    recorder.take(TimedFrame(frame=encoded(pictures[0]), arrived_s=0.0))  # not recording yet
    assert recorder.toggle()
    for picture in pictures[:4]:
        recorder.take(TimedFrame(frame=encoded(picture), arrived_s=0.0))
    assert not recorder.toggle()
    recorder.start()
    for picture in pictures[4:]:
        recorder.take(TimedFrame(frame=encoded(picture), arrived_s=0.0))
    recorder.stop()
    assert recorder.lost == 0
    assert len(recorder.files) == 2
    read = [f.values for path in recorder.files for f in open_capture(path).encoded_frames()]
    np.testing.assert_array_equal(read, pictures)


def test_a_recording_without_a_frame_leaves_nothing(tmp_path: Path) -> None:
    recorder = LiveRecorder(tmp_path, 30.0)
    recorder.start()
    recorder.stop()
    assert (recorder.files, recorder.problem, list(tmp_path.iterdir())) == ([], "", [])


def test_a_recording_that_fails_is_over_and_the_next_one_is_not_blamed(tmp_path: Path, monkeypatch) -> None:
    def full_disk(_path: Path, frames: object, _rate: float) -> None:
        next(frames)
        raise CannotWrite("no space left")

    recorder = LiveRecorder(tmp_path, 30.0)
    with monkeypatch.context() as failing:
        failing.setattr("vntoolkit.live.capture.write_video", full_disk)
        recorder.start()
        recorder.take(TimedFrame(frame=encoded(dome_picture()), arrived_s=0.0))
        until = time.monotonic() + 10
        while recorder.is_recording and time.monotonic() < until:
            time.sleep(0.01)
    assert not recorder.is_recording
    assert (recorder.files, recorder.problem) == ([], "no space left")
    recorder.toggle()
    recorder.take(TimedFrame(frame=encoded(dome_picture()), arrived_s=0.0))
    assert recorder.problem == ""
    recorder.stop()
    assert len(recorder.files) == 1


def test_every_r_in_the_terminal_counts(monkeypatch) -> None:
    ours, theirs = os.openpty()
    pressed: list[int] = []
    with os.fdopen(theirs) as terminal:
        monkeypatch.setattr("sys.stdin", terminal)
        with _keys(lambda: pressed.append(1)):
            os.write(ours, b"rxr")
            until = time.monotonic() + 10
            while len(pressed) < 2 and time.monotonic() < until:
                time.sleep(0.01)
    os.close(ours)
    assert len(pressed) == 2


def test_rate_and_latency_are_measured() -> None:
    meter = LatencyMeter()
    assert meter.figures() == (0.0, (0.0, 0.0))
    now = time.perf_counter()
    meter.reached(now - 1.0)
    meter.reached(now - 1.0)
    median, high = meter.figures()[1]
    assert 1.0 <= median <= high < 2.0


def test_the_command_plays_a_video_and_says_what_was_dropped(tmp_path: Path, capsys) -> None:
    write_video(tmp_path / "a.mkv", [dome_picture()] * 6, 30.0)
    write_rig(tmp_path / "rig.json", RIG)
    arguments = ["live", "--rig", str(tmp_path / "rig.json"), "--port", "8192"]
    assert main([*arguments, "--video", str(tmp_path / "a.mkv")]) == 0
    printed = capsys.readouterr().out
    assert "0 of 6 dropped" in printed
    assert main([*arguments, "--video", str(tmp_path / "a.mkv"), "--camera", "0"]) != 0
    assert "either --camera NUMBER or --video FILE" in capsys.readouterr().err
    assert main([*arguments, "--video", str(tmp_path / "a.mkv"), "--seconds", "0"]) != 0
    assert "seconds: expected more than 0, got 0" in capsys.readouterr().err
    assert main([*arguments, "--video", str(tmp_path / "a.mkv"), "--rate", "5"]) != 0
    assert "a video has its own" in capsys.readouterr().err


@pytest.mark.parametrize("number", [-1, 100, 99999999999])
def test_a_camera_number_that_opencv_would_choke_on_is_refused(tmp_path: Path, capsys, number: int) -> None:
    write_rig(tmp_path / "rig.json", RIG)
    assert main(["live", "--rig", str(tmp_path / "rig.json"), "--camera", str(number)]) == 1
    said = capsys.readouterr().err
    assert f"camera: expected a number from 0, the first camera, to 99, got {number}" in said
    assert said.count("\n") == 1


def test_normals_for_depth_are_the_means_of_their_blocks(rng):
    normals = rng.normal(size=(7, 9, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    mask = np.ones((7, 9), bool)
    mask[0, :2] = mask[2:4, 2:4] = mask[3, 0] = mask[4:6, 4:6] = False
    mask[4, 4] = True  # a fourth of its block
    normals[~mask] = 0
    found = reduced(NormalMap(normals_in_camera=normals, mask=mask), 2)
    blocks = normals[:6, :8].reshape(3, 2, 4, 2, 3).sum(axis=(1, 3))
    valid = np.ones((3, 4), bool)
    valid[1, 1] = valid[2, 2] = False
    np.testing.assert_array_equal(found.mask, valid)
    wanted = blocks[valid] / np.linalg.norm(blocks[valid], axis=1, keepdims=True)
    np.testing.assert_allclose(found.normals_in_camera[valid], wanted, atol=1e-6)
    assert not found.normals_in_camera[~valid].any()

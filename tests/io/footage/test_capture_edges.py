"""Options and footage at their edges: numbers that are none, strips, scattered pixels, a full disk."""

import contextlib
import errno
import json

import numpy as np
import pytest

from vntoolkit.diagnosis.inspection import inspect_capture
from vntoolkit.errors import BadCapture, BadInput, CannotWrite
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.decoding import EncodedFrame, linear_frame_from_encoded
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.light_files import read_lights
from vntoolkit.io.results.frame_log import FrameEntry, FrameLog
from vntoolkit.io.results.manifest import now_utc, read_manifest
from vntoolkit.io.results.seams import read_seams
from vntoolkit.io.rigs import read_rig, write_rig
from vntoolkit.options.footage import SensorOptions
from vntoolkit.options.pages import CameraOptions
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig, SourceFile
from vntoolkit.photometry.transfer import Transfer

NAN, INF = float("nan"), float("inf")
RESPONSE = LightResponse(matrix=np.array([[0.5, 0.1, -0.5], [-0.3, 0.4, -0.5], [-0.2, -0.5, -0.6]]))


@pytest.mark.parametrize(
    ("options", "line"),
    [
        ({"max_megapixels": NAN}, "capture: max_megapixels: expected a positive number, got nan"),
        ({"max_megapixels": -1.0}, "capture: max_megapixels: expected a positive number, got -1"),
        ({"frame_rate_hz": NAN}, "capture: frame rate: expected a positive number, got nan"),
        ({"frame_rate_hz": 0.0}, "capture: frame rate: expected a positive number, got 0"),
        ({"threads": 0}, "capture: threads: expected a positive number, got 0"),
    ],
)
def test_capture_options_that_are_none(options, line):
    with pytest.raises(BadInput) as refusal:
        CaptureOptions(**options)
    assert str(refusal.value) == line


@pytest.mark.parametrize("rate", [NAN, INF, 0.0])
def test_a_camera_needs_a_rate(rate):
    with pytest.raises(BadInput, match="rate: expected a positive number, got"):
        CameraOptions(rate=rate)


def test_a_sample_holds_no_more_bits_than_its_bytes(tmp_path):
    for bits in (0, 17):
        with pytest.raises(BadInput, match=f"bits: expected a value from 1 to 16, got {bits}"):
            SensorOptions(bits=bits)
    write_png(tmp_path / "a.png", np.full((4, 4, 3), 200, np.uint8))
    with pytest.raises(BadCapture, match=r"a\.png: samples of 8 bits cannot hold 12"):
        open_capture(tmp_path / "a.png", CaptureOptions(sensor=SensorOptions(bits=12)))


@pytest.mark.parametrize("curve", ["linear", "srgb", "gamma:2.2"])
@pytest.mark.parametrize(("dtype", "bits"), [(np.uint8, 8), (np.uint16, 12)])
def test_clipped_pixels_are_those_whose_light_reaches_the_white_level(rng, curve, dtype, bits):
    """The white level is one of light, so that a curve moves the stored value that reaches it."""
    transfer = Transfer(curve=Transfer.from_text(curve).curve, gamma=2.2, black_level=0.1, white_level=0.6)
    values = rng.integers(0, 2**bits, (30, 40, 3)).astype(dtype)
    frame = EncodedFrame(values=values, bits=bits, number=0, name="frame")
    linear = linear_frame_from_encoded(frame, transfer)
    assert 0.1 < linear.clipped.mean() < 0.9
    white = (transfer.white_level - transfer.black_level) / (1 - transfer.black_level)
    np.testing.assert_array_equal(linear.clipped, linear.rgb.max(axis=2) >= white - 1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 600), (600, 1), (20, 4000)])
def test_a_strip_is_inspected(tmp_path, rng, shape):
    write_png(tmp_path / "a.png", rng.integers(40, 240, (*shape, 3), dtype=np.uint8))
    rig = Rig(camera=Camera.orthographic(width=shape[1], height=shape[0]), response=RESPONSE)
    report = inspect_capture(tmp_path / "a.png", rig=rig)
    assert [finding.text for finding in report.findings if "exchanged" in finding.text] == []
    with pytest.raises(BadInput, match="samples: expected a positive number"):
        inspect_capture(tmp_path / "a.png", samples=0)


@pytest.mark.parametrize("shape", [(5, 7), (1, 300), (11, 11)])
def test_a_sequence_of_small_pictures_is_inspected(tmp_path, rng, shape):
    for number in range(4):
        write_png(tmp_path / f"{number}.png", rng.integers(40, 240, (*shape, 3), dtype=np.uint8))
    assert inspect_capture(tmp_path).findings


@pytest.mark.parametrize(
    ("files", "line"),
    [
        (
            {"mask": {"file": "a", "sha256": "0" * 64, "size": 1}},
            "unknown key 'extra_files.mask.size'; known",
        ),
        ({"mask": 3}, "extra_files.mask: expected a JSON object with the keys file, sha256"),
        ({"file": 3}, "extra_files.file: expected a JSON object with the keys file, sha256"),
    ],
)
def test_a_manifest_of_odd_files_is_one_line(tmp_path, files, line):
    camera = {"model": "PINHOLE", "width": 1, "height": 1, "K": np.eye(3).tolist()}
    source = {"source": "a", "files": [], "width": 1, "height": 1, "frame_count": 1, "frame_rate_hz": 1.0}
    rig = {"camera": camera, "response": {"matrix": np.eye(3).tolist()}}
    content = {"version": 2, "input": source, "rig": rig, "extra_files": files}
    (tmp_path / "reconstruction.json").write_text(json.dumps(content))
    with pytest.raises(BadInput) as refusal:
        read_manifest(tmp_path)
    assert line in str(refusal.value)


def test_a_fixed_moment_must_be_a_number(monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    assert now_utc() == "1970-01-01T00:00:00+00:00"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "yesterday")
    with pytest.raises(BadInput, match="SOURCE_DATE_EPOCH: expected seconds since 1970, got 'yesterday'"):
        now_utc()


def test_a_seam_beyond_all_numbers_is_one_line(tmp_path):
    (tmp_path / "a.json").write_text('{"seams": [[[1' + "0" * 400 + ", 2], [3, 4]]]}")
    with pytest.raises(BadInput, match="seam 0: expected two points"):
        read_seams(tmp_path / "a.json")


def test_a_log_that_cannot_be_written_can_be_closed(tmp_path):
    class Full:
        def write(self, text):
            raise OSError(errno.ENOSPC, "No space left on device")

        flush = close = lambda self: self.write("")

    log = FrameLog(tmp_path)
    log.append(FrameEntry(number=0))
    log._stream.close()
    log._stream = Full()
    with pytest.raises(CannotWrite, match="no space left"):
        log.append(FrameEntry(number=1))
    log.close()
    assert list(log.entries()) == [0]


def test_intensities_of_one_number_and_names_with_blanks(tmp_path):
    (tmp_path / "light_directions.txt").write_text("0 0 1\n0 0.6 0.8\n0.6 0 0.8\n")
    (tmp_path / "filenames.txt").write_text("my 1.png\n\nmy 2.png\nmy 3.png\n")
    for text in ("1\n2\n1\n", "3\n1\n2\n1\n"):  # with and without their number in front
        (tmp_path / "light_intensities.txt").write_text(text)
        lights = read_lights(tmp_path)
        assert lights.intensities.tolist() == [[1, 1, 1], [2, 2, 2], [1, 1, 1]]
        assert [path.name for path in lights.images] == ["my 1.png", "my 2.png", "my 3.png"]


def test_a_name_that_is_no_unicode_is_recorded_and_comes_back(tmp_path):
    """Linux allows any bytes in a name; Python stands those that are no UTF-8 in as lone surrogates."""
    name = "take\udcff.png"
    source = SourceFile(file=name, sha256="0" * 64)
    camera = Camera.orthographic(width=4, height=4)
    write_rig(tmp_path / "rig.json", Rig(camera=camera, response=RESPONSE, sources=(source,)))
    assert read_rig(tmp_path / "rig.json").sources == (source,)
    with contextlib.closing(FrameLog(tmp_path)) as log:
        log.append(FrameEntry(number=0, failure=f"{name} is black"))
        assert log.entries()[0].failure == "take\\udcff.png is black"

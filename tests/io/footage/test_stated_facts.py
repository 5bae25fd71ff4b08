"""What a file states about itself is obeyed, or refused by name."""

import json
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import OpenEXR
import pytest
import tifffile
from PIL import Image

from tests.pipeline.conftest import RESPONSE, dome_light, to_normals
from vntoolkit.__main__ import main
from vntoolkit.errors import BadCapture
from vntoolkit.io.footage import video_index
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.footage.orientation import Orientation
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.io.rigs import read_rig
from vntoolkit.photometry.response import rgb_from_normals
from vntoolkit.photometry.transfer import Transfer, encoded_from_linear

HEIGHT, WIDTH = 32, 48


def film(
    path, frames, codec="ffv1", pixels="bgr0", *, times=None, rotation=0, context=None, sound=False, **options
):
    """Write uint8 RGB frames. times: in milliseconds. context: attributes of the encoder."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(25), options=options)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = pixels
        for name, value in (context or {}).items():
            setattr(stream.codec_context, name, value)
        if rotation:
            stream.set_display_rotation(rotation)
        if times:
            stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        voice = container.add_stream("flac", rate=8000, layout="mono") if sound else None
        for number, values in enumerate(frames):
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(values), format="rgb24")
            if times:
                picture.pts, picture.time_base = times[number], Fraction(1, 1000)
            container.mux(stream.encode(picture))
            if voice is not None:
                heard = np.random.default_rng(number).integers(-9999, 9999, (1, 320)).astype(np.int16)
                tone = av.AudioFrame.from_ndarray(heard, format="s16", layout="mono")
                tone.sample_rate, tone.pts = 8000, 320 * number
                container.mux(voice.encode(tone))
        for one in (stream, voice):
            if one is not None:
                container.mux(one.encode(None))


def _arrow() -> np.ndarray:
    """A picture that no turn or flip maps to itself."""
    picture = np.full((HEIGHT, WIDTH, 3), 40, np.uint8)
    picture[: HEIGHT // 2, : WIDTH // 4] = 200
    return picture


def _levels(count: int) -> list[np.ndarray]:
    return [np.full((HEIGHT, WIDTH, 3), 20 + 12 * k, np.uint8) for k in range(count)]


# How the camera was held.


@pytest.mark.parametrize(("rotation", "quarters"), [(90, 1), (180, 2), (270, 3)])
def test_a_turned_video_comes_upright(tmp_path, rotation, quarters):
    """FFmpeg states the turn counter-clockwise, as `numpy.rot90` takes it."""
    film(tmp_path / "a.mp4", [_arrow()], "libx264", "yuv444p", rotation=rotation, crf="0")
    capture = open_capture(tmp_path / "a.mp4")
    upright = np.rot90(_arrow(), quarters)
    assert (capture.info.height, capture.info.width) == upright.shape[:2]
    np.testing.assert_allclose(capture.encoded(0).values.astype(int), upright, atol=3)
    assert "turned by" in capture.info.orientation


@pytest.mark.parametrize(("value", "quarters"), [(1, 0), (3, 2), (6, 3), (8, 1)])
def test_a_video_of_pictures_with_exif_comes_upright(tmp_path, value, quarters):
    """FFmpeg hands EXIF as data of the frame; PyAV 18 does not know its kind and lists none of the others."""
    exif = Image.Exif()
    exif[274] = value
    upright = _arrow()
    stored = np.ascontiguousarray(np.rot90(upright, -quarters))
    Image.fromarray(stored).save(tmp_path / "a.jpg", exif=exif, quality=99)
    with av.open(str(tmp_path / "a.avi"), "w") as container:
        stream = container.add_stream("mjpeg", rate=25)
        stream.height, stream.width, stream.pix_fmt = *stored.shape[:2], "yuvj420p"
        packet = av.Packet((tmp_path / "a.jpg").read_bytes())
        packet.stream, packet.pts, packet.dts, packet.time_base = stream, 0, 0, Fraction(1, 25)
        container.mux(packet)
    np.testing.assert_allclose(
        open_capture(tmp_path / "a.avi").encoded(0).values.astype(int), upright, atol=12
    )


@pytest.mark.parametrize("kind", ["png", "jpg", "tif"])
@pytest.mark.parametrize("value", range(1, 9))
def test_exif_and_tiff_orientation_is_obeyed(tmp_path, kind, value):
    upright = _arrow()
    turned = Orientation.from_exif(value)
    stored = next(
        picture
        for quarters in range(4)
        for picture in (np.rot90(upright, quarters), np.rot90(upright[:, ::-1], quarters))
        if turned.upright(picture).shape == upright.shape and (turned.upright(picture) == upright).all()
    )
    path = tmp_path / f"a.{kind}"
    if kind == "tif":
        tag = [(274, "H", 1, value, True)]
        tifffile.imwrite(path, np.ascontiguousarray(stored), photometric="rgb", extratags=tag)
    else:
        exif = Image.Exif()
        exif[274] = value
        Image.fromarray(stored).save(path, exif=exif, **({"quality": 99} if kind == "jpg" else {}))
    np.testing.assert_allclose(read_image(path).astype(int), upright, atol=12)
    info = open_capture(path).info
    assert (info.width, info.height, bool(info.orientation)) == (WIDTH, HEIGHT, value != 1)


def test_the_eight_exif_values_are_the_eight_turns_and_flips():
    """6, what telephones write, is shown turned clockwise; 8 counter-clockwise; 5 and 7 are mirrored."""
    picture = _arrow()
    expected = {
        1: picture, 2: picture[:, ::-1], 3: picture[::-1, ::-1], 4: picture[::-1],
        5: np.swapaxes(picture, 0, 1), 6: np.rot90(picture, 3), 7: np.rot90(picture, 3)[::-1],
        8: np.rot90(picture),
    }  # fmt: skip
    for value, upright in expected.items():
        np.testing.assert_array_equal(Orientation.from_exif(value).upright(picture), upright)


def test_interlaced_video_is_refused_with_the_command_that_helps(tmp_path):
    options = {"x264-params": "interlaced=1:tff=1"}
    film(tmp_path / "a.mp4", _levels(3), "libx264", "yuv420p", **options)
    with pytest.raises(
        BadCapture, match=r"is interlaced.*ffmpeg -i .*a\.mp4 -vf bwdif -c:v ffv1 a_progressive"
    ):
        open_capture(tmp_path / "a.mp4")


# The curve.


@pytest.mark.parametrize(
    ("tag", "curve"),
    [(1, "bt709"), (4, "gamma:2.2"), (5, "gamma:2.8"), (8, "linear"), (13, "srgb"), (16, "pq"), (18, "hlg")],
)
def test_a_stated_curve_is_the_default(tmp_path, tag, curve):
    film(tmp_path / "a.mkv", _levels(2), "libx264", "yuv444p", context={"color_trc": tag})
    capture = open_capture(tmp_path / "a.mkv")
    assert (capture.info.stated_transfer, capture.transfer) == (curve, Transfer.from_text(curve))
    assert open_capture(tmp_path / "a.mkv", CaptureOptions(transfer=Transfer())).transfer == Transfer()


def test_camera_logs_read_codes_whatever_the_range(tmp_path):
    """A grey card in S-Log3 is code 420 of 1023, in a file of limited and in one of full range."""
    grey = 0.18 * Transfer.from_text("slog3").diffuse_white
    for name, tag in (("limited", 1), ("full", 2)):
        with av.open(str(tmp_path / f"{name}.mkv"), "w") as container:
            stream = container.add_stream("libx264", rate=25, options={"crf": "0"})
            stream.height, stream.width, stream.pix_fmt = HEIGHT, WIDTH, "yuv444p10le"
            stream.codec_context.color_range = tag
            picture = av.VideoFrame(WIDTH, HEIGHT, "yuv444p10le")
            for plane, code in zip(picture.planes, (420, 512, 512), strict=True):
                plane.update(np.full(plane.buffer_size // 2, code, np.uint16).tobytes())
            picture.color_range = tag
            container.mux(stream.encode(picture))
            container.mux(stream.encode(None))
        options = CaptureOptions(transfer=Transfer.from_text("slog3"))
        frame = open_capture(tmp_path / f"{name}.mkv", options).frame(0)
        np.testing.assert_allclose(frame.rgb, grey, rtol=3e-3)


def _dome(path: Path, curve: str, tag: int) -> None:
    """A dome under three lights, 4:4:4 without loss, and its tag."""
    frames = []
    for k in range(3):
        encoded = encoded_from_linear(dome_light(31.5 + k), Transfer.from_text(curve))
        frames.append(np.rint(255 * encoded).astype(np.uint8))
    film(path, frames, "libx264rgb", "rgb24", context={"color_trc": tag}, crf="0")


def test_a_tag_against_the_rig_stops_the_run_and_names_both(tmp_path, capsys, caplog):
    _dome(tmp_path / "a.mkv", "linear", 13)
    command = to_normals(tmp_path, tmp_path / "a.mkv")
    assert main(command) == 1
    said = " ".join(capsys.readouterr().err.split())
    assert "the file states the transfer curve srgb, the rig's is linear" in said
    assert "--allow tag" in said
    assert not (tmp_path / "out").exists()
    assert main([*command, "--transfer", "linear"]) == 0
    assert main([*command, "--allow", "tag", "--overwrite"]) == 0
    assert main(["doctor", str(tmp_path / "a.mkv"), "--rig", str(tmp_path / "rig.json")]) == 1


def test_calibration_takes_the_stated_curve_into_the_rig(tmp_path, capsys):
    v, u = np.mgrid[:96, :96].astype(float)
    x, y = (u - 47.5) / 40, (v - 47.5) / 40
    ball = x**2 + y**2 < 1
    normals = np.stack([x, y, -np.sqrt(np.maximum(1 - x**2 - y**2, 0))], -1)
    light = np.where(ball[..., None], rgb_from_normals(normals, RESPONSE), 0).clip(0, 1)
    encoded = np.rint(255 * encoded_from_linear(light, Transfer.from_text("srgb"))).astype(np.uint8)
    film(tmp_path / "ball.mkv", [encoded], "libx264rgb", "rgb24", context={"color_trc": 13}, crf="0")
    out = tmp_path / "rig.json"
    assert main(["calibrate", "sphere", str(tmp_path / "ball.mkv"), "--out", str(out)]) == 0
    assert read_rig(out).transfer == Transfer.from_text("srgb")
    assert "transfer curve    srgb" in capsys.readouterr().out


def test_calibration_obeys_the_judge(tmp_path, capsys):
    Image.fromarray(np.full((96, 96), 90, np.uint8)).save(tmp_path / "a.png")
    assert main(["calibrate", "sphere", str(tmp_path / "a.png"), "--out", str(tmp_path / "rig.json")]) == 1
    assert "the footage is grey" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "rig.json").exists()


# Windows and pages.


def test_a_few_pixels_in_a_vast_exr_window_are_refused(tmp_path):
    """One flipped bit of a header would else fill the memory with empty pixels."""
    values = {name: np.zeros((6, 8), np.float32) for name in "BGR"}
    header = {
        "dataWindow": ((0, 0), (7, 5)), "displayWindow": ((0, 0), (9999, 5)), "type": OpenEXR.scanlineimage
    }  # fmt: skip
    OpenEXR.File(header, values).write(str(tmp_path / "a.exr"))
    with pytest.raises(BadCapture, match="its 8×6 pixels lie in a picture of 10000×6"):
        read_image(tmp_path / "a.exr")


# Times.


def test_times_of_a_varying_rate_reach_the_manifest(tmp_path):
    times = [0, 33, 66, 150, 183, 250]
    film(tmp_path / "a.mkv", [np.rint(255 * dome_light()).astype(np.uint8)] * 6, times=times)
    film(tmp_path / "even.mkv", _levels(6))
    assert open_capture(tmp_path / "even.mkv").info.times_s == ()
    assert main(to_normals(tmp_path, tmp_path / "a.mkv")) == 0
    entry = json.loads((tmp_path / "out/reconstruction.json").read_text())["input"]
    assert entry["times_s"] == [time / 1000 for time in times]


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ([0, 0, 0, 0], "the file gives all 4 frames one time"),
        ([0, 33, 33, 66], "the file gives 1 of 4 frames the time of another"),
        ([0, 33, 66, 3_600_000_000], "the file puts two of its frames 1,000 hours apart"),
        ([k * 3_600_000_000 for k in range(4)], "the file puts two of its frames 1,000 hours apart"),
    ],
)
def test_times_that_cannot_be_are_said_with_what_is_done_instead(tmp_path, caplog, times, said):
    frames = [np.rint(dome_light() * (250 - 20 * k)).astype(np.uint8) for k in range(4)]
    film(tmp_path / "a.mkv", frames, times=times)
    capture = open_capture(tmp_path / "a.mkv")
    assert capture.info.times_s == ()
    for number in (2, 0, 3):  # each frame is the one that was stored in its place
        assert (capture.encoded(number).values == frames[number]).all()
    command = to_normals(tmp_path, tmp_path / "a.mkv", "--frames", "0:3:2")
    assert main(command) == 0
    assert f"{said}; the frames are played at 25 per second: give --frame-rate-hz" in caplog.text
    caplog.clear()
    assert main([*command, "--overwrite", "--frame-rate-hz", "12.5"]) == 0
    assert "are played at" not in caplog.text
    filmed = read_manifest(tmp_path / "out").input
    assert filmed.times_of((0, 2)).tolist() == [0, 0.16]
    assert filmed.rate_of((0, 2)) == 6.25


def test_falling_times_are_told_from_frames_that_are_stored_out_of_order():
    packets = [(9, True, None), (5, True, None), (0, True, None)]
    assert video_index._wrong_with_times(packets) == "the file's times fall from one frame to the next"
    builds_on_later = [(0, True, None), (9, False, None), (5, False, None)]
    assert video_index._wrong_with_times(builds_on_later) == ""


def test_the_rate_of_even_times_counts_not_the_headers(tmp_path):
    film(tmp_path / "a.mkv", _levels(4), times=[0, 10_000, 20_000, 30_000])
    info = open_capture(tmp_path / "a.mkv").info
    assert info.frame_rate_hz == pytest.approx(0.1)
    assert info.times_s == ()


def test_b_frames_in_avi_come_in_the_order_they_are_shown(tmp_path):
    """AVI stores no times; FFmpeg's are those of decoding."""
    film(tmp_path / "a.avi", _levels(9), "libx264", "yuv444p", bf="3", **{"b-adapt": "0"})
    capture = open_capture(tmp_path / "a.avi")
    shown = [round(float(frame.values.mean())) for frame in capture.encoded_frames()]
    np.testing.assert_allclose(shown, [20 + 12 * k for k in range(9)], atol=3)
    for number in (7, 2, 4):
        assert capture.encoded(number).values.mean() == pytest.approx(20 + 12 * number, abs=3)


@pytest.mark.parametrize("sound", [False, True])
def test_a_frame_that_is_stored_before_lost_ones_does_not_take_their_number(tmp_path, rng, sound):
    """Cut off among B-frames, a P-frame shown after them has come already."""
    frames = [values + rng.integers(0, 20, values.shape, dtype=np.uint8) for values in _levels(16)]
    options = {"bf": "3", "b-adapt": "0", "crf": "10"}
    film(tmp_path / "a.mkv", frames, "libx264", "yuv444p", sound=sound, **options)
    content = (tmp_path / "a.mkv").read_bytes()
    lengths = set()
    for share in np.linspace(0.4, 0.9, 6):
        (tmp_path / "cut.mkv").write_bytes(content[: int(share * len(content))])
        capture = open_capture(tmp_path / "cut.mkv")
        assert capture.info.promised_frame_count == 16
        lengths.add(len(capture))
        for frame in capture.encoded_frames(0, len(capture)):
            assert frame.values.mean() == pytest.approx(29.5 + 12 * frame.number, abs=3)
    assert len(lengths) > 3


@pytest.mark.parametrize(("space", "name"), [(8, "YCgCo"), (14, "ICtCp")])
def test_a_matrix_that_is_not_read_is_refused_by_name(tmp_path, space, name):
    film(tmp_path / "a.mkv", _levels(1), "libx264", "yuv444p", context={"colorspace": space})
    with pytest.raises(BadCapture, match=f"a.mkv: is stored as {name}, expected RGB"):
        open_capture(tmp_path / "a.mkv")


def test_doctor_prints_what_is_stated_and_what_is_done(tmp_path, capsys):
    context = {"color_trc": 1, "colorspace": 9}
    options = {"context": context, "times": [0, 40, 95, 120], "rotation": 90}
    film(tmp_path / "a.mp4", [_arrow()] * 4, "libx264", "yuv420p", **options)
    main(["doctor", str(tmp_path / "a.mp4")])
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "transfer curve bt709 bt709 is undone" in said
    assert "YUV matrix BT.2020" in said
    assert "converted by BT.2020" in said
    assert "turned by 270°" in said
    assert "uneven" in said
    assert "frames declared 4 all came" in said

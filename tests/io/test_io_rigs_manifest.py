"""Rigs and manifests: everything comes back, and what is wrong is named by its key."""

import json
from dataclasses import replace

import numpy as np
import pytest

from vntoolkit.errors import BadInput, BadRig
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.io.files import sha256_of_file, source_file
from vntoolkit.io.results.folder import begin_run, require_same_request
from vntoolkit.io.results.frame_log import FrameEntry, FrameLog
from vntoolkit.io.results.manifest import InputEntry, Manifest, read_manifest
from vntoolkit.io.results.reconstruction import RECONSTRUCTION, hashed, library_versions, write_manifest
from vntoolkit.io.rigs import RigFile, entry_from_rig, read_rig, rig_from_text, text_from_rig, write_rig
from vntoolkit.photometry.gel import EARLIER_TERMS, GelResponse, completed_coefficients
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import FitQuality, Rig, SourceFile
from vntoolkit.photometry.transfer import Transfer, TransferCurve


@pytest.fixture
def rig(rng) -> Rig:
    colours = np.eye(3) + 0.1 * rng.random((3, 3))
    matrix = np.array([[0.5, 0.1, -0.4], [-0.3, 0.4, -0.5], [-0.1, -0.5, -0.4]])
    return Rig(
        camera=Camera(
            model=CameraModel.OPENCV,
            width=640,
            height=480,
            matrix=np.array([[700.1, 0, 320], [0, 701.2, 240], [0, 0, 1]]),
            distortion=np.array([0.1, -0.2, 0.001, 0.002]),
        ),
        response=LightResponse(matrix=matrix, ambient=np.array([0.01, 0.02, 0.03]), light_colours=colours),
        transfer=Transfer(curve=TransferCurve.GAMMA, gamma=2.2, black_level=0.01, white_level=0.98),
        quality=FitQuality(
            method="board", residual_deg=1.25, condition_number=3.5, samples=9000, cone_deg=64.0
        ),
        sources=(SourceFile(file="board.mkv", sha256="ab" * 32),),
    )


def test_a_rig_comes_back_to_the_last_digit(tmp_path, rig):
    write_rig(tmp_path / "rig.json", rig)
    back = read_rig(tmp_path / "rig.json")
    assert text_from_rig(back) == text_from_rig(rig)
    np.testing.assert_array_equal(back.camera.matrix, rig.camera.matrix)
    np.testing.assert_array_equal(back.camera.distortion, rig.camera.distortion)
    np.testing.assert_array_equal(back.response.matrix, rig.response.matrix)
    np.testing.assert_array_equal(back.response.light_colours, rig.response.light_colours)
    assert (back.transfer, back.quality, back.sources) == (rig.transfer, rig.quality, rig.sources)


def test_a_gel_of_the_third_degree_is_read_as_one_of_the_fourth(rng, rig):
    earlier = rng.normal(size=(EARLIER_TERMS, 2))
    gel = GelResponse(
        coefficients=completed_coefficients(earlier),
        centre_px=np.zeros(2),
        scale_px=1.0,
        reach=1.0,
        errors_deg=np.array([[1.0, 0.5], [20.0, 3.0]]),
    )
    content = json.loads(text_from_rig(replace(rig, gel=gel)))
    assert content["version"] == 5
    content["version"], content["gel"]["coefficients"] = 3, earlier.tolist()
    back = rig_from_text(json.dumps(content), "rig.json")
    np.testing.assert_array_equal(back.gel.coefficients, gel.coefficients)
    np.testing.assert_array_equal(back.gel.errors_deg, gel.errors_deg)
    content["gel"]["coefficients"].append([0, 0])
    with pytest.raises(BadRig, match="coefficients"):
        rig_from_text(json.dumps(content), "rig.json")


def test_a_lens_of_eight_numbers_comes_back_and_asks_for_a_reader_of_them(rig):
    lens = [0.3, 0.05, 1e-3, -2e-3, 0.01, 0.5, 0.1, 0.02]
    for count, version in ((4, json.loads(text_from_rig(rig))["version"]), (5, 8), (8, 8)):
        camera = replace(rig.camera, distortion=np.array(lens[:count]))
        text = text_from_rig(replace(rig, camera=camera))
        assert json.loads(text)["version"] == version
        np.testing.assert_array_equal(rig_from_text(text).camera.distortion, lens[:count])


def _changed(rig, *path, value):
    content = json.loads(text_from_rig(rig))
    *steps, last = path
    inner = content
    for step in steps:
        inner = inner[step]
    if value is KeyError:
        del inner[last]
    else:
        inner[last] = value
    return json.dumps(content)


@pytest.mark.parametrize(
    ("path", "value", "line"),
    [
        (
            ("camera", "focal"),
            3,
            "unknown key 'camera.focal'; known there: model, width, height, K, distortion",
        ),
        (("colours",), 3, "unknown key 'colours'; known there: version, camera"),
        (("sources", 0, "md5"), "", r"unknown key 'sources\.0\.md5'; known there: file, sha256"),
        (("quality", "note"), "", r"unknown key 'quality\.note'; known there: method"),
        (("response", "matrix"), KeyError, r"the key 'response\.matrix' is missing"),
        (("camera", "width"), -1, r"camera\.width: input should be greater than 0, got -1"),
        (("camera", "model"), "FISHEYE", r"camera\.model: .*expected PINHOLE, OPENCV, .*undistort"),
        (("camera", "model"), "PINHOLE", "PINHOLE camera has no distortion"),
        (("response", "matrix"), [[1, 2, 3], [2, 4, 6], [0, 0, 1]], "M is singular"),
        (("response", "ambient"), [0, 0, float("nan")], r"response\.ambient\.2: input should be a finite"),
        (("response", "frame"), "graphics", r"response\.frame: input should be 'camera'"),
        (("colour", "transfer"), "log", "expected linear, srgb, bt709, gamma:G"),
        (("colour", "order"), "bgr", r"colour\.order: input should be 'rgb'"),
        (("sources", 0, "sha256"), "12", r"sources\.0\.sha256"),
        (("version",), 9, "is of version 9, this program reads 1 to 8"),
        (("version",), True, "version: expected a number, got true"),
        (("version",), "1", 'version: expected a number, got "1"'),
        (("camera", "K", 0, 0), 1e300, "expected numbers up to 1e"),
    ],
)
def test_a_bad_rig_is_one_line_that_names_the_key(rig, path, value, line):
    with pytest.raises(BadRig, match=line) as caught:
        rig_from_text(_changed(rig, *path, value=value), "rig.json")
    assert str(caught.value).startswith("rig.json: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "is empty"),
        ("{", "is not JSON"),
        ("[]", "expected a JSON object"),
        ("{}", "'camera' is missing"),
        ("[" * 100_000, "brackets are nested too deeply"),
        ('{"version": ' + "9" * 5000 + "}", "but this is not JSON: Exceeds the limit"),
        ('{"a": 1, "a": 2}', "the key 'a' stands there twice"),
    ],
)
def test_what_is_no_rig_is_one_line(tmp_path, text, line):
    (tmp_path / "rig.json").write_text(text)
    with pytest.raises(BadRig, match=line):
        read_rig(tmp_path / "rig.json")


def test_every_number_of_the_schema_has_its_meaning():
    schema = RigFile.model_json_schema()
    for entry in schema["$defs"].values():
        assert all(len(field["description"]) > 10 for field in entry["properties"].values())
        assert entry["additionalProperties"] is False


def test_hashes_are_of_the_bytes(tmp_path):
    (tmp_path / "a").write_bytes(b"abc")  # FIPS 180-4, the first example
    expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert sha256_of_file(tmp_path / "a") == expected
    assert source_file(tmp_path / "a") == SourceFile(file="a", sha256=expected)


@pytest.fixture
def manifest(tmp_path, rig) -> Manifest:
    (tmp_path / "in.mkv").write_bytes(b"footage")
    return Manifest(
        input=InputEntry(
            source="in.mkv",
            files=hashed([tmp_path / "in.mkv"]),
            width=640,
            height=480,
            frame_count=9,
            frame_rate_hz=60,
        ),
        rig=entry_from_rig(rig),
        options={"integrator": "cosine", "smoothness": 0.5, "region": (1, 2)},
        versions=library_versions(),
    )


def test_a_manifest_comes_back_and_names_what_changed(tmp_path, manifest, rig):
    out = tmp_path / "out"
    assert not require_same_request(out, RECONSTRUCTION, manifest)  # nothing there: nothing to object to
    write_manifest(out, manifest)
    back = read_manifest(out)
    assert require_same_request(out, RECONSTRUCTION, back)
    assert back.label_legend["5"] == "lit by light 0 and light 2"
    options = {**manifest.options, "smoothness": 0.7}
    (tmp_path / "in.mkv").write_bytes(b"other footage")
    changed_input = manifest.input.model_copy(update={"files": hashed([tmp_path / "in.mkv"])})
    colour = manifest.rig.colour.model_copy(update={"transfer": "srgb"})
    other = manifest.model_copy(
        update={
            "options": options,
            "input": changed_input,
            "rig": manifest.rig.model_copy(update={"colour": colour}),
            "frames": "0:5:1",
        }
    )
    with pytest.raises(
        BadInput, match=r"input files.*the rig's colour; smoothness \(0\.5 → 0\.7\); add --overwr"
    ):
        require_same_request(out, RECONSTRUCTION, other)
    later = manifest.model_copy(update={"frames": "0:5:1", "started": "now"})
    assert require_same_request(out, RECONSTRUCTION, later)
    with pytest.raises(BadInput, match=r"smoothness \(0\.5 → 0\.7\)"):
        begin_run(out, RECONSTRUCTION, other)
    assert not begin_run(out, RECONSTRUCTION, other, overwrite=True)
    assert read_manifest(out).options["smoothness"] == 0.7


def test_a_folder_without_a_manifest_is_refused(tmp_path):
    with pytest.raises(BadInput, match=r"holds no reconstruction\.json"):
        read_manifest(tmp_path)
    (tmp_path / "reconstruction.json").write_text('{"version": 2, "input": 3}')
    with pytest.raises(BadInput, match="input: expected a JSON object with the keys source"):
        read_manifest(tmp_path)
    (tmp_path / "reconstruction.json").write_text('{"version": 1}')
    with pytest.raises(
        BadInput, match="of version 1, this program reads 2; reconstruct again, with --overwr"
    ):
        read_manifest(tmp_path)


def test_finished_frames_are_remembered_across_a_crash(tmp_path):
    log = FrameLog(tmp_path)
    assert log.done() == {}
    for number in (0, 1, 5):
        log.append(FrameEntry(number=number, seconds=0.25, valid_share=0.5, clipped_share=0.01))
    log.close()
    with (tmp_path / "frames.log").open("a") as torn:
        torn.write("6")  # the crash
    log = FrameLog(tmp_path)
    assert log.done() == {0: 0.25, 1: 0.25, 5: 0.25}
    log.append(FrameEntry(number=7))
    pressed = FrameEntry(number=8, error_deg=2.5, contact_mm2=3.0, contact_depth_mm=0.25)
    log.append(pressed)
    assert log.entries()[8] == pressed
    assert log.entries()[7].error_deg is None
    log.append(FrameEntry(number=8, failure="black"))
    assert set(log.done()) == {0, 1, 5, 7}
    assert log.entries()[5].clipped_share == 0.01
    log.append(FrameEntry(number=1, failure="f1.png is black:\nno light"))
    assert set(log.done()) == {0, 5, 7}
    assert log.entries()[1].failure == "f1.png is black: no light"
    log.close()

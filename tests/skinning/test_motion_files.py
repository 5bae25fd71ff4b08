"""Malformed motion capture gets one clear line, in bounded memory."""

from __future__ import annotations

import hashlib
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.motion_texts import AMC, ASF, BVH
from vntoolkit.errors import BadInput, BadMotion
from vntoolkit.geometry.motion import Skeleton
from vntoolkit.io.motion import bvh
from vntoolkit.io.motion.asf import CMU_FRAME_RATE_HZ, read_asf_amc
from vntoolkit.io.motion.bvh import read_bvh
from vntoolkit.io.motion.garment_fits import read_garment_fit

DATA = Path(__file__).parents[2] / "data"


def write(path: Path, text: str | bytes) -> Path:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_small_bvh_reads_as_written(tmp_path: Path) -> None:
    motion = read_bvh(write(tmp_path / "m.bvh", BVH))
    assert motion.skeleton.names == ("Hips", "Chest")
    assert motion.frame_rate_hz == pytest.approx(100)
    assert motion.metres_per_unit is None
    np.testing.assert_allclose(motion.root_positions[0], [1, -2, -3])  # y up on disk, y down in memory
    np.testing.assert_allclose(motion.skeleton.offsets, [[0, -1, 0], [0, -1, 0]])
    half = np.sqrt(0.5)
    np.testing.assert_allclose(motion.rotations[:, 1], [[0, 0, -half, half], [half, 0, 0, half]], atol=1e-12)


# The same two frames, as others write them.
GOOD_BVH = {
    "wrapped lines": BVH.replace("90 0 0\n", "90\n0\n0\n"),
    "one line": " ".join(BVH.split()),
    "numbers that go on beyond what is read first": " " * ((1 << 20) - 300) + BVH,
    "small letters": BVH.replace("MOTION", "Motion").replace("End Site", "end site"),
    "a blank before the colon": BVH.replace("Frames:", "Frames :").replace("Time:", "time :"),
    "decimal commas": BVH.replace("0.01", "0,01").replace("1 2 3", "1,0 2 3,0"),
    "UTF-16": BVH.encode("utf-16"),
    "UTF-8 with a mark": BVH.encode("utf-8-sig"),
    "lines of Windows": BVH.replace("\n", "\r\n"),
    "positions of a joint": BVH.replace("3 Zrot", "6 Xposition Yposition Zposition Zrot")
    .replace("0 0 0 90 0 0", "0 0 0 0 1 0 90 0 0")
    .replace("0 0 0 0 0 90", "0 0 0 0 1 0 0 0 90"),
}


@pytest.mark.parametrize("name", GOOD_BVH)
def test_bvh_is_read_as_others_write_it(name: str, tmp_path: Path) -> None:
    plain = read_bvh(write(tmp_path / "plain.bvh", BVH))
    read = read_bvh(write(tmp_path / "m.bvh", GOOD_BVH[name]))
    assert read.skeleton.names == plain.skeleton.names
    assert read.frame_rate_hz == plain.frame_rate_hz
    for kind in ("rotations", "root_positions"):
        np.testing.assert_array_equal(getattr(read, kind), getattr(plain, kind))
    np.testing.assert_array_equal(read.skeleton.offsets, plain.skeleton.offsets)


def test_joints_may_have_one_rotation_or_none(tmp_path: Path) -> None:
    one = BVH.replace("3 Zrotation Yrotation Xrotation", "1 Xrotation")
    motion = read_bvh(write(tmp_path / "m.bvh", one.replace("90 0 0", "30").replace("0 0 90\n", "60\n")))
    angles = 2 * np.degrees(np.arctan2(motion.rotations[:, 1, 0], motion.rotations[:, 1, 3]))
    np.testing.assert_allclose(angles, [30, 60])
    none = BVH.replace("3 Zrotation Yrotation Xrotation", "0")
    motion = read_bvh(write(tmp_path / "m.bvh", none.replace(" 90 0 0\n", "\n").replace(" 0 0 90\n", "\n")))
    np.testing.assert_array_equal(motion.rotations[:, 1], [[0, 0, 0, 1], [0, 0, 0, 1]])


SPINE_GROWS = BVH.replace("3 Zrotation Yrotation Xrotation", "1 Yposition").replace("0 0 0 0 0 90", "0 0 0 1")
NO_JOINT_POSITION = SPINE_GROWS.replace("0 0 0 90 0 0", "0 0 0 0").replace("0 0 0 1", "0 0 0 0")
REFUSALS = [
    # A text, or what of a good file is replaced, and by what.
    ("bvh", "", "the file is empty"),
    ("bvh", b"\x00\xff\xfe" * 50, "line 1: expected HIERARCHY"),
    ("bvh", BVH[:150], "line 9: expected ROOT, JOINT, End Site, OFFSET, CHANNELS or }, got 'C'"),
    ("bvh", BVH[:140], "no MOTION section"),
    ("bvh", BVH[: BVH.index("1 2 3")], "expected 2 frames of 9 numbers, got 0 numbers"),
    ("bvh", BVH.rstrip()[:-6], "2 frames of 9 numbers, got 15 numbers, 1.667 frames"),
    ("bvh", ("1 2 3 0 0 0 0 0 90\n", ""), "expected 2 frames of 9 numbers, got 9 numbers"),
    ("bvh", BVH.replace(" 90 0 0\n", "\n").replace(" 0 0 90\n", "\n"), "got 12 numbers, 1.333 frames"),
    ("bvh", ("CHANNELS 3", "CHANNELS 4"), "line 10: expected 4 .* channels .* got 'End'"),
    ("bvh", ("6 Xposition", "6 Wposition"), "line 5: expected 6 .* got 'Wposition'"),
    ("bvh", ("3 Zrotation", "3 Xrotation"), "line 9: .* got 'Xrotation'"),
    ("bvh", ("CHANNELS 3", "CHANNELS 9"), "line 9: expected 0 to 6 channels, got '9'"),
    ("bvh", ("1 2 3 0 0 0 90", "1 nan 3 0 0 0 90"), "line 19: expected a finite number, got 'nan'"),
    ("bvh", ("0 0 0 90 0 0", "0 0 0 1e999 0 0"), "line 19: expected a finite number, got '1e999'"),
    ("bvh", ("OFFSET 0 1 0", "OFFSET 0 nan 0"), "line 4: expected a finite number, got 'nan'"),
    ("bvh", ("90 0 0", "90 zero 0"), "line 19: expected a number, got 'zero'"),
    ("bvh", ("90 0 0", "90,5 0.5 0"), "both commas and points"),
    ("bvh", ("JOINT Chest", "JOINT Hips"), r"line 7: joint 'Hips' occurs twice or has no name \(a cycle\?\)"),
    ("bvh", ("JOINT Chest", "JOINT"), "has no name"),
    ("bvh", BVH.replace("ROOT Hips", f"ROOT {'x' * 2_000_000}"), "no MOTION section"),
    ("bvh", ("    OFFSET 0 1 0\n    CHANNELS 3", "    CHANNELS 3"), "joint 'Chest' has no OFFSET"),
    ("bvh", ("}\nMOTION", "MOTION"), "1 unmatched braces in the hierarchy"),
    ("bvh", ("ROOT", "BONE"), "line 2: expected ROOT, .* got 'BONE'"),
    ("bvh", ("ROOT", "JOINT"), "line 2: a JOINT outside any ROOT"),
    ("bvh", "HIERARCHY\nMOTION\nFrames: 1\nFrame Time: 0.1\n0\n", "no ROOT in the hierarchy"),
    ("bvh", ("MOTION", "ROOT Other\n{\nOFFSET 0 0 0\n}\nMOTION"), "line 16: a second ROOT"),
    ("bvh", ("Frames: 2", "Frames: 0"), "expected at least one frame"),
    ("bvh", ("Time: 0.01", "Time: -0.01"), "expected a frame time above 0 s"),
    ("bvh", ("Frame Time: 0.01\n", ""), "expected 'Frames: N' and 'Frame Time: SECONDS'"),
    ("bvh", SPINE_GROWS.replace("0 0 0 90 0 0", "0 0 0 2"),
     "line 6: joint 'Chest' moves by 1 against its parent"),
    ("bvh", NO_JOINT_POSITION, "line 6: the positions of joint 'Chest' are all 0"),
    ("bvh", "HIERARCHY " + "x" * 10**6 + BVH[9:], "line 1: expected ROOT"),
    ("asf", "", "empty"),
    ("asf", ASF[: ASF.index("id 2")], "no section :hierarchy"),
    ("asf", ASF.rstrip()[:-5], "hierarchy has no end"),
    ("asf", ("root spine\n    spine head", "spine head\n head spine"), "does not reach"),
    ("asf", ("root spine", "root spine head"), "cyclic hierarchy: 'head' has two"),
    ("asf", ("spine head", "spine head root"), "cyclic hierarchy: 'root'"),
    ("asf", ("spine head", "spine tail"), "'tail', which has no bone data"),
    ("asf", ("name head", "name spine"), "bone spine occurs twice"),
    ("asf", ("direction 0 1 0", "direction 0 nan 0"), "three finite numbers"),
    ("asf", ("orientation 0 0 0", "orientation 0 0 nan"), "root orientation: expected three finite numbers"),
    ("asf", ("0 0 30 XYZ", "0 0 30 XXZ"), "order of axes"),
    ("asf", ("axis XYZ", "axis XYW"), "root axis: expected an order of axes such as XYZ, got 'XYW'"),
    ("asf", ("dof rx rz", "dof rx l"), "expected channels among"),
    ("asf", ("dof rx rz", "dof rx rx"), "bone spine, dof: expected channels among"),
    ("asf", ("    length 1\n", ""), "malformed ASF"),
    ("asf", ("length 2", "length -1"), "bone spine: expected a length, got -1"),
    ("asf", ("length 0.45", "length 0"), "expected a positive length unit, got 0"),
    ("asf", ("    id 1", "begin\n    id 1"), "expected end of a bone, got 'begin'"),
    ("asf", ("  begin\n    id 1\n    name", "    name"), "expected begin of a bone, got 'name'"),
    ("asf", ("  end\n:hierarchy", ":hierarchy"), "the last bone has no end: the file is truncated"),
    ("amc", "", "empty"),
    ("amc", "#\n:DEGREES\n", "no frame found"),
    ("amc", AMC.rstrip().removesuffix("spine 10 20"), "frame 2 lacks 2 of 8 values .first: spine"),
    ("amc", ("spine 10 20", "spine 10 20 30"), "line 6: spine has 2 channels, got 3"),
    ("amc", ("spine 10 20", "spine 10"), "spine has 2 channels, got 1"),
    ("amc", ("10 20", "nan 20"), "line 6: spine holds NaN"),
    ("amc", ("10 20", "ten 20"), "expected numbers for spine"),
    ("amc", ("spine 10 20", "spine 10 20\nhead 1"), "no moving bone 'head'"),
    ("amc", ("\n2\n", "\n7\n"), "expected frame 2, got 7"),
    ("amc", ("1\nroot", "root"), "expected a frame number"),
]  # fmt: skip


@pytest.mark.parametrize(("kind", "changed", "line"), REFUSALS, ids=[row[2] for row in REFUSALS])
def test_malformed_motion_is_one_line_that_names_the_file(kind, changed, line, tmp_path):
    files = {"bvh": BVH, "asf": ASF, "amc": AMC}
    files[kind] = files[kind].replace(*changed) if isinstance(changed, tuple) else changed
    written = {suffix: write(tmp_path / f"m.{suffix}", text) for suffix, text in files.items()}
    with pytest.raises(BadMotion, match=line) as caught:
        read_bvh(written["bvh"]) if kind == "bvh" else read_asf_amc(written["asf"], written["amc"])
    assert "\n" not in str(caught.value)
    assert f"m.{kind}" in str(caught.value)


def test_a_flood_of_joints_is_refused_in_bounded_memory(tmp_path: Path) -> None:
    path = tmp_path / "flood.bvh"
    with path.open("w") as file:
        file.write("HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\nCHANNELS 0\n")
        for number in range(400_000):
            file.write(f"JOINT j{number}\n{{\nOFFSET 0 1 0\nCHANNELS 3 Zrotation Yrotation Xrotation\n")
    assert path.stat().st_size > 25e6
    tracemalloc.start()
    with pytest.raises(BadMotion, match="a chain of more than 256 joints"):
        read_bvh(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4e6


def test_a_gigabyte_is_refused_by_its_size(tmp_path: Path) -> None:
    path = tmp_path / "huge.bvh"
    with path.open("wb") as file:
        file.truncate(2**30)  # sparse: takes no disk
    with pytest.raises(BadMotion, match=r"MB, expected 268\.44 at most of a motion"):
        read_bvh(path)
    asf = write(tmp_path / "s.asf", ASF)
    with pytest.raises(BadMotion, match="MB, expected 268"):
        read_asf_amc(asf, path.rename(tmp_path / "huge.amc"))
    with (tmp_path / "huge.asf").open("wb") as file:
        file.truncate(2**30)
    with pytest.raises(BadMotion, match="MB, expected 16"):
        read_asf_amc(tmp_path / "huge.asf", write(tmp_path / "m.amc", AMC))


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(BadMotion, match="no such file"):
        read_bvh(tmp_path / "none.bvh")
    with pytest.raises(BadMotion, match="is a folder"):
        read_bvh(tmp_path)


def test_bvh_is_written_depth_first_or_not_at_all(tmp_path: Path) -> None:
    motion = read_bvh(write(tmp_path / "m.bvh", BVH))
    breadth = Skeleton(names=("a", "b", "c", "d"), parents=np.array([-1, 0, 0, 1]), offsets=np.ones((4, 3)))
    still = np.tile([0.0, 0, 0, 1], (2, 4, 1))
    with pytest.raises(BadMotion, match="without interruption"):
        bvh.write_bvh(tmp_path / "b.bvh", replace(motion, skeleton=breadth, rotations=still))
    assert not list(tmp_path.glob("*b.bvh"))


def test_small_acclaim_reads_as_written(tmp_path: Path) -> None:
    asf, amc = write(tmp_path / "s.asf", ASF), write(tmp_path / "m.amc", AMC)
    motion = read_asf_amc(asf, amc)
    assert motion.skeleton.names == ("root", "spine", "head")
    assert motion.frame_rate_hz == CMU_FRAME_RATE_HZ
    np.testing.assert_allclose(motion.skeleton.offsets[2], [0, -2, 0])
    np.testing.assert_allclose(motion.root_positions[0], [1, -2, -3])
    radians = ASF.replace("angle deg", "angle rad").replace("0 0 30 XYZ", f"0 0 {np.pi / 6} XYZ")
    in_radians = AMC.replace(":DEGREES", ":RADIANS").replace("10 20", f"{np.pi / 18} {np.pi / 9}")
    again = read_asf_amc(write(tmp_path / "r.asf", radians), write(tmp_path / "r.amc", in_radians))
    np.testing.assert_allclose(again.rotations, motion.rotations, atol=1e-12)


def test_shipped_motion_has_the_checksum_its_page_states() -> None:
    digest = hashlib.sha256((DATA / "walk.bvh").read_bytes()).hexdigest()
    assert digest in (DATA / "README.md").read_text()


def test_fit_file_turns_into_camera_axes(tmp_path: Path) -> None:
    text = """{"version": 1, "scale": 1.1, "translation_m": [0.1, 0.2, 0.3], "rotation_deg": [0, 0, 90],
    "pose_deg": {"LeftArm": [0, 0, 90]}, "landmarks": [{"vertex": 1, "joint": "Hips"},
    {"vertex": 2, "joint": "Neck", "offset_m": [0, 0.1, 0]}, {"vertex": 3, "joint": "Head"}]}"""
    fit = read_garment_fit(write(tmp_path / "fit.json", text))
    np.testing.assert_allclose(fit.adjustment.translation, [0.1, -0.2, -0.3])
    # a quarter turn from x to y, up: in memory, from x to −y
    np.testing.assert_allclose(fit.adjustment.rotate([1.0, 0, 0]), [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(fit.pose["LeftArm"], [0, 0, -np.sqrt(0.5), np.sqrt(0.5)], atol=1e-12)
    np.testing.assert_allclose(fit.landmarks[1].offset, [0, -0.1, 0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"version": 1, "scales": 2}', "unknown key 'scales'; known there: version, scale"),
        ('{"version": 2}', "version: input should be 1, got 2"),
        ('{"version": 1, "scale": -1}', "scale: .*greater than 0"),
        ('{"version": 1, "landmarks": [{"vertex": 1, "joint": "a"}]}', "at least three landmarks, got 1"),
        ("{", "expected a JSON file that corrects how a garment sits, but this is not JSON"),
    ],
)
def test_bad_fit_files_are_one_line(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=message) as caught:
        read_garment_fit(write(tmp_path / "fit.json", text))
    assert "\n" not in str(caught.value)

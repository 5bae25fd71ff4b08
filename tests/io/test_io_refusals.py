"""Each reader and writer refuses what it cannot serve by one line: the file, what was expected, what came."""

import struct
import warnings
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile

from vntoolkit.errors import BadCapture, BadInput, BadMesh, CannotWrite
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.point_cloud import PointCloud
from vntoolkit.io.atomic import write_bytes
from vntoolkit.io.files import require_file, require_inside, sha256_of_file
from vntoolkit.io.footage.image_writing import encoded_image, write_png
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.footage.video import write_video
from vntoolkit.io.maps_and_meshes.arrays import map_npy, read_npz
from vntoolkit.io.maps_and_meshes.exr import read_exr, write_exr
from vntoolkit.io.maps_and_meshes.label_images import read_labels, write_labels
from vntoolkit.io.maps_and_meshes.maps import (
    read_depth_map,
    read_normal_map,
    write_depth_map,
    write_normal_map,
)
from vntoolkit.io.maps_and_meshes.meshes import write_mesh, write_point_cloud
from vntoolkit.io.maps_and_meshes.usd import write_usd_sequence
from vntoolkit.io.results.frame_log import FrameEntry, FrameLog
from vntoolkit.live.capture import CameraSource
from vntoolkit.pipeline.calibrate_presses import read_press_label

TRIANGLE = Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]], dtype=np.int32))
PLANE = np.ones((4, 5), dtype=np.float32)
ALL = np.ones((4, 5), dtype=bool)
FLAT = NormalMap(normals_in_camera=np.tile(np.float32([0, 0, -1]), (4, 5, 1)), mask=ALL)
LEVEL = DepthMap(depth=PLANE, mask=ALL)
IN_METRES = DepthMap(depth=PLANE, mask=ALL, unit=LengthUnit.METRE)


def usd_at_rate(path, frame_rate_hz):
    write_usd_sequence(path, TRIANGLE, [], frame_rate_hz=frame_rate_hz)


@pytest.mark.parametrize(
    ("write", "error", "line"),
    [
        (lambda p: write_png(p / "a.png", PLANE), BadInput, "a PNG holds 8- or 16-bit integers, got float32"),
        (lambda p: write_png(p / "a.png", np.zeros((4, 5, 2), np.uint8)), BadInput, r"got \(4, 5, 2\)"),
        (lambda p: encoded_image(np.zeros((4, 5), np.uint8), ".gif"), BadInput, r"one of \.png.*'\.gif'"),
        (lambda p: encoded_image(np.zeros((0, 5), np.uint8)), BadInput, r"of shape \(0, 5\) as \.png"),
        (lambda p: write_png(p / "a.png", np.zeros((0, 5), np.uint8)), BadInput, r"got \(0, 5\)"),
        (lambda p: write_png(p / "a.png", np.zeros((0, 3), np.uint8)), BadInput, r"a\.png: expected"),
        (lambda p: write_png(p / "a.png", np.zeros(4, np.uint8)), BadInput, r"a\.png: expected"),
        (lambda p: write_png(p / "a.png", np.zeros((2, 2, 2, 3), np.uint8)), BadInput, r"a\.png: expected"),
        (lambda p: write_exr(p / "a.exr", {"Z": PLANE.astype(int)}), BadInput, "float32, got int64"),
        (lambda p: write_labels(p / "a.png", np.full((4, 5), 8, np.uint8)), BadInput, "bytes from 0 to 7"),
        (lambda p: write_normal_map(p / "a.jpg", FLAT), BadInput, r"as \.exr or \.png, not '\.jpg'"),
        (lambda p: write_depth_map(p / "a.png", LEVEL), BadInput, r"a depth map is written as \.exr"),
        (lambda p: write_mesh(p / "a.off", TRIANGLE), CannotWrite, r"as \.ply, \.obj or \.stl, not '\.off'"),
        (
            lambda p: write_mesh(p / "a.obj", TRIANGLE, texture=np.zeros((4, 4, 3), np.uint8)),
            BadMesh,
            "a texture needs texture coordinates",
        ),
        (
            lambda p: write_mesh(p / "a.ply", TRIANGLE, texture=np.zeros((4, 4, 3), np.uint8)),
            CannotWrite,
            "a PLY carries no texture; write .obj",
        ),
        (lambda p: write_point_cloud(p / "a.obj", PointCloud(points=np.eye(3))), CannotWrite, r"as \.ply"),
        (lambda p: write_mesh(p, TRIANGLE), CannotWrite, "a mesh is written as"),
        (lambda p: write_png(p, np.zeros((4, 5), np.uint8)), CannotWrite, "is a folder, expected the name"),
        (lambda p: write_bytes(".", b""), CannotWrite, "is a folder"),
        (lambda p: write_bytes("/", b""), CannotWrite, "is a folder"),
        (lambda p: write_bytes("", b""), CannotWrite, "is a folder"),
        (lambda p: usd_at_rate(p / "a.abc", 60), BadInput, r"ends in \.usdc or \.usd"),
        (lambda p: usd_at_rate(p / "a.usdc", 0), BadInput, "positive frame rate"),
        (lambda p: write_video(p / "a.mp4", [], 30), CannotWrite, r"a name that ends in \.mkv"),
        (lambda p: write_video(p / "a.mkv", [], 30), BadCapture, "no frame to write"),
        (lambda p: write_video(p / "a.mkv", [PLANE], 30), BadCapture, r"uint16 frames, got \(4, 5\) float32"),
    ],
)  # fmt: skip
def test_writers_refuse_what_the_format_cannot_hold(tmp_path, capfd, write, error, line):
    with pytest.raises(error, match=line):
        write(tmp_path)
    assert capfd.readouterr() == ("", "")
    assert not list(tmp_path.iterdir())


def without_label(path, map_written, values, channels, label):
    """Write a map, and another in its place whose label of one of these values says something else."""
    map_written(path)
    key = next(key for key, value in read_exr(path)[1].texts.items() if value in values)
    write_exr(path, channels, attributes={key: label})


def damaged_tiff(path, packing):
    values = np.random.default_rng(1).random((9, 9, 3)).astype(np.float16)
    tifffile.imwrite(path, values, photometric="rgb", compression=packing)
    path.write_bytes(path.read_bytes()[:-200] + bytes(100) + path.read_bytes()[-100:])


def cut_png(path, length=None, flipped=None):
    write_png(path, np.zeros((4, 5, 3), np.uint8))
    content = bytearray(path.read_bytes())
    if flipped is not None:
        content[flipped] ^= 1
    path.write_bytes(content[:length])


def png_of_a_long_chunk(path):
    chunk = b"IHDR" + struct.pack(">IIBBBBB", 5, 4, 8, 2, 0, 0, 0)
    whole = struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + whole + struct.pack(">I", 10**9) + b"IDAT" + bytes(64))


def npy_in_place_of_npz(path):
    np.save(path.with_suffix(".npy"), np.ones(3))
    path.with_suffix(".npy").rename(path)


def cut_npy(path):
    np.save(path, np.ones(3))
    path.write_bytes(path.read_bytes()[:-9])


def read_depth_array(path):
    return read_npz(path, "depth")


READS = [  # the file's name, what writes it, what reads it, the error and its line
    ("a.exr", lambda p: write_exr(p, {"P": PLANE, "Q": PLANE}), read_image, BadInput,
     r"expected the channels R, G, B \(or Y\), found P, Q"),
    ("a.exr", lambda p: write_exr(p, {"P": PLANE, "Q": PLANE}), read_normal_map, BadInput,
     "expected the channels R, G, B or X, Y, Z, found P, Q"),
    ("a.exr", lambda p: write_exr(p, {"P": PLANE, "Q": PLANE}), read_depth_map, BadInput,
     "expected a channel Z, found P, Q"),
    ("a.exr", lambda p: write_exr(p, {"Z": PLANE * np.nan}), read_depth_map, BadInput,
     "no pixel holds a depth"),
    ("a.exr", lambda p: without_label(p, lambda q: write_depth_map(q, IN_METRES), (LengthUnit.METRE.value,),
     {"Z": PLANE}, "smoot"), read_depth_map, BadInput, "unknown length unit 'smoot'"),
    ("a.exr", lambda p: without_label(p, lambda q: write_normal_map(q, FLAT), ("opengl", "directx"),
     dict.fromkeys("RGB", PLANE), "sideways"), read_normal_map, BadInput,
     "unknown normal convention 'sideways'"),
    ("a.tiff", lambda p: cv2.imwrite(str(p), np.zeros((4, 5), np.int32)), read_image, BadCapture,
     "expected 8-bit, 16-bit or float samples, got int32"),
    ("a.tiff", lambda p: damaged_tiff(p, "zlib"), read_image, BadCapture, "its samples are damaged, or comp"),
    ("a.tiff", lambda p: damaged_tiff(p, "lzma"), read_image, BadCapture, "its samples are damaged, or comp"),
    ("a.png", lambda p: cut_png(p, flipped=45), read_image, BadCapture,
     "the PNG file is damaged: the checksum at byte 33 is wrong"),
    ("a.png", lambda p: cut_png(p, 60), read_image, BadCapture, r"the PNG file is (cut off|damaged)"),
    ("a.png", png_of_a_long_chunk, read_image, BadCapture,
     "the PNG file is cut off; copy or write it again"),
    ("a.png", lambda p: write_png(p, np.zeros((4, 5), np.uint16)), read_labels, BadInput,
     "visibility labels are 8-bit, got uint16"),
    ("a.png", lambda p: write_png(p, np.full((4, 5), 9, np.uint8)), read_labels, BadInput, "label"),
    ("a.txt", lambda p: p.write_text("a b c"), read_press_label, BadInput,
     r"expected three numbers \(u, v, contact radius\), got 'a"),
    ("a.txt", lambda p: p.write_text("1 2"), read_press_label, BadInput, "> 0\\), got 2"),
    ("a.txt", lambda p: p.write_text("1 2 0"), read_press_label, BadInput, "got 3"),
    ("a.npz", lambda p: p.write_text("no archive"), read_depth_array, BadInput,
     r"is not a whole \.npz archive"),
    ("a.npz", lambda p: np.savez(p, other=np.ones(3)), read_depth_array, BadInput, "holds no array 'depth'"),
    ("a.npz", lambda p: np.savez(p, depth=np.array([{}], dtype=object)), read_depth_array, BadInput,
     "allow_pickle=False"),
    ("a.npz", npy_in_place_of_npz, read_depth_array, BadInput, r"is not a whole \.npz archive"),
    ("a.npy", cut_npy, map_npy, BadInput, r"is not a whole \.npy array"),
]  # fmt: skip


@pytest.mark.parametrize(("name", "write", "read", "error", "line"), READS)
def test_readers_refuse_what_is_damaged_or_of_another_kind(tmp_path, name, write, read, error, line):
    write(tmp_path / name)
    with pytest.raises(error, match=line):
        read(tmp_path / name)


def test_normals_that_are_infinite_where_there_is_no_subject_are_passed_over_in_silence(tmp_path):
    path = tmp_path / "a.exr"
    planes = {"R": PLANE * 0, "G": PLANE * 0, "B": np.ones_like(PLANE), "A": np.ones_like(PLANE)}
    planes["R"][0, 0], planes["A"][0, 0] = np.inf, 0
    write_exr(path, planes)
    np.savez(tmp_path / "a.npz", normals=np.full((4, 5, 3), 1e300))
    planes["R"][0, 1] = 1e38
    write_exr(path, planes)
    with warnings.catch_warnings(action="error"):
        found = read_normal_map(path)
        with pytest.raises(BadInput, match="got none of length"):
            read_normal_map(tmp_path / "a.npz")
    assert not found.mask[0, :2].any()
    assert (found.normals_in_camera[0, :2] == 0).all()


def test_exr_headers_that_cannot_be(tmp_path):
    path = tmp_path / "a.exr"
    write_exr(path, {"Z": PLANE})
    good = path.read_bytes()
    at = good.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    for spoilt, line in (
        (
            good[:at] + struct.pack("<4i", 0, 0, -2, 3) + good[at + 16 :],
            "the EXR header is damaged or cut off",
        ),
        (good[:60], "the EXR header is damaged or cut off"),
        (good.replace(b"Z\0", b"\x80\0", 1), "the EXR header is damaged"),
        (good[:-9], "the EXR file is damaged or cut off .*; copy it again"),
        (b"no EXR at all", "is not an OpenEXR file"),
    ):
        path.write_bytes(spoilt)
        with pytest.raises(BadCapture, match=line):
            read_exr(path)


def test_names_that_lead_nowhere_or_out(tmp_path):
    with pytest.raises(BadInput, match="list: names a file by 300 characters"):
        require_inside(tmp_path, "x" * 300, "list")
    with pytest.raises(BadInput, match="list: names a file that cannot be"):
        require_inside(tmp_path, "a\0b", "list")


def test_a_frame_log_that_is_no_file(tmp_path):
    (tmp_path / "frames.log").mkdir()
    with pytest.raises(BadInput, match=r"frames\.log: is a folder"):
        FrameLog(tmp_path).entries()
    with pytest.raises(CannotWrite, match=r"cannot write .*frames\.log"):
        FrameLog(tmp_path).append(FrameEntry(number=0, seconds=1.0))


def test_files_that_the_system_will_not_open(tmp_path, monkeypatch):
    with pytest.raises(BadInput, match=r"cannot be read \(File name too long"):
        require_file(tmp_path / ("x" * 300))
    (tmp_path / "a.png").write_bytes(b"0")

    def refused(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refused)
    with pytest.raises(BadInput, match=r"a\.png: cannot be read \(Permission denied"):
        sha256_of_file(tmp_path / "a.png")


class _Camera:
    """A camera that gives one frame and then none."""

    def __init__(self, number):
        self.left = 1

    def isOpened(self):
        return True

    def set(self, key, value):
        return True

    def get(self, key):
        return 24.0

    def read(self):
        self.left -= 1
        return self.left >= 0, np.zeros((24, 24, 3), np.uint8)

    def release(self):
        self.left = 0


def test_a_camera_that_is_unplugged(monkeypatch):
    monkeypatch.setattr(cv2, "VideoCapture", _Camera)
    frames = CameraSource(3).frames()
    assert next(frames).frame.number == 0
    with pytest.raises(BadCapture, match="camera 3: gives no frames any more"):
        next(frames)

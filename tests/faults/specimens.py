"""Small good files of every kind that is read, and how each kind is read and judged."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile

from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.mesh_sequence import MeshSequence
from vntoolkit.io.captures import CaptureOptions, open_capture
from vntoolkit.io.exr import ExrCompression, write_exr
from vntoolkit.io.frame_log import FrameEntry, FrameLog
from vntoolkit.io.garment_fits import read_garment_fit
from vntoolkit.io.images import write_png
from vntoolkit.io.light_files import read_lights
from vntoolkit.io.manifest import InputEntry, Manifest, read_manifest, write_manifest
from vntoolkit.io.maps import (
    read_depth_map,
    read_flow,
    read_labels,
    read_mask,
    read_normal_map,
    write_depth_map,
    write_flow,
    write_labels,
    write_mask,
    write_normal_map,
)
from vntoolkit.io.meshes import read_mesh, read_point_cloud, write_mesh
from vntoolkit.io.motion_asf import read_asf_amc
from vntoolkit.io.motion_bvh import read_bvh
from vntoolkit.io.obj import read_obj_texture
from vntoolkit.io.press_labels import read_press_label
from vntoolkit.io.rigs import entry_from_rig, read_rig, write_rig
from vntoolkit.io.seams import read_seams
from vntoolkit.io.sequences import read_mesh_sequence, write_mesh_sequence
from vntoolkit.io.video import write_video
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import FitQuality, Rig, SourceFile
from vntoolkit.pipeline.tracked_folder import read_track_record, write_track_record

H, W = 24, 32
LIMITED = CaptureOptions(max_megapixels=4.0)  # what the option is for: memory of untrusted footage
MATRIX = np.array([[0.35, -0.02, -0.5], [-0.17, 0.3, -0.48], [-0.15, -0.28, -0.52]])


@dataclass(frozen=True, kw_only=True)
class Kind:
    """How a kind of input is read; `judge` fails where what was let in is no sound object."""

    read: Callable[[Path], Any]
    judge: Callable[[Any], bool] = lambda result: True


def _finite(*arrays: Any) -> bool:
    return all(array is None or bool(np.isfinite(array).all()) for array in arrays)


def _read_capture(path: Path) -> list[Any]:
    return list(open_capture(path, LIMITED).frames())


def _judge_mesh(mesh: Any) -> bool:
    inside = not len(mesh.faces) or (mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices))
    return bool(inside) and _finite(mesh.vertices, mesh.normals, mesh.colours, mesh.uv)


def _read_moving_mesh(folder: Path) -> MeshSequence:
    sequence = read_mesh_sequence(folder)
    for frame in range(len(sequence)):
        _ = sequence[frame]
    return sequence


def _read_textured(path: Path) -> Any:
    mesh = read_mesh(path)
    read_obj_texture(path)
    return mesh


KINDS: dict[str, Kind] = {
    "capture": Kind(read=_read_capture, judge=lambda found: bool(found) and _finite(*(f.rgb for f in found))),
    "rig": Kind(read=read_rig, judge=lambda rig: _finite(rig.camera.matrix, rig.response.inverse)),
    "mask": Kind(read=read_mask, judge=lambda mask: mask.dtype == bool and mask.any()),
    "labels": Kind(read=read_labels, judge=lambda labels: labels.max() <= 7),
    "normals": Kind(
        read=read_normal_map,
        judge=lambda n: np.allclose(np.linalg.norm(n.normals_in_camera[n.mask], axis=-1), 1, atol=1e-3),
    ),
    "depth": Kind(read=read_depth_map, judge=lambda d: _finite(d.depth)),
    "flow": Kind(read=read_flow),
    "mesh": Kind(read=read_mesh, judge=_judge_mesh),
    "textured": Kind(read=_read_textured, judge=_judge_mesh),
    "points": Kind(read=read_point_cloud, judge=lambda cloud: _finite(cloud.points, cloud.normals)),
    "moving": Kind(read=_read_moving_mesh, judge=lambda s: _finite(np.asarray(s.vertices))),
    "bvh": Kind(read=read_bvh, judge=lambda m: _finite(m.rotations, m.root_positions)),
    "acclaim": Kind(
        read=lambda folder: read_asf_amc(folder / "a.asf", folder / "a.amc"),
        judge=lambda m: _finite(m.rotations, m.root_positions),
    ),
    "manifest": Kind(read=lambda folder: (read_manifest(folder), FrameLog(folder).entries())),
    "track": Kind(read=read_track_record),
    "seams": Kind(read=read_seams, judge=lambda seams: _finite(*seams)),
    "lights": Kind(read=read_lights, judge=lambda lights: _finite(lights.directions, lights.intensities)),
    "press": Kind(read=read_press_label, judge=lambda label: _finite(np.array(label))),
    "fit": Kind(read=read_garment_fit),
}  # fmt: skip


def write_specimens(folder: Path) -> list[tuple[str, Path]]:
    """Write good files of every kind; return (kind, file or folder) of each."""
    rng = np.random.default_rng(9)
    found = [("capture", path) for path in _write_captures(folder / "captures", rng)]
    found += _write_maps(folder / "maps", rng)
    found += _write_meshes(folder / "meshes")
    found += _write_motion(folder / "motion")
    found += _write_texts(folder / "texts")
    for kind, path in found:
        assert KINDS[kind].judge(KINDS[kind].read(path)), f"the good {path} is not read"
    return found


def rig() -> Rig:
    quality = FitQuality(method="sphere", residual_deg=1.5, condition_number=2.5, samples=1000, cone_deg=60.0)
    return Rig(
        camera=Camera.orthographic(width=W, height=H),
        response=LightResponse(matrix=MATRIX, light_colours=np.eye(3) + 0.05),
        quality=quality,
        sources=(SourceFile(file="ball.png", sha256="0" * 64),),
    )


def _write_captures(folder: Path, rng: np.random.Generator) -> list[Path]:
    folder.mkdir(parents=True)
    eight = cv2.GaussianBlur(rng.integers(30, 220, (H, W, 3), dtype=np.uint8), (5, 5), 0)
    sixteen = eight.astype(np.uint16) * 257
    write_png(folder / "8.png", eight)
    write_png(folder / "16.png", sixteen)
    write_png(folder / "grey.png", eight[..., 0])
    write_png(folder / "alpha.png", np.dstack([eight, np.full((H, W), 255, np.uint8)]))
    for name, compression in (("plain", None), ("deflate", "zlib")):
        tifffile.imwrite(folder / f"{name}.tif", eight, photometric="rgb", compression=compression)
    assert cv2.imwrite(str(folder / "lzw.tif"), eight, [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    tifffile.imwrite(folder / "16.tif", sixteen, photometric="rgb")
    tifffile.imwrite(folder / "float.tif", eight.astype(np.float32) / 255, photometric="rgb")
    for suffix in ("jpg", "bmp"):
        assert cv2.imwrite(str(folder / f"a.{suffix}"), eight)
    planes = {name: np.ascontiguousarray(eight[..., i] / np.float32(255)) for i, name in enumerate("RGB")}
    for compression in ExrCompression:
        write_exr(folder / f"{compression.value}.exr", planes, compression=compression)
    for name, frame in (("8", eight), ("16", sixteen)):
        write_video(folder / f"{name}.mkv", [np.roll(frame, i, 1) for i in range(6)], 30)
    _write_coded_videos(folder, eight)
    (folder / "sequence").mkdir()
    for number in range(4):
        write_png(folder / "sequence" / f"f{number}.png", np.roll(eight, number, 1))
    return sorted(folder.iterdir())


def _write_coded_videos(folder: Path, frame: np.ndarray) -> None:
    import av

    chosen = (
        ("mpeg4", "yuv420p", "mp4"), ("libx264", "yuv444p", "mp4"), ("mjpeg", "yuvj420p", "avi"),
        ("prores_ks", "yuv422p10le", "mov"), ("rawvideo", "rgb24", "avi"), ("png", "rgb24", "mov"),
    )  # fmt: skip
    for codec, pixels, suffix in chosen:
        if codec not in av.codecs_available:
            continue
        with av.open(str(folder / f"{codec}.{suffix}"), "w") as container:
            stream = container.add_stream(codec, rate=30)
            stream.width, stream.height, stream.pix_fmt = W, H, pixels
            stream.codec_context.thread_count = 1
            for shift in range(6):
                picture = av.VideoFrame.from_ndarray(np.roll(frame, shift, 1), format="rgb24")
                container.mux(stream.encode(picture))
            container.mux(stream.encode(None))


def _write_maps(folder: Path, rng: np.random.Generator) -> list[tuple[str, Path]]:
    folder.mkdir()
    v, u = np.mgrid[:H, :W]
    slopes = np.stack([0.3 * np.sin(u / 5), 0.3 * np.cos(v / 4), -np.ones((H, W))], axis=-1)
    mask = (u - 15) ** 2 + (v - 12) ** 2 < 120
    normals = np.where(mask[..., None], slopes / np.linalg.norm(slopes, axis=-1, keepdims=True), 0)
    normal_map = NormalMap(normals_in_camera=normals.astype(np.float32), mask=mask)
    depth_map = DepthMap(
        depth=np.where(mask, u / 7.0, 0).astype(np.float32), mask=mask, unit=LengthUnit.PIXEL
    )
    write_normal_map(folder / "n.exr", normal_map)
    write_normal_map(folder / "n.png", normal_map)
    write_normal_map(folder / "n8.png", normal_map, bits=8)
    write_normal_map(folder / "zip.exr", normal_map, compression=ExrCompression.ZIP)
    write_depth_map(folder / "d.exr", depth_map)
    write_depth_map(folder / "piz.exr", depth_map, compression=ExrCompression.PIZ)
    write_flow(folder / "flow.exr", rng.normal(size=(H, W, 2)).astype(np.float32))
    write_mask(folder / "mask.png", mask)
    write_labels(folder / "labels.png", rng.integers(0, 8, (H, W), dtype=np.uint8))
    return [
        *(("normals", folder / name) for name in ("n.exr", "n.png", "n8.png", "zip.exr")),
        ("depth", folder / "d.exr"), ("depth", folder / "piz.exr"), ("flow", folder / "flow.exr"),
        ("mask", folder / "mask.png"), ("labels", folder / "labels.png"),
    ]  # fmt: skip


def a_mesh(size: int = 6) -> Mesh:
    v, u = np.mgrid[:size, :size].astype(float)
    vertices = np.stack([u, v, np.sin(u)], axis=-1).reshape(-1, 3)
    corner = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    faces = np.concatenate(
        [
            np.stack([corner, corner + size, corner + 1], 1),
            np.stack([corner + 1, corner + size, corner + size + 1], 1),
        ]
    )
    normals = np.tile([0.0, 0.0, -1.0], (len(vertices), 1))
    colours = np.clip(vertices / size, 0, 1).astype(np.float32)
    return Mesh(
        vertices=vertices,
        faces=faces.astype(np.int32),
        normals=normals,
        colours=colours,
        uv=vertices[:, :2] / size,
    )


def _write_meshes(folder: Path) -> list[tuple[str, Path]]:
    folder.mkdir()
    mesh = a_mesh()
    write_mesh(folder / "a.ply", mesh)
    write_mesh(folder / "a.obj", mesh, texture=np.full((8, 8, 3), 99, dtype=np.uint8))
    rows = [" ".join(f"{x:.4f}" for x in vertex) for vertex in mesh.vertices]
    quads = [f"4 {a} {a + 1} {a + 7} {a + 6}" for a in range(0, 20, 7)] + ["3 0 1 2"]
    head = "ply\nformat ascii 1.0\nelement vertex 36\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {len(quads)}\nproperty list uchar int vertex_indices\nend_header\n"
    (folder / "ascii.ply").write_text(head + "\n".join(rows + quads) + "\n")
    mixed = head.replace("ascii", "binary_big_endian").encode() + mesh.vertices.astype(">f4").tobytes()
    for quad in quads:
        count, *corners = map(int, quad.split())
        mixed += bytes([count]) + np.array(corners, dtype=">i4").tobytes()
    (folder / "big.ply").write_bytes(mixed)
    frames = np.stack([mesh.vertices + k for k in range(3)]).astype(np.float32)
    confidence = np.ones(frames.shape[:2], dtype=np.float32)
    moving = MeshSequence(template=mesh, vertices=frames, frame_rate_hz=30, confidence=confidence)
    write_mesh_sequence(folder / "moving", moving)
    return [
        *(("mesh", folder / name) for name in ("a.ply", "ascii.ply", "big.ply")),
        ("textured", folder / "a.obj"), ("points", folder / "a.ply"), ("moving", folder / "moving"),
    ]  # fmt: skip


BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Chest
  {
    OFFSET 0 5.5 0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 0 4 0
    }
  }
}
MOTION
Frames: 3
Frame Time: 0.0333333
0 1 2 10 20 30 1 2 3
0 1 2 11 21 31 1 2 3
0 1 2 12 22 32 1 2 3
"""
ASF = """:version 1.10
:name a
:units
  mass 1.0
  length 0.45
  angle deg
:root
  order TX TY TZ RX RY RZ
  axis XYZ
  position 0 0 0
  orientation 0 0 0
:bonedata
  begin
    id 1
    name spine
    direction 0 1 0
    length 2.2
    axis 0 0 20 XYZ
    dof rx ry rz
    limits (-160.0 20.0)
           (-70.0 70.0)
           (-60.0 70.0)
  end
  begin
    id 2
    name head
    direction 0 1 0.1
    length 1.2
    axis 10 0 0 XYZ
    dof rx
  end
:hierarchy
  begin
    root spine
    spine head
  end
"""
AMC = "#!OML:ASF a.ASF\n:FULLY-SPECIFIED\n:DEGREES\n" + "".join(
    f"{n}\nroot 0 1 2 {n} 20 30\nspine 1 2 {n}\nhead 5\n" for n in (1, 2, 3)
)


def _write_motion(folder: Path) -> list[tuple[str, Path]]:
    (folder / "acclaim").mkdir(parents=True)
    (folder / "a.bvh").write_text(BVH)
    (folder / "acclaim" / "a.asf").write_text(ASF)
    (folder / "acclaim" / "a.amc").write_text(AMC)
    return [("bvh", folder / "a.bvh"), ("acclaim", folder / "acclaim")]


def _write_texts(folder: Path) -> list[tuple[str, Path]]:
    folder.mkdir()
    write_rig(folder / "rig.json", rig())
    entry = InputEntry(source="a.mkv", files=[], width=W, height=H, frame_count=3, frame_rate_hz=30)
    write_manifest(
        folder / "result",
        Manifest(input=entry, rig=entry_from_rig(rig()), options={"a": 1.5, "b": "x", "c": None}),
    )
    log = FrameLog(folder / "result")
    for number in range(3):
        log.append(FrameEntry(number=number, seconds=0.01, valid_share=0.5))
    log.close()
    write_track_record(folder / "track", {"template": 0, "options": {}, "seams": [], "frames": [0, 1, 2]})
    (folder / "seams.json").write_text('{"seams": [[[3, 4], [5.5, 6], [7, 8]], [[1, 2], [2, 3]]]}')
    (folder / "lights.txt").write_text("2\n# x y z r g b\n0.1 0.2 0.9 1 1 1\n-0.1 0.2 0.9 1 0.5 1\n")
    (folder / "diligent").mkdir()
    (folder / "diligent" / "light_directions.txt").write_text("0.1 0.2 0.9\n0 0 1\n")
    (folder / "diligent" / "light_intensities.txt").write_text("1 1 1\n0.9 1 1\n")
    (folder / "diligent" / "filenames.txt").write_text("001.png\n002.png\n")
    (folder / "press.txt").write_text("120.5 99.25 17\n")
    landmarks = [{"vertex": k, "joint": "Hips", "offset_m": [0, 0.1, 0]} for k in range(3)]
    fit = {"version": 1, "scale": 1.1, "rotation_deg": [0, 5, 0], "bind_frame": 0, "landmarks": landmarks}
    fit["pose_deg"] = {"Hips": [0, 0, 9]}
    (folder / "fit.json").write_text(json.dumps(fit, indent=1))
    return [
        ("rig", folder / "rig.json"), ("manifest", folder / "result"), ("track", folder / "track"),
        ("seams", folder / "seams.json"), ("lights", folder / "lights.txt"), ("lights", folder / "diligent"),
        ("press", folder / "press.txt"), ("fit", folder / "fit.json"),
    ]  # fmt: skip


def copy_of(path: Path, folder: Path) -> Path:
    """Put a specimen, with what lies beside an OBJ, into an empty folder."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    if path.is_dir():
        shutil.copytree(path, folder / path.name)
    elif path.suffix == ".obj":
        for file in path.parent.glob(f"{path.stem}.*"):
            shutil.copy(file, folder)
    else:
        shutil.copy(path, folder)
    return folder / path.name

"""Small good files of every kind that is read, and how each kind is read and judged."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from PIL import Image, ImageCms
from scipy.io import savemat
from specimen_texts import write_motion, write_texts

from tests.faults.stated_sensors import write_dng
from tests.result_files import write_mesh_sequence
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.video import write_video
from vntoolkit.io.light_files import read_lights
from vntoolkit.io.maps_and_meshes.exr import ExrCompression, write_exr
from vntoolkit.io.maps_and_meshes.label_images import read_labels, write_labels
from vntoolkit.io.maps_and_meshes.maps import (
    read_depth_map,
    read_normal_map,
    write_depth_map,
    write_normal_map,
)
from vntoolkit.io.maps_and_meshes.masks import read_mask, write_mask
from vntoolkit.io.maps_and_meshes.meshes import read_mesh, write_mesh
from vntoolkit.io.motion.asf import read_asf_amc
from vntoolkit.io.motion.bvh import read_bvh
from vntoolkit.io.motion.garment_fits import read_garment_fit
from vntoolkit.io.results.frame_log import FrameLog
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.io.results.seams import read_seams
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.io.rigs import read_rig
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import FitQuality, Rig, SourceFile
from vntoolkit.pipeline.calibrate_presses import read_press_label
from vntoolkit.pipeline.tracked_folder import read_track_record

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
    "mesh": Kind(read=read_mesh, judge=_judge_mesh),
    "textured": Kind(read=read_mesh, judge=_judge_mesh),
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
    found += write_motion(folder / "motion")
    found += write_texts(folder / "texts", rig())
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
    for name, compression in (("plain", None), ("deflate", "zlib"), ("lzma", "lzma")):
        tifffile.imwrite(folder / f"{name}.tif", eight, photometric="rgb", compression=compression)
    assert cv2.imwrite(str(folder / "lzw.tif"), eight, [cv2.IMWRITE_TIFF_COMPRESSION, 5])
    tifffile.imwrite(folder / "16.tif", sixteen, photometric="rgb")
    tifffile.imwrite(folder / "float.tif", eight.astype(np.float32) / 255, photometric="rgb")
    for suffix in ("jpg", "bmp"):
        assert cv2.imwrite(str(folder / f"a.{suffix}"), eight)
    tifffile.imwrite(folder / "big.tif", eight, photometric="rgb", bigtiff=True)
    exif = Image.Exif()
    exif[274] = 6  # to be turned
    Image.fromarray(eight).save(folder / "turned.jpg", exif=exif, progressive=True)
    Image.fromarray(eight).save(folder / "turned.png", exif=exif)
    _write_rare_pictures(folder, eight, sixteen)
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


def _write_rare_pictures(folder: Path, eight: np.ndarray, sixteen: np.ndarray) -> None:
    """What few cameras and programs write: files of other decoders than the common ones'."""
    profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    for name in ("a.webp", "profile.png", "profile.jpg"):
        Image.fromarray(eight).save(folder / name, icc_profile=profile)
    Image.fromarray(eight).save(
        folder / "preview.jpg", "MPO", save_all=True, append_images=[Image.fromarray(eight[::2, ::2])]
    )
    rows = eight[::-1, :, ::-1].tobytes()
    header = struct.pack("<IiiHHIIiiII", 124, W, H, 1, 24, 0, len(rows), 2835, 2835, 0, 0)
    header += bytes(16) + b"DEBM" + bytes(48) + struct.pack("<4I", 4, 124 + len(rows), len(profile), 0)
    start = b"BM" + struct.pack("<IHHI", 138 + len(rows) + len(profile), 0, 0, 138)
    (folder / "profile.bmp").write_bytes(start + header + rows + profile)
    tifffile.imwrite(folder / "half.tif", eight.astype(np.float16) / 255, photometric="rgb")
    tifffile.imwrite(folder / "tiles.tif", sixteen, photometric="rgb", tile=(16, 16))
    planes = np.ascontiguousarray(np.moveaxis(sixteen, 2, 0))
    tifffile.imwrite(folder / "planes.tif", planes, photometric="rgb", planarconfig="separate")
    cells = [
        (33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes([0, 1, 1, 2]), True),
        (50713, "H", 2, (3, 3), True), (50714, "H", 9, tuple(range(60, 69)), True),
        (50717, "I", 1, 65535, True),
    ]  # fmt: skip
    write_dng(folder / "mosaic.dng", sixteen[..., 1], 32803, cells)
    white = [(50714, "H", 3, (64, 65, 66), True), (50717, "I", 3, (65535,) * 3, True)]
    write_dng(folder / "colours.dng", sixteen, 34892, white)


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
    write_png(folder / "n8.png", np.rint(127.5 * (normals * [1, -1, -1] + 1)).astype(np.uint8))
    write_normal_map(folder / "zip.exr", normal_map, compression=ExrCompression.ZIP)
    np.savez_compressed(folder / "n.npz", normals=normals * [1, -1, -1], mask=mask)
    for name, is_packed in (("n.mat", False), ("packed.mat", True)):
        savemat(folder / name, {"Normal_gt": normals * [1, -1, -1]}, do_compression=is_packed)
    write_depth_map(folder / "d.exr", depth_map)
    write_depth_map(folder / "piz.exr", depth_map, compression=ExrCompression.PIZ)
    write_mask(folder / "mask.png", mask)
    write_labels(folder / "labels.png", rng.integers(0, 8, (H, W), dtype=np.uint8))
    stored = ("n.exr", "n.png", "n8.png", "zip.exr", "n.npz", "n.mat", "packed.mat")
    return [
        *(("normals", folder / name) for name in stored),
        ("depth", folder / "d.exr"), ("depth", folder / "piz.exr"),
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
    moving = MeshSequence(template=mesh, vertices=frames, frame_rate_hz=30, uncertainty_px=confidence)
    write_mesh_sequence(folder / "moving", moving)
    return [
        *(("mesh", folder / name) for name in ("a.ply", "ascii.ply", "big.ply")),
        ("textured", folder / "a.obj"), ("moving", folder / "moving"),
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

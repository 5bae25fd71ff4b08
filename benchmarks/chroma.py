"""What subsampled chroma costs: normals from 4:4:4, from 4:2:0 plainly, and with the detail of the luma.

    python -m benchmarks.chroma [--scenes sweater spandex] [--crf 8]    # 1 min

Two frames of each scene, without noise and shadows, are encoded as H.264 and HEVC with 8 and 10 bits. Prints
the mean error of the normals by the true M, inside the figure, in degrees. The same quality setting, `--crf`,
is given to all.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import av
import cv2
import numpy as np

import vntoolkit as vt
from vntoolkit.arrays import LinearImage, Mask
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.maps_and_meshes.maps import read_normal_map
from vntoolkit.io.rigs import read_rig
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.transfer import Transfer, TransferCurve, encoded_from_linear

CURVE = Transfer(curve=TransferCurve.BT709)
FRAMES = (0, 20)
CODECS = (("libx264", ""), ("libx264", "10le"), ("libx265", ""), ("libx265", "10le"))
CLEAN = ("noise", "near_lights", "ambient", "shadows", "texture", "gloss")
OUTLINE_PX = 9


def encode(path: Path, light: LinearImage, codec: str, pixel_format: str, crf: int) -> None:
    """Write one linear frame (h, w, 3) as a video of this format."""
    stored = np.rint(65535 * encoded_from_linear(light, CURVE).clip(0, 1)).astype(np.uint16)
    options = {"crf": str(crf)} | ({"x265-params": "log-level=none:bframes=0"} if codec == "libx265" else {})
    # x265 makes up a lone frame's decoding time where B frames may come, and the file may refuse it.
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options=options)
        stream.height, stream.width, stream.pix_fmt = *light.shape[:2], pixel_format
        picture = av.VideoFrame.from_ndarray(stored, format="rgb48le")
        picture.pts = 0
        container.mux(stream.encode(picture.reformat(format=pixel_format, interpolation="BICUBIC")))
        container.mux(stream.encode(None))


def error_deg(
    path: Path, truth: NormalMap, inside: Mask, response: LightResponse, takes_detail: bool
) -> float:
    """Return the mean error of the normals of a video's first frame."""
    options = CaptureOptions(transfer=CURVE, response=response if takes_detail else None)
    normals = (open_capture(path, options).frame(0).rgb - response.ambient) @ response.inverse.T
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    cosine = (normals * truth.normals_in_camera).sum(axis=-1)[inside]
    return float(np.rad2deg(np.arccos(cosine.clip(-1, 1))).mean())


def main(scenes: list[str], crf: int) -> None:
    with tempfile.TemporaryDirectory(prefix="vntoolkit-") as scratch:
        for scene in scenes:
            folder = Path(scratch) / scene
            vt.simulate(
                scene, out=folder, frames=f"{FRAMES[0]}:{2 * FRAMES[1]}:{FRAMES[1]}",
                **dict.fromkeys(CLEAN, False),
            )  # fmt: skip
            response = read_rig(folder / "truth" / "rig.json").response.central
            capture = open_capture(folder / "capture.mkv")
            for codec, depth in CODECS:
                rows = []
                for place in range(len(FRAMES)):
                    light = capture.frame(place).rgb
                    truth = read_normal_map(folder / "truth" / "normals" / f"{place:06d}.exr")
                    lit = (truth.mask & (light.min(axis=-1) > 0.02)).astype(np.uint8)
                    inside = cv2.erode(lit, np.ones((OUTLINE_PX, OUTLINE_PX), np.uint8)) > 0
                    paths = [Path(scratch) / f"{chroma}.mkv" for chroma in ("444", "420")]
                    for path in paths:
                        encode(path, light, codec, f"yuv{path.stem}p{depth}", crf)
                    rows.append(
                        [
                            error_deg(path, truth, inside, response, detail)
                            for path, detail in ((paths[0], False), (paths[1], False), (paths[1], True))
                        ]
                    )
                full, plain, found = np.mean(rows, axis=0)
                name = f"{scene:8} {codec}{depth:5}"
                print(f"{name} 4:4:4 {full:.2f}, 4:2:0 plain {plain:.2f}, with detail {found:.2f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", nargs="+", default=["sweater", "spandex"])
    parser.add_argument("--crf", type=int, default=8, help="quality of the encoders, 0 best")
    arguments = parser.parse_args()
    main(arguments.scenes, arguments.crf)

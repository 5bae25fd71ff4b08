"""Fine relief through 4:2:0: luma takes back what it can tell; smooth surfaces lose nothing."""

from pathlib import Path

import av
import numpy as np
import pytest

from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.photometry.response import LightResponse, rgb_from_normals
from vntoolkit.photometry.transfer import Transfer, encoded_from_linear

SIZE = (96, 160)
RESPONSE = LightResponse(matrix=np.array([[-0.3, 0.12, -0.6], [0.28, 0.14, -0.6], [0.02, -0.34, -0.5]]))


def _normals(knit: bool, rng: np.random.Generator) -> np.ndarray:
    """A rolling surface, with wales and courses of three pixels on it and a little of every frequency."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    p, q = 0.5 * np.sin(u / 17) * np.cos(v / 23), 0.4 * np.cos(u / 19) + 0.2 * np.sin(v / 13)
    if knit:
        p = p + 0.22 * np.cos(2.1 * u) * np.sin(1.3 * v) + 0.05 * rng.standard_normal(SIZE)
        q = q + 0.22 * np.sin(2.1 * u) * np.cos(1.3 * v) + 0.05 * rng.standard_normal(SIZE)
    normals = np.stack([p, q, -np.ones(SIZE)], -1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _film(path: Path, light: np.ndarray, transfer: Transfer, codec: str, pixels: str) -> None:
    encoded = np.rint(65535 * encoded_from_linear(light, transfer)).astype(np.uint16)
    options = {"crf": "6"} | ({"x265-params": "log-level=none:bframes=0"} if codec == "libx265" else {})
    # x265 makes up a lone frame's decoding time where B frames may come, and the file may refuse it.
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options=options)
        stream.height, stream.width, stream.pix_fmt = *SIZE, pixels
        picture = av.VideoFrame.from_ndarray(encoded, format="rgb48le")
        picture.pts = 0
        container.mux(stream.encode(picture.reformat(format=pixels, interpolation="BICUBIC", threads=1)))
        container.mux(stream.encode(None))


def _error_deg(path: Path, normals: np.ndarray, transfer: Transfer, response: LightResponse | None) -> float:
    frame = open_capture(path, CaptureOptions(transfer=transfer, response=response)).frame(0)
    found = frame.rgb @ RESPONSE.inverse.T
    found /= np.linalg.norm(found, axis=-1, keepdims=True)
    inner = (slice(4, -4), slice(4, -4))
    return float(np.rad2deg(np.arccos((found * normals).sum(-1).clip(-1, 1)))[inner].mean())


@pytest.mark.parametrize(
    ("codec", "depth", "curve"), [("libx264", "", "linear"), ("libx265", "10le", "bt709")]
)
def test_luma_takes_back_what_it_can_tell(tmp_path, rng, codec, depth, curve):
    """All of this relief is finer than the chroma. Its waves that run across luma's gradient stay unseen.

    Luma alone leaves the root of a half of the cost (0.71); the pattern of its detail tells more.
    """
    transfer, costs = Transfer.from_text(curve), {}
    for knit in (True, False):
        normals = _normals(knit, rng)
        light = rgb_from_normals(normals, RESPONSE).clip(0, 1)
        for chroma in ("444", "420"):
            _film(tmp_path / f"{chroma}.mkv", light, transfer, codec, f"yuv{chroma}p{depth}")
        best = _error_deg(tmp_path / "444.mkv", normals, transfer, None)
        plain = _error_deg(tmp_path / "420.mkv", normals, transfer, None)
        costs[knit] = plain - best, _error_deg(tmp_path / "420.mkv", normals, transfer, RESPONSE) - best
    assert costs[True][0] > 2
    assert costs[True][1] < 0.66 * costs[True][0]
    assert costs[False][1] < costs[False][0] + 0.02


@pytest.mark.parametrize("pixels", ["yuv422p", "yuv440p", "yuv420p", "yuv422p10le"])
@pytest.mark.parametrize("size", [(4, 4), (9, 7), (31, 17)])
def test_every_subsampling_and_odd_sizes_keep_a_flat_colour(tmp_path, pixels, size):
    """Without detail there is nothing to add: the same colour as by plain decoding, to a level."""
    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.height, stream.width, stream.pix_fmt = *size, pixels
        flat = np.full((*size, 3), (120, 90, 160), np.uint8)
        container.mux(
            stream.encode(av.VideoFrame.from_ndarray(flat, format="rgb24").reformat(format=pixels, threads=1))
        )
        container.mux(stream.encode(None))
    plain = open_capture(tmp_path / "a.mkv", CaptureOptions(transfer=Transfer())).frame(0).rgb
    options = CaptureOptions(transfer=Transfer(), response=RESPONSE)
    np.testing.assert_allclose(open_capture(tmp_path / "a.mkv", options).frame(0).rgb, plain, atol=0.006)

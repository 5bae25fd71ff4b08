"""Videos that state a curve, a range, alpha, views, streams or an edit list."""

from __future__ import annotations

import io
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image

from tests.faults.stated_change import CURVES, Change, H, Rng, W, chosen, profile_of, random_code


def film(path: Path, *frames: np.ndarray, codec: str = "ffv1", **stated: Any) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.height, stream.width = frames[0].shape[:2]
        has_alpha = frames[0].shape[2] == 4
        stream.pix_fmt = "bgra" if has_alpha else "rgb24" if codec == "libx264rgb" else "bgr0"
        stream.codec_context.thread_count = 1
        stream.metadata.update({name: text for name, text in stated.items() if isinstance(text, str)})
        for name, value in stated.items():
            if not isinstance(value, str):
                setattr(stream.codec_context, name, value)
        for frame in frames:
            picture = av.VideoFrame.from_ndarray(frame, format="rgba" if has_alpha else "rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))


def video_alpha(folder: Path, rng: Rng) -> Change:
    (values, code), alpha = random_code(rng), chosen(rng, (255, 254, 128, 0))
    film(folder / "a.mkv", np.dstack([values, np.full((H, W), alpha, np.uint8)]))
    return Change(
        path=folder / "a.mkv", rgb=code, refused="" if alpha == 255 else "alpha channel is not opaque"
    )


def video_stereo(folder: Path, rng: Rng) -> Change:
    values, code = random_code(rng)
    mode = chosen(rng, ("mono", "left_right", "top_bottom"))
    film(folder / "a.mkv", values, stereo_mode=mode)
    return Change(path=folder / "a.mkv", rgb=code, refused="" if mode == "mono" else "holds 2 views")


def video_packed(folder: Path, rng: Rng) -> Change:
    """Two views in a frame, as H.264 itself states it; 0 and 5 are patterns of pixels and turns in time."""
    (values, code), arrangement = random_code(rng), int(rng.integers(0, 7))
    path, wide = folder / "a.mkv", np.tile(values, (2, 2, 1))
    options = {"x264-params": f"frame-packing={arrangement}" if arrangement < 6 else "", "qp": "0"}
    film(path, wide, codec="libx264rgb", options=options)
    return Change(path=path, rgb=code, refused="holds 2 views" if arrangement < 6 else "", tolerance=0.02)


def video_alpha_apart(folder: Path, rng: Rng) -> Change:
    """VP8 and VP9 store alpha beside the video, where FFmpeg's decoder leaves it."""
    (values, _), path = random_code(rng), folder / "a.webm"
    with av.open(str(path), "w") as container:
        stream = container.add_stream(chosen(rng, ("libvpx", "libvpx-vp9")), rate=25)
        stream.height, stream.width, stream.pix_fmt = 2 * H, 2 * W, "yuva420p"
        stream.options = {"auto-alt-ref": "0"}
        picture = np.dstack([np.tile(values, (2, 2, 1)), np.full((2 * H, 2 * W), 128, np.uint8)])
        container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgba")))
        container.mux(stream.encode(None))
    return Change(path=path, refused="an alpha channel apart")


def video_streams(folder: Path, rng: Rng) -> Change:
    """Two video streams; a cover picture is none, wherever it stands."""
    (values, code), path = random_code(rng), folder / "a.mp4"
    way = int(rng.integers(3))  # two videos, the cover first, the cover last
    pictures = [values, 255 - values] if way == 2 else [255 - values, values]
    with av.open(str(path), "w") as container:
        codecs = [("png", "rgb24") if k == way - 1 else ("libx264rgb", "rgb24") for k in range(2)]
        streams = [container.add_stream(name, rate=25, options={"qp": "0"}) for name, _ in codecs]
        for stream, (_, kind) in zip(streams, codecs, strict=True):
            stream.height, stream.width, stream.pix_fmt = H, W, kind
        if way:
            streams[way - 1].disposition = av.stream.Disposition.attached_pic
        for stream, picture in zip(streams, pictures, strict=True):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            container.mux(stream.encode(None))
    return Change(path=path, rgb=code, refused="" if way else "holds 2 video streams, expected one")


def video_profile(folder: Path, rng: Rng) -> Change:
    """Frames that are PNG with a profile."""
    (values, code), curve, path = random_code(rng), chosen(rng, CURVES), folder / "a.mov"
    stream = io.BytesIO()
    Image.fromarray(values).save(stream, "PNG", icc_profile=profile_of(rng, curve))
    with av.open(str(path), "w") as container:
        film = container.add_stream("png", rate=25)
        film.height, film.width, film.pix_fmt = H, W, "rgb24"
        packet = av.Packet(stream.getvalue())
        packet.stream, packet.pts, packet.dts, packet.time_base = film, 0, 0, Fraction(1, 25)
        container.mux(packet)
    refused = "states the transfer curve of an ICC profile" if curve == "odd" else ""
    return Change(path=path, rgb=CURVES[curve](code), refused=refused, tolerance=0.004)


def video_curve(folder: Path, rng: Rng) -> Change:
    (values, code), path = random_code(rng), folder / "a.mkv"
    number, curve = chosen(rng, {1: "bt709", 8: "linear", 13: "srgb", 4: "gamma:2.2", 17: ""}.items())
    film(path, values, codec="libx264rgb", color_trc=number)
    if not curve:
        return Change(path=path, refused="states the transfer curve smpte428, which is not read")
    return Change(path=path, rgb=CURVES[curve](code), tolerance=0.02)


def video_range(folder: Path, rng: Rng) -> Change:
    (values, code), limited = random_code(rng), int(rng.integers(1, 3))
    film(folder / "a.mkv", values, codec="libx264rgb", color_range=limited)
    refused = "is stored as RGB of limited range" if limited == 1 else ""
    return Change(path=folder / "a.mkv", rgb=code, refused=refused, tolerance=0.02)


def video_edit_list(folder: Path, rng: Rng) -> Change:
    """An MP4 cut without encoding: it begins between two key frames, and hides those before."""
    light, first, path = rng.integers(30, 226, 12), int(rng.integers(1, 5)), folder / "a.mp4"
    film(
        folder / "whole.mp4",
        *(np.full((H, W, 3), n, np.uint8) for n in light),
        codec="libx264rgb",
        options={"qp": "0", "g": "6", "bf": "2"},
    )
    with av.open(str(folder / "whole.mp4")) as whole, av.open(str(path), "w") as container:
        stream = container.add_stream_from_template(whole.streams.video[0])
        for packet in whole.demux(whole.streams.video[0]):
            if packet.pts is not None and packet.dts is not None:
                shift = round(first / 25 / packet.time_base)
                packet.pts, packet.dts, packet.stream = packet.pts - shift, packet.dts - shift, stream
                container.mux(packet)
    return Change(path=path, rgb=light[first] / 255, tolerance=0.004)


def video_curves(folder: Path, rng: Rng) -> Change:
    """Two shots in one stream, of which the second may state another curve."""
    (values, code), curves = random_code(rng), rng.choice([1, 13, 4], 2).tolist()
    path = folder / "a.ts"
    with av.open(str(path), "w") as container:
        film = container.add_stream("libx264", rate=25)
        film.height, film.width, film.pix_fmt = H, W, "yuv444p"
        for shot, curve in enumerate(curves):
            context = av.CodecContext.create("libx264", "w")
            assert isinstance(context, av.VideoCodecContext)
            context.height, context.width, context.pix_fmt = H, W, "yuv444p"
            context.time_base, context.options, context.color_trc = (
                Fraction(1, 25),
                {"qp": "1", "bf": "0"},
                curve,
            )
            for k in (*range(3), None):
                frame = None if k is None else av.VideoFrame.from_ndarray(values, format="rgb24")
                if frame is not None:
                    frame.pts = 3 * shot + k
                for packet in context.encode(frame):
                    packet.stream = film
                    container.mux(packet)
    light = {1: "bt709", 13: "srgb", 4: "gamma:2.2"}[curves[0]]
    refused = "" if curves[0] == curves[1] else "frame 3 states the transfer curve"
    return Change(path=path, rgb=CURVES[light](code), refused=refused, tolerance=0.03)

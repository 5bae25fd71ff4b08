"""`vntoolkit live`: normals and the surface while filming."""

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np

from vntoolkit.cli.output import print_next, say, unused
from vntoolkit.cli.verb import verb
from vntoolkit.diagnosis.finding import judge, require_known_checks
from vntoolkit.diagnosis.rig_checks import findings_from_rig
from vntoolkit.errors import BadInput, VntError
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.maps_and_meshes.masks import read_mask
from vntoolkit.io.rigs import read_rig
from vntoolkit.live import capture
from vntoolkit.live.frames import FrameView, LiveProcessor, LiveResult
from vntoolkit.live.page import LiveViewer
from vntoolkit.options.base import File, Named, OptionalFile, named, positive
from vntoolkit.options.footage import MatteOptions, PictureLimits
from vntoolkit.options.normals import ShadowMethod, ShadowMethodName
from vntoolkit.options.pages import CameraOptions, ViewerOptions
from vntoolkit.options.shared import AllowOptions, CornerOptions
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.corners import rectification_from_corners, rig_with_corners
from vntoolkit.pipeline.gel import Gel

_GREY = 128
_LATE_FRAMES = 1.5  # intervals between frames; a result that took longer is late


@dataclass(frozen=True, kw_only=True)
class LiveArguments(CornerOptions, AllowOptions, CameraOptions, ViewerOptions, PictureLimits):
    """What `watch` takes."""

    rig: File
    """The rig.json of `vntoolkit calibrate`; it belongs to the picture after crop and rectification."""
    camera: int | None = None
    """Number of the camera, 0 for the first."""
    video: OptionalFile = named(None)
    """A video or a folder of images instead of a camera."""
    realtime: bool = False
    """Play the video at the speed at which it was filmed, dropping frames as a camera would."""
    mask: OptionalFile = named(None)
    """An image, white where the subject is."""
    background: OptionalFile = named(None)
    """An image of the scene under ambient light only, or of the untouched gel, as the camera sees it. With
    --key, of the set under the lamps without the subject."""
    key: float | None = None
    """Difference from the background, as a share of full scale, above which a pixel is the subject."""
    crop: tuple[int, int, int, int] | None = None
    """Left, top, width and height in pixels of the part to work on."""
    pixel_mm: float | None = None
    """Side of a pixel of the rectified picture in millimetres; a gel's rig knows it."""
    shadows: Named[ShadowMethod, ShadowMethodName] = named(ShadowMethod.NONE)
    """How self-shadows are found, as in `reconstruct`; robust takes half a second a frame of 1280×720."""
    record_to: File = Path()
    """The folder for recordings."""
    seconds: Annotated[float | None, positive("more than 0")] = None
    """Stop after so many seconds; default: when the video ends, or Ctrl-C."""


def _prepared(asked: LiveArguments) -> tuple[capture.LiveSource, LiveProcessor]:
    """Return where frames come from and what works on them, warm."""
    require_known_checks(asked.allow)
    rig = read_rig(Path(asked.rig))
    source = _source(asked, rig)
    view = FrameView(crop=asked.crop)
    view.require_inside(source.width, source.height)
    if rig.gel is not None:
        rig = rig_with_corners(rig, asked, view.size(source.width, source.height))
    else:
        view = replace(view, rectification=rectification_from_corners(asked, asked.pixel_mm))
    rig.require_size(*view.size(source.width, source.height), source.name)
    judge(findings_from_rig(rig), asked.allow)
    plate = _background(asked)
    if rig.gel is not None and plate is not None:
        gel = Gel(rig, view.cut(plate).values, allow=asked.allow)
        if asked.video is not None:  # a camera's first frame is yet to come
            gel(view.cut(_first_frame(source, asked.video)).values)
    processor = LiveProcessor(
        rig,
        view,
        mask=None if asked.mask is None else read_mask(asked.mask),
        background=plate,
        key=MatteOptions(key=asked.key).key,
        shadows=asked.shadows,
    )
    processor.warm_up(_first_frame(source, asked.video))
    return source, processor


def _background(asked: LiveArguments) -> EncodedFrame | None:
    return None if asked.background is None else next(open_capture(asked.background).encoded_frames())


@verb(LiveArguments, prints=True)
def watch(asked: LiveArguments) -> list[Path]:
    """Watch normals and a turning, relit surface in a browser while filming.

    Frames that come too fast are dropped and counted. `r` in the terminal, or the button on the page, starts
    and stops a lossless recording of what the camera gives. In Python the recordings are returned.
    """
    source, processor = _prepared(asked)
    recorder = capture.LiveRecorder(Path(asked.record_to), source.frame_rate_hz)
    _watch(source, processor, recorder, asked.seconds, asked.part(ViewerOptions), asked.realtime)
    files = list(recorder.files)
    if files:
        plate = [] if asked.background is None else ["--background", str(asked.background)]
        plate += [] if asked.key is None else ["--key", f"{asked.key:g}"]
        print_next("reconstruct", files[-1], "--rig", str(asked.rig), *plate, "--out", unused("result"))
    return files


def _watch(
    source: capture.LiveSource,
    processor: LiveProcessor,
    recorder: capture.LiveRecorder,
    seconds: float | None,
    options: ViewerOptions | None,
    realtime: bool,
) -> None:
    def on_result(result: LiveResult, timed: capture.TimedFrame) -> None:
        shown.show(result, timed)

    def on_failure(problem: VntError, timed: capture.TimedFrame) -> None:
        shown.show_failure(problem, timed)

    def on_r() -> None:
        try:
            say("recording" if recorder.toggle() else "recording stopped", flush=True)
        except VntError as error:  # nothing can be written there: go on showing
            say(f"not recording: {error}", flush=True)

    wait_for_all = isinstance(source, capture.FileSource) and not realtime
    run = capture.LiveRun(
        source, processor, on_result, recorder.take, on_failure=on_failure, wait_for_all=wait_for_all
    )
    shown = LiveViewer(
        processor.depth_camera,
        options,
        figures=run.figures,
        recorder=recorder,
        late_s=_LATE_FRAMES / source.frame_rate_hz,
    )
    say(f"{shown.address} (r records, Ctrl-C ends)", flush=True)
    timer = None if seconds is None else threading.Timer(seconds, run.stop)
    try:
        if timer is not None:
            timer.start()
        with contextlib.suppress(KeyboardInterrupt), _keys(on_r):
            run.run()
    finally:
        if timer is not None:
            timer.cancel()
        recorder.stop()
        shown.close()
    rate, (median, high) = shown.meter.figures()
    say(f"{source.name}: {run.figures().line()}")
    if shown.meter.count:
        timing = f"{rate:.1f} frames/s, {1000 * median:.0f} ms (95 %: {1000 * high:.0f} ms) after arrival"
        say(f"drawn {shown.meter.count}: {timing}")
    for path in recorder.files:
        say(f"recorded {path}")
    if recorder.lost:
        say(f"the recordings lost {recorder.lost} frames: the disk is too slow")
    if recorder.problem:
        say(f"not recorded: {recorder.problem}")


def _source(asked: LiveArguments, rig: Rig) -> capture.LiveSource:
    if (asked.camera is None) == (asked.video is None):
        raise BadInput("live: expected either --camera NUMBER or --video FILE")
    wanted = asked.part(CameraOptions)
    if asked.video is not None and wanted != CameraOptions():
        raise BadInput("live: --width, --height and --rate are asked of a camera; a video has its own")
    if asked.video is not None:
        return capture.FileSource(
            open_capture(asked.video, CaptureOptions(transfer=rig.transfer)), realtime=asked.realtime
        )
    if asked.realtime:
        raise BadInput("live: --realtime is for --video; a camera always is")
    assert asked.camera is not None
    return capture.CameraSource(asked.camera, wanted)


def _first_frame(source: capture.LiveSource, video: Path | None) -> EncodedFrame:
    """A frame such as will come: the video's first, or a grey one for a camera."""
    if video is not None:
        return next(open_capture(video).encoded_frames())
    grey = np.full((source.height, source.width, 3), _GREY, np.uint8)
    return EncodedFrame(values=grey, bits=8, number=0, name="grey")


@contextlib.contextmanager
def _keys(on_r: Callable[[], None]) -> Iterator[None]:
    """Call `on_r` whenever r is pressed in the terminal, where there is one."""
    if not sys.stdin.isatty():
        yield
        return
    import select
    import termios
    import tty

    terminal = sys.stdin.fileno()
    before = termios.tcgetattr(terminal)
    ended = threading.Event()

    def listen() -> None:
        while not ended.is_set():
            # by the descriptor: sys.stdin would read ahead, where select cannot see what waits
            if select.select([terminal], [], [], 0.2)[0] and os.read(terminal, 1) == b"r":
                on_r()

    tty.setcbreak(terminal)
    listener = threading.Thread(target=listen, daemon=True)
    listener.start()
    try:
        yield
    finally:
        ended.set()
        listener.join()
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)

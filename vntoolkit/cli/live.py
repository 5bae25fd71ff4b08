"""`vntoolkit live`: normals and the surface while filming."""

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
from cyclopts import Parameter

from vntoolkit.cli import flags
from vntoolkit.cli.output import print_next
from vntoolkit.diagnosis.checks import CHECK_NAMES, findings_from_rig
from vntoolkit.diagnosis.finding import judge, require_known_checks
from vntoolkit.errors import BadInput, VntError
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.footage.mattes import MatteOptions
from vntoolkit.io.maps_and_meshes.label_images import read_mask
from vntoolkit.io.rigs import read_rig
from vntoolkit.live import capture
from vntoolkit.live.frames import FrameView, LiveProcessor, LiveResult
from vntoolkit.live.page import LiveViewer
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.gel import Gel
from vntoolkit.report.local_server import ViewerOptions
from vntoolkit.shadows.detector import ShadowMethod

_GREY = 128
_LATE_FRAMES = 1.5  # intervals between frames; a result that took longer is late


Crop: TypeAlias = Annotated[tuple[int, int, int, int] | None, Parameter(consume_multiple=True, negative=())]


@flags.verb("max_megapixels")
def live(
    *,
    rig: Path,
    camera: int | None = None,
    video: Path | None = None,
    realtime: Annotated[bool, Parameter(negative=())] = False,
    mask: Path | None = None,
    background: Path | None = None,
    key: float | None = None,
    crop: Crop = None,
    corners: flags.Corners = None,
    size_mm: flags.SizeMm = None,
    pixel_mm: float | None = None,
    shadows: ShadowMethod = ShadowMethod.NONE,
    record_to: Path = Path(),
    seconds: float | None = None,
    allow: flags.Allow = (),
    asked: Annotated[capture.CameraOptions | None, flags.Flags()] = None,
    viewer: Annotated[ViewerOptions | None, flags.Flags()] = None,
) -> None:
    """Watch normals and a turning, relit surface in a browser while filming.

    Frames that come too fast are dropped and counted. `r` in the terminal, or the button on the page, starts
    and stops a lossless recording of what the camera gives.

    Parameters
    ----------
    rig
        The rig.json of `vntoolkit calibrate`; it belongs to the picture after crop and rectification.
    camera
        Number of the camera, 0 for the first.
    video
        A video or a folder of images instead of a camera.
    realtime
        Play the video at the speed at which it was filmed, dropping frames as a camera would.
    mask
        An image, white where the subject is.
    background
        An image of the scene under ambient light only, or of the untouched gel, as the camera sees it. With
        --key, of the set under the lamps without the subject.
    key
        Difference from the background, as a share of full scale, above which a pixel is the subject.
    crop
        Left, top, width and height in pixels of the part to work on.
    pixel_mm
        Side of a pixel of the rectified picture in millimetres; a gel's rig knows it.
    shadows
        How self-shadows are found, as in `reconstruct`; robust takes about 0.1 s a frame of 1280×720.
    record_to
        The folder for recordings.
    seconds
        Stop after so many seconds; default: when the video ends, or Ctrl-C.
    """
    require_known_checks(allow, CHECK_NAMES)
    if seconds is not None and not seconds > 0:
        raise BadInput(f"seconds: expected more than 0, got {seconds:g}")
    read = read_rig(rig)
    source = _source(camera, video, realtime, asked, read)
    view = FrameView(crop=crop)
    view.require_inside(source.width, source.height)
    if read.gel is not None:
        read = flags.rig_with_corners(read, corners, size_mm, view.size(source.width, source.height))
    else:
        view = replace(view, rectification=_rectification(corners, size_mm, pixel_mm))
    read.require_size(*view.size(source.width, source.height), source.name)
    judge(findings_from_rig(read), allow)
    plate = None if background is None else next(open_capture(background).encoded_frames())
    if read.gel is not None and plate is not None:
        gel = Gel(read, view.cut(plate).values, allow=allow)
        if video is not None:  # a camera's first frame is yet to come
            gel(view.cut(_first_frame(source, video)).values)
    processor = LiveProcessor(
        read,
        view,
        mask=None if mask is None else read_mask(mask),
        background=plate,
        key=MatteOptions(key=key).key,
        shadows=shadows,
    )
    processor.warm_up(_first_frame(source, video))
    recorder = capture.LiveRecorder(record_to, source.frame_rate_hz)
    _watch(source, processor, recorder, seconds, viewer, realtime)
    if recorder.files:
        how: list[str | Path] = [] if background is None else ["--background", background]
        how += [] if key is None else ["--key", f"{key:g}"]
        print_next("reconstruct", recorder.files[-1], "--rig", rig, *how, "--out", "result")


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
            print("recording" if recorder.toggle() else "recording stopped", flush=True)
        except VntError as error:  # nothing can be written there: go on showing
            print(f"not recording: {error}", flush=True)

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
    print(f"{shown.address} (r records, Ctrl-C ends)", flush=True)
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
    print(f"{source.name}: {run.figures().line()}")
    if shown.meter.count:
        timing = f"{rate:.1f} frames/s, {1000 * median:.0f} ms (95 %: {1000 * high:.0f} ms) after arrival"
        print(f"drawn {shown.meter.count}: {timing}")
    for path in recorder.files:
        print(f"recorded {path}")
    if recorder.lost:
        print(f"the recordings lost {recorder.lost} frames: the disk is too slow")
    if recorder.problem:
        print(f"not recorded: {recorder.problem}")


def _source(
    camera: int | None, video: Path | None, realtime: bool, asked: capture.CameraOptions | None, rig: Rig
) -> capture.LiveSource:
    if (camera is None) == (video is None):
        raise BadInput("live: expected either --camera NUMBER or --video FILE")
    if video is not None and asked is not None:
        raise BadInput("live: --width, --height and --rate are asked of a camera; a video has its own")
    if video is not None:
        return capture.FileSource(
            open_capture(video, CaptureOptions(transfer=rig.transfer)), realtime=realtime
        )
    if realtime:
        raise BadInput("live: --realtime is for --video; a camera always is")
    assert camera is not None
    return capture.CameraSource(camera, asked)


def _first_frame(source: capture.LiveSource, video: Path | None) -> EncodedFrame:
    """A frame such as will come: the video's first, or a grey one for a camera."""
    if video is not None:
        return next(open_capture(video).encoded_frames())
    grey = np.full((source.height, source.width, 3), _GREY, np.uint8)
    return EncodedFrame(values=grey, bits=8, number=0, name="grey")


def _rectification(
    corners: tuple[float, ...] | None, size_mm: tuple[float, float] | None, pixel_mm: float | None
) -> Rectification | None:
    if corners is None and size_mm is None:
        return None
    if pixel_mm is None:
        raise BadInput("live: --corners and --size-mm need --pixel-mm")
    return flags.rectification_from_flags(corners, size_mm, pixel_mm)


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

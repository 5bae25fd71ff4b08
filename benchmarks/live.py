"""Live mode on a 1280×720 file played at 30 frames a second: frames dropped and latency, viewer open.

python -m benchmarks.live [--size 1280x720] [--seconds 15] [--codec ffv1] [--browser] [--out F.json]   # 1 min
python -m benchmarks.live --rate 10 --shadows robust      # each light is missing over two discs that travel

Latency counts from the moment a frame is due to its result, and to its having been drawn by the page.
--browser opens the page in headless Chromium, which renders it on the same cores; it has drawn for three
seconds when counting begins. Processor time is told by process, in milliseconds a second, and says what each
takes even where others load the machine.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.pipeline import footage, rig_of, with_shadows, write_h264
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.footage.video import write_video
from vntoolkit.live.capture import FileSource, LatencyMeter, LiveRun, TimedFrame
from vntoolkit.live.frames import LiveProcessor, LiveResult
from vntoolkit.live.page import LiveViewer
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.pages import ViewerOptions

_LEAD_IN_S = 3.0  # a page that draws its first surface takes both cores for a moment, and is not what counts


@contextlib.contextmanager
def browser_on(address: str, wanted: bool) -> Iterator[None]:
    """Hold the page open in headless Chromium."""
    if not wanted:
        yield
        return
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        page = chromium.new_page(viewport={"width": 1280, "height": 800})
        page.goto(address)
        page.wait_for_timeout(3000)
        yield
        chromium.close()


def processor_s() -> dict[str, float]:
    """Seconds of processor time so far: of this process, and of the browser's together."""
    import psutil

    spent = {"capture": sum(psutil.Process().cpu_times()[:2]), "browser": 0.0}
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if "chrom" in process.name():
                spent["browser"] += sum(process.cpu_times()[:2])
    return spent


def written(
    path: Path, codec: str, width: int, height: int, seconds: float, rate_hz: int, shadows: ShadowMethod
) -> Path:
    """Write footage of this length; return its file."""
    frames = footage(width, height, round(seconds * rate_hz))
    if shadows is not ShadowMethod.NONE:
        encoded = (EncodedFrame(values=f, bits=8, number=i, name="") for i, f in enumerate(frames))
        frames = (frame.values for frame in with_shadows(list(encoded)))
    if codec == "h264":
        write_h264(path.with_suffix(".mp4"), frames, width, height, rate_hz)
        return path.with_suffix(".mp4")
    write_video(path.with_suffix(".mkv"), frames, rate_hz)
    return path.with_suffix(".mkv")


def measure(
    width: int,
    height: int,
    seconds: float,
    codec: str,
    browser: bool,
    rate_hz: int = 30,
    shadows: ShadowMethod = ShadowMethod.NONE,
) -> dict[str, object]:
    processed = LatencyMeter()
    with tempfile.TemporaryDirectory() as folder:
        lead_in = written(Path(folder) / "lead_in", codec, width, height, _LEAD_IN_S, rate_hz, shadows)
        path = written(Path(folder) / "live", codec, width, height, seconds, rate_hz, shadows)
        processor = LiveProcessor(rig_of(width, height), shadows=shadows)
        processor.warm_up(next(open_capture(path).encoded_frames()))

        def on_result(result: LiveResult, timed: TimedFrame) -> None:
            viewer.show(result, timed)
            processed.reached(timed.arrived_s)

        def run_of(video: Path) -> LiveRun:
            return LiveRun(FileSource(open_capture(video)), processor, on_result)

        run = run_of(path)
        viewer = LiveViewer(processor.depth_camera, ViewerOptions(port=8097), figures=run.figures)
        load = os.getloadavg()[0]
        with browser_on(viewer.address, browser):
            run_of(lead_in).run()
            viewer.meter, processed = LatencyMeter(keep=None), LatencyMeter(keep=None)
            watchers = viewer.watchers
            before, started = processor_s(), time.perf_counter()
            figures = run.run()
            after, seconds = processor_s(), time.perf_counter() - started
        viewer.close()
    rate, latency = processed.figures()
    shown_rate, shown = viewer.meter.figures()
    return {
        "size": [width, height],
        "codec": codec,
        "browsers": watchers,
        "load_before": load,
        "processor_ms_per_s": {name: round(1000 * (after[name] - before[name]) / seconds) for name in after},
        "arrived": figures.arrived,
        "dropped": figures.dropped,
        "rate_hz": round(rate, 2),
        "latency_ms_median_p95": list(np.round(1000 * np.array(latency), 1)),
        "drawn": viewer.meter.count,
        "drawn_hz": round(shown_rate, 2),
        "drawn_latency_ms_median_p95": list(np.round(1000 * np.array(shown), 1)),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument(
        "--codec", choices=("h264", "ffv1"), default="h264", help="as cameras write, or lossless"
    )
    parser.add_argument("--rate", type=int, default=30, help="frames a second")
    parser.add_argument("--shadows", choices=[method.value for method in ShadowMethod], default="none")
    parser.add_argument("--browser", action="store_true")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    found = measure(
        width, height, arguments.seconds, arguments.codec, arguments.browser, arguments.rate,
        ShadowMethod(arguments.shadows),
    )  # fmt: skip
    text = json.dumps(found, indent=2)
    print(text)
    if arguments.out is not None:
        arguments.out.write_text(text + "\n")


if __name__ == "__main__":
    main()

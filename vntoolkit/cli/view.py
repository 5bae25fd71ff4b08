"""`vntoolkit view`: look at a reconstruction in a browser."""

import contextlib
from dataclasses import dataclass, field
from pathlib import Path

from vntoolkit.cli.output import PAGE, print_next, require_output, say
from vntoolkit.cli.verb import verb
from vntoolkit.options.base import File, OptionalFile, named
from vntoolkit.options.footage import ReadingLimits
from vntoolkit.options.pages import ScenePageOptions, ViewerOptions
from vntoolkit.options.shared import FrameOptions, MovedFootageOptions
from vntoolkit.pipeline.opened_result import OpenedResult, read_result
from vntoolkit.report.result_scene import ResultViewer, counted, write_scene


@dataclass(frozen=True, kw_only=True)
class ViewArguments(FrameOptions, MovedFootageOptions, ViewerOptions, ScenePageOptions, ReadingLimits):
    """What `view` takes."""

    folder: File = field(kw_only=False)
    """The folder that `vntoolkit reconstruct` wrote, tracked or not."""
    html: OptionalFile = named(None)
    """Write one self-contained page that opens offline, instead of serving."""


def _opened(asked: ViewArguments) -> OpenedResult:
    require_output(asked.html, PAGE)
    return read_result(asked.folder, frames=asked.frames, footage=asked.footage)


def _written(asked: ViewArguments, result: OpenedResult, html: Path) -> int:
    """Write the page; return how many frames it has."""
    scene = asked.part(ScenePageOptions)
    write_scene(html, result, scene)
    return min(len(result.numbers), scene.most_frames)


def _shown(asked: ViewArguments) -> None:
    """Serve until Ctrl-C, or print what was written."""
    result = _opened(asked)
    if asked.html is not None:
        count = _written(asked, result, asked.html)
        thinned = f" of {len(result.numbers)}, evenly spread" if count < len(result.numbers) else ""
        say(f"{asked.html}: {counted(count)}{thinned}; {asked.html.stat().st_size / 1e6:.1f} MB")
        print_next("report", str(asked.folder))
        return
    shown = ResultViewer(result, asked.part(ViewerOptions))
    say(f"{shown.address} (Ctrl-C ends)", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        shown.wait()
    shown.close()
    print_next("report", str(asked.folder))


@verb(ViewArguments, show=_shown)
def view(asked: ViewArguments) -> ResultViewer | Path:
    """Serve a page that shows a reconstruction: move through its frames, drag a light. Or write such a page.

    In Python the server is returned, of which `.address` is the page and `.close()` ends it; or the file.
    """
    result = _opened(asked)
    if asked.html is None:
        return ResultViewer(result, asked.part(ViewerOptions))
    _written(asked, result, asked.html)
    return asked.html

"""`vntoolkit view`: look at a reconstruction in a browser."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from vntoolkit.cli.output import PAGE, print_next, require_output, say
from vntoolkit.cli.verb import verb
from vntoolkit.options.base import File, OptionalFile, named
from vntoolkit.options.footage import ReadingLimits
from vntoolkit.options.pages import ScenePageOptions, ViewerOptions
from vntoolkit.options.shared import FrameOptions, MovedFootageOptions
from vntoolkit.pipeline.opened_result import read_result
from vntoolkit.report.result_scene import ResultViewer, counted, write_scene


@dataclass(frozen=True, kw_only=True)
class ViewArguments(FrameOptions, MovedFootageOptions, ViewerOptions, ScenePageOptions, ReadingLimits):
    """What `view` takes."""

    folder: File = field(kw_only=False)
    """The folder that `vntoolkit reconstruct` wrote, tracked or not."""
    html: OptionalFile = named(None)
    """Write one self-contained page that opens offline, instead of serving."""


def _shown(asked: ViewArguments, run: Callable[[ViewArguments], ResultViewer | Path]) -> None:
    """Serve until Ctrl-C, where no page was written."""
    shown = run(asked)
    if isinstance(shown, ResultViewer):
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
    require_output(asked.html, PAGE)
    result = read_result(asked.folder, frames=asked.frames, footage=asked.footage)
    if asked.html is None:
        return ResultViewer(result, asked.part(ViewerOptions))
    scene = asked.part(ScenePageOptions)
    write_scene(asked.html, result, scene)
    count, most = len(result.numbers), scene.most_frames
    thinned = f" of {count}, evenly spread" if most < count else ""
    say(f"{asked.html}: {counted(min(count, most))}{thinned}; {asked.html.stat().st_size / 1e6:.1f} MB")
    return asked.html

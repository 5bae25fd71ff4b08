"""`vntoolkit view`: look at a reconstruction in a browser."""

import contextlib
from pathlib import Path
from typing import Annotated

from vntoolkit.cli.flags import Flags, Footage, Frames, verb
from vntoolkit.cli.output import PAGE, print_next, progress_bar, require_output
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.options.pages import ScenePageOptions, ViewerOptions
from vntoolkit.pipeline.opened_result import open_result
from vntoolkit.report.result_scene import ResultViewer, counted, write_scene


@verb("max_megapixels", "max_vertices")
def view(
    folder: Path,
    *,
    frames: Frames = "::",
    footage: Footage = "",
    html: Path | None = None,
    viewer: Annotated[ViewerOptions | None, Flags()] = None,
    scene: Annotated[ScenePageOptions | None, Flags()] = None,
) -> None:
    """Serve a page on which one scrubs through a reconstruction and drags a light; or write one to keep.

    Parameters
    ----------
    folder
        The folder that `vntoolkit reconstruct` wrote, tracked or not.
    html
        Write one self-contained page that opens offline, instead of serving.
    """
    require_output(html, PAGE)
    result = open_result(folder, frames=FrameRange.from_text(frames), footage=footage)
    if html is not None:
        scene = scene or ScenePageOptions()
        count = min(len(result.numbers), scene.most_frames)
        with progress_bar("scene", count) as advance:
            write_scene(html, result, scene, on_frame=lambda: advance(1))
        thinned = f" of {len(result.numbers)}, evenly spread" if count < len(result.numbers) else ""
        print(f"{html}: {counted(count)}{thinned}; {html.stat().st_size / 1e6:.1f} MB")
        print_next("report", folder)
        return
    shown = ResultViewer(result, viewer)
    print(f"{shown.address} (Ctrl-C ends)", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        shown.wait()
    shown.close()
    print_next("report", folder)

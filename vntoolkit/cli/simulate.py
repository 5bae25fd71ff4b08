"""`vntoolkit simulate`: render a synthetic capture with ground truth."""

import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from vntoolkit.cli.flags import Flags, Frames, Jobs, Overwrite, verb
from vntoolkit.cli.output import ProgressBars, print_next
from vntoolkit.errors import BadInput
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.options.simulation import Nuisances, RenderOptions, SceneOptions
from vntoolkit.pipeline.simulate import SimulationFolder, SimulationJob
from vntoolkit.pipeline.simulate import simulate as run
from vntoolkit.simulation.scene import SCENES

_FLAGS = Flags(without=("width", "height"), renamed={"field_width_m": "field-width"})
_MOST_MEGAPIXELS = 200  # as readers take by default


@verb()
def simulate(
    scene: Annotated[str, Parameter(help=f"One of {', '.join(SCENES)}.")],
    *,
    out: Path,
    frames: Frames = "::",
    size: str = "640x480",
    motion: Path | None = None,
    jobs: Jobs = 1,
    overwrite: Overwrite = False,
    options: Annotated[SceneOptions | None, _FLAGS] = None,
    nuisances: Annotated[Nuisances | None, Flags()] = None,
    rendering: Annotated[RenderOptions | None, Flags(without=("threads",))] = None,
) -> None:
    """Render a synthetic scene under three coloured lights, with ground truth beside the video.

    The same command again continues an interrupted run.

    Parameters
    ----------
    out
        The folder to write: capture.mkv, truth, contact_sheet.png and simulation.json.
    size
        Image size in pixels, WIDTHxHEIGHT.
    motion
        A .npy file of vertices (frames, n, 3), metres in the camera frame, that replaces the scene's motion.
    overwrite
        Replace the capture that the folder holds.
    """
    width, height = _size(size)
    job = SimulationJob(
        scene=scene,
        folder=SimulationFolder(root=out),
        options=replace(options or SceneOptions(), width=width, height=height),
        nuisances=nuisances or Nuisances(),
        rendering=rendering or RenderOptions(),
        frames=FrameRange.from_text(frames),
        motion=motion,
    )
    with ProgressBars() as bars:
        summary = run(
            job, jobs=jobs, overwrite=overwrite, on_start=partial(bars.begin, "simulate"), on_frame=bars.step
        )
    print(f"{out}: {summary.frames} frames of {scene} in capture.mkv, {summary.rendered} rendered now")
    if scene in ("board", "sphere"):
        print_next("calibrate", scene, job.folder.video, "--out", "rig.json")
    elif scene == "gel":
        radius, pixel = (f"{job.built.facts[name]:g}" for name in ("ball_radius_mm", "pixel_mm"))
        ball = ("--ball-radius-mm", radius, "--pixel-mm", pixel)
        rest = out.with_name("rest") / "capture.mkv"
        if summary.frames == 1:
            print_next(
                "simulate", scene, "--out", out.with_name("presses"), "--frames", "1:25", "--size", size
            )
            return
        print_next("calibrate", "presses", job.folder.video, "--background", rest, *ball, "--out", "gel.json")
    else:
        print_next("reconstruct", job.folder.video, "--rig", "rig.json", "--out", "result")


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)[x×](\d+)", text.strip())
    if match is None:
        raise BadInput(f"size: expected WIDTHxHEIGHT such as 1280x720, got '{text}'")
    width, height = int(match[1]), int(match[2])
    if width * height > _MOST_MEGAPIXELS * 1e6:
        raise BadInput(f"size: expected at most {_MOST_MEGAPIXELS} megapixels, got {text}")
    return width, height

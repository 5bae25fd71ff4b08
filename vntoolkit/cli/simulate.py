"""`vntoolkit simulate`: render a synthetic capture with ground truth."""

import re
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

from vntoolkit.cli.output import print_next, say, unused
from vntoolkit.cli.verb import verb
from vntoolkit.errors import BadInput
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.options.base import File, OptionalFile, named
from vntoolkit.options.shared import FrameOptions, JobOptions
from vntoolkit.options.simulation import Nuisances, RenderOptions, SceneOptions
from vntoolkit.pipeline.simulate import SimulationFolder, SimulationJob
from vntoolkit.pipeline.simulate import simulate as run

_MOST_MEGAPIXELS = 200  # as readers take by default


@dataclass(frozen=True, kw_only=True)
class SimulateArguments(FrameOptions, SceneOptions, Nuisances, RenderOptions, JobOptions):
    """What `simulate` takes."""

    WITHOUT: ClassVar[tuple[str, ...]] = ("width", "height", "threads")

    scene: str = field(kw_only=False)
    """One of cylinder, board, board_sweep, sphere, gel, jacket, sweater, sweater_stripes, sweater_logo,
    sweater_tartan, spandex, head_turn, face, face_makeup."""
    out: File
    """The folder to write: capture.mkv, truth, contact_sheet.png and simulation.json."""
    size: str = "640x480"
    """Image size in pixels, WIDTHxHEIGHT."""
    motion: OptionalFile = named(None)
    """A .npy file of vertices (frames, n, 3), metres in the camera frame, that replaces the scene's
    motion."""
    overwrite: bool = False
    """Replace the capture that the folder holds."""


@verb(SimulateArguments)
def simulate(asked: SimulateArguments) -> Path:
    """Render a synthetic scene under three coloured lights, with ground truth beside the video.

    The same command again continues an interrupted run.
    """
    width, height = _size(asked.size)
    job = SimulationJob(
        scene=asked.scene,
        folder=SimulationFolder(root=Path(asked.out)),
        options=replace(asked.part(SceneOptions), width=width, height=height),
        nuisances=asked.part(Nuisances),
        rendering=asked.part(RenderOptions),
        frames=FrameRange.from_text(asked.frames or "::"),
        motion=asked.motion,
    )
    rendered = run(job, jobs=asked.jobs, overwrite=asked.overwrite)
    out, scene = Path(asked.out), asked.scene
    say(f"{out}: {len(job.numbers)} frames of {scene} in capture.mkv, {rendered} rendered now")
    video, own_rig = job.folder.video, job.folder.truth / "rig.json"
    if scene in ("board", "sphere"):
        print_next("calibrate", scene, video, "--out", "rig.json")
    elif scene == "board_sweep":
        print_next("calibrate", "board", video, "--degree", "2", "--out", "rig.json")
    elif scene == "head_turn":
        print_next("calibrate", "head", video, "--camera", own_rig, "--out", "rig.json")
    elif scene == "gel" and len(job.numbers) == 1:
        presses = out.with_name("presses")
        print_next("simulate", scene, "--out", presses, "--frames", "1:25", "--size", asked.size)
    elif scene == "gel":
        radius, pixel = (f"{job.built.facts[name]:g}" for name in ("ball_radius_mm", "pixel_mm"))
        ball = ("--ball-radius-mm", radius, "--pixel-mm", pixel)
        rest, earlier = (out.with_name(name) / "capture.mkv" for name in ("rest", "presses"))
        pressed = earlier if earlier.is_file() else video  # touches are filmed after the presses
        print_next("calibrate", "presses", pressed, "--background", rest, *ball, "--out", "gel.json")
    elif own_rig.is_file():
        print_next("reconstruct", video, "--rig", own_rig, "--out", unused("result"))
    else:  # under one lamp
        print_next("doctor", video)
    return out


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)[x×](\d+)", text.strip())
    if match is None:
        raise BadInput(f"size: expected WIDTHxHEIGHT such as 1280x720, got '{text}'")
    width, height = int(match[1]), int(match[2])
    if width * height > _MOST_MEGAPIXELS * 1e6:
        raise BadInput(f"size: expected at most {_MOST_MEGAPIXELS} megapixels, got {text}")
    return width, height

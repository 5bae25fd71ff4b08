"""The whole chain on simulated footage: render a board, calibrate, render a garment, reconstruct it.

What a user does with lamps and a camera of their own, in the same order and by the same functions.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.io.atomic import sole_writer
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.rigs import read_rig, write_rig
from vntoolkit.options.calibration import BoardOptions
from vntoolkit.options.reconstruction import ReconstructOptions
from vntoolkit.options.simulation import DemoOptions, SceneOptions
from vntoolkit.pipeline.block_work import ReconstructionJob
from vntoolkit.pipeline.calibrate import CalibrationJob, calibrate_board
from vntoolkit.pipeline.outputs import ReconstructionFolder
from vntoolkit.pipeline.processes import processes_kept
from vntoolkit.pipeline.reconstruct import ReconstructionSummary, reconstruct
from vntoolkit.pipeline.simulate import SimulationFolder, SimulationJob, simulate
from vntoolkit.simulation.lights import CAMERA_DISTANCE_M
from vntoolkit.simulation.scene import build_scene

_BOARD = "board_sweep"  # carried through the field, so that M is known all over it: the lights are near
_BOARD_STEP = 3  # of its 240 frames: neighbours show the same tilt
_DEGREE = 2  # of the polynomials by which M varies
_FIELD_WIDTH_M = 1.42  # one zoom for the board and the garment, as on a real set

Stage = Callable[[str, int, int], None]


@dataclass(frozen=True, kw_only=True)
class DemoFolder:
    """Where the demonstration's parts lie."""

    root: Path

    @property
    def board(self) -> Path:
        """The simulated footage of the calibration board."""
        return self.root / "board"

    @property
    def rig(self) -> Path:
        """The rig that was fitted to it."""
        return self.root / "rig.json"

    @property
    def garment(self) -> Path:
        """The simulated capture, with its truth."""
        return self.root / "sweater"

    @property
    def reconstruction(self) -> Path:
        """What was made of it."""
        return self.root / "reconstruction"


def run_demo(
    folder: DemoFolder,
    options: DemoOptions | None = None,
    *,
    jobs: int = 1,
    overwrite: bool = False,
    on_progress: Stage = lambda stage, done, total: None,
) -> ReconstructionSummary:
    """Simulate, calibrate, simulate, reconstruct; go on where an earlier run stopped.

    on_progress is told the stage's name, how many of its frames are done, and of how many.
    """
    options = options or DemoOptions()
    films = {
        "film the board": _film(_BOARD, folder.board, f"::{_BOARD_STEP}", options, sample="sweater"),
        "film the sweater": _film("sweater", folder.garment, f":{options.frames}", options),
    }
    with sole_writer(folder.root), processes_kept():
        for stage, job in films.items():
            count = _Counter(stage, on_progress)
            simulate(job, jobs=jobs, overwrite=overwrite, on_start=count.start, on_frame=count.advance)
            if job.scene == _BOARD:
                _calibrate(folder, on_progress)
        reconstruction = ReconstructionJob(
            source=str(SimulationFolder(root=folder.garment).video),
            rig=read_rig(folder.rig),
            options=ReconstructOptions(distance_m=CAMERA_DISTANCE_M),
            folder=ReconstructionFolder(root=folder.reconstruction),
        )
        count = _Counter("reconstruct", on_progress)
        return reconstruct(
            reconstruction, jobs=jobs, overwrite=overwrite, on_start=count.start, on_frame=count.advance
        )


def _film(
    scene: str, folder: Path, frames: str, options: DemoOptions, sample: str | None = None
) -> SimulationJob:
    return SimulationJob(
        scene=scene,
        folder=SimulationFolder(root=folder),
        options=SceneOptions(
            width=options.width, height=options.height, field_width_m=_FIELD_WIDTH_M, sample=sample
        ),
        frames=FrameRange.from_text(frames),
    )


def _calibrate(folder: DemoFolder, on_progress: Stage) -> None:
    facts = build_scene(_BOARD, SceneOptions(field_width_m=_FIELD_WIDTH_M)).facts  # a user measures the print
    layout = BoardLayout(
        columns=int(facts["columns"]),
        rows=int(facts["rows"]),
        square_mm=facts["square_mm"],
        hole_squares=int(facts["hole_squares"]),
    )
    job = CalibrationJob(source=str(SimulationFolder(root=folder.board).video))
    rig, _ = calibrate_board(
        job,
        layout,
        BoardOptions(degree=_DEGREE),
        lambda done, total: on_progress("calibrate", done, total),
    )
    write_rig(folder.rig, rig)


class _Counter:
    """Turns what the stages tell into (name, done, total)."""

    def __init__(self, stage: str, on_progress: Stage) -> None:
        self._stage, self._report = stage, on_progress
        self._done = self._total = 0

    def start(self, total: int, done: int) -> None:
        self._total, self._done = total, done
        self._report(self._stage, done, total)

    def advance(self, _finished: object) -> None:
        self._done += 1
        self._report(self._stage, self._done, self._total)

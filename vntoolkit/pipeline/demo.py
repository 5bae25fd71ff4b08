"""The whole chain on simulated footage: render a board, calibrate, render a garment, reconstruct it.

What a user does with lamps and a camera of their own, in the same order and by the same functions.
"""

from pathlib import Path

from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.results.folder import write_lock
from vntoolkit.io.results.manifest import ReconstructionFolder
from vntoolkit.io.rigs import read_rig, write_rig
from vntoolkit.options.calibration import BoardOptions
from vntoolkit.options.reconstruction import ReconstructOptions
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.pipeline.calibrate import CalibrationJob, calibrate_board
from vntoolkit.pipeline.reconstruct import ReconstructionSummary, reconstruct
from vntoolkit.pipeline.request import Request
from vntoolkit.pipeline.simulate import SimulationFolder, SimulationJob, simulate
from vntoolkit.simulation.lights import CAMERA_DISTANCE_M
from vntoolkit.simulation.scene import build_scene

_BOARD = "board_sweep"  # carried through the field, so that M is known all over it: the lights are near
_BOARD_STEP = 3  # of its 240 frames: neighbours show the same tilt
_DEGREE = 2  # of the polynomials by which M varies
_FIELD_WIDTH_M = 1.42  # one zoom for the board and the garment, as on a real set

# Where the parts lie: footage of the board, its rig, the garment's capture, and what was made of it.
BOARD, RIG, GARMENT, RECONSTRUCTION = "board", "rig.json", "sweater", "reconstruction"


def run_demo(root: Path, frames: int, *, jobs: int = 1, overwrite: bool = False) -> ReconstructionSummary:
    """Simulate, calibrate, simulate, reconstruct so many frames; go on where an earlier run stopped."""
    board = _film(_BOARD, root / BOARD, f"::{_BOARD_STEP}", sample="sweater")
    garment = _film("sweater", root / GARMENT, f":{frames}")
    with write_lock(root):
        simulate(board, jobs=jobs, overwrite=overwrite)
        _calibrate(board.folder.video, root / RIG)
        simulate(garment, jobs=jobs, overwrite=overwrite)
        reconstruction = Request(
            source=str(garment.folder.video),
            rig=read_rig(root / RIG),
            options=ReconstructOptions(distance_m=CAMERA_DISTANCE_M),
            folder=ReconstructionFolder(root=root / RECONSTRUCTION),
        )
        return reconstruct(reconstruction, jobs=jobs, overwrite=overwrite)


def _film(scene: str, folder: Path, frames: str, sample: str | None = None) -> SimulationJob:
    return SimulationJob(
        scene=scene,
        folder=SimulationFolder(root=folder),
        options=SceneOptions(field_width_m=_FIELD_WIDTH_M, sample=sample),
        frames=FrameRange.from_text(frames),
    )


def _calibrate(video: Path, out: Path) -> None:
    facts = build_scene(_BOARD, SceneOptions(field_width_m=_FIELD_WIDTH_M)).facts  # a user measures the print
    layout = BoardLayout(
        columns=int(facts["columns"]),
        rows=int(facts["rows"]),
        square_mm=facts["square_mm"],
        hole_squares=int(facts["hole_squares"]),
    )
    job = CalibrationJob(source=str(video))
    rig, _ = calibrate_board(job, layout, BoardOptions(degree=_DEGREE))
    write_rig(out, rig)

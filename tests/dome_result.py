"""A small result folder: a dome that moves, one frame of which is black and skipped; tracked."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from tests.pipeline.conftest import write_dome_capture
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.results.manifest import ReconstructionFolder
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import OnError, ReconstructOptions
from vntoolkit.options.tracking import TrackArguments
from vntoolkit.photometry.rig import FitQuality
from vntoolkit.pipeline.checkerboard import write_checkerboard
from vntoolkit.pipeline.reconstruct import reconstruct
from vntoolkit.pipeline.request import Request
from vntoolkit.pipeline.texture import write_texture
from vntoolkit.pipeline.track import track

HOSTILE = '<b>dome & "co"'
SKIPPED = 3


@dataclass(frozen=True)
class DomeResult:
    folder: Path
    footage: Path


@pytest.fixture(scope="session")
def dome_result(tmp_path_factory: pytest.TempPathFactory) -> DomeResult:
    root = tmp_path_factory.mktemp("result")
    footage = root / HOSTILE
    footage.mkdir()
    capture = write_dome_capture(footage, count=6)
    write_png(footage / f"f{SKIPPED}.png", np.zeros((48, 64, 3), np.uint16))
    quality = FitQuality(method="sphere", residual_deg=0.4, condition_number=3.1, samples=900, cone_deg=61.0)
    job = Request(
        source=str(footage),
        rig=replace(capture.rig, quality=quality),
        options=ReconstructOptions(shadows=ShadowMethod.ROBUST, on_error=OnError.SKIP),
        folder=ReconstructionFolder(root=root / "out"),
    )
    reconstruct(job)
    track(TrackArguments(root / "out"))
    write_checkerboard(root / "out")
    write_texture(root / "out")
    return DomeResult(folder=root / "out", footage=footage)

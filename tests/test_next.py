"""Each command that a verb prints as the next one runs as printed, in the folder where it was printed.

The folder holds what a user would have filmed: board.mkv, capture.mkv (a sweater), touch.mkv and presses of
a gel, stills under one lamp each, all small. A chain begins with one command. Each printed next command
follows, until that verb has run after that other verb before.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.cli.test_photometric_stereo_verb import photographs
from tests.readme_commands import Step, next_of, run_step
from tests.test_readme import film
from vntoolkit.cli import GROUPS

FILMED = {"board.mkv": ("board", "::15"), "capture.mkv": ("sweater", "0:3")}
GEL = "vntoolkit simulate gel --size 160x120 --samples 1"
CHAINS = (
    "board --out board.pdf --square-mm 15.9",
    "doctor capture.mkv",
    "simulate sphere --out ball --frames 0:1",
    "simulate sweater --out scene --frames 0:2 --size 160x120",
    "simulate gel --out rest --frames 0:1 --size 160x120 --samples 1",
    "photometric-stereo stills --lights stills/lights.txt --out stereo",
    "evaluate mesh result/mesh/000001.ply result/mesh/000000.ply --out compared",
    "evaluate normals scene/truth/normals scene/truth/normals --out errors",
    "export result --to glb",
    "data walk.bvh",
)


@pytest.fixture(scope="module")
def studio(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("next")
    for name, (scene, frames) in FILMED.items():
        film(folder, name, scene, frames)
    run_step(Step("sh", f"{GEL} --out .gel --frames 37:39", 0), folder)
    (folder / ".gel" / "capture.mkv").rename(folder / "touch.mkv")
    photographs(folder / "stills", np.random.default_rng(7))
    return folder


@pytest.mark.slow
def test_every_printed_next_command_runs(studio: Path) -> None:
    seen: set[tuple[str, str]] = set()
    for first in CHAINS:
        before, waiting = first, [Step("sh", f"vntoolkit {first}", 0)]
        while waiting:
            step = waiting.pop()
            words = step.text.split()
            verb = " ".join(words[1:3]) if words[1] in GROUPS else words[1]
            if (before, verb) in seen:
                break
            seen.add((before, verb))
            before, waiting = verb, next_of(run_step(step, studio))
    verbs = {verb.split()[0] for _, verb in seen}
    assert {"calibrate", "reconstruct", "view", "report", "track", "dress", "integrate"} <= verbs

"""Each command that a verb prints as the next one runs as printed, in the folder where it was printed.

The folder holds the films of `studio`, and stills under one lamp each. A chain begins with one command. Each
printed next command follows, until that verb has run after that other verb before.
"""

from pathlib import Path

import numpy as np
import pytest

from tests.cli.test_photometric_stereo_verb import photographs
from tests.readme_commands import Step, next_of, run_step
from vntoolkit.cli import GROUPS

CHAINS = (
    "board --out board.pdf --square-mm 15.9",
    "doctor capture.mkv",
    "simulate sphere --out ball --frames 0:1",
    "simulate sweater --out scene --frames 0:2 --size 160x120",
    "simulate gel --out rest --frames 0:1 --size 320x240 --samples 1",
    "photometric-stereo stills --lights stills/lights.txt --out stereo",
    "evaluate mesh result/mesh/000001.ply result/mesh/000000.ply --out compared",
    "evaluate normals scene/truth/normals scene/truth/normals --out errors",
    "export result --to glb",
    "data walk.bvh",
)


@pytest.mark.slow
def test_every_printed_next_command_runs(studio: Path) -> None:
    photographs(studio / "stills", np.random.default_rng(7))
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

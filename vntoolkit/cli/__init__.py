"""Floor 4, the command line: a verb's file is imported only when the verb is called.

A verb reads its options (the frozen dataclasses of the stages), calls `pipeline`, `live`, `report` or a
stage, and prints what it wrote. It contains no algorithm.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Any

from cyclopts import App, Parameter

from vntoolkit import __version__
from vntoolkit.cli.flags import require_finite, require_new_outputs

# verb -> (where it lives, the line that `vntoolkit --help` shows)
VERBS: dict[str, tuple[str, str]] = {
    "demo": ("vntoolkit.cli.demo:demo", "Run the whole chain on a simulated capture and write a report."),
    "rectify": (
        "vntoolkit.cli.calibrate:rectify",
        "Resample footage of a tilted plane to square pixels.",
    ),
    "circles": (
        "vntoolkit.cli.circles:circles",
        "Find the contact circles of presses of a tactile gel, and correct them.",
    ),
    "board": ("vntoolkit.cli.board:board", "Write the calibration board as a PDF, to scale."),
    "simulate": (
        "vntoolkit.cli.simulate:simulate",
        "Simulate a capture with ground truth.",
    ),
    "doctor": (
        "vntoolkit.cli.doctor:doctor",
        "Check the libraries, or check footage for faults that spoil normals.",
    ),
    "schema": ("vntoolkit.cli.schema:schema", "Print the JSON schema of rig.json or reconstruction.json."),
    "data": ("vntoolkit.cli.schema:data", "Copy a file that the package ships, such as walk.bvh."),
    "reconstruct": (
        "vntoolkit.cli.reconstruct:reconstruct",
        "Compute normals, depth and meshes from footage and a rig.",
    ),
    "track": ("vntoolkit.cli.track:track", "Register all frames of a reconstruction to one mesh."),
    "session": (
        "vntoolkit.cli.session:session",
        "Reconstruct and track many captures, on one machine or several.",
    ),
    "view": (
        "vntoolkit.cli.view:view",
        "Show results in a browser, or write them as one HTML page.",
    ),
    "export": (
        "vntoolkit.cli.export:export",
        "Convert results to PLY, OBJ, USD, GLB, NPZ or DiLiGenT's format.",
    ),
    "report": (
        "vntoolkit.cli.report:report",
        "Write an HTML report on the quality of a reconstruction.",
    ),
    "live": ("vntoolkit.cli.live:live", "Show normals and the surface of a camera live."),
    "dress": ("vntoolkit.cli.dress:run", "Put a tracked garment on a skeleton animated by motion capture."),
}

GROUPS: dict[str, tuple[str, dict[str, tuple[str, str]]]] = {
    "calibrate": (
        "Fit a rig (camera and light response) to footage of a calibration object.",
        {
            "sphere": ("vntoolkit.cli.calibrate:sphere", "Calibrate on a matte ball of the material."),
            "board": (
                "vntoolkit.cli.calibrate:board",
                "Calibrate on the printed board with the material in its hole.",
            ),
            "head": (
                "vntoolkit.cli.calibrate:head",
                "Calibrate on a bare head that turns left and right.",
            ),
            "lights": ("vntoolkit.cli.calibrate:lights", "Compute a rig from known light directions."),
            "presses": (
                "vntoolkit.cli.calibrate:presses",
                "Calibrate a tactile sensor on a ball pressed into its gel.",
            ),
        },
    ),
    "recipe": (
        "Reproduce the paper's figures and tables.",
        {
            "list": ("vntoolkit.cli.recipe:list_", "List the recipes."),
            "run": (
                "vntoolkit.cli.recipe:run",
                "Run one recipe or all; list each number beside the paper's.",
            ),
        },
    ),
    "evaluate": (
        "Compare results with ground truth.",
        {
            "normals": (
                "vntoolkit.cli.evaluate:normals",
                "Measure the angles between normal maps.",
            ),
            "mesh": (
                "vntoolkit.cli.evaluate:mesh",
                "Measure the distances between two meshes, and their quality.",
            ),
            "cylinder": (
                "vntoolkit.cli.evaluate:cylinder",
                "Compare the normals of a cylinder with one fitted cylinder.",
            ),
            "tracks": ("vntoolkit.cli.evaluate:tracks", "Compare tracked vertices with the simulator's."),
            "integration": (
                "vntoolkit.cli.evaluate:integration",
                "Measure every integrator on surfaces of known depth.",
            ),
        },
    ),
}


# What `--help` ends with: a call that works on one's own files.
EXAMPLES: dict[str, str] = {
    "demo": "vntoolkit demo --out demo",
    "rectify": "vntoolkit rectify presses --corners 12 9 308 11 4 231 316 229 --size-mm 18.6 14.3 "
    "--pixel-mm 0.03 --out flat",
    "circles": "vntoolkit circles presses --background gel.png --out labels",
    "board": "vntoolkit board --out board.pdf",
    "simulate": "vntoolkit simulate sweater --out sweater --frames 0:10",
    "doctor": "vntoolkit doctor capture.mkv --rig rig.json",
    "schema": "vntoolkit schema rig",
    "data": "vntoolkit data walk.bvh",
    "reconstruct": "vntoolkit reconstruct capture.mkv --rig rig.json --out result --distance 5",
    "track": "vntoolkit track result",
    "session": "vntoolkit session take1.mkv take2.mkv --rig rig.json --out day --track",
    "view": "vntoolkit view result",
    "export": "vntoolkit export result --to usd --units cm",
    "report": "vntoolkit report result",
    "live": "vntoolkit live --camera 0 --rig rig.json",
    "dress": "vntoolkit dress result/track --motion data/walk.bvh --out cloth.usdc",
    "calibrate sphere": "vntoolkit calibrate sphere ball.mkv --out rig.json",
    "calibrate board": "vntoolkit calibrate board board.mkv --square-mm 15.9 --out rig.json",
    "calibrate head": "vntoolkit calibrate head turn.mkv --out rig.json --report head.html",
    "calibrate lights": "vntoolkit calibrate lights lamps.txt --like capture.mkv --out rig.json",
    "calibrate presses": "vntoolkit calibrate presses presses --background gel.png --labels labels "
    "--ball-radius-mm 2 --pixel-mm 0.03 --out gel.json",
    "recipe list": "vntoolkit recipe list",
    "recipe run": "vntoolkit recipe run figure02 --quick",
    "evaluate normals": "vntoolkit evaluate normals result/normals truth/normals",
    "evaluate mesh": "vntoolkit evaluate mesh result/mesh/000000.ply scan.ply",
    "evaluate cylinder": "vntoolkit evaluate cylinder result",
    "evaluate tracks": "vntoolkit evaluate tracks result --truth sweater",
    "evaluate integration": "vntoolkit evaluate integration --out evaluation",
}


def build_app(arguments: Sequence[str] = ()) -> App:
    """Register every verb by name; nothing but cyclopts is imported.

    arguments: the typed words. The verb that they name shows its whole docstring as help; the others show
    one line each.
    """
    app = App(
        name="vntoolkit",
        help="Normals, depth and moving meshes from video under three coloured lights.",
        version=__version__,
        help_format="markdown",
        default_parameter=Parameter(show_default=_shown_default, validator=require_finite),
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
        suppress_keyboard_interrupt=False,  # `main` prints how to continue
    )
    for verb, (target, line) in VERBS.items():
        app.command(target, name=verb, help=None if arguments[:1] == [verb] else line, **_epilogue(verb))
    for group, (line, verbs) in GROUPS.items():
        sub = App(name=group, help=line, help_format="markdown", version_flags=())
        for verb, (target, verb_line) in verbs.items():
            help_line = None if arguments[:2] == [group, verb] else verb_line
            sub.command(target, name=verb, help=help_line, **_epilogue(f"{group} {verb}"))
        app.command(sub)
    return app


def run_verb(arguments: Sequence[str]) -> Any:
    """Run what was typed, once it is sure that no output is an input; return what the verb does."""
    app = build_app(arguments)
    verb, bound, _ = app.parse_args(arguments, exit_on_error=False, print_error=False)
    require_new_outputs(bound)
    return verb(*bound.args, **bound.kwargs)


def _epilogue(verb: str) -> dict[str, str]:
    return {"help_epilogue": f"Example: `{EXAMPLES[verb]}`"}


def _shown_default(value: Any) -> str | None:
    """Return the text of a default in `--help`; None for empty defaults."""
    if value is None or value is False or value in ("", ()):
        return None
    if isinstance(value, Enum):
        return value.name.lower().replace("_", "-")
    return str(value)

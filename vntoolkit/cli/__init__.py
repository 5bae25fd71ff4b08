"""Floor 4, the command line: a verb's file is imported only when the verb is called.

A verb is one typed function (`verb.py`): its argument class, composed of the option classes, is the command
line and the Python call. It calls `pipeline`, `live`, `report` or a stage, says what came of it, and returns
it. Only where it is typed as a command is that printed. It contains no algorithm.
"""

import math
from collections.abc import Sequence
from enum import Enum
from typing import Any

from cyclopts import App, Parameter

from vntoolkit import __version__
from vntoolkit.cli.removed import require_no_removed

# verb -> the line that `vntoolkit --help` shows
VERBS: dict[str, str] = {
    "demo": "Run the whole chain on a simulated capture and write a report.",
    "rectify": "Resample footage of a tilted plane to square pixels.",
    "board": "Write the calibration board as a PDF, to scale.",
    "simulate": "Simulate a capture with ground truth.",
    "doctor": "Check the libraries, or check footage for faults that spoil normals.",
    "schema": "Print the JSON schema of rig.json or reconstruction.json.",
    "data": "Copy a file that the package ships, such as walk.bvh.",
    "reconstruct": "Compute normals, depth and meshes from footage and a rig.",
    "photometric-stereo": "Compute normals from photographs under one lamp each.",
    "integrate": "Compute depth and meshes from anyone's normal maps.",
    "track": "Register all frames of a reconstruction to one mesh.",
    "session": "Reconstruct and track many captures, on one machine or several.",
    "view": "Show results in a browser, or write them as one HTML page.",
    "export": "Convert results to PLY, OBJ, USD, GLB, NPZ or DiLiGenT's format.",
    "report": "Write an HTML report on the quality of a reconstruction.",
    "live": "Show normals and the surface of a camera live.",
    "dress": "Put a tracked garment on a skeleton animated by motion capture.",
    "calibrate sphere": "Calibrate on a matte ball of the material.",
    "calibrate board": "Calibrate on the printed board with the material in its hole.",
    "calibrate head": "Calibrate on a bare head that turns left and right.",
    "calibrate lights": "Compute a rig from known light directions.",
    "calibrate presses": "Calibrate a tactile sensor on a ball pressed into its gel.",
    "recipe list": "List the recipes.",
    "recipe run": "Run one recipe or all; list each number beside the paper's.",
    "evaluate normals": "Measure the angles between normal maps.",
    "evaluate mesh": "Measure the distances between two meshes, and their quality.",
    "evaluate cylinder": "Compare the normals of a cylinder with one fitted cylinder.",
    "evaluate tracks": "Compare tracked vertices with the simulator's.",
    "evaluate integration": "Measure every integrator on surfaces of known depth.",
}

GROUPS: dict[str, str] = {
    "calibrate": "Fit a rig (camera and light response) to footage of a calibration object.",
    "recipe": "Reproduce the paper's figures and tables.",
    "evaluate": "Compare results with ground truth.",
}

# verb -> the function that is its call from Python, where it is not of the verb's name; "file:name": a
# command of its own
_FUNCTIONS: dict[str, str] = {
    "board": "write_board",
    "doctor": "inspect_footage",
    "schema": "schema:schema_command",
    "data": "schema:data_command",
    "live": "watch",
    "report": "write_report",
    "recipe list": "recipe:list_command",
    "recipe run": "recipe:run_command",
    "evaluate normals": "evaluate_normal_files",
}

# What `--help` ends with: a call that works on one's own files.
EXAMPLES: dict[str, str] = {
    "demo": "vntoolkit demo --out demo",
    "rectify": "vntoolkit rectify presses --corners 12 9 308 11 4 231 316 229 --size-mm 18.6 14.3 "
    "--pixel-mm 0.03 --out flat",
    "board": "vntoolkit board --out board.pdf",
    "simulate": "vntoolkit simulate sweater --out sweater --frames 0:10",
    "doctor": "vntoolkit doctor capture.mkv --rig rig.json",
    "schema": "vntoolkit schema rig",
    "data": "vntoolkit data walk.bvh",
    "reconstruct": "vntoolkit reconstruct capture.mkv --rig rig.json --out result --distance 5",
    "photometric-stereo": "vntoolkit photometric-stereo photographs --lights lights.txt --out solved",
    "integrate": "vntoolkit integrate normals.png --out result --focal-px 1200",
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
    "calibrate presses": "vntoolkit calibrate presses presses --background gel.png --overlay circles.png "
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
        default_parameter=Parameter(show_default=shown_default, validator=require_finite),
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
        suppress_keyboard_interrupt=False,  # `main` prints how to continue
    )
    groups = {
        group: App(name=group, help=line, help_format="markdown", version_flags=())
        for group, line in GROUPS.items()
    }
    for verb, line in VERBS.items():
        *group, name = verb.split()
        function = _FUNCTIONS.get(verb, verb.replace(" ", "_").replace("-", "_"))
        target = f"vntoolkit.cli.{function}" if ":" in function else f"vntoolkit.cli.verb:{function}"
        shown = None if list(arguments[: len(group) + 1]) == verb.split() else line
        parent = groups[group[0]] if group else app
        parent.command(target, name=name, help=shown, help_epilogue=f"Example: `{EXAMPLES[verb]}`")
    for sub in groups.values():
        app.command(sub)
    return app


def run_verb(arguments: Sequence[str]) -> Any:
    """Run what was typed; return what the command does. A flag that was removed is answered by a line."""
    require_no_removed(*arguments)
    command, bound, _ = build_app(arguments).parse_args(arguments, exit_on_error=False, print_error=False)
    return command(*bound.args, **bound.kwargs)


def require_finite(_kind: Any, value: Any) -> None:
    """Refuse NaN and infinity in every flag."""
    numbers = value if isinstance(value, tuple | list) else (value,)
    if any(isinstance(number, float) and not math.isfinite(number) for number in numbers):
        raise ValueError("Expected a finite number.")


def shown_default(value: Any) -> str | None:
    """Return the text of a default in `--help`; None for empty defaults."""
    if value is None or value is False or value in ("", ()):
        return None
    if value == "::":
        return "all"  # frames
    if isinstance(value, Enum):
        return value.name.lower().replace("_", "-")
    return str(value)

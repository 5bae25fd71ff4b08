"""Floor 4, the command line: one file a verb, imported only when its verb is called.

A verb parses its options (the frozen dataclasses of the stages), calls `pipeline`, `report` or a stage,
and says what it wrote. No algorithm lives here.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Any

from cyclopts import App, Parameter

from vntoolkit import __version__
from vntoolkit.cli.flags import require_finite

# verb -> (where it lives, the line that `vntoolkit --help` shows)
VERBS: dict[str, tuple[str, str]] = {
    "demo": ("vntoolkit.cli.demo:demo", "Do the whole job on synthetic footage, and show it on a page."),
    "rectify": (
        "vntoolkit.cli.calibrate:rectify",
        "Resample footage of a plane seen at an angle onto square pixels.",
    ),
    "board": ("vntoolkit.cli.board:board", "Draw the calibration board, printed to scale."),
    "simulate": (
        "vntoolkit.cli.simulate:simulate",
        "Film a synthetic scene, with everything true beside the video.",
    ),
    "doctor": (
        "vntoolkit.cli.doctor:doctor",
        "Check the libraries, or say what in this footage will ruin normals.",
    ),
    "schema": ("vntoolkit.cli.schema:schema", "Print the JSON schema of rig.json or reconstruction.json."),
    "reconstruct": (
        "vntoolkit.cli.reconstruct:reconstruct",
        "Turn footage and a rig into normals, depth and meshes.",
    ),
    "track": ("vntoolkit.cli.track:track", "Follow one surface through a reconstruction's frames."),
    "session": (
        "vntoolkit.cli.session:session",
        "Reconstruct and track all captures of a session, on this machine or on many.",
    ),
    "view": (
        "vntoolkit.cli.view:view",
        "Look at results in a browser, or write a page that shows them offline.",
    ),
    "export": ("vntoolkit.cli.export:export", "Hand results on as PLY, OBJ, USD, GLB, NPZ or DiLiGenT's."),
    "report": (
        "vntoolkit.cli.report:report",
        "Write one page that tells whether a reconstruction can be trusted.",
    ),
    "live": ("vntoolkit.cli.live:live", "Watch normals and the surface while filming."),
    "dress": ("vntoolkit.cli.dress:run", "Put a tracked garment on a figure that motion capture moves."),
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
            "lights": ("vntoolkit.cli.calibrate:lights", "Make a rig from lights that are known."),
            "presses": (
                "vntoolkit.cli.calibrate:presses",
                "Calibrate a tactile sensor on a ball pressed into its gel.",
            ),
        },
    ),
    "recipe": (
        "Reproduce the paper's figures and tables.",
        {
            "list": ("vntoolkit.cli.recipe:list_", "Name the recipes."),
            "run": ("vntoolkit.cli.recipe:run", "Run one, or all, and show every number beside the paper's."),
        },
    ),
    "evaluate": (
        "Compare results with the truth.",
        {
            "normals": (
                "vntoolkit.cli.evaluate:normals",
                "Angles between two normal maps, or folders of them.",
            ),
            "mesh": (
                "vntoolkit.cli.evaluate:mesh",
                "Distances between two meshes both ways, and their quality.",
            ),
            "cylinder": (
                "vntoolkit.cli.evaluate:cylinder",
                "A moving cylinder's normals against one fitted cylinder.",
            ),
            "tracks": ("vntoolkit.cli.evaluate:tracks", "Tracked vertices against the simulator's."),
            "integration": (
                "vntoolkit.cli.evaluate:integration",
                "The integrators on surfaces whose depth is known.",
            ),
        },
    ),
}


def build_app(arguments: Sequence[str] = ()) -> App:
    """Register every verb by name; nothing but cyclopts is imported.

    arguments: what was typed. The verb that it names explains itself by its whole docstring; the others
    stand in a list, with their line.
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
        suppress_keyboard_interrupt=False,  # else no sentence says how to go on
    )
    for verb, (target, line) in VERBS.items():
        app.command(target, name=verb, help=None if arguments[:1] == [verb] else line)
    for group, (line, verbs) in GROUPS.items():
        sub = App(name=group, help=line, help_format="markdown", version_flags=())
        for verb, (target, verb_line) in verbs.items():
            sub.command(target, name=verb, help=None if arguments[:2] == [group, verb] else verb_line)
        app.command(sub)
    return app


def _shown_default(value: Any) -> str | None:
    """Return how `--help` shows a default; None where it would say nothing."""
    if value is None or value is False or value in ("", ()):
        return None
    if isinstance(value, Enum):
        return value.name.lower().replace("_", "-")
    return str(value)

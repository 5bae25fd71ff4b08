"""Imports go strictly down the floors that CONTRIBUTING.md shows, and no stage imports another stage.

Floors, from the ground: 0 foundations; 1 the objects that flow; 1.8 options; 2 the stages; 2.5 diagnosis; 3
pipeline; 3.5 report; 3.7 live; 4 the command line. A file may import from lower floors and from its own room
only. `DOORS` lists, for each third-party library, the rooms and files that may import it.

`LINES` and `CLOSURES` are budgets. They are lowered as rooms shrink. A budget is raised in a commit of its
own that says why.
"""

import ast
import collections
import json
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "vntoolkit"

# A room may import rooms with lower numbers, and itself.
FLOORS = {
    "threads": 0, "arrays": 0, "errors": 0.1, "shipped": 0.2, "checks": 0.2, "native": 0.3, "libraries": 0.3,
    "progress": 0, "spread": 0.1, "display": 0.3, "solvers": 0.4, "geometry": 1, "photometry": 1.5,
    "options": 1.8, "io": 2, "calibration": 2, "materials": 2, "simulation": 2, "normals": 2, "shadows": 2,
    "integration": 2, "inspection": 2, "meshing": 2, "tactile": 2, "tracking": 2, "skinning": 2,
    "evaluation": 2, "diagnosis": 2.5, "pipeline": 3, "report": 3.5, "live": 3.7,
    "cli": 4, "__main__": 5,
}  # fmt: skip

# Library -> prefixes of the files that may import it; a library that is not listed may be imported anywhere.
DOORS = {
    "pycolmap": ("calibration/head",),
    "pymeshlab": ("geometry/", "evaluation/", "meshing/", "libraries.py"),
    "open3d": (
        "geometry/",
        "calibration/head",
        "simulation/",
        "meshing/",
        "tracking/",
        "report/",
        "io/maps_and_meshes/",
        "libraries.py",
    ),
    "cv2": (
        "io/",
        "diagnosis/",
        "live/",
        "calibration/",
        "normals/frame_evidence",
        "report/mesh_views",
        "tracking/",
        "shadows/",
        "simulation/",
        "tactile/",
        "native.py",
    ),
    "av": ("io/", "live/"),
    "mcap": ("io/recordings/",),
    "mcap_ros2": ("io/recordings/",),
    "rerun": ("io/recordings/",),
    "OpenEXR": ("io/",),
    "pxr": ("io/",),
    "pydantic": ("io/",),
    "jinja2": ("report/", "live/"),
    "matplotlib": ("report/",),
    "reportlab": ("io/",),
    "surfalize": ("inspection/",),
    "dask": ("pipeline",),
    "distributed": ("pipeline",),
    "cyclopts": ("cli/", "__main__.py"),
    "rich": ("cli/", "__main__.py"),
}

# Room -> most lines of all its files; "(root)" holds the files beside the rooms.
LINES = {
    "(root)": 1540,
    "calibration": 4700,
    "cli": 3040,
    "diagnosis": 4080,
    "evaluation": 1080,
    "geometry": 1800,
    "inspection": 240,
    "integration": 2010,
    "io": 8640,
    "live": 900,
    "materials": 2860,
    "meshing": 380,
    "normals": 1380,
    "options": 1440,
    "photometry": 1040,
    "pipeline": 7750,
    "report": 3130,
    "shadows": 2330,
    "simulation": 3500,
    "skinning": 1980,
    "tactile": 1990,
    "tracking": 3110,
}

# Verb -> most modules of the package, and most lines of them, that are loaded before its function runs.
CLOSURES = {
    "reconstruct": (61, 7_980),
    "track": (89, 12_120),
    "export": (51, 6_700),
    "view": (57, 7_370),
    "report": (53, 6_780),
    "integrate": (80, 11_660),
    "dress": (93, 14_230),
    "simulate": (79, 11_190),
    "doctor": (29, 3_650),
    "board": (29, 3_410),
    "schema": (24, 2_820),
}

# The same of `reconstruct --shadows none --materials calibrated` when it has run.
PLAIN_RUN = (118, 19_600)

FILES = sorted(PACKAGE.rglob("*.py"))


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports_of(tree: ast.AST) -> list[str]:
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            names.append(node.module or "")
            if names[-1].split(".")[0] in ("vntoolkit", "numba"):
                names += [f"{node.module}.{alias.name}" for alias in node.names]
    return [name for name in names if name != "vntoolkit.__version__"]


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_go_down_and_use_their_doors(path: Path) -> None:
    here = room_of(path)
    relative = path.relative_to(PACKAGE).as_posix()
    for name in imports_of(ast.parse(path.read_text())):
        top, *rest = name.split(".")
        if top == "vntoolkit" and rest and here != "__init__":
            there = rest[0]
            assert there in FLOORS, f"{relative} imports {name}, which has no floor"
            assert there == here or FLOORS[there] < FLOORS[here], f"{relative} must not import {name}"
        elif top in DOORS:
            assert relative.startswith(DOORS[top]), f"{relative} must not import {top}"
        assert name != "numba.njit", f"{relative}: kernels are made by native.njit, whose cache may fail"


def test_every_room_has_a_floor() -> None:
    assert {room_of(path) for path in FILES} - {"__init__"} <= set(FLOORS)


def test_no_files_import_each_other_in_a_circle() -> None:
    """Each is understood without the others: what only types need counts, what functions import does not."""
    modules = {
        ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"): path
        for path in FILES
    }
    waiting = {}
    for name, path in modules.items():
        top = [node for node in ast.parse(path.read_text()).body if not isinstance(node, ast.FunctionDef)]
        found = set(imports_of(ast.Module(body=top, type_ignores=[])))
        waiting[name] = found & set(modules) - {name, "vntoolkit"}
    while ready := {name for name, needs in waiting.items() if not needs & set(waiting)}:
        waiting = {name: needs for name, needs in waiting.items() if name not in ready}
    assert not waiting, f"these import each other: {sorted(waiting)}"


def test_no_room_outgrows_its_lines() -> None:
    rooms: collections.Counter[str] = collections.Counter()
    for path in FILES:
        within = len(path.relative_to(PACKAGE).parts) > 1
        rooms[room_of(path) if within else "(root)"] += path.read_text().count("\n")
    over = {room: lines for room, lines in rooms.items() if lines > LINES.get(room, 0)}
    assert not over, f"more lines than LINES allows: {over}"


# Each verb has a process of its own; libraries are not counted, so all of them get those of their parent.
_LOAD = """
import json, os, sys
import cv2, cyclopts, numba, numpy, pydantic, scipy.ndimage, scipy.sparse.linalg, scipy.spatial

for verb in sys.argv[1:]:
    if os.fork():
        assert os.wait()[1] == 0, verb
        continue
    from vntoolkit.cli import build_app

    app = build_app()
    for word in verb.split():
        app = app[word]
    app.default_command  # imports the verb's module
    files = [getattr(module, "__file__", None) for name, module in sys.modules.items()
             if name.split(".")[0] == "vntoolkit"]
    print(json.dumps([verb, [file for file in files if file]]), flush=True)
    os._exit(0)
"""


@pytest.fixture(scope="module")
def loaded() -> dict[str, list[str]]:
    command = [sys.executable, "-c", _LOAD, *CLOSURES]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return dict(map(json.loads, said.splitlines()))


@pytest.mark.parametrize("verb", CLOSURES)
def test_no_verb_loads_more_than_its_closure(verb: str, loaded: dict[str, list[str]]) -> None:
    """A verb is understood by reading what it loads."""
    files = loaded[verb]
    lines = sum(Path(file).read_text().count("\n") for file in files)
    most_files, most_lines = CLOSURES[verb]
    assert len(files) <= most_files
    assert lines <= most_lines


_RUN = """
import json, sys
from vntoolkit.__main__ import main

assert main(sys.argv[1:]) == 0
files = [getattr(module, "__file__", None) for name, module in sys.modules.items()
         if name.split(".")[0] == "vntoolkit"]
print(json.dumps([file for file in files if file]))
"""


@pytest.mark.slow
def test_a_plain_run_loads_no_more_than_its_closure(tmp_path: Path) -> None:
    """Checks of the footage, depth and meshes included; shadows, materials and other formats left out."""

    def run(*words: str) -> str:
        command = [sys.executable, "-c", _RUN, *words]
        return subprocess.run(command, check=True, capture_output=True, text=True, cwd=tmp_path).stdout

    run("simulate", "sweater", "--out", "cap", "--frames", "0:2", "--size", "160x120")
    plain = ("--shadows", "none", "--materials", "calibrated")
    said = run("reconstruct", "cap/capture.mkv", "--rig", "cap/truth/rig.json", "--out", "out", *plain)
    files = json.loads(said.splitlines()[-1])
    lines = sum(Path(file).read_text().count("\n") for file in files)
    most_files, most_lines = PLAIN_RUN
    assert len(files) <= most_files
    assert lines <= most_lines


def test_options_name_no_algorithm() -> None:
    """They are imported without any stage: compiled loops and solvers stay unloaded."""
    loaded = "import vntoolkit.options.reconstruction, sys; print(*sys.modules)"
    names = subprocess.run(
        [sys.executable, "-c", loaded], check=True, capture_output=True, text=True
    ).stdout.split()
    rooms = {name.split(".")[1] for name in names if name.startswith("vntoolkit.")}
    assert rooms <= {"arrays", "checks", "errors", "geometry", "options", "photometry"}

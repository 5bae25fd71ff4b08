"""What `import vntoolkit` offers: complete, lazy, known to type checkers, and changed on purpose only."""

import ast
import dataclasses
import importlib
import importlib.util
import inspect
import subprocess
import sys
import typing
from enum import Enum
from pathlib import Path

import pytest

import vntoolkit
from vntoolkit.errors import BadInput
from vntoolkit.options import base

SNAPSHOT = Path(__file__).with_name("public_names.txt")
SOURCE = Path(vntoolkit.__file__).read_text(encoding="utf-8")
WRONG = """\
import vntoolkit as vt

rig = vt.read_rig("rig.json")
for frame in vt.open_capture("capture.mkv").frames(0, 1):
    normals = vt.normals_from_frame(frame, rig.response)
    depth = vt.DepthIntegrator(rig.camera).integrate(normals)
    print(depth.dpeth)
    print(normals.normals)
x: int = vt.read_rigg("rig.json")
vt.IntegrationOptions(integrator="poisson")
vt.IntegrationOptions(integrator="poison")
vt.reconstruct("capture.mkv", rig="rig.json", out="result", shaddows="none")
vt.IntegrationOptions(tolerance=(1e-5, 1e-6))
print(vt.read_result("result").normals("3"))
"""
MISTAKES = {7, 8, 9, 11, 12, 13, 14}  # lines


def described(name: str) -> str:
    """A line on a public name: the parameters of a call, the members of an enum."""
    thing = getattr(vntoolkit, name)
    if isinstance(thing, type) and issubclass(thing, Enum):
        return f"{name}: {', '.join(map(base.name_of, thing))}"
    if isinstance(thing, type) and issubclass(thing, Exception):
        return f"{name}: error"
    if not callable(thing):
        return f"{name}: {type(thing).__name__}"
    words, before = [], inspect.Parameter.POSITIONAL_OR_KEYWORD
    for parameter in inspect.signature(thing).parameters.values():
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY is not before:
            words.append("*")
        before = parameter.kind
        words.append(parameter.name + _default(parameter.default))
    return f"{name}({', '.join(words)})"


def _default(value: object) -> str:
    if value is inspect.Parameter.empty:
        return ""
    if isinstance(value, Enum):
        return f"={base.name_of(value)}"
    return f"={value!r}" if isinstance(value, str | int | float | tuple | None) else "=…"


def test_the_public_names_and_their_parameters_are_those_of_the_snapshot() -> None:
    """A change is meant: `python -m tests.test_public_names` writes the snapshot anew."""
    assert "\n".join(map(described, vntoolkit.__all__)) + "\n" == SNAPSHOT.read_text(encoding="utf-8")


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'nothing_of_the_kind'"):
        vntoolkit.nothing_of_the_kind  # noqa: B018


def test_importing_the_package_imports_no_stage() -> None:
    assert importlib.util.find_spec("vntoolkit.integration") is not None
    assert "\nfrom vntoolkit" not in SOURCE


def test_type_checkers_know_the_names_that_there_are() -> None:
    stated = {
        alias.asname: node.module
        for node in ast.walk(ast.parse(SOURCE))
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("vntoolkit.")
        for alias in node.names
    }
    assert stated == vntoolkit._PUBLIC


@pytest.mark.slow
def test_a_type_checker_finds_every_mistake_and_no_other(tmp_path: Path) -> None:
    script = tmp_path / "user.py"
    script.write_text(WRONG)
    command = [
        sys.executable,
        "-m",
        "mypy",
        "--cache-dir",
        str(tmp_path / "cache"),
        "--follow-imports=silent",
    ]
    said = subprocess.run([*command, str(script)], capture_output=True, text=True, check=False).stdout
    found = {int(line.split(":")[1]) for line in said.splitlines() if line.startswith(str(script))}
    assert found == MISTAKES, said


def test_a_method_may_be_given_by_its_name() -> None:
    options = vntoolkit.ReconstructOptions(shadows="none", materials="calibrated", to="depth")
    assert options.shadows is vntoolkit.ShadowMethod.NONE
    assert options.materials is vntoolkit.MaterialSearch.CALIBRATED
    assert (
        vntoolkit.TrackingOptions(method="laplacian_previous").method is vntoolkit.Tracker.LAPLACIAN_PREVIOUS
    )
    with pytest.raises(BadInput, match=r"integrator: expected one of fourier, cosine, .*, got 'poison'"):
        vntoolkit.IntegrationOptions(integrator="poison")


OPTIONS = sorted(Path(base.__file__).parent.glob("[a-z]*.py"))


@pytest.mark.parametrize("path", OPTIONS, ids=lambda path: path.stem)
def test_the_stated_names_are_those_of_the_members(path: Path) -> None:
    """A type checker refuses a name that no member has, and takes each that one has."""
    names = vars(importlib.import_module(f"vntoolkit.options.{path.stem}"))
    for kind in [thing for thing in names.values() if dataclasses.is_dataclass(thing)]:
        for hint in typing.get_type_hints(kind).values():
            enums = [h for h in typing.get_args(hint) if isinstance(h, type) and issubclass(h, Enum)]
            stated = [
                typing.get_args(h) for h in typing.get_args(hint) if typing.get_origin(h) is typing.Literal
            ]
            if stated:
                assert [tuple(map(base.name_of, enum)) for enum in enums] == stated, kind


if __name__ == "__main__":
    SNAPSHOT.write_text("\n".join(map(described, vntoolkit.__all__)) + "\n", encoding="utf-8")

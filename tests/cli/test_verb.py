"""A verb is made of its argument class: the fields are its flags, the docstrings beneath them its help."""

import dataclasses
from typing import ClassVar

import pytest
from cyclopts import App

from vntoolkit.cli import VERBS, build_app
from vntoolkit.cli.verb import command, meanings_of_fields, verb
from vntoolkit.errors import BadInput
from vntoolkit.options.base import File, Named, OptionalFile, Options, named
from vntoolkit.options.footage import Gaps, GapsName


@dataclasses.dataclass(frozen=True, kw_only=True)
class Size(Options):
    """How large."""

    size_mm: float = 2.0
    """Its width, in millimetres."""
    hidden: int = 7
    """Not for users."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class DrawArguments(Size):
    """What `draw` takes."""

    WITHOUT: ClassVar[tuple[str, ...]] = ("hidden",)

    names: tuple[str, ...] = dataclasses.field(kw_only=False)
    """What is drawn."""
    out: File
    """Where."""
    gaps: Named[Gaps, GapsName] = named(Gaps.REFUSE)
    """What is done at a gap."""
    mask: OptionalFile = named(None)
    """Where the subject is."""


@verb(DrawArguments)
def draw(asked: DrawArguments) -> DrawArguments:
    """Draw."""
    return asked


def test_the_flags_make_the_same_as_the_call(capsys: pytest.CaptureFixture[str]) -> None:
    app = App(result_action="return_value")
    app.default(command(draw))
    typed = app(["a", "b", "--out", "o", "--size-mm", "3", "--gaps", "skip", "--mask", "m.png"])
    assert typed == draw(("a", "b"), out="o", size_mm=3, gaps="skip", mask="m.png")
    assert typed.part(Size) == Size(size_mm=3.0)
    assert typed.out.name == "o"
    app(["--help"])
    shown = capsys.readouterr().out
    assert "Its width, in millimetres." in shown
    assert "--hidden" not in shown


def test_an_undocumented_field_is_refused() -> None:
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class Silent(Options):
        """Says nothing."""

        volume: int = 0

    with pytest.raises(KeyError, match="no docstring beneath volume"):
        meanings_of_fields(Silent)


def test_a_verb_writes_over_nothing_that_it_reads(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.png").write_text("")
    with pytest.raises(
        BadInput, match=r"m\.png: would be written over, but mask reads it; choose another --out"
    ):
        draw(("a",), out="m.png", mask="m.png")


@pytest.mark.parametrize("name", VERBS)
def test_every_flag_of_every_verb_has_its_help(name: str) -> None:
    app = build_app(name.split())
    for word in name.split():
        app = app[word]
    arguments = app.assemble_argument_collection(parse_docstring=True)
    silent = [each.name for each in arguments if not each.parameter.help]
    assert not silent

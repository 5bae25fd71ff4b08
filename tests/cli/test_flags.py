import pickle
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated

import pytest
from cyclopts import App

from vntoolkit.cli.flags import Flags, meanings_of_fields, verb
from vntoolkit.options.reconstruction import Product, ReconstructOptions


class Kind(Enum):
    ROUND = "round"
    SQUARE = "square"


@dataclass(frozen=True, kw_only=True)
class Shape:
    """A shape."""

    size_mm: float = 2.0
    """Its width, in millimetres."""
    kind: Kind = Kind.ROUND
    """Which kind."""
    first: int = 1
    """The first."""
    second: int = 2
    """The second."""


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """A drawing."""

    title: str = ""
    """Above it."""
    shape: Shape = field(default_factory=Shape)


def test_the_docstring_becomes_the_help_and_the_class_the_value(capsys: pytest.CaptureFixture[str]) -> None:
    app = App(result_action="return_value")

    @verb()
    def draw(
        *, drawing: Annotated[Drawing | None, Flags(without=("second",), renamed={"first": "number"})] = None
    ) -> Drawing | None:
        return drawing

    app.default(draw)
    made = app(["--size-mm", "3", "--kind", "square", "--number", "7"])
    assert isinstance(made, Drawing)
    shape = made.shape
    assert (made.title, shape.size_mm, shape.kind, shape.first, shape.second) == ("", 3.0, Kind.SQUARE, 7, 2)
    assert app(["--title", "A"]).shape.size_mm == 2.0
    assert app([]) is None  # the verb then takes the defaults of the class
    app(["--help"])
    shown = capsys.readouterr().out
    assert "Its width, in millimetres" in shown
    assert "--second" not in shown


def test_an_undocumented_field_is_refused() -> None:
    @dataclass
    class Silent:
        """Says nothing."""

        volume: int = 0

    with pytest.raises(KeyError, match="no docstring beneath volume"):
        meanings_of_fields(Silent)


def test_the_options_of_the_pipeline_are_documented() -> None:
    assert {"to", "distance_m", "materials", "on_error"} <= set(meanings_of_fields(ReconstructOptions))


def test_options_from_flags_go_to_another_process_as_the_stages_own() -> None:
    app = App(result_action="return_value")

    @verb()
    def draw(*, options: Annotated[ReconstructOptions | None, Flags()] = None) -> ReconstructOptions | None:
        return options

    app.default(draw)
    again = pickle.loads(pickle.dumps(app(["--to", "normals"])))
    assert type(again) is ReconstructOptions
    assert again == ReconstructOptions(to=Product.NORMALS)

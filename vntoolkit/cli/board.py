"""`vntoolkit board`: write the calibration board as a PDF."""

from dataclasses import dataclass
from pathlib import Path

from vntoolkit.cli.output import print_next, say
from vntoolkit.cli.verb import verb
from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.io.board_pdf import write_board_pdf
from vntoolkit.options.base import File, Named, Options, named
from vntoolkit.options.pages import PageSize, PageSizeName


@dataclass(frozen=True, kw_only=True)
class WriteBoardArguments(Options, BoardLayout):
    """What `write_board` takes."""

    out: File
    """The PDF to write."""
    page: Named[PageSize, PageSizeName] = named(PageSize.A4)
    """Size of the paper."""


@verb(WriteBoardArguments)
def write_board(asked: WriteBoardArguments) -> Path:
    """Draw the calibration board to scale, with a scale bar and instructions."""
    out = Path(asked.out)
    write_board_pdf(out, asked.part(BoardLayout), asked.page)
    say(
        f"{out}: {asked.columns} × {asked.rows} squares of {asked.square_mm:g} mm on {asked.page.name}; "
        "print at 100 % and measure the scale bar"
    )
    print_next("calibrate", "board", "board.mkv", "--square-mm", f"{asked.square_mm:g}", "--out", "rig.json")
    return out

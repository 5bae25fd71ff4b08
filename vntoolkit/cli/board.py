"""`vntoolkit board`: write the calibration board as a PDF."""

from pathlib import Path
from typing import Annotated

from vntoolkit.cli.flags import Flags, verb
from vntoolkit.cli.output import print_next
from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.io.board_pdf import write_board_pdf
from vntoolkit.options.pages import PageSize


@verb()
def board(
    *, out: Path, page: PageSize = PageSize.A4, layout: Annotated[BoardLayout | None, Flags()] = None
) -> None:
    """Draw the calibration board to scale, with a scale bar and instructions.

    Parameters
    ----------
    out
        The PDF to write.
    page
        Size of the paper.
    """
    drawn = layout or BoardLayout()
    write_board_pdf(out, drawn, page)
    print(
        f"{out}: {drawn.columns} × {drawn.rows} squares of {drawn.square_mm:g} mm on {page.name}; "
        "print at 100 % and measure the scale bar"
    )
    print_next("calibrate", "board", "board.mkv", "--square-mm", f"{drawn.square_mm:g}", "--out", "rig.json")

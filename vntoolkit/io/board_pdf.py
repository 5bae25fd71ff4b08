"""The calibration board as a PDF page, drawn to scale."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from vntoolkit.errors import BadInput
from vntoolkit.geometry.board_layout import MARKER_DICTIONARY, BoardLayout
from vntoolkit.io.atomic import atomic_path
from vntoolkit.options.pages import PageSize

_CELLS = 6  # a 4×4 marker with its black border
_MARGIN_MM = 10.0  # what printers cannot reach
_SCALE_BAR_MM = 100.0
_TEXT_HEIGHT_MM = 24.0
_HAIRLINE_MM = 0.14


def write_board_pdf(path: Path | str, layout: BoardLayout, page: PageSize = PageSize.A4) -> None:
    """Draw the board in the middle of a page, with a scale bar and instructions.

    Raises `BadInput` where the board does not fit on the page, `CannotWrite` where the file cannot be made.
    """
    if Path(path).suffix.lower() != ".pdf":
        raise BadInput(f"{path}: the board is drawn as .pdf, not '{Path(path).suffix}'")
    width, height = page.value
    if layout.width_mm > width - 2 * _MARGIN_MM or layout.height_mm > height - 2 * _TEXT_HEIGHT_MM:
        raise BadInput(
            f"board of {layout.width_mm:g} × {layout.height_mm:g} mm does not fit on {page.name} "
            f"({width:g} × {height:g} mm) with margins; use smaller squares or a larger page"
        )
    from reportlab.lib.units import mm
    from reportlab.pdfgen import canvas

    with atomic_path(path) as temporary:
        sheet = canvas.Canvas(str(temporary), pagesize=(width * mm, height * mm), invariant=1)
        sheet.setTitle("vntoolkit calibration board")
        _write_text(sheet, layout, width, height)
        # from here on in the board frame: millimetres, y down
        sheet.translate((width - layout.width_mm) / 2 * mm, (height + layout.height_mm) / 2 * mm)
        sheet.scale(mm, -mm)
        _draw_board(sheet, layout)
        sheet.save()


def _draw_board(sheet: Any, layout: BoardLayout) -> None:
    side = layout.square_mm
    sheet.setFillGray(0.0)
    for row in range(layout.rows):
        for column in range(layout.columns):
            if (row + column) % 2 == 0 and not layout.in_hole([column, row]):
                sheet.rect(column * side, row * side, side, side, stroke=0, fill=1)
    for marker in layout.sound_marker_ids:
        _draw_marker(sheet, int(marker), layout)
    if layout.hole_squares:
        sheet.setStrokeGray(0.5)
        sheet.setLineWidth(_HAIRLINE_MM)
        sheet.rect(*layout.hole_mm[0], layout.hole_squares * side, layout.hole_squares * side)


def _draw_marker(sheet: Any, marker: int, layout: BoardLayout) -> None:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, MARKER_DICTIONARY))
    bits = dictionary.generateImageMarker(marker, _CELLS, borderBits=1)
    cell = layout.marker_mm / _CELLS
    border = (layout.square_mm - layout.marker_mm) / 2
    x, y = layout.marker_squares[marker] * layout.square_mm + border
    sheet.setFillGray(0.0)
    sheet.rect(x, y, layout.marker_mm, layout.marker_mm, stroke=0, fill=1)
    sheet.setFillGray(1.0)
    for v, u in np.argwhere(bits):
        sheet.rect(x + u * cell, y + v * cell, cell, cell, stroke=0, fill=1)


def _write_text(sheet: Any, layout: BoardLayout, width: float, height: float) -> None:
    from reportlab.lib.units import mm

    left, right = (width - _SCALE_BAR_MM) / 2 * mm, (width + _SCALE_BAR_MM) / 2 * mm
    bottom, middle = (height - layout.height_mm) / 2, width / 2 * mm
    sheet.setLineWidth(0.6)
    y = (bottom - 10.0) * mm
    sheet.line(left, y, right, y)
    for x in (left, middle, right):
        sheet.line(x, y - 1.5 * mm, x, y + 1.5 * mm)
    sheet.setFont("Helvetica", 9)
    measure = f"{_SCALE_BAR_MM:g} mm: measure it; print at 100 %, not fitted to the page"
    sheet.drawCentredString(middle, y - 6.0 * mm, measure)
    lines = [
        f"vntoolkit board: {layout.columns} × {layout.rows} squares of {layout.square_mm:g} mm, hole of "
        f"{layout.hole_squares} × {layout.hole_squares} squares",
        "Glue flat on a stiff board, cut out along the grey line, fix the material behind the hole, flush.",
        "Film it tilted by 30 degrees and more in all directions, under the lights of the capture.",
    ]
    if not layout.hole_squares:
        lines = [lines[0].split(", hole")[0], *lines[2:]]
    for i, line in enumerate(lines):
        sheet.drawCentredString(middle, (height - bottom + 16.0 - 5.0 * i) * mm, line)

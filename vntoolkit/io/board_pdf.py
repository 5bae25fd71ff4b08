"""The calibration board as a PDF page, drawn to scale."""

from pathlib import Path
from typing import Any

import cv2

from vntoolkit.errors import BadInput
from vntoolkit.geometry.board_layout import MARKER_DICTIONARY, BoardLayout
from vntoolkit.io.atomic import atomic_path
from vntoolkit.options.pages import PageSize

_CELLS = 6  # a 4×4 marker with its black border
_MARGIN_MM = 10.0  # what printers cannot reach
_SCALE_BAR_MM = 100.0
_TEXT_HEIGHT_MM = 24.0


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
    from reportlab.pdfgen import canvas

    with atomic_path(path) as temporary:
        sheet = canvas.Canvas(str(temporary), pagesize=(_points(width), _points(height)), invariant=1)
        sheet.setTitle("vntoolkit calibration board")
        left, top = (width - layout.width_mm) / 2, (height + layout.height_mm) / 2
        _Pen(sheet, left, top).board(layout)
        _write_text(sheet, layout, width, height)
        sheet.save()


class _Pen:
    """Draws in the board frame (millimetres, y down) on a page whose y goes up."""

    def __init__(self, sheet: Any, left_mm: float, top_mm: float) -> None:
        self.sheet, self.left, self.top = sheet, left_mm, top_mm

    def square(self, x_mm: float, y_mm: float, side_mm: float, *, fill: int, stroke: int = 0) -> None:
        self.sheet.rect(
            _points(self.left + x_mm),
            _points(self.top - y_mm - side_mm),
            _points(side_mm),
            _points(side_mm),
            fill=fill,
            stroke=stroke,
        )

    def board(self, layout: BoardLayout) -> None:
        side = layout.square_mm
        self.sheet.setFillGray(0.0)
        for row in range(layout.rows):
            for column in range(layout.columns):
                if (row + column) % 2 == 0 and not layout.in_hole([column, row]):
                    self.square(column * side, row * side, side, fill=1)
        for marker in layout.sound_marker_ids:
            self.marker(int(marker), layout)
        if layout.hole_squares:
            x, y = layout.hole_mm[0]
            self.sheet.setStrokeGray(0.5)
            self.sheet.setLineWidth(0.4)
            self.square(x, y, layout.hole_squares * side, fill=0, stroke=1)

    def marker(self, marker: int, layout: BoardLayout) -> None:
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, MARKER_DICTIONARY))
        bits = dictionary.generateImageMarker(marker, _CELLS, borderBits=1)
        cell = layout.marker_mm / _CELLS
        border = (layout.square_mm - layout.marker_mm) / 2
        column, row = layout.marker_squares[marker]
        x, y = column * layout.square_mm + border, row * layout.square_mm + border
        self.sheet.setFillGray(0.0)
        self.square(x, y, layout.marker_mm, fill=1)
        self.sheet.setFillGray(1.0)
        for v in range(_CELLS):
            for u in range(_CELLS):
                if bits[v, u]:
                    self.square(x + u * cell, y + v * cell, cell, fill=1)
        self.sheet.setFillGray(0.0)


def _write_text(sheet: Any, layout: BoardLayout, width: float, height: float) -> None:
    left = (width - _SCALE_BAR_MM) / 2
    bottom = (height - layout.height_mm) / 2
    sheet.setFillGray(0.0)
    sheet.setStrokeGray(0.0)
    sheet.setLineWidth(0.6)
    y = bottom - 10.0
    sheet.line(_points(left), _points(y), _points(left + _SCALE_BAR_MM), _points(y))
    for x in (left, left + _SCALE_BAR_MM / 2, left + _SCALE_BAR_MM):
        sheet.line(_points(x), _points(y - 1.5), _points(x), _points(y + 1.5))
    sheet.setFont("Helvetica", 9)
    middle = _points(width / 2)
    sheet.drawCentredString(
        middle, _points(y - 6.0), f"{_SCALE_BAR_MM:g} mm: measure it; print at 100 %, not fitted to the page"
    )
    lines = [
        f"vntoolkit board: {layout.columns} × {layout.rows} squares of {layout.square_mm:g} mm, hole of "
        f"{layout.hole_squares} × {layout.hole_squares} squares",
        "Glue flat on a stiff board, cut out along the grey line, fix the material behind the hole, flush.",
        "Film it tilted by 30 degrees and more in all directions, under the lights of the capture.",
    ]
    if not layout.hole_squares:
        lines = [lines[0].split(", hole")[0], *lines[2:]]
    for i, line in enumerate(lines):
        sheet.drawCentredString(middle, _points(height - bottom + 16.0 - 5.0 * i), line)


def _points(mm: float) -> float:
    return mm * 72.0 / 25.4

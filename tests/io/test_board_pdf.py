"""The printed board has the millimetres it promises."""

import re
import zlib
from base64 import a85decode

import numpy as np
import pytest

from vntoolkit.errors import BadInput, CannotWrite
from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.io.board_pdf import write_board_pdf
from vntoolkit.options.pages import PageSize


def rectangles_mm(path):
    """The filled rectangles (x, y, width, height) of the page, in millimetres."""
    content = b""
    for stream in re.findall(rb"stream\r?\n(.*?)endstream", path.read_bytes(), re.S):
        try:
            content += zlib.decompress(a85decode(stream.strip(), adobe=stream.strip().startswith(b"<~")))
        except (ValueError, zlib.error):
            content += zlib.decompress(a85decode(stream.strip().removesuffix(b"~>")))
    found = re.findall(rb"([-\d.]+) ([-\d.]+) ([-\d.]+) ([-\d.]+) re f\*?", content)
    across, down, *origin = re.findall(rb"([-\d.]+) 0 0 (-[\d.]+) ([-\d.]+) ([-\d.]+) cm", content)[0]
    sizes = np.array(found, dtype=float) * np.array([across, down] * 2, dtype=float)
    sizes[:, :2] += np.array(origin, dtype=float)
    return sizes * 25.4 / 72


def test_squares_and_markers_are_to_scale(tmp_path) -> None:
    layout = BoardLayout(square_mm=14.0)
    write_board_pdf(tmp_path / "board.pdf", layout, PageSize.LETTER)
    boxes = rectangles_mm(tmp_path / "board.pdf")
    squares = boxes[np.abs(boxes[:, 2] - 14.0) < 1e-3]
    markers = boxes[np.abs(boxes[:, 2] - layout.marker_mm) < 1e-3]
    assert len(squares) == 61 - 13
    assert len(markers) == len(layout.sound_marker_ids) == 60 - 12
    assert np.ptp(squares[:, 0]) + 14.0 == pytest.approx(layout.width_mm, abs=1e-3)
    middle = [boxes[:, 0].min() + layout.width_mm / 2, boxes[:, 1].max() - layout.height_mm / 2]
    np.testing.assert_allclose(middle, np.array(PageSize.LETTER.value) / 2, atol=1e-3)


def test_two_boards_of_one_layout_are_the_same_bytes(tmp_path) -> None:
    write_board_pdf(tmp_path / "a.pdf", BoardLayout())
    write_board_pdf(tmp_path / "b.pdf", BoardLayout())
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes()


def test_refusals(tmp_path) -> None:
    with pytest.raises(BadInput, match="does not fit on A4"):
        write_board_pdf(tmp_path / "board.pdf", BoardLayout(square_mm=25.0))
    assert not (tmp_path / "board.pdf").exists()
    with pytest.raises(CannotWrite):
        write_board_pdf("/proc/board.pdf", BoardLayout())


@pytest.mark.parametrize(
    ("sizes", "line"),
    [
        ({"square_mm": float("inf")}, "positive size in mm, got inf"),
        ({"hole_squares": -3}, "got -3; 0 for none"),
    ],
)
def test_layouts_of_no_paper_are_refused(sizes, line) -> None:
    with pytest.raises(BadInput, match=line):
        BoardLayout(**sizes)

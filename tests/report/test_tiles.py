"""Pictures under headings: each stands where it should, unchanged; the scale says what its colours mean."""

from pathlib import Path

import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.io.footage.images import read_image
from vntoolkit.report.pictures import ErrorScale, _letters, picture_of_errors, tiled, write_tiles


def plain(height: int, width: int, *colour: int) -> np.ndarray:
    return np.full((height, width, 3), colour, np.uint8)


def where(picture: np.ndarray, colour: tuple[int, int, int]) -> tuple[int, int, int, int]:
    """Top, left, height, width of the box around a colour."""
    v, u = np.nonzero((picture == colour).all(axis=2))
    return int(v.min()), int(u.min()), int(np.ptp(v)) + 1, int(np.ptp(u)) + 1


def test_pictures_stand_in_columns_below_their_headings() -> None:
    rows = [
        {"left": plain(40, 60, 250, 0, 1), "right": plain(40, 90, 0, 250, 2)},
        {"left": plain(40, 60, 0, 3, 250), "right": plain(40, 90, 4, 120, 120)},
    ]
    picture = tiled(rows, ["one", "two"])
    boxes = [where(picture, c) for c in ((250, 0, 1), (0, 250, 2), (0, 3, 250), (4, 120, 120))]
    assert [box[2:] for box in boxes] == [(40, 60), (40, 90)] * 2
    assert boxes[0][1] == boxes[2][1] == 0
    assert boxes[1][1] == boxes[3][1] > 60
    assert boxes[0][0] == boxes[1][0] > 2 * 20  # a name and a heading above
    assert boxes[2][0] - (boxes[0][0] + 40) == 24 + 2 * 8  # a name alone: the headings are the same
    changed = tiled([rows[0], {"other": rows[1]["left"]}])
    assert where(changed, (0, 3, 250))[0] > where(changed, (250, 0, 1))[0] + 40 + 20


def test_errors_are_told_apart_and_the_scale_shows_their_colours(tmp_path: Path) -> None:
    scale = ErrorScale(most=40.0)
    errors = np.tile(np.linspace(0, 80, 81), (30, 1))
    compared = np.ones(errors.shape, dtype=bool)
    compared[:5] = False
    map_ = picture_of_errors(errors, compared, scale)
    assert (map_[:5] == 255).all()
    light = map_[10].astype(float) @ [0.3, 0.6, 0.1]
    assert (np.diff(light[:41:4]) > 0).all()  # brighter is worse, in grey print too
    assert (map_[10, 40:] == map_[10, 40]).all()
    write_tiles(
        tmp_path / "a.png", [{"angle": np.repeat(map_, 8, axis=1)}], scale=scale, legend={"none": "#123456"}
    )
    picture = read_image(tmp_path / "a.png")
    below = picture[24 + 30 + 8 :]
    assert where(below, (0x12, 0x34, 0x56))[2:] == (11, 11)
    bar = below[-12]
    assert (bar == map_[10, 20]).all(axis=1).any()  # the middle of the scale
    assert (bar == map_[10, 0]).all(axis=1).any()


@pytest.mark.parametrize("shape", [(5, 7), (300, 1), (1, 60)])
def test_a_scale_has_room_beneath_the_smallest_picture(shape: tuple[int, int]) -> None:
    scale = ErrorScale(most=40.0)
    picture = tiled([{"a": plain(*shape, 250, 0, 1)}], scale=scale, legend={"none": "#123456"})
    assert where(picture, (250, 0, 1))[2:] == shape
    ends = picture_of_errors(np.array([[0.0, 40.0]]), np.ones((1, 2), dtype=bool), scale)[0]
    first, last = (where(picture, tuple(end.tolist()))[1] for end in ends)
    assert 60 < first < last - 60


def test_refusals() -> None:
    with pytest.raises(BadInput, match="a name for every row"):
        tiled([{"a": plain(4, 4, 0, 0, 0)}], ["one", "two"])


def test_signs_and_the_letters_of_file_names_are_drawn_not_boxes() -> None:
    letters = _letters(12.0)
    box = bytes(letters.getmask("\uffff"))
    assert all(bytes(letters.getmask(each)) != box for each in "≥≤°×αЖé")

"""Known lights: both layouts are read into the camera frame; damage is named."""

import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.io.light_files import read_lights


def test_text_file_with_a_count(tmp_path) -> None:
    path = tmp_path / "lights.txt"
    path.write_text("2\n0.4 0.5 0.8\n# a remark\n-0.1 0.2 0.9\n")
    lights = read_lights(path)
    np.testing.assert_allclose(lights.directions, [[0.4, -0.5, -0.8], [-0.1, -0.2, -0.9]])
    assert lights.intensities is None


def test_text_file_with_colours(tmp_path) -> None:
    path = tmp_path / "lights.txt"
    path.write_text("0,0,1, 1,0.1,0\n1,0,1, 0,1,0.2\n")
    np.testing.assert_allclose(read_lights(path).intensities, [[1, 0.1, 0], [0, 1, 0.2]])


def test_diligent_folder(tmp_path) -> None:
    (tmp_path / "light_directions.txt").write_text("0 0 1\n0 0.6 0.8\n0.6 0 0.8\n")
    (tmp_path / "light_intensities.txt").write_text("1 2 3\n4 5 6\n7 8 9\n")
    (tmp_path / "filenames.txt").write_text("001.png\n002.png\n003.png\n")
    lights = read_lights(tmp_path)
    np.testing.assert_allclose(lights.directions[1], [0, -0.6, -0.8])
    np.testing.assert_allclose(lights.intensities[2], [7, 8, 9])
    assert [path.name for path in lights.images] == ["001.png", "002.png", "003.png"]
    assert len(lights.files) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("3\n0 0 1\n", "promises 3 lights, holds 1"),
        ("0 0 1\n0 1\n", "line 2 holds 2 numbers"),
        ("0 0 1\nnorth\n", "line 2 is not a row of numbers"),
        ("0 0\n0 1\n", "expected 3 or 6 numbers"),
        ("# nothing\n", "holds no light"),
        ("0 0 nan\n", "NaN"),
    ],
)
def test_damaged_files_are_refused(tmp_path, text, message) -> None:
    path = tmp_path / "lights.txt"
    path.write_text(text)
    with pytest.raises(BadInput, match=message):
        read_lights(path)


def test_folder_whose_files_disagree_is_refused(tmp_path) -> None:
    (tmp_path / "light_directions.txt").write_text("0 0 1\n0 0.6 0.8\n")
    (tmp_path / "filenames.txt").write_text("001.png\n")
    with pytest.raises(BadInput, match="names 1 images for 2"):
        read_lights(tmp_path)

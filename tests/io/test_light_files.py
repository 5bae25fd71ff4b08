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
    ("files", "line"),
    [
        ({"lights.txt": "3\n0 0 1\n"}, "promises 3 lights, holds 1"),
        ({"lights.txt": "0 0 1\n0 1\n"}, "line 2 holds 2 numbers, those before 3"),
        ({"lights.txt": "0 0 1\nnorth\n"}, "line 2 is not a row of numbers"),
        ({"lights.txt": "0 0\n0 1\n"}, "expected 3 or 6 numbers"),
        ({"lights.txt": "# nothing\n"}, "holds no light; expected x y z"),
        ({"lights.txt": "0 0 nan\n"}, "holds NaN or infinity"),
        ({"light_directions.txt": "0 1\n1 0\n"}, "expected 3 numbers a light, got 2"),
        ({"light_directions.txt": "0 0 1\n", "light_intensities.txt": "1 1\n"},
         "holds 1 rows of 2, expected 1"),
        ({"light_directions.txt": "0 0 1\n", "filenames.txt": "a\nb"},
         "names 2 images for 1 light directions"),
    ],
)  # fmt: skip
def test_damaged_files_are_refused(tmp_path, files, line) -> None:
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(BadInput, match=line):
        read_lights(tmp_path / "lights.txt" if "lights.txt" in files else tmp_path)

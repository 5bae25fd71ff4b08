"""The shipped shapes: what the script makes, small, packed with the package, and refused where damaged."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from recipes import scene_shapes
from vntoolkit import shipped
from vntoolkit.errors import BadInput
from vntoolkit.simulation import shapes
from vntoolkit.simulation.shapes import read_shape

ROOT = Path(__file__).parents[2]
NAMES = ("head", "legs", "sweater")


@pytest.mark.slow
def test_the_script_still_makes_the_shapes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene_shapes.main(tmp_path)
    assert sorted(path.stem for path in tmp_path.iterdir()) == sorted(NAMES)
    for name in NAMES:
        shape = read_shape(name)
        monkeypatch.setattr(shapes, "shipped_file", lambda path: tmp_path / Path(path).name)
        made = read_shape(name)
        monkeypatch.undo()
        assert sorted(made) == sorted(shape)
        np.testing.assert_array_equal(made["faces"], shape["faces"])
        for key, values in made.items():
            # 1e-3 cm, below which no shift is kept, and 2 of 65535 levels: another library's rounding
            atol = 2 if key.startswith("colours") else 1.1e-3
            np.testing.assert_allclose(values * 1.0, shape[key] * 1.0, rtol=0, atol=atol, err_msg=key)


def test_the_shapes_are_small_and_packed() -> None:
    assert sum((ROOT / "data" / "shapes" / f"{name}.npz").stat().st_size for name in NAMES) < 3e6
    packing = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]
    assert packing["wheel"]["force-include"]["data"] == "vntoolkit/data"


def test_an_installed_package_finds_them_inside_itself(tmp_path, monkeypatch):
    inside = tmp_path / "vntoolkit" / "data"
    (inside / "shapes").mkdir(parents=True)
    (inside / "walk.bvh").write_text("")
    (inside / "shapes" / "legs.npz").write_text("")
    monkeypatch.setattr(shipped, "_FOLDERS", (tmp_path / "data", inside))
    assert shipped.shipped_files() == {"walk.bvh": inside / "walk.bvh"}
    assert shipped.shipped_file("shapes/legs.npz") == inside / "shapes" / "legs.npz"


def test_a_missing_or_damaged_shape_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = shipped.shipped_file("shapes/legs.npz").read_bytes()
    monkeypatch.setattr(shipped, "_FOLDERS", (tmp_path,))
    with pytest.raises(
        BadInput, match=r"data/shapes/legs\.npz: expected the file in .*, found none; install"
    ):
        read_shape("legs")
    path = tmp_path / "shapes" / "legs.npz"
    path.parent.mkdir()
    for content in (b"", b"legs", whole[:1000], whole[: len(whole) // 2], whole[:-100]):
        path.write_bytes(content)
        with pytest.raises(BadInput, match=r"legs\.npz: expected the arrays of a shape; install"):
            read_shape("legs")

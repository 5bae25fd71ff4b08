"""The table of nuisances: nothing wrong without them, and each adds what it should."""

import pytest

from recipes.nuisances import nuisance_errors
from vntoolkit.options.simulation import Nuisances, RenderOptions, SceneOptions, nuisance_names
from vntoolkit.simulation.scene import build_scene

pytestmark = pytest.mark.slow  # a capture for every nuisance


@pytest.fixture(scope="module")
def table():
    scene = build_scene("cylinder", SceneOptions(width=240, height=180))
    rows = nuisance_errors(scene, Nuisances(), frame=20, rendering=RenderOptions(samples=1))
    return {row.name: row for row in rows}


def test_every_nuisance_has_a_row_between_none_and_all(table):
    assert list(table) == ["none", *nuisance_names(), "all"]


def test_the_world_of_equation_1_has_no_error_and_each_photographic_nuisance_has_one(table):
    assert table["none"].alone.median_deg < 1e-3
    for name in ("near_lights", "noise", "bayer", "quantisation", "blur_px"):
        assert table[name].alone.median_deg > 0.05
    assert table["all"].alone.median_deg > max(table[n].alone.median_deg for n in ("noise", "quantisation"))


def test_known_ambient_and_crosstalk_cost_nothing_where_the_rig_holds_them(table):
    for name in ("ambient", "crosstalk", "texture"):
        assert table[name].alone.median_deg < 0.02


def test_taking_the_worst_away_helps(table):
    assert table["near_lights"].without.median_deg < 0.7 * table["all"].alone.median_deg

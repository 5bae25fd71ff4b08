"""Views of meshes: the whole subject is in the picture, with smooth edges, lit from above."""

import numpy as np
import pytest

from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.footage.images import read_image
from vntoolkit.report.figures import write_moments
from vntoolkit.report.mesh_views import BACKGROUND, View, picture_of


def slab(width: float, height: float) -> Mesh:
    x, y = width / 2, height / 2
    corners = [[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]]
    vertices = np.array([0.3, -0.2, 5.0]) + np.array(corners)
    return Mesh(vertices=vertices, faces=np.array([[0, 2, 1], [0, 3, 2]], np.int32))


def covered(picture: np.ndarray) -> np.ndarray:
    return np.abs(picture.astype(int) - (np.array(BACKGROUND) * 255)).max(axis=2) > 20


@pytest.mark.parametrize(("width", "height"), [(2.0, 1.0), (0.5, 3.0)])
def test_the_subject_fills_the_picture_and_stays_in_it(width: float, height: float) -> None:
    seen = covered(picture_of([slab(width, height)], View.around(slab(width, height), 200, 120)))
    v, u = np.nonzero(seen)
    edges = np.array([v.min(), 119 - v.max(), u.min(), 199 - u.max()])
    assert edges.min() >= 3
    share = max(np.ptp(v) / 120, np.ptp(u) / 200)
    assert 0.82 < share < 0.92  # the room is 15 % of the subject
    assert abs(u.mean() - 99.5) < 1
    assert abs(v.mean() - 59.5) < 1


def test_edges_are_smooth() -> None:
    turned = View.around(slab(1.0, 1.0), 100, 100, azimuth_deg=30.0, elevation_deg=25.0)
    picture = picture_of([slab(1.0, 1.0)], turned).reshape(-1, 3)
    assert len(np.unique(picture, axis=0)) >= 4  # ground, surface, and shares of both


def test_moments_of_methods_stand_side_by_side(tmp_path) -> None:
    moments = {
        name: {row: np.full((40, 60, 3), (row, 200, colour), np.uint8) for row in (0, 4, 8, 12)}
        for name, colour in (("flow", 10), ("default", 250))
    }
    write_moments(tmp_path / "m.png", moments)
    picture = read_image(tmp_path / "m.png")
    at = {
        (row, colour): np.argwhere((picture == (row, 200, colour)).all(axis=2))
        for row in (4, 8, 12)
        for colour in (10, 250)
    }
    assert all(len(places) == 40 * 60 for places in at.values())
    assert not (picture[..., 1] == 200)[(picture[..., 0] == 0)].any()  # the last three only
    assert at[4, 10][0, 0] == at[4, 250][0, 0] < at[8, 10][0, 0]
    assert at[4, 10][0, 1] < at[4, 250][0, 1]

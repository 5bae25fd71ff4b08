"""Pictures of a dressed figure: seen from the right side, moving along the sheet, turning on the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recipes.walk_motion import walking_motion
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.io.footage.images import read_image
from vntoolkit.pipeline.dress import dress
from vntoolkit.report.mesh_views import (
    PreviewOptions,
    View,
    contact_sheet,
    picture_of,
    turntable,
    write_preview,
)


def test_picture_shows_left_right_up_and_near() -> None:
    corner = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0.2, 0]])

    def patch(shift, colour) -> Mesh:
        return Mesh(
            vertices=corner + shift, faces=np.array([[0, 1, 2]]), colours=np.tile(np.float32(colour), (3, 1))
        )

    right_and_down = patch([0.2, 0.2, 0], [1, 0, 0])
    behind = patch([0.2, 0.2, 0.3], [0, 1, 0])
    view = View(centre=np.zeros(3), height=1.0, width_px=100, height_px=100)
    picture = picture_of([right_and_down, behind], view).astype(int)
    red = np.argwhere((picture[..., 0] > 100) & (picture[..., 1] < 50))
    assert red.mean(axis=0).min() > 70  # right and low in the picture
    assert not np.any((picture[..., 1] > 100) & (picture[..., 0] < 50))  # the nearer one hides the other
    from_behind = picture_of([right_and_down], View(centre=np.zeros(3), height=1.0, azimuth_deg=180)).astype(
        int
    )
    seen = np.argwhere((from_behind[..., 0] > 100) & (from_behind[..., 1] < 50))
    assert seen[:, 1].mean() < 320 / 2
    from_left = picture_of(
        [right_and_down, patch([-0.4, 0.2, 0], [0, 1, 0])],
        View(centre=np.zeros(3), height=1.0, azimuth_deg=90, elevation_deg=1),
    )
    assert from_left.shape == (480, 320, 3)


def test_preview_moves_and_turns(moving_jumper: MeshSequence, tmp_path: Path) -> None:
    dressed = dress(moving_jumper, walking_motion())
    options = PreviewOptions(
        frames=3, azimuths_deg=(0.0, 90.0), picture_width=60, picture_height=80, turn_frames=4
    )
    sheet = contact_sheet(dressed, options)
    assert sheet.shape == (160, 180, 3)
    tiles = [sheet[:80, 60 * i : 60 * i + 60].astype(int) for i in range(3)]
    assert np.abs(tiles[0] - tiles[2]).mean() > 1
    pictures = list(turntable(dressed, options))
    assert len(pictures) == 4
    cloth = (pictures[0][..., 0].astype(int) - pictures[0][..., 2]) > 15
    assert 0.05 < cloth.mean() < 0.5
    write_preview(tmp_path, "walk", dressed, options)
    headed = read_image(tmp_path / "walk_sheet.png")
    assert headed.shape[0] > 160 + 3 * 20  # the same, below times and beside directions
    assert (tmp_path / "walk_turntable.mkv").stat().st_size > 1000

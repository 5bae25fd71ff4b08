"""Footage of a head that cannot calibrate is refused by the stage that fails, with what to film instead."""

import re

import numpy as np
import pytest

from vntoolkit.calibration.head.factorisation import fit_affine_model, metric_poses
from vntoolkit.calibration.head.light import fit_light
from vntoolkit.calibration.head.samples import HeadSamples
from vntoolkit.calibration.head.silhouettes import Silhouette, find_silhouette, require_head
from vntoolkit.calibration.head.tracks import Tracks, require_tracks
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.head import HeadSteps

CAMERA = Camera.pinhole(width=64, height=48, focal_px=100.0)


def silhouette(share: float, rival: float = 0.0, cut: float = 0.0, **more: float) -> Silhouette:
    mask = np.zeros((10, 100), dtype=bool)
    mask.flat[: round(1000 * share)] = True
    return Silhouette(mask=mask, bright=mask, rival_share=rival, cut_share=cut, **more)


@pytest.mark.parametrize(
    ("seen", "line"),
    [
        (silhouette(0.0), "nothing head-sized stands out .* in 100% of the frames; film one head, lit"),
        (silhouette(1.0), "no contrast between head and background .* or give --threshold"),
        (
            silhouette(0.3, backdrop=0.5, rival=0.9),
            "no contrast: the backdrop is 50% as bright as the subject",
        ),
        (silhouette(0.3, edge_share=0.5, rival=0.9), "bright up to the picture's edge in 100% of the frames"),
        (silhouette(0.3, rival=0.9), "two subjects in 100% of the frames; film one person alone"),
        (silhouette(0.3, cut=0.9), "the head is cut off by the picture's edge in 100% of the frames"),
    ],
)
def test_pictures_without_one_whole_head(seen, line):
    require_head([silhouette(0.3)] * 9)
    with pytest.raises(BadCalibration, match=f"silhouettes: {line}"):
        require_head([seen] * 9)


def test_an_uneven_backdrop_is_warned_of(caplog):
    still, moving = (
        0.3 * np.random.default_rng(0).random((60, 80, 3)).astype(np.float32) * k for k in (0, 1)
    )
    for backdrop in (still, moving):
        backdrop[20:50, 30:60] = 0.6
    require_head([find_silhouette(still)] * 9)
    assert not caplog.text
    require_head([find_silhouette(moving)] * 9)
    assert re.search(r"it varies by \d\.\d % of the subject's brightness", caplog.text)
    assert "film before a plain, dark, unlit backdrop" in caplog.text


def tracks_of(points: int, frames: int, moves: float = 5.0, missing: frozenset[int] = frozenset()) -> Tracks:
    """Points on a grid that all move alike; the later half is not seen in the missing frames."""
    rng = np.random.default_rng(3)
    start = rng.uniform(0, 40, (points, 2))
    seen = [(p, f) for p in range(points) for f in range(frames) if f not in missing or p < points // 9]
    point, frame = np.array(seen, dtype=int).reshape(-1, 2).T
    return Tracks(
        point=point,
        frame=frame,
        positions_px=start[point] + np.outer(frame * moves, [1.0, 0.0]),
        frame_count=frames,
    )


@pytest.mark.parametrize(
    ("tracks", "line"),
    [
        (tracks_of(20, 12), "only 20 points of the skin can be followed from frame to frame, 60 are needed"),
        (tracks_of(0, 12), "only 0 points of the skin can be followed"),
        (tracks_of(100, 12, missing=frozenset({5})), "lost between frames [45] and [56] of those used"),
        (tracks_of(100, 12, moves=0.0), "the head hardly turns .*; film it turning all the way"),
    ],
)
def test_skin_that_cannot_be_followed(tracks, line):
    with pytest.raises(BadCalibration, match=f"tracks: {line}"):
        require_tracks(tracks)


def test_tracks_that_tell_no_shape():
    with pytest.raises(BadCalibration, match=r"poses: fewer than \d+ points can be followed over"):
        fit_affine_model(tracks_of(3, 12))
    with pytest.raises(BadCalibration, match="poses: the tracks do not tell how far the head turns"):
        metric_poses(fit_affine_model(tracks_of(100, 12)), CAMERA, mirrored=False)


def samples_of(normals: np.ndarray, rgb: np.ndarray) -> HeadSamples:
    count = np.arange(len(normals))
    return HeadSamples(
        point=count,
        frame=count * 0,
        normals_in_camera=normals,
        rgb=rgb,
        position_px=np.zeros((len(normals), 2)),
        camera_from_head=(RigidTransform(),),
    )


def test_skin_that_tells_no_light(rng):
    normals = rng.normal(size=(400, 3))
    normals[:, 2] = -np.abs(normals[:, 2]) - 0.5
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for samples in (
        samples_of(np.tile([0, 0, -1.0], (400, 1)), np.full((400, 3), 0.5)),
        samples_of(normals, np.full((400, 3), 0.5)),
        samples_of(normals, rng.uniform(0.1, 1, (400, 3))),
    ):
        with pytest.raises(BadCalibration, match=r"light: only \d+% .* agree on one light response; check"):
            fit_light(samples, None, HeadSteps(), rng)

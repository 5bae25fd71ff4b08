"""The whole calibration on an egg whose shape, motion and M are known exactly; and footage it must refuse."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tests.calibration.turning_egg import (
    AXES,
    BACKGROUND,
    CAMERA,
    DISTANCE,
    relative_error,
    render_egg,
    turning_poses,
    write_frames,
)
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.io.maps_and_meshes.meshes import read_mesh, write_mesh
from vntoolkit.options.head import Features, HeadOptions, HeadShape, HeadSteps
from vntoolkit.pipeline.calibrate import CalibrationJob
from vntoolkit.pipeline.calibrate_head import calibrate_head
from vntoolkit.report.head import notices_of_head, write_head_page

OPTIONS = HeadOptions(  # for a picture of 320 by 240
    steps=HeadSteps(
        corners=600, corner_spacing_px=4.0, margin_px=8, window_px=9, pose_tracks=500, hull_cells=64,
        references=5, stereo_window_px=11, light_frames=9, light_points=1500,
    ),
    head_shape=HeadShape.FUSED,
)  # fmt: skip
FOCAL = float(CAMERA.matrix[0, 0])


@pytest.fixture(scope="module")
def footage(tmp_path_factory):
    poses = turning_poses(31, 60.0)
    folder = tmp_path_factory.mktemp("egg")
    return write_frames(folder, [render_egg(pose) for pose in poses]), poses


@pytest.fixture(scope="module")
def calibrated(footage):
    return calibrate_head(CalibrationJob(source=footage[0], focal_px=FOCAL), OPTIONS)


def constant_rotation(motion, poses):
    pairs = zip(motion.camera_from_head, poses, strict=True)
    return Rotation.from_matrix([true.rotation.T @ found.rotation for found, true in pairs])


def test_poses(footage, calibrated):
    relative = constant_rotation(calibrated[1].motion, footage[1])
    errors = np.rad2deg((relative.mean().inv() * relative).magnitude())
    assert errors.mean() < 0.8  # the egg is 150 pixels wide: a degree is 1.3 of them
    assert calibrated[1].motion.turn_deg == pytest.approx(120.0, abs=2.0)


def surface_error(mesh, motion, poses):
    """Mean distance to the egg of the vertices that face the camera amid the turn, over its diagonal."""
    turn = constant_rotation(motion, poses).mean().as_matrix()
    points = DISTANCE * (mesh.vertices @ turn.T)
    front = mesh.normals @ turn.T @ [0.0, 0.0, 1.0] < -0.5
    near = points[front]

    def gaps(unknowns):  # the head frame's origin and unit are free
        radii = np.linalg.norm((near - unknowns[:3]) / unknowns[3] / AXES, axis=1)
        return (1.0 - 1.0 / radii) * np.linalg.norm(near - unknowns[:3], axis=1) / unknowns[3]

    solution = least_squares(gaps, np.array([0.0, 0.0, near[:, 2].min() + AXES[2], 1.0]))
    return np.abs(solution.fun).mean() / (2 * np.linalg.norm(AXES))


def test_shape_is_the_eggs_and_stereo_betters_the_hull(footage, calibrated):
    _, result = calibrated
    fused = surface_error(result.mesh, result.motion, footage[1])
    hull = surface_error(result.hull, result.motion, footage[1])
    assert fused < min(hull / 3, 0.001)
    require_closed_and_outward(result.mesh)


def require_closed_and_outward(mesh):
    # no edge belongs to one triangle alone: the mesh is closed
    faces = mesh.faces
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert np.all(counts % 2 == 0)
    # and its triangles face outwards
    a, b, c = (mesh.vertices[faces[:, k]] for k in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) > 0


@pytest.mark.slow
def test_features_place_photographs_far_apart(footage):
    options = replace(
        OPTIONS,
        features=Features.SIFT,
        head_shape=HeadShape.HULL,
    )
    job = CalibrationJob(source=footage[0], focal_px=FOCAL, frames="::2")
    _, result = calibrate_head(job, options)
    relative = constant_rotation(result.motion, footage[1][::2])
    errors = np.rad2deg((relative.mean().inv() * relative).magnitude())
    assert errors.mean() < 0.8


def test_light_response(calibrated):
    rig, result = calibrated
    assert relative_error(rig.response.matrix) < 0.05
    assert rig.quality.method == "head"
    assert rig.quality.cone_deg > 45
    assert result.light.inliers.mean() > 0.6


def test_the_page_shows_every_stage_and_says_what_is_weak(tmp_path, footage, calibrated):
    rig, result = calibrated
    job = CalibrationJob(source=footage[0], focal_px=FOCAL)
    write_head_page(tmp_path / "head.html", job, rig, result)
    text = (tmp_path / "head.html").read_text()
    for shown in ("Tracks and poses", "Shape", "Light", "Time and sources", "Turn, tracks and samples carry"):
        assert shown in text
    assert text.count("data:image/") == 5  # tracks, shape, meshes, samples, sphere
    assert "http://" not in text.replace("http://www.w3.org", "")
    weak = replace(result.motion, turn_deg=70.0, interpolated=np.arange(31) == 4)
    notices = notices_of_head(replace(result, motion=weak))
    assert [notice.severity for notice in notices] == ["warning", "warning"]
    assert "turns by only 70°" in notices[0].text
    assert "1 of the frames were not placed" in notices[1].text


@pytest.mark.slow
def test_the_hull_alone_gives_the_light_too(footage):
    options = replace(OPTIONS, head_shape=HeadShape.HULL)
    rig, result = calibrate_head(CalibrationJob(source=footage[0], focal_px=FOCAL), options)
    assert relative_error(rig.response.matrix) < 0.10
    assert "stereo" not in result.stage_seconds


@pytest.mark.slow
def test_normals_better_shape_and_light(tmp_path, footage, calibrated):
    job = CalibrationJob(source=footage[0], focal_px=FOCAL)
    rig, result = calibrate_head(job, replace(OPTIONS, head_shape=HeadShape.REFINED))
    assert relative_error(rig.response.matrix) < 0.02
    refined = surface_error(result.mesh, result.motion, footage[1])
    assert refined < 1.1 * surface_error(result.fused, result.motion, footage[1])
    assert result.refined.changes[-1] < result.refined.changes[0]
    require_closed_and_outward(result.mesh)
    write_mesh(tmp_path / "egg.ply", result.mesh)
    written = read_mesh(tmp_path / "egg.ply")
    assert written.normals.shape == written.colours.shape == written.vertices.shape
    assert (written.error_deg > 0).all()
    write_head_page(tmp_path / "head.html", job, rig, result)
    text = (tmp_path / "head.html").read_text()
    assert "refined by normals" in text
    assert "last change of M" in text
    assert "data:image/webp" in text


def refused(tmp_path, images, options=OPTIONS):
    job = CalibrationJob(source=write_frames(tmp_path / "bad", images), focal_px=FOCAL)
    with pytest.raises(BadCalibration) as caught:
        calibrate_head(job, options)
    return str(caught.value)


def test_a_head_that_hardly_turns_is_refused(tmp_path):
    message = refused(tmp_path, [render_egg(pose) for pose in turning_poses(14, 8.0)])
    assert "turn" in message
    assert "60 degrees" in message


def test_a_still_head_is_refused(tmp_path):
    message = refused(tmp_path, [render_egg(pose) for pose in turning_poses(14, 0.05)])
    assert message.startswith("tracks: the head hardly turns")


def test_an_empty_room_is_refused(tmp_path):
    empty = np.full((CAMERA.height, CAMERA.width, 3), BACKGROUND, dtype=np.float32)
    assert refused(tmp_path, [empty] * 14).startswith("silhouettes: nothing head-sized stands out")


def test_a_lit_background_is_refused(tmp_path):
    images = [np.maximum(render_egg(pose), 0.0) for pose in turning_poses(14, 30.0)]
    slope = np.linspace(0.2, 0.9, CAMERA.width, dtype=np.float32)[None, :, None]
    message = refused(tmp_path, [np.where(image < 0.01, slope, image) for image in images])
    assert message.startswith("silhouettes:")
    assert "dark" in message


def test_two_people_are_refused(tmp_path):
    poses = turning_poses(14, 30.0)
    pairs = [
        np.maximum(render_egg(p, shift_m=-0.09, size=0.8), render_egg(p, 9, shift_m=0.09, size=0.75))
        for p in poses
    ]
    assert refused(tmp_path, pairs).startswith("silhouettes: two subjects in 100%")


def test_tracks_lost_half_way_are_refused(tmp_path):
    poses = turning_poses(24, 50.0)
    images = [render_egg(pose, pattern_seed=3 if k < 12 else 4) for k, pose in enumerate(poses)]
    assert refused(tmp_path, images).startswith("tracks: lost between frames 11 and 12")


def test_too_few_and_too_many_frames_are_refused(tmp_path):
    assert refused(tmp_path, [render_egg(turning_poses(3, 30.0)[0])] * 5).startswith("tracks: expected 12")
    job = CalibrationJob(source=str(tmp_path / "bad"), frames="9:")
    with pytest.raises(BadInput, match="only 5 frames"):
        calibrate_head(job, OPTIONS)

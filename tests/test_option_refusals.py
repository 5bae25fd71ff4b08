"""Every class of options and every object refuses what makes no sense, by one line that names it."""

import importlib

import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.motion import Skeleton

ONE_JOINT = Skeleton(names=("hips",), parents=np.array([-1]), offsets=np.zeros((1, 3)))
STILL = {
    "skeleton": ONE_JOINT,
    "rotations": np.array([[[0, 0, 0, 1.0]]]),
    "root_positions": np.zeros((1, 3)),
    "frame_rate_hz": 30.0,
}
MOVING = {
    "template": Mesh(vertices=np.eye(3), faces=np.array([[0, 1, 2]], dtype=np.int32)),
    "vertices": np.zeros((1, 3, 3), np.float32),
}
NAN, INFINITE = float("nan"), float("inf")
ALIKE = {"matrix": np.eye(3), "light_colours": np.ones((3, 3))}
PRESS = {"ball_radius_mm": 3.0, "pixel_mm": 0.1}
PLANE = {
    "corners_px": (0.0, 0.0, 90.0, 0.0, 0.0, 90.0, 90.0, 90.0),
    "width_mm": 20.0,
    "height_mm": 20.0,
    "pixel_mm": 0.1,
}
VARIATION = {
    "powers": [[1, 0], [1, 0]],
    "matrices": np.zeros((2, 3, 3)),
    "ambients": np.zeros((2, 3)),
    "centre_px": [0, 0],
    "scale_px": 9,
}
REFUSALS = [
    ("options.calibration:BoardOptions", {"radial_terms": 3}, "radial terms: expected a value from 0 to 2"),
    ("options.calibration:BoardOptions", {"degree": 4}, "degree: expected a value from 0 to 3, got 4"),
    ("options.head:HeadOptions", {"threshold": 2.0}, "threshold: expected a share between 0 and 1"),
    ("options.calibration:PressOptions", {**PRESS, "pixel_mm": 0.0}, "pixel mm: expected a positive number"),
    ("options.calibration:PressOptions", {**PRESS, "ball_radius_mm": INFINITE}, "millimetres, got inf"),
    ("geometry.board_layout:BoardLayout", {"columns": 10}, "odd numbers of squares from 3 on, got 10 × 11"),
    ("geometry.board_layout:BoardLayout", {"square_mm": 0.0}, "squares of a positive size in mm, got 0"),
    ("geometry.board_layout:BoardLayout", {"marker_share": 1.0}, "markers of 0.3 to 0.9 of a square, got 1"),
    ("geometry.board_layout:BoardLayout", {"hole_squares": 4}, "a hole of an odd number of squares, got 4"),
    ("geometry.board_layout:BoardLayout", {"hole_squares": 9}, "leaves no ring of two squares"),
    ("geometry.board_layout:BoardLayout", {"columns": 99, "rows": 99}, "99 × 99 squares need more than"),
    ("geometry.camera:Camera.orthographic", {"width": 0, "height": 9}, "a positive image size, got 0×9"),
    ("geometry.garment_fit:GarmentFit", {"scale": 0.0}, r"fit: expected a positive scale, got 0\.0"),
    ("geometry.maps:DepthMap", {"depth": np.zeros((2, 2), int), "mask": None}, "floating point, got int64"),
    ("geometry.maps:DepthMap", {"depth": np.zeros((2, 2)), "mask": np.ones((2, 2))}, "booleans, got float64"),
    ("geometry.mesh:MeshSequence", {**MOVING, "frame_rate_hz": 0.0}, r"a positive number, got 0\.0"),
    ("geometry.motion:Motion", {**STILL, "rotations": np.zeros((1, 1, 4))}, "expected unit quaternions"),
    ("geometry.motion:Motion", {**STILL, "frame_rate_hz": 0.0}, r"a positive number, got 0\.0"),
    ("geometry.motion:Motion", {**STILL, "metres_per_unit": -1.0}, "metres per unit: expected a positive"),
    (
        "geometry.motion:Motion",
        {**STILL, "rotations": np.zeros((0, 1, 4)), "root_positions": np.zeros((0, 3))},
        "motion: expected at least one frame",
    ),
    ("geometry.rectification:Rectification", {**PLANE, "corners_px": (0.0,)}, "eight numbers, got 1"),
    ("geometry.rectification:Rectification", {**PLANE, "width_mm": 0.0}, "positive sizes in millimetres"),
    ("geometry.rectification:Rectification", {**PLANE, "pixel_mm": 1e-6}, "the pixel size makes an image of"),
    ("geometry.rectification:Rectification", {**PLANE, "corners_px": (0.0,) * 8}, "corners lie on a line"),
    (
        "geometry.motion:Skeleton",
        {"names": "a", "parents": [-1], "offsets": [[0, 0, 0]], "tip_joints": [1], "tip_offsets": [[0] * 3]},
        "a tip names a joint that does not exist",
    ),
    ("io.footage.frame_range:FrameRange", {"start": 0, "stop": None, "step": 0}, "step"),
    ("options.pages:CameraOptions", {"rate": 0.0}, "rate: expected a positive number, got 0"),
    ("options.export:CleanOptions", {"smallest_piece": -1}, "smallest piece: expected 0 or more, got -1"),
    ("options.export:ExportOptions", {"to": "ply", "scale": 0.0},
     "scale: expected a positive number of metres, got 0"),
    ("options.export:ExportOptions", {"to": "glb", "up": "z"}, "metres and y up by its standard"),
    ("options.pages:ViewerOptions", {"port": 0}, "port: expected 1 to 65535"),
    ("options.pages:ReportOptions", {"samples": 0}, "samples: expected 1 or more, got 0"),
    ("options.export:CleanOptions", {"most_faces": 0}, "at least one triangle to remain, got 0"),
    ("options.depth:MeshOptions", {"largest_step": 0.0}, "a positive number of pixels, got 0"),
    ("options.depth:MeshOptions", {"stride": 0}, "stride: expected 1 or more, got 0"),
    ("options.normals:InversionOptions", {"relative_albedo": 0.0}, "relative albedo: expected a positive"),
    ("options.normals:InversionOptions", {"relative_albedo": INFINITE}, "a positive number, got inf"),
    ("options.normals:InversionOptions", {"darkest": 1.0}, "darkest: expected a share between 0 and 1"),
    ("photometry.response:LightResponse", ALIKE, "light colours are mixtures of each other"),
    ("photometry.transfer:Transfer", {"gamma": 0.0}, r"a gamma from 0\.1 to 10, got 0"),
    ("photometry.transfer:Transfer", {"black_level": 1.0}, "black_level < white_level <= 1, got 1 and 1"),
    ("photometry.response:ResponseVariation", VARIATION, "a monomial is listed twice"),
    ("cli.demo:DemoArguments", {"frames": 0}, "frames: expected 1 to 1000 frames, got 0"),
    ("options.dressing:DressOptions", {"figure_height": 0.0}, "figure height: expected positive metres"),
    ("options.reconstruction:ReconstructOptions", {"distance_m": 0.0}, "a positive number of metres, got 0"),
    ("options.reconstruction:ReconstructOptions", {"smoothing": 2.0}, "a share of full scale from 0 to 1"),
    ("options.reconstruction:ReconstructOptions", {"materials": 0},
     "expected auto, calibrated or a number from 1 to 12, got 0"),
    ("options.reconstruction:ReconstructOptions", {"reference_frame": -1}, "expected a frame number, got -1"),
    ("options.pages:ScenePageOptions", {"vertices": 3}, "vertices: expected 4 or more, got 3"),
    ("report.mesh_views:PreviewOptions", {"frames": 0}, "preview: expected at least one frame"),
    ("options.simulation:Nuisances", {"bits": 9}, "bits: expected one of 8, 10, 12, 16, got 9"),
    ("options.simulation:Nuisances", {"read_noise_electrons": -1},
     "read noise electrons: expected a value from 0"),
    ("options.simulation:RenderOptions", {"samples": 2}, "samples: expected 1, 5 or 9 per pixel, got 2"),
    ("options.simulation:SceneOptions", {"width": 9}, "width: expected 16 or more, got 9"),
    ("options.simulation:SceneOptions", {"field_width_m": 9.0}, r"expected 0\.01 to 5 m across, got 9"),
    ("options.dressing:DressOptions", {"max_stretch": 1.0}, "max stretch: expected a factor above 1"),
    ("options.dressing:ClockOptions", {"speed": 0.0}, "speed: expected a positive number, got 0"),
    ("options.dressing:ClockOptions", {"start": -1.0}, "start: expected seconds from 0 on, got -1"),
    ("options.dressing:ClockOptions", {"stop": float("nan")}, "stop: expected seconds from 0 on, got nan"),
    ("options.dressing:WeightOptions", {"neighbours": 0}, "neighbours: expected at least 1, got 0"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("name", "values", "line"), REFUSALS, ids=[f"{n}-{i}" for i, (n, *_) in enumerate(REFUSALS)]
)
def test_what_makes_no_sense_is_refused_by_a_line_that_names_it(name, values, line):
    module, path = name.split(":")
    made = importlib.import_module(f"vntoolkit.{module}")
    for part in path.split("."):
        made = getattr(made, part)
    with pytest.raises(BadInput, match=line):
        made(**values)

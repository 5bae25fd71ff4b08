"""What is carried before the camera: the board (Section III-A) and a cylinder (Figure 7)."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import Faces, FloatArray, Points, Vector3
from vntoolkit.geometry.board_layout import MARKER_DICTIONARY, BoardLayout
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.simulation.grids import closed_columns, grid_faces, grid_uv
from vntoolkit.simulation.lights import FRAME_RATE_HZ, studio_camera, studio_centre
from vntoolkit.simulation.relief import paper_fibres, plain_weave, tiling_noise
from vntoolkit.simulation.scene import Detail, Scene, SceneSurface, sample_weights

FRAME_COUNT = 240
_FIELD_WIDTH_M = 0.38
_MARGIN_MM = 12.0
_TEXELS_PER_MM = 6
_CLOTH_ROWS = 64  # white texels under the print, where the sample's texture coordinates lie
_PAPER = np.array([0.80, 0.79, 0.77])
_CLOTH = np.array([0.62, 0.60, 0.57])
_INK_SHARE = 0.05  # of the paper's reflectance
_CLOTH_DEPTH_MM = 1.0  # the board's thickness: the sample is stuck on from behind
_THREAD_MM = 0.8
_WEAVE_HEIGHT_M = 8e-5
SWEPT_LAYOUT = BoardLayout(columns=7, rows=7, hole_squares=3, square_mm=36.0)
RADIUS_M, LENGTH_M = 0.12, 0.42
CYLINDER_FIELD_WIDTH_M = 0.9
CYLINDER_FRAME_COUNT = 180  # 3 s
_ROWS, _COLUMNS = 150, 720
_WRAPPING_PAPER = np.array([0.80, 0.785, 0.75])
_FIBRE_HEIGHT_M = 6e-5


def build_board(options: SceneOptions) -> Scene:
    """The default board filmed full frame; `camera_from_object` is the pose of the board frame, in metres."""
    field_width_m = options.field_width_m or _FIELD_WIDTH_M
    scale = field_width_m / _FIELD_WIDTH_M
    layout = BoardLayout(square_mm=BoardLayout().square_mm * scale)
    sway = Sway(
        turns_deg=(36.0, 38.0, 22.0),
        shifts_m=(0.012, 0.006, 0.04),  # held in one place, whatever its size
        periods_s=(1.3, 2.1, 3.7, 1.9, 2.3, 2.9),
        phases=_phases(options),
        rest=_about_its_middle(layout),
    )
    level = 0.7  # the paper is brighter than the sample and must not clip
    return _board_scene("board", options, field_width_m, scale, layout, sway, _CLOTH, level)


def build_board_sweep(options: SceneOptions) -> Scene:
    """The board, 25 cm wide, moved ±26 cm across and ±17 cm up and down while it tilts."""
    field_width_m = options.field_width_m or CYLINDER_FIELD_WIDTH_M
    scale = field_width_m / CYLINDER_FIELD_WIDTH_M
    layout = replace(SWEPT_LAYOUT, square_mm=SWEPT_LAYOUT.square_mm * scale)
    sway = Sway(
        turns_deg=(34.0, 36.0, 16.0),
        shifts_m=(0.26 * scale, 0.17 * scale, 0.08),
        periods_s=(0.53, 0.71, 1.9, 2.3, 1.37, 3.1),  # tilts quicker than it travels: all tilts everywhere
        phases=_phases(options),
        rest=_about_its_middle(layout),
    )
    return _board_scene("board_sweep", options, field_width_m, scale, layout, sway, _WRAPPING_PAPER, 0.8)


def _phases(options: SceneOptions) -> Vector3:
    return np.random.default_rng(options.seed).uniform(0, 2 * np.pi, 6)


def _about_its_middle(layout: BoardLayout) -> RigidTransform:
    width_m, height_m = layout.width_mm / 1000, layout.height_mm / 1000
    return RigidTransform(translation=np.array([-width_m / 2, -height_m / 2, 0.0]))


def _board_scene(
    name: str,
    options: SceneOptions,
    field_width_m: float,
    scale: float,
    layout: BoardLayout,
    sway: "Sway",
    sample: FloatArray,
    exposure_level: float,
) -> Scene:
    """Return a board that sways. scale, sample: as of `board_mesh`, the sample where none is asked for."""
    rest, surface = board_mesh(layout, scale, sample_weights(options, sample))
    return Scene(
        name=name,
        camera=studio_camera(options, field_width_m),
        surface=surface,
        vertices=lambda frame: sway.camera_from_object(frame).apply(rest),
        frame_count=FRAME_COUNT,
        exposure_level=exposure_level,
        camera_from_object=sway.camera_from_object,
        facts={name: getattr(layout, name) for name in ("square_mm", "columns", "rows", "hole_squares")},
    )


def board_mesh(
    layout: BoardLayout, scale: float = 1.0, sample: FloatArray = _CLOTH
) -> tuple[Points, SceneSurface]:
    """Return vertices (n, 3) in the board frame, metres, and the printed surface with the sample.

    scale: how much larger than the A4 board it is: its margin, its thickness and the print's texels grow with
    it, the sample's weave does not. sample: (b,) pigments of the material in the hole.
    """
    board, board_uv = _flat_grid(_lines(layout.columns, layout, scale), _lines(layout.rows, layout, scale))
    grid = np.arange(len(board)).reshape(layout.rows + 3, layout.columns + 3)
    columns, rows = np.meshgrid(np.arange(-1, layout.columns + 1), np.arange(-1, layout.rows + 1))
    kept = ~layout.in_hole(np.stack([columns, rows], axis=-1)).ravel()
    board_faces = grid_faces(grid).reshape(-1, 2, 3)[kept].reshape(-1, 3)
    # The sample reaches half a square behind the board all round.
    low = layout.hole_mm[0] - layout.square_mm / 2
    side = layout.hole_mm[2] + layout.square_mm / 2 - low
    cloth, cloth_uv = _flat_grid(low[0] + np.array([0.0, side[0]]), low[1] + np.array([0.0, side[1]]))
    cloth[:, 2] = _CLOTH_DEPTH_MM * scale
    cloth_faces = grid_faces(np.arange(4).reshape(2, 2)) + len(board)
    texture = _print_and_white(layout, scale)
    print_share = 1.0 - _CLOTH_ROWS / len(texture)
    # v of the sample stays off the border of its white strip, where interpolation would reach the print.
    strip = np.array([1.0, 0.8 * (1.0 - print_share)])
    uv = np.concatenate(
        [
            board_uv * [1.0, print_share],
            cloth_uv * strip + [0.0, print_share + 0.1 * (1.0 - print_share)],
        ]
    )
    faces = np.concatenate([board_faces, cloth_faces]).astype(np.int32)
    is_cloth = np.arange(len(uv)) >= len(board)
    weave = plain_weave(8, 16)
    surface = SceneSurface(
        faces=faces,
        reference_weights=sample,
        vertex_weights=np.where(is_cloth[:, None], sample, _PAPER),
        texture=texture,
        uv=uv[faces],
        detail=Detail(
            height_m=_WEAVE_HEIGHT_M * weave,
            repeats=(side[0] / (8 * _THREAD_MM), side[1] / (8 * _THREAD_MM) / strip[1]),
            strength=is_cloth.astype(np.float64),
        ),
    )
    return np.concatenate([board, cloth]) / 1000.0, surface


def draw_board(layout: BoardLayout, texels_per_mm: float, margin_mm: float) -> FloatArray:
    """Return the print, (h, w), 1 = paper, 0 = ink: black where row + column is even, markers elsewhere."""
    square = round(layout.square_mm * texels_per_mm)
    marker = round(layout.marker_mm * texels_per_mm)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, MARKER_DICTIONARY))
    print_ = np.ones((layout.rows * square, layout.columns * square))
    row, column = np.indices((layout.rows, layout.columns))
    print_ *= np.kron((row + column) % 2, np.ones((square, square)))
    for number in layout.sound_marker_ids:
        column_of, row_of = layout.marker_squares[number]
        x, y = (at * square + (square - marker) // 2 for at in (column_of, row_of))
        print_[y : y + marker, x : x + marker] = (
            cv2.aruco.generateImageMarker(dictionary, int(number), marker, borderBits=1) / 255.0
        )
    return np.pad(print_, round(margin_mm * texels_per_mm), constant_values=1.0)


def _print_and_white(layout: BoardLayout, scale: float) -> FloatArray:
    """Return (h, w, 3) reflectance relative to the paper's: the print, and a white strip under it."""
    printed = _INK_SHARE + (1.0 - _INK_SHARE) * draw_board(layout, _TEXELS_PER_MM / scale, _MARGIN_MM * scale)
    sheet = np.concatenate([printed, np.ones((_CLOTH_ROWS, printed.shape[1]))])
    return np.repeat(sheet[..., None], 3, axis=2)


def _lines(squares: int, layout: BoardLayout, scale: float) -> FloatArray:
    """Positions in mm of the grid lines across: margin, square borders, margin."""
    inner = np.arange(squares + 1) * layout.square_mm
    margin = _MARGIN_MM * scale
    return np.concatenate([[-margin], inner, [inner[-1] + margin]])


def _flat_grid(x: FloatArray, y: FloatArray) -> tuple[Points, FloatArray]:
    """Return vertices (n, 3), row by row, at z = 0, and their places in the rectangle, (n, 2) 0 to 1."""
    at = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    share = (at - at[0]) / (at[-1] - at[0])
    return np.column_stack([at, np.zeros(len(at))]), share


# A cylinder wrapped in paper, moved through all six degrees of freedom.


def build_cylinder(options: SceneOptions) -> Scene:
    """A paper tube of 42 cm by 24 cm with end caps; its axis is the object's y axis."""
    generator = np.random.default_rng(options.seed)
    rest, faces, uv = cylinder_mesh()
    fibres = paper_fibres(1024, 9000, 40.0, generator)
    sway = Sway(
        turns_deg=(24.0, 70.0, 38.0),
        shifts_m=(0.10, 0.06, 0.12),
        periods_s=(2.1, 3.7, 3.1, 1.7, 2.3, 2.9),
        phases=generator.uniform(0, 2 * np.pi, 6),
        rest=RigidTransform.from_rotation_vector((0.0, 0.0, 0.5)),
    )
    return Scene(
        name="cylinder",
        camera=studio_camera(options, CYLINDER_FIELD_WIDTH_M),
        surface=SceneSurface(
            faces=faces,
            reference_weights=_WRAPPING_PAPER,
            texture=_paper_texture(fibres, generator),
            uv=uv,
            detail=Detail(height_m=_FIBRE_HEIGHT_M * fibres, repeats=(3.0, 2.0)),
        ),
        vertices=lambda frame: sway.camera_from_object(frame).apply(rest),
        frame_count=CYLINDER_FRAME_COUNT,
        camera_from_object=sway.camera_from_object,
        facts={"radius_m": RADIUS_M, "length_m": LENGTH_M},
    )


def cylinder_mesh() -> tuple[Points, Faces, FloatArray]:
    """Return vertices (n, 3) about the origin, axis y; faces; uv per corner (u once round, v along)."""
    around = np.linspace(0.0, 2 * np.pi, _COLUMNS, endpoint=False)
    ring = np.stack([np.sin(around), np.zeros(_COLUMNS), -np.cos(around)], axis=1) * RADIUS_M
    heights = np.linspace(-LENGTH_M / 2, LENGTH_M / 2, _ROWS)
    side = ring[None] + heights[:, None, None] * np.array([0.0, 1.0, 0.0])
    vertices, faces = [side.reshape(-1, 3)], [grid_faces(closed_columns(_ROWS, _COLUMNS))]
    uv = [grid_uv(_ROWS, _COLUMNS + 1)]
    for end in (-1, 1):
        cap, triangles = _cap(ring, end)
        faces.append(triangles + sum(len(part) for part in vertices))
        vertices.append(cap)
        # The paper's scale on the caps too: metres over circumference and length.
        flat = cap[:, [0, 2]] / np.array([2 * np.pi * RADIUS_M, LENGTH_M]) + 0.5
        uv.append(flat[triangles])
    return np.concatenate(vertices), np.concatenate(faces).astype(np.int32), np.concatenate(uv)


def _cap(ring: Points, end: int) -> tuple[Points, Faces]:
    """Return a disc at the top (−1) or the bottom (1); own vertices, since its edge is sharp."""
    lift = np.array([0.0, end * LENGTH_M / 2, 0.0])
    vertices = np.concatenate([ring + lift, ring * 0.5 + lift, lift[None]])
    index = np.arange(_COLUMNS)
    after, middle = np.roll(index, -1), np.full(_COLUMNS, 2 * _COLUMNS)
    inner, inner_after = index + _COLUMNS, after + _COLUMNS
    triangles = np.concatenate(
        [
            np.stack([index, after, inner], 1),
            np.stack([after, inner_after, inner], 1),
            np.stack([inner, inner_after, middle], 1),
        ]
    )
    return vertices, (triangles if end < 0 else triangles[:, ::-1]).astype(np.int32)


def _paper_texture(fibres: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Nearly white, faintly mottled and fibrous, with the line of the overlapping edge at u = 0."""
    size = len(fibres)
    cloudy = 0.008 * tiling_noise(size, 60.0, generator) + 0.012 * (fibres - fibres.mean())
    column = np.minimum(np.arange(size), size - 1 - np.arange(size))
    edge = 1.0 - 0.12 * np.exp(-np.square(column / 1.5))
    return (1.0 + cloudy)[..., None] * edge[None, :, None] * _WRAPPING_PAPER


@dataclass(frozen=True, kw_only=True, eq=False)
class Sway:
    """Motion along and about three axes by six sines of different periods, so that it repeats late.

    turns_deg: amplitudes about x, y, z. shifts_m: amplitudes along x, y, z. periods_s: six, rotations first.
    phases: six, radians. rest: object's orientation at the middle of the motion.
    """

    turns_deg: tuple[float, float, float]
    shifts_m: tuple[float, float, float]
    periods_s: tuple[float, ...]
    phases: Vector3
    rest: RigidTransform = RigidTransform()  # noqa: RUF009  frozen, hence safe to share

    def camera_from_object(self, frame: int) -> RigidTransform:
        """Return the pose of a frame; the object's origin stays near the studio's centre."""
        time_s = frame / FRAME_RATE_HZ
        waves = np.sin(2 * np.pi * time_s / np.array(self.periods_s) + self.phases)
        rotation = Rotation.from_euler("xyz", waves[:3] * np.array(self.turns_deg), degrees=True)
        shift = studio_centre() + waves[3:] * np.array(self.shifts_m)
        return RigidTransform(rotation=rotation.as_matrix(), translation=shift) @ self.rest

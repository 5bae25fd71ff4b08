"""A cotton jacket that stands still (Figure 6): folds, pockets, buttons, seams, ribbed hem and cuffs."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PchipInterpolator

from vntoolkit.arrays import Faces, FloatArray, Points
from vntoolkit.geometry.mesh import vertex_normals
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.simulation.grids import closed_columns, grid_faces, grid_uv
from vntoolkit.simulation.lights import studio_camera, studio_centre
from vntoolkit.simulation.relief import twill_weave
from vntoolkit.simulation.scene import Detail, Scene, SceneSurface

_COTTON = np.array([0.47, 0.43, 0.35])
_THREADS = 16  # in a tile of the weave
_THREAD_M = 0.0011
_WEAVE_HEIGHT_M = 1.2e-4
_TURN_DEG = 14.0  # a little from the front, so that one side falls away
_SPACING_M = 0.0017
_STITCH_M = 0.0016
_RIGHT, _TOWARDS_VIEWER = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])
_BUTTON_SHADE = 0.35  # buttons are darker than the cloth


def build_jacket(options: SceneOptions) -> Scene:
    """A jacket of 65 cm on an invisible form, turned a little to one side."""
    generator = np.random.default_rng(options.seed)
    parts = [torso(generator), sleeve(-1, generator), sleeve(1, generator), collar(generator)]
    vertices, surface = _joined(parts)
    pose = RigidTransform.from_rotation_vector(
        (0.0, np.deg2rad(_TURN_DEG), 0.0), studio_centre() + np.array([0.0, 0.02, 0.0])
    )
    standing = pose.apply(vertices)
    return Scene(
        name="jacket",
        camera=studio_camera(options, field_width_m=1.05),
        surface=surface,
        vertices=lambda _frame: standing,
        frame_count=1,
        camera_from_object=lambda _frame: pose,
    )


def _joined(parts: "list[Part]") -> tuple[Points, SceneSurface]:
    """Return all vertices and one surface; the parts' texture coordinates become tiles of the weave."""
    tubes, tile_m = [part.tube for part in parts], _THREADS * _THREAD_M
    starts = np.cumsum([0] + [len(tube.vertices) for tube in tubes])
    faces = [tube.faces + start for tube, start in zip(tubes, starts, strict=False)]
    uv = [tube.uv * np.array([round(tube.girth / tile_m), tube.length / tile_m]) for tube in tubes]
    weights = np.concatenate([part.shade for part in parts])[:, None] * _COTTON
    surface = SceneSurface(
        faces=np.concatenate(faces),
        reference_weights=_COTTON,
        vertex_weights=weights,
        uv=np.concatenate(uv),
        detail=Detail(
            height_m=_WEAVE_HEIGHT_M * twill_weave(_THREADS, 8),
            strength=np.concatenate([part.weave for part in parts]),
        ),
    )
    return np.concatenate([tube.vertices for tube in tubes]), surface


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """One part. tube: relief included. shade: (n,) reflectance relative to the cloth. weave: (n,) strength of
    the weave's relief.
    """

    tube: "Tube"
    shade: FloatArray
    weave: FloatArray


# Parts: torso, sleeves and collar, each a tube with relief; y points down, metres.


def torso(generator: np.random.Generator) -> Part:
    """Return the body from neck to hem, front line in the middle of the button strip."""
    rows = np.array(
        [  # y, half width, half depth
            [-0.290, 0.070, 0.068], [-0.280, 0.078, 0.072], [-0.266, 0.130, 0.088], [-0.246, 0.182, 0.104],
            [-0.215, 0.214, 0.118], [-0.150, 0.226, 0.132], [-0.050, 0.224, 0.142], [0.080, 0.210, 0.132],
            [0.170, 0.214, 0.134], [0.245, 0.226, 0.146], [0.268, 0.206, 0.130], [0.330, 0.200, 0.126],
        ]
    )  # fmt: skip
    centres = np.column_stack([np.zeros(len(rows)), rows[:, 0], np.zeros(len(rows))])
    tube = tube_along(centres, rows[:, 1:])
    s, y = tube.s, tube.vertices[:, 1]
    folds = [
        *_mirrored_folds(generator, s_at=0.27, t_at=-0.11, count=9),
        *scattered_folds(
            38, s_range=(-0.6, 0.6), t_range=(0.10, 0.24), angles_deg=(-60, 60), length=0.16, width=0.011,
            height=0.0085, generator=generator,
        ),
        *scattered_folds(
            26, s_range=(-0.55, 0.55), t_range=(-0.10, 0.12), angles_deg=(40, 140), length=0.22, width=0.014,
            height=0.0075, generator=generator,
        ),
    ]  # fmt: skip
    ribbed = step(y - 0.268, 0.002)
    free = (1.0 - ribbed) * step(y + 0.27, 0.02) * (0.45 + 0.55 * step(np.abs(s) - 0.03, 0.01))
    height = sum_of_folds(s, y, folds) * free
    height += ribbed * 0.0011 * np.cos(2 * np.pi * s / (tube.girth / 150))
    height += 0.0020 * step(0.019 - np.abs(s), 0.0008) * (1 - ribbed)
    seams = groove(np.abs(s) - 0.0155) * (1 - ribbed) + groove(y + 0.165)
    pockets, pocket_seams = _pockets(s, y)
    buttons = _buttons(s, y)
    height += pockets - 0.0011 * np.maximum(seams, pocket_seams) + 0.003 * buttons
    shade = 1.0 + 0.06 * np.maximum(seams, pocket_seams) - (1.0 - _BUTTON_SHADE) * buttons
    return Part(tube=tube.raised(height), shade=shade, weave=(1.0 - buttons) * (1.0 - 0.7 * ribbed))


def sleeve(side: int, generator: np.random.Generator) -> Part:
    """Return the right (−1, at the viewer's left) or left (1) sleeve, hanging, bent at the elbow."""
    rows = np.array(
        [  # x, y, z, half width, half depth
            [0.120, -0.160, 0.000, 0.050, 0.066], [0.180, -0.155, 0.000, 0.066, 0.078],
            [0.236, -0.100, 0.000, 0.070, 0.080], [0.285, 0.020, 0.010, 0.064, 0.070],
            [0.305, 0.120, -0.010, 0.060, 0.064], [0.312, 0.200, -0.035, 0.058, 0.060],
            [0.316, 0.226, -0.045, 0.046, 0.048], [0.322, 0.275, -0.060, 0.044, 0.046],
        ]
    )  # fmt: skip
    centres = rows[:, :3] * np.array([side, 1.0, 1.0])
    tube = tube_along(centres, rows[:, 3:])
    s, t = tube.s, tube.t
    elbow = 0.30
    folds = [
        *scattered_folds(
            20, s_range=(-0.2, 0.2), t_range=(elbow - 0.07, elbow + 0.08), angles_deg=(-35, 35), length=0.12,
            width=0.0085, height=0.0085, generator=generator,
        ),
        *scattered_folds(
            12, s_range=(-0.2, 0.2), t_range=(0.06, 0.22), angles_deg=(20, 75), length=0.18, width=0.012,
            height=0.007, generator=generator,
        ),
        *scattered_folds(
            14, s_range=(-0.2, 0.2), t_range=(tube.length - 0.16, tube.length - 0.06), angles_deg=(-25, 25),
            length=0.11, width=0.008, height=0.007, generator=generator,
        ),
    ]  # fmt: skip
    cuff = step(t - (tube.length - 0.052), 0.002)
    height = sum_of_folds(s, t, folds) * (1.0 - cuff)
    height += cuff * 0.0010 * np.cos(2 * np.pi * s / (tube.girth / 48))
    return Part(tube=tube.raised(height), shade=np.ones_like(s), weave=1.0 - 0.7 * cuff)


def collar(generator: np.random.Generator) -> Part:
    """Return the turned-down collar: a tube whose upper half lies inside, longer in front, split there."""
    rows = np.array(
        [  # y, half width, half depth
            [-0.270, 0.072, 0.070], [-0.318, 0.070, 0.068], [-0.326, 0.074, 0.072], [-0.322, 0.080, 0.078],
            [-0.300, 0.093, 0.090], [-0.268, 0.112, 0.104],
        ]
    )  # fmt: skip
    centres = np.column_stack([np.zeros(len(rows)), rows[:, 0], np.zeros(len(rows))])
    tube = tube_along(centres, rows[:, 1:])
    angle = tube.s / tube.girth * 2 * np.pi
    leaf = np.clip((tube.t - 0.06) / (tube.length - 0.06), 0.0, 1.0)
    tip = np.exp(-np.square((np.abs(angle) - 0.42) / 0.30))
    vertices = tube.vertices + (leaf * tip)[:, None] * np.array([0.0, 0.034, -0.016])
    # The split in front: both leaves end at an edge that leans outwards towards the tips.
    edge = 0.10 + 0.22 * leaf
    bare = np.abs(angle) < edge
    faces = tube.faces[~bare[tube.faces].any(axis=1)]
    uv = tube.uv[~bare[tube.faces].any(axis=1)]
    stitches = leaf * groove(tube.length - tube.t - 0.006)
    waves = 0.0012 * np.sin(3.0 * angle + generator.uniform(0, 2 * np.pi)) * leaf
    shaped = replace(tube, vertices=vertices, faces=faces, uv=uv).raised(waves - 0.0008 * stitches)
    return Part(tube=shaped, shade=1.0 + 0.06 * stitches, weave=np.ones_like(leaf))


def _mirrored_folds(generator: np.random.Generator, *, s_at: float, t_at: float, count: int) -> "list[Fold]":
    """Drag lines that spring from both armpits and run towards the middle and down."""
    folds: list[Fold] = []
    for side, angles in ((-1, (5, 80)), (1, (100, 175))):
        folds += scattered_folds(
            count, s_range=(side * s_at - 0.03, side * s_at + 0.03), t_range=(t_at - 0.03, t_at + 0.05),
            angles_deg=angles, length=0.2, width=0.010, height=0.009, generator=generator,
        )  # fmt: skip
    return folds


def _pockets(s: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the height of two chest pockets with flaps, and their seams."""
    height, seams = np.zeros_like(s), np.zeros_like(s)
    for centre in (-0.135, 0.135):
        bag = patch(s, y, (centre, -0.070), (0.115, 0.120))
        flap = patch(s, y, (centre, -0.112), (0.122, 0.048))
        height += 0.0018 * step(bag, 0.0008) + 0.0024 * step(flap, 0.0008)
        inner = np.maximum(groove(bag - 0.004) * (flap < -0.002), groove(flap - 0.004))
        seams = np.maximum(seams, inner)
    return height, seams


def _buttons(s: FloatArray, y: FloatArray) -> FloatArray:
    """Return 1 on the buttons of the front strip and of the flaps, 0 elsewhere."""
    places = [(0.0, at) for at in np.linspace(-0.225, 0.235, 6)] + [(-0.135, -0.098), (0.135, -0.098)]
    distance = np.min([np.hypot(s - a, y - b) for a, b in places], axis=0)
    return step(0.0075 - distance, 0.0006)


@dataclass(frozen=True, kw_only=True)
class Fold:
    """A bent ridge over cloth coordinates (s, t).

    start: its one end. angle_rad, length: direction and reach, s towards t. bend: sideways deviation at its
    middle. width: of the ridge's flank. height: of its crest. lean: −1 to 1, which flank is the steeper.
    """

    start: tuple[float, float]
    angle_rad: float
    length: float
    bend: float
    width: float
    height: float
    lean: float


# Relief: folds, seams and pockets as heights over the unrolled cloth, metres.


def fold_height(s: FloatArray, t: FloatArray, fold: Fold) -> FloatArray:
    """Return the height that one fold adds at (s, t)."""
    cos, sin = np.cos(fold.angle_rad), np.sin(fold.angle_rad)
    along = (cos * (s - fold.start[0]) + sin * (t - fold.start[1])) / fold.length
    across = -sin * (s - fold.start[0]) + cos * (t - fold.start[1])
    inside = np.clip(along, 0.0, 1.0)
    across = across - 4.0 * fold.bend * inside * (1.0 - inside)
    # A fold is narrow where it springs from and spreads as it runs out.
    x = across / (fold.width * (0.6 + 0.8 * inside))
    flank = np.where(x * fold.lean > 0, 1.0 + 1.2 * abs(fold.lean), 1.0 - 0.35 * abs(fold.lean))
    fade = np.where((along > 0) & (along < 1), np.sin(np.pi * np.sqrt(inside)) ** 1.5, 0.0)
    return fold.height * fade * (1.0 - np.tanh(1.6 * x * flank) ** 2)


def scattered_folds(
    count: int,
    *,
    s_range: tuple[float, float],
    t_range: tuple[float, float],
    angles_deg: tuple[float, float],
    length: float,
    width: float,
    height: float,
    generator: np.random.Generator,
) -> list[Fold]:
    """Draw `count` folds that start in a rectangle and run at some angle in `angles_deg`, sizes ± 40 %."""
    folds = []
    for _ in range(count):
        size = generator.uniform(0.6, 1.4, 3)
        folds.append(
            Fold(
                start=(float(generator.uniform(*s_range)), float(generator.uniform(*t_range))),
                angle_rad=float(np.deg2rad(generator.uniform(*angles_deg))),
                length=length * float(size[0]),
                bend=float(generator.normal(0.0, 0.08)) * length,
                width=width * float(size[1]),
                height=height * float(size[2]),
                lean=float(generator.uniform(-1, 1)),
            )
        )
    return folds


def sum_of_folds(s: FloatArray, t: FloatArray, folds: list[Fold]) -> FloatArray:
    """Add up folds; where several meet, the higher one swallows part of the lower."""
    total = np.zeros_like(s)
    for fold in folds:
        total += fold_height(s, t, fold) * (1.0 - 0.5 * np.clip(total / 0.02, 0.0, 1.0))
    return total


def groove(distance: FloatArray) -> FloatArray:
    """Return 1 on a line and 0 away from it: the dent of a seam."""
    return np.exp(-np.square(distance / _STITCH_M))


def patch(s: FloatArray, t: FloatArray, centre: tuple[float, float], size: tuple[float, float]) -> FloatArray:
    """Return the distance to a rectangle's outline, positive inside: pockets and flaps."""
    away_s = size[0] / 2 - np.abs(s - centre[0])
    away_t = size[1] / 2 - np.abs(t - centre[1])
    return np.minimum(away_s, away_t)


def step(distance: FloatArray, width: float) -> FloatArray:
    """Return 0 outside, 1 inside, with a soft edge."""
    return 0.5 * (1.0 + np.tanh(distance / width))


@dataclass(frozen=True, kw_only=True, eq=False)
class Tube:
    """A tube of cloth.

    vertices: (n, 3), row by row, from the first ring down. faces: (m, 3). uv: (m, 3, 2), u round, v along.
    s: (n,) metres round the tube from its front line, −half to half; t: (n,) metres along it.
    girth, length: its mean extent in metres.
    """

    vertices: Points
    faces: Faces
    uv: FloatArray
    s: FloatArray
    t: FloatArray
    girth: float
    length: float

    def raised(self, height: FloatArray) -> "Tube":
        """Return the tube with its vertices moved outwards by `height` (n,)."""
        normals = vertex_normals(self.vertices, self.faces)
        return replace(self, vertices=self.vertices + height[:, None] * normals)


# Tubes of cloth about a centre line; cloth coordinates in metres, relief along the normal.


def tube_along(centres: FloatArray, radii: FloatArray) -> Tube:
    """Sweep ellipses along a curve that goes roughly down, by control rows; the front faces the viewer.

    centres: (k, 3). radii: (k, 2) half widths to the right and towards the viewer.
    """
    control = np.column_stack([centres, radii])
    knots = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(control[:, :4], axis=0), axis=1))])
    rows = round(knots[-1] / _SPACING_M) + 1
    at = np.linspace(0.0, knots[-1], rows)
    swept = PchipInterpolator(knots, control)(at)
    girth = float(2 * np.pi * np.sqrt(np.mean(np.square(radii))))
    columns = 2 * round(girth / _SPACING_M / 2)
    angle = (np.arange(columns) / columns - 0.5) * 2 * np.pi  # 0 in front, the cut at the back
    down = np.gradient(swept[:, :3], axis=0)
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    side = _RIGHT - (down @ _RIGHT)[:, None] * down
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    front = np.cross(side, down)
    front *= np.sign(front @ _TOWARDS_VIEWER)[:, None]
    wide, deep = swept[:, 3, None, None], swept[:, 4, None, None]
    ring = (
        wide * np.sin(angle)[None, :, None] * side[:, None]
        + deep * np.cos(angle)[None, :, None] * front[:, None]
    )
    vertices = (swept[:, None, :3] + ring).reshape(-1, 3)
    return Tube(
        vertices=vertices,
        faces=grid_faces(closed_columns(rows, columns)),
        uv=grid_uv(rows, columns + 1),
        s=np.tile(angle / (2 * np.pi) * girth, rows),
        t=np.repeat(at, columns),
        girth=girth,
        length=float(knots[-1]),
    )

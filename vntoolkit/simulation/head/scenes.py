"""The scenes `head_turn`, `face` and `face_makeup` (Figures 2, 3, 8)."""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.simulation.head import rig
from vntoolkit.simulation.head.rig import (
    Expression,
    Head,
    HeadRig,
    Makeup,
    performance_at,
    performance_pose,
    read_head,
    turning_pose,
)
from vntoolkit.simulation.lights import FRAME_RATE_HZ, studio_camera, studio_centre
from vntoolkit.simulation.scene import Detail, Scene, SceneSurface
from vntoolkit.simulation.shapes import smooth_step

_TURN_FRAMES, _WIDEST_TURN_DEG = 90, 68.0
_FACE_FRAMES = 1000
_FIELD_WIDTH_M = 0.40
_FACE_FIELD_WIDTH_M = 0.355
_MIDDLE_CM = np.array([0.0, -0.6, 0.0])
_FACE_MIDDLE_CM = np.array([0.0, -0.3, 0.0])
_SKIN_GLOSS, _EYE_GLOSS = 0.010, 0.015
ROWS, COLUMNS = 1024, 2048
_LOW_CM, _HIGH_CM = -20.0, 12.6
_SKIN_ROWS = 0.97  # the rows above are plain: eyes, teeth, tongue
# how much a freckle takes from red, green, blue: melanin absorbs most at short wavelengths
_MELANIN = np.array([0.30, 0.62, 1.15])
_REFLECTANCES = {Makeup.NONE: np.array([0.64, 0.43, 0.33]), Makeup.UNIFORM: np.array([0.66, 0.62, 0.57])}
_SOFT = (rig.SKIN, rig.CAVITY, rig.LID_RIM)
# azimuth from the front, degrees, and the height where the hair begins there, centimetres
HAIRLINE_DEG = (0.0, 20.0, 40.0, 55.0, 66.0, 76.0, 84.0, 98.0, 118.0, 128.0, 145.0, 180.0)
HAIRLINE_CM = (7.0, 7.1, 6.4, 4.6, 2.6, -1.0, 2.6, 3.3, 2.6, -2.0, -6.0, -7.0)
_HAIR_EDGE_CM = 0.7


def build_head_turn(options: SceneOptions) -> Scene:
    """Return a freckled head that turns from 68° left to 68° right with a fixed expression."""
    head = HeadRig(read_head())

    def vertices(frame: int) -> Points:
        pose = turning_pose(frame / (_TURN_FRAMES - 1), _WIDEST_TURN_DEG)
        return head.vertices(Expression(), pose)

    return _scene("head_turn", options, Makeup.NONE, vertices, _TURN_FRAMES, _FIELD_WIDTH_M, _MIDDLE_CM)


def build_face(options: SceneOptions) -> Scene:
    """Return the bare face: it smiles, grimaces, speaks and blinks."""
    return _performing("face", options, Makeup.NONE)


def build_face_makeup(options: SceneOptions) -> Scene:
    """Return the same performance in makeup of one colour."""
    return _performing("face_makeup", options, Makeup.UNIFORM)


def _performing(name: str, options: SceneOptions, makeup: "Makeup") -> Scene:
    head = HeadRig(read_head())
    phases = np.random.default_rng(options.seed).uniform(0.0, 2.0 * np.pi, 8)

    def vertices(frame: int) -> Points:
        time_s = frame / FRAME_RATE_HZ
        return head.vertices(performance_at(time_s, phases), performance_pose(time_s, phases))

    return _scene(name, options, makeup, vertices, _FACE_FRAMES, _FACE_FIELD_WIDTH_M, _FACE_MIDDLE_CM)


def _scene(
    name: str,
    options: SceneOptions,
    makeup: "Makeup",
    vertices_cm: Callable[[int], Points],
    frame_count: int,
    field_width_m: float,
    middle_cm: Points,
) -> Scene:
    head = read_head()
    rng = np.random.default_rng(options.seed + 1)
    soft = np.isin(head.part, _SOFT)
    surface = SceneSurface(
        faces=head.faces,
        reference_weights=skin_reflectance(makeup),
        vertex_weights=head.colours[makeup],
        texture=skin_texture(rng, makeup),
        uv=corner_uv(head),
        detail=Detail(height_m=skin_relief(rng), strength=soft.astype(np.float64)),
        gloss=_gloss(head, makeup),
        gloss_exponent=30.0,
    )
    return Scene(
        name=name,
        camera=studio_camera(options, field_width_m),
        surface=surface,
        vertices=lambda frame: 0.01 * (vertices_cm(frame) - middle_cm) * [1.0, -1.0, -1.0] + studio_centre(),
        frame_count=frame_count,
    )


def _gloss(head: Head, makeup: "Makeup") -> Points:
    """Return (n,) the strength of the specular lobe: a trace on bare skin, none on matte makeup."""
    gloss = np.full(len(head.vertices), _SKIN_GLOSS if makeup is Makeup.NONE else 0.0)
    gloss[np.isin(head.part, (rig.EYES, rig.UPPER_TEETH, rig.LOWER_TEETH))] = _EYE_GLOSS
    return gloss


# The skin's colours and finest relief: freckles, brows, hair; or makeup.


def skin_reflectance(makeup: Makeup) -> FloatArray:
    """Return (3,) the RGB weights of most of the skin."""
    return _REFLECTANCES[makeup]


def corner_uv(head: Head) -> FloatArray:
    """Return (m, 3, 2) cylindrical texture coordinates; faces across the back are unwrapped."""
    u = azimuth_deg(head.vertices) / 360.0 + 0.5
    above = np.maximum(head.vertices[:, 1] - _LOW_CM, 0.0)  # the rim lies a hair to either side of the cut
    v = _SKIN_ROWS * above / (_HIGH_CM - _LOW_CM)
    own = ~np.isin(head.part, _SOFT)
    u, v = np.where(own, 0.5, u), np.where(own, 0.985, v)
    uv = np.stack([u, v], axis=1)[head.faces]
    wraps = np.ptp(uv[..., 0], axis=1) > 0.5
    uv[wraps, :, 0] += uv[wraps, :, 0] < 0.5
    return np.asarray(uv)


def skin_texture(rng: np.random.Generator, makeup: Makeup) -> FloatArray:
    """Return (1024, 2048, 3) float32 factors: freckles, mottle, brows, strands of hair."""
    azimuth, height = _texel_grid()
    hair = _hair_on_texels(azimuth, height)
    optical = np.zeros((ROWS, COLUMNS))
    brows = np.zeros((ROWS, COLUMNS))
    if makeup is Makeup.NONE:
        optical += _freckles(rng) + 0.05 * _noise(rng, 6.0) + 0.03 * _noise(rng, 25.0)
        brows += _brows(rng, azimuth, height)
    skin = np.exp(-np.clip(optical, -0.3, 3.0)[..., None] * _MELANIN)
    skin *= 1.0 - 0.86 * brows[..., None] * np.array([0.9, 0.97, 1.0])
    strands = np.clip(1.0 + 0.35 * _strands(rng), 0.3, 1.6)[..., None]
    texture = skin + hair[..., None] * (0.62 * strands - skin)
    texture[int(_SKIN_ROWS * ROWS) :] = 1.0
    return np.clip(texture, 0.0, 1.25).astype(np.float32)


def skin_relief(rng: np.random.Generator) -> FloatArray:
    """Return (1024, 2048) metres: pores, lines of the forehead, strands of hair."""
    azimuth, height = _texel_grid()
    hair = _hair_on_texels(azimuth, height)
    pores = 2.2e-5 * np.tanh(_noise(rng, 1.6)) + 2.0e-5 * _noise(rng, 4.0)
    lines = np.zeros_like(pores)
    for line in (3.9, 4.7, 5.5):
        wave = line + 0.12 * np.sin(np.radians(azimuth) * 7.0 + line)
        lines -= 1.2e-4 * np.exp(-0.5 * ((height - wave) / 0.10) ** 2) * np.exp(-((azimuth / 34.0) ** 4))
    relief = (pores + lines) * (1.0 - hair) + 1.6e-4 * hair * np.clip(_strands(rng), -2.0, 2.0)
    relief[int(_SKIN_ROWS * ROWS) - 4 :] = 0.0
    return np.asarray(relief)


def _texel_grid() -> tuple[FloatArray, FloatArray]:
    """Return azimuth in degrees and height in centimetres of every texel."""
    azimuth = ((np.arange(COLUMNS) + 0.5) / COLUMNS - 0.5) * 360.0
    height = _LOW_CM + (np.arange(ROWS) + 0.5) / ROWS / _SKIN_ROWS * (_HIGH_CM - _LOW_CM)
    grid = np.meshgrid(azimuth, height)
    return grid[0], grid[1]


def azimuth_deg(points: Points) -> FloatArray:
    """Return (n,) the angle about the vertical from the front, positive towards +x."""
    return np.degrees(np.arctan2(points[:, 0], points[:, 2]))


def hair_share(points: Points) -> FloatArray:
    """Return (n,) from 0 on skin to 1 in the hair."""
    azimuth = np.abs(azimuth_deg(points))
    line = np.interp(azimuth, HAIRLINE_DEG, HAIRLINE_CM)
    ripple = 0.10 * np.sin(1.7 * azimuth) + 0.14 * np.sin(0.43 * azimuth + 2.0) + 0.08 * np.sin(1.1 * azimuth)
    share = smooth_step((points[:, 1] - line - ripple) / _HAIR_EDGE_CM)
    in_ear = (
        (np.abs(points[:, 0]) > 6.75) & (points[:, 1] < 2.9) & (points[:, 2] > -2.6) & (points[:, 2] < 1.4)
    )
    return np.where(in_ear, 0.0, share)


def _hair_on_texels(azimuth: FloatArray, height: FloatArray) -> FloatArray:
    angle = np.radians(azimuth)
    points = np.stack([7.3 * np.sin(angle), height, 7.3 * np.cos(angle)], axis=-1).reshape(-1, 3)
    return hair_share(points).reshape(height.shape)


def _noise(rng: np.random.Generator, blur: float) -> FloatArray:
    """Return smooth noise of unit variance, wrapping round the head."""
    noise = gaussian_filter(rng.standard_normal((ROWS, COLUMNS)), blur, mode=("nearest", "wrap"))
    return np.asarray(noise / noise.std())


def _strands(rng: np.random.Generator) -> FloatArray:
    noise = gaussian_filter1d(rng.standard_normal((ROWS, COLUMNS)), 40.0, axis=0, mode="nearest")
    noise = gaussian_filter1d(noise, 1.2, axis=1, mode="wrap")
    return np.asarray(noise / noise.std())


def _freckles(rng: np.random.Generator) -> FloatArray:
    """Return the optical density of freckles, thickest over nose and cheeks, none on eyes and lips."""
    count = 1500
    azimuth = rng.normal(0.0, 26.0, count)
    height = rng.normal(-1.9, 1.9, count)
    radius = np.clip(rng.lognormal(np.log(0.075), 0.35, count), 0.04, 0.19)
    depth = np.clip(rng.normal(0.55, 0.22, count), 0.12, 1.2)
    on_eye = ((np.abs(azimuth) - 22.0) / 11.0) ** 2 + ((height + 0.1) / 1.2) ** 2 < 1.0
    on_lips = (np.abs(azimuth) < 19.0) & (np.abs(height + 6.8) < 1.2)
    keep = ~(on_eye | on_lips) & (np.abs(azimuth) < 78.0)
    density = np.zeros((ROWS, COLUMNS))
    column_cm, row_cm = 2.0 * np.pi * 8.6 / COLUMNS, (_HIGH_CM - _LOW_CM) / (ROWS * _SKIN_ROWS)
    for a, h, r, d in zip(azimuth[keep], height[keep], radius[keep], depth[keep], strict=True):
        u, v = (a / 360.0 + 0.5) * COLUMNS - 0.5, (h - _LOW_CM) / row_cm - 0.5
        reach = int(3.0 * r / min(column_cm, row_cm)) + 1
        rows = np.arange(int(v) - reach, int(v) + reach + 1)
        columns = np.arange(int(u) - reach, int(u) + reach + 1)
        squared = ((rows[:, None] - v) * row_cm) ** 2 + ((columns[None, :] - u) * column_cm) ** 2
        density[np.ix_(rows, columns)] += d * np.exp(-((squared / r**2) ** 1.5))
    return density


def _brows(rng: np.random.Generator, azimuth: FloatArray, height: FloatArray) -> FloatArray:
    """Return from 0 to 1 how much brow hair covers the skin."""
    away = np.abs(azimuth)
    along = (away - 6.5) / 33.0
    middle = 1.85 + 0.95 * np.sin(np.clip(along, 0.0, 1.0) * np.pi * 0.72) - 0.35 * np.clip(along, 0, 1)
    thickness = 0.46 * np.clip(1.0 - 0.6 * np.clip(along, 0.0, 1.0), 0.1, 1.0)
    body = (
        np.exp(-(((height - middle) / thickness) ** 4))
        * smooth_step(along / 0.12)
        * smooth_step((1.0 - along) / 0.2)
    )
    hairs = gaussian_filter(rng.standard_normal((ROWS, COLUMNS)), (2.2, 1.2), mode=("nearest", "wrap"))
    return np.asarray(body * np.clip(0.86 + 0.18 * hairs / hairs.std(), 0.0, 1.0))

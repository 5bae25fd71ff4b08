"""The interface between scenes and the renderer.

A scene is a function `SceneOptions -> Scene`, registered in `SCENES` below as "module:function". All
lengths are metres, all positions are in the camera frame (x right, y down, z forward, camera at the
origin); the subject stands at `studio_centre()` = (0, 0, 5).

    def build_sphere(options: SceneOptions) -> Scene:
        return Scene(
            name="sphere",
            camera=studio_camera(options, field_width_m=1.0),
            surface=SceneSurface(faces=faces, vertex_weights=weights),     # weights of the RGB pigments
            vertices=lambda frame: template + shift(frame),            # (n, 3) float64
            frame_count=60,
        )

Rules for `vertices`: topology never changes; any frame from 0 to frame_count - 1 may be asked for, but the
renderer's pipeline asks for them once, in rising order, in one process, and keeps them on disk. A solver
that steps through time may therefore simulate on demand and hold only its last state (restarting where an
earlier frame is asked for). Randomness comes from `np.random.default_rng(options.seed)` only.

Faces are counter-clockwise seen from outside: the outward geometric normal of a visible face has n_z < 0.
Shading normals are interpolated from area-weighted vertex normals: split vertices along a hard crease.
Both sides of a face stop light; only the outside is coloured (the inside is shaded with the flipped normal).
"""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from vntoolkit.arrays import Faces, FloatArray, Points, read_only
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.simulation import lights as studio

# name -> "module:function" of type SceneFactory; imported only when the scene is asked for
SCENES: dict[str, str] = {
    "cylinder": "vntoolkit.simulation.rigid.board_and_cylinder:build_cylinder",
    "board": "vntoolkit.simulation.rigid.board_and_cylinder:build_board",
    "board_sweep": "vntoolkit.simulation.rigid.board_and_cylinder:build_board_sweep",
    "sphere": "vntoolkit.simulation.rigid.sphere:build_sphere",
    "gel": "vntoolkit.simulation.rigid.gel:build_gel",
    "jacket": "vntoolkit.simulation.rigid.jacket:build_jacket",
    "sweater": "vntoolkit.simulation.garment.sweater:build_sweater",
    "sweater_stripes": "vntoolkit.simulation.garment.sweater:build_striped_sweater",
    "sweater_logo": "vntoolkit.simulation.garment.sweater:build_sweater_with_logo",
    "sweater_tartan": "vntoolkit.simulation.garment.sweater:build_tartan_sweater",
    "spandex": "vntoolkit.simulation.spandex:build_spandex",
    "head_turn": "vntoolkit.simulation.head.scenes:build_head_turn",
    "face": "vntoolkit.simulation.head.scenes:build_face",
    "face_makeup": "vntoolkit.simulation.head.scenes:build_face_makeup",
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Detail:
    """Relief too fine for the mesh: a height map that tilts the shading (and the true) normal.

    height_m: (th, tw) metres along the outward normal, tiling seamlessly. repeats: how often the tile
    repeats over uv = 1, along u and v. strength: (n,) per vertex factor from 0 to 1, or None for 1.
    The relief moves neither depth nor silhouette nor cast shadow; keep it below half a millimetre high.
    """

    height_m: FloatArray
    repeats: tuple[float, float] = (1.0, 1.0)
    strength: FloatArray | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneSurface:
    """Topology and material of a scene's one mesh.

    faces: (m, 3) int32. The reflectance of a point is a weighted sum of `rgb_pigments`. Its weights are the
    product of `vertex_weights` (n, 3), interpolated over the triangle, and `texture` (th, tw, 3), bilinear,
    tiling; either may be None for 1. uv: (m, 3, 2) per face corner, needed with texture or detail; (0, 0) is
    the first corner of texture[0, 0], u runs along its columns and v along its rows, 1 = the whole image.
    reference_weights: (3,) the material that M is stated for, usually the mean of the surface's weights.
    gloss: strength of the specular lobe (energy share, 0 = matte), a number or (n,) per vertex;
    gloss_exponent: its sharpness (Blinn-Phong).
    """

    faces: Faces
    reference_weights: FloatArray
    vertex_weights: FloatArray | None = None
    texture: FloatArray | None = None
    uv: FloatArray | None = None
    detail: Detail | None = None
    gloss: float | FloatArray = 0.0
    gloss_exponent: float = 20.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "faces", read_only(np.asarray(self.faces, dtype=np.int32)))
        require_shape(self.faces, (None, 3), "surface: faces")
        require_shape(np.asarray(self.reference_weights), (3,), "surface: reference_weights")
        if self.vertex_weights is not None:
            require_shape(self.vertex_weights, (None, 3), "surface: vertex_weights")
        if self.texture is not None:
            require_shape(self.texture, (None, None, 3), "surface: texture")
        if self.uv is not None:
            require_shape(self.uv, (len(self.faces), 3, 2), "surface: uv")
        elif self.texture is not None or self.detail is not None:
            raise BadInput("surface: a texture or detail needs uv, (m, 3, 2) per face corner")


@dataclass(frozen=True, kw_only=True, eq=False)
class Scene:
    """A filmed moving mesh (see the module's docstring for the rules).

    vertices: frame number -> (n, 3). centre: (3,) where M is stated; there every lamp has its nominal power.
    background_rgb: linear colour where no surface is, 1 = full scale.
    exposure_level: the brightest channel of the reference material at its best orientation, matte part,
    under the lamps `exposed_for`, or the scene's own where None.
    camera_from_object: frame number -> pose of the rigid object, or None where the surface deforms or has
    several parts that move apart. facts: what else is exactly known, by name with its unit, such as
    {"radius_m": 0.1}; written beside the truth.
    """

    name: str
    camera: Camera
    surface: SceneSurface
    vertices: Callable[[int], Points]
    frame_count: int
    lights: studio.Lights = field(default_factory=studio.studio_lights)
    centre: Points = field(default_factory=studio.studio_centre)
    background_rgb: float = 0.003
    exposure_level: float = 0.8
    exposed_for: studio.Lights | None = None
    camera_from_object: Callable[[int], RigidTransform] | None = None
    facts: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.camera.is_perspective:
            raise BadInput(f"scene {self.name}: expected a perspective camera, at the origin")
        if self.frame_count < 1:
            raise BadInput(f"scene {self.name}: expected at least one frame")

    @property
    def vertex_count(self) -> int:
        """How many vertices the mesh has."""
        return int(self.surface.faces.max()) + 1


def sample_weights(options: SceneOptions, otherwise: FloatArray) -> FloatArray:
    """Return (3,) the pigments of the material in the board's hole: another scene's, or the board's own."""
    if options.sample is None:
        return otherwise
    return build_scene(options.sample, replace(options, sample=None)).surface.reference_weights


SceneFactory = Callable[[SceneOptions], Scene]


def build_scene(name: str, options: SceneOptions) -> Scene:
    """Build the scene of that name. Raises `BadInput` for an unknown one."""
    if name not in SCENES:
        raise BadInput(f"unknown scene '{name}': expected one of {', '.join(sorted(SCENES))}")
    if options.sample is not None and options.sample not in SCENES:
        raise BadInput(f"simulate: no scene '{options.sample}' to take a sample from")
    module, function = SCENES[name].split(":")
    scene: Scene = getattr(importlib.import_module(module), function)(options)
    lights = scene.lights.under(options.lighting)
    alone = lights is not scene.lights and len(lights) == len(scene.lights)
    return replace(scene, lights=lights, exposed_for=scene.lights if alone else None)

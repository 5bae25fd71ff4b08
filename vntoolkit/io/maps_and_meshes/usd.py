"""Animated USD: a skinned mesh, a moving mesh, or a new mesh in every frame, in constant memory.

Vertices come in the camera frame (y down) and leave with y up, as every file, or z up. Houdini, Maya and
usdview take scale, up axis and frame rate from the file. Blender 5.0.1 takes scale, axis and the range of
frames but keeps the frame rate of its own scene, 24: set it there, or write the file at that rate, else the
motion plays too slowly. `scripts/check_in_blender.py` shows what arrives there.
"""

import contextlib
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import count as count_up
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.arrays import Array, FloatArray, Points
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadInput, BadMesh, CannotWrite
from vntoolkit.geometry.camera import ViewedFrom
from vntoolkit.geometry.mesh import Mesh, require_times, vertex_normals
from vntoolkit.geometry.motion import Motion, joint_paths, rest_pose
from vntoolkit.geometry.skinned_clip import SkinnedClip
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.conventions import graphics_from_camera, motion_with_axes_turned
from vntoolkit.io.maps_and_meshes.texture import SurfaceTexture
from vntoolkit.libraries import require_address_space, require_installed
from vntoolkit.options.export import MeshUpAxis

ROOT = "/World"
SURFACE = f"{ROOT}/Surface"
FIGURE = f"{ROOT}/Figure"
CLOTH = f"{ROOT}/Cloth"
CAMERA = f"{ROOT}/Camera"
SUFFIXES = (".usdc", ".usd")
_FLUSH_VERTICES = 2**19  # that take 12 to 36 MB
_ADDRESS_SPACE = 2 << 30  # bytes, mostly its threads' stacks and heaps; with less it ends the process


def write_usd_sequence(
    path: Path | str,
    template: Mesh,
    frames: Iterable[Points],
    *,
    frame_rate_hz: float,
    times_s: FloatArray | None = None,
    metres_per_unit: float = 1.0,
    motion: Motion | None = None,
    up: MeshUpAxis = MeshUpAxis.Y,
    camera: ViewedFrom | None = None,
    texture: SurfaceTexture | None = None,
) -> int:
    """Write one surface of fixed topology, its vertices (n, 3) a time sample a frame; return the frames.

    times_s: (frames,) of each, rising; None for one every 1 / frame_rate_hz seconds, as a skeleton asks.
    Colours become `displayColor`, texture coordinates `st`; normals are those of each frame. With `motion`
    (one frame a frame, in the same unit) the file also holds the skeleton as UsdSkel; the surface is not
    bound to it, its vertices move already. Memory does not grow with the number of frames.
    """
    if motion is not None and up is not MeshUpAxis.Y:
        raise BadInput(f"{path}: a skeleton is written with y up only")
    if motion is not None and times_s is not None:
        raise BadInput(f"{path}: a skeleton moves at an even rate; leave out times_s")
    codes = _time_codes(times_s, frame_rate_hz)
    count = 0
    with new_stage(path, frame_rate_hz=frame_rate_hz, metres_per_unit=metres_per_unit, up=up) as stage:
        mesh = _define_mesh(stage.stage)
        _set_topology(mesh, template, None)
        _set_attributes(mesh, template, None, up)
        add_material(stage.stage, mesh, template, texture)
        if motion is not None:
            add_skeleton(stage.stage, motion)
        if camera is not None:
            add_camera(stage.stage, camera, metres_per_unit, up)
        for count, vertices in enumerate(frames, start=1):
            require_shape(vertices, (len(template.vertices), 3), f"frame {count - 1}", BadMesh)
            require_finite(vertices, f"frame {count - 1}", BadMesh)
            time = next(codes)
            _set_points(mesh, vertices, time, up)
            _set_normals(mesh, vertex_normals(vertices, template.faces), time, up)
            stage.wrote(len(vertices), time)
    return count


def write_usd_meshes(
    path: Path | str,
    meshes: Iterable[Mesh],
    *,
    frame_rate_hz: float,
    times_s: FloatArray | None = None,
    metres_per_unit: float = 1.0,
    up: MeshUpAxis = MeshUpAxis.Y,
) -> int:
    """Write a mesh of its own topology for every frame; return the number of frames.

    times_s: as for `write_usd_sequence`. Memory does not grow with the number of frames. Colours and texture
    coordinates are written where a mesh has them.
    """
    count, codes = 0, _time_codes(times_s, frame_rate_hz)
    with new_stage(path, frame_rate_hz=frame_rate_hz, metres_per_unit=metres_per_unit, up=up) as stage:
        surface = _define_mesh(stage.stage)
        for mesh, time in zip(meshes, codes, strict=False):
            count += 1
            _set_points(surface, mesh.vertices, time, up)
            _set_topology(surface, mesh, time)
            _set_attributes(surface, mesh, time, up)
            if not stage.stage.GetPrimAtPath(CLOTH):
                add_material(stage.stage, surface, mesh, None)
            stage.wrote(len(mesh.vertices), time)
    return count


def write_usd_skin(
    path: Path | str,
    clip: SkinnedClip,
    *,
    camera: ViewedFrom | None = None,
    texture: SurfaceTexture | None = None,
) -> int:
    """Write a surface bound to its moving skeleton as UsdSkel, lengths in metres; return the frames.

    Joint indices and weights, blend shapes with their weights in each frame, normals, `st`, `displayColor`
    and a UsdPreviewSurface, with the textures where there are any.
    """
    rate = clip.motion.frame_rate_hz
    with new_stage(path, frame_rate_hz=rate, metres_per_unit=1.0) as stage:
        from pxr import UsdSkel, Vt

        names = [f"Fold_{number:02d}" for number in range(len(clip.shapes))]
        add_skeleton(stage.stage, clip.motion, clip.rest_from_model, names, clip.shape_weights)
        mesh = _define_mesh(stage.stage, f"{FIGURE}/Cloth")
        _set_points(mesh, clip.mesh.vertices, None, MeshUpAxis.Y)
        _set_topology(mesh, clip.mesh, None)
        _set_attributes(mesh, clip.mesh, None, MeshUpAxis.Y)
        add_material(stage.stage, mesh, clip.mesh, texture)
        binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
        binding.CreateSkeletonRel().SetTargets([f"{FIGURE}/Skeleton"])
        count = clip.joints.shape[1]
        joints = Vt.IntArray.FromNumpy(np.ascontiguousarray(clip.joints, dtype=np.int32).ravel())
        binding.CreateJointIndicesPrimvar(False, count).Set(joints)
        weights = Vt.FloatArray.FromNumpy(np.ascontiguousarray(clip.weights, dtype=np.float32).ravel())
        binding.CreateJointWeightsPrimvar(False, count).Set(weights)
        binding.CreateGeomBindTransformAttr().Set(_matrices(np.eye(4)[None])[0])
        targets = []
        for name, shape in zip(names, clip.shapes, strict=True):
            target = UsdSkel.BlendShape.Define(stage.stage, f"{FIGURE}/Cloth/{name}")
            target.CreateOffsetsAttr(vec3f_from_camera(shape))
            targets.append(target.GetPath())
        if targets:
            binding.CreateBlendShapesAttr().Set(Vt.TokenArray(names))
            binding.CreateBlendShapeTargetsRel().SetTargets(targets)
        if camera is not None:
            add_camera(stage.stage, camera)
        stage.last = len(clip.motion) - 1.0
    return len(clip.motion)


def _time_codes(times_s: FloatArray | None, frame_rate_hz: float) -> Iterator[float]:
    """Yield the time code of each frame: a whole number where it is one of an even rate."""
    if times_s is None:
        return map(float, count_up())
    require_times(times_s, len(times_s), "times of a USD file")
    return iter(np.round((times_s - times_s[:1]) * frame_rate_hz, 6).tolist())


def _define_mesh(stage: Any, path: str = SURFACE) -> Any:
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh.Define(stage, path)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)  # else viewers smooth the capture away
    mesh.CreateDoubleSidedAttr(True)  # captured cloth is one layer, seen from both sides
    return mesh


def _time(time: float | None) -> Any:
    from pxr import Usd

    return Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)


def _set_points(mesh: Any, vertices: Points, time: float | None, up: MeshUpAxis) -> None:
    """Author positions and their bounding box."""
    from pxr import Vt

    points = vec3f_from_camera(vertices, up)
    mesh.CreatePointsAttr().Set(points, _time(time))
    box = np.zeros((2, 3))
    if len(vertices):
        columns = [vertices[:, axis] for axis in range(3)]  # numpy is ten times slower along the first axis
        ends = [[column.min() for column in columns], [column.max() for column in columns]]
        turned = graphics_from_camera(np.array(ends), up)
        box = np.stack([turned.min(axis=0), turned.max(axis=0)])  # turning swaps least and greatest
    mesh.CreateExtentAttr().Set(Vt.Vec3fArray.FromNumpy(box.astype(np.float32)), _time(time))


def _set_topology(surface: Any, mesh: Mesh, time: float | None) -> None:
    from pxr import Vt

    counts = np.full(len(mesh.faces), 3, dtype=np.int32)
    surface.CreateFaceVertexCountsAttr().Set(Vt.IntArray.FromNumpy(counts), _time(time))
    indices = np.ascontiguousarray(mesh.faces, dtype=np.int32).ravel()
    surface.CreateFaceVertexIndicesAttr().Set(Vt.IntArray.FromNumpy(indices), _time(time))


def _set_normals(surface: Any, normals: Points, time: float | None, up: MeshUpAxis) -> None:
    from pxr import UsdGeom

    surface.CreateNormalsAttr().Set(vec3f_from_camera(normals, up), _time(time))
    surface.SetNormalsInterpolation(UsdGeom.Tokens.vertex)


def _set_attributes(surface: Any, mesh: Mesh, time: float | None, up: MeshUpAxis) -> None:
    """Author normals, and colours and texture coordinates where there are any."""
    from pxr import Sdf, UsdGeom, Vt

    normals = vertex_normals(mesh.vertices, mesh.faces) if mesh.normals is None else mesh.normals
    _set_normals(surface, normals, time, up)
    kinds = Sdf.ValueTypeNames
    for name, kind, array, values in (
        ("displayColor", kinds.Color3fArray, Vt.Vec3fArray, mesh.colours),
        ("st", kinds.TexCoord2fArray, Vt.Vec2fArray, mesh.uv),
    ):
        if values is not None:
            primvar = UsdGeom.PrimvarsAPI(surface).CreatePrimvar(name, kind, UsdGeom.Tokens.vertex)
            primvar.Set(array.FromNumpy(np.ascontiguousarray(values, dtype=np.float32)), _time(time))


class UsdStage:
    """An open stage; `wrote(vertices, time)` after each frame lets it empty its memory into the file.

    last: the last time code.
    A saved crate layer keeps only where each time sample lies in the file, and saving again appends. So
    a save every so many vertices bounds the memory, and one file results, where value clips would need many.
    """

    def __init__(self, stage: Any) -> None:
        self.stage = stage
        self._pending = 0
        self.last = 0.0

    def wrote(self, vertices: int, time: float) -> None:
        """Count the frame of a time code; save where enough has gathered."""
        self.last = time
        self._pending += vertices
        if self._pending >= _FLUSH_VERTICES:
            self.save()

    def save(self) -> None:
        """Append what is in memory to the file, with the time range so far."""
        self.stage.SetStartTimeCode(0)
        self.stage.SetEndTimeCode(self.last)
        self.stage.GetRootLayer().Save()
        self._pending = 0


@contextlib.contextmanager
def new_stage(
    path: Path | str, *, frame_rate_hz: float, metres_per_unit: float, up: MeshUpAxis = MeshUpAxis.Y
) -> Iterator[UsdStage]:
    """Yield a stage with its up axis, length unit, frame rate (time code = frame) and a root prim."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise BadInput(f"{path}: expected a name that ends in .usdc or .usd (binary USD)")
    if not 0 < frame_rate_hz < np.inf or not 0 < metres_per_unit < np.inf:
        raise BadInput(f"{path}: expected a positive frame rate and length unit")
    require_installed("pxr", "usd-core", f"{path}: USD files need usd-core, or write .glb")
    require_address_space(_ADDRESS_SPACE, "USD")
    from pxr import Sdf, Tf, Usd, UsdGeom

    with atomic_path(path) as temporary:
        try:
            layer = Sdf.Layer.CreateNew(str(temporary), {"format": "usdc"})
            stage = Usd.Stage.Open(layer)
            UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y if up is MeshUpAxis.Y else UsdGeom.Tokens.z)
            UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit)
            stage.SetTimeCodesPerSecond(frame_rate_hz)
            stage.SetFramesPerSecond(frame_rate_hz)
            stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, ROOT).GetPrim())
            open_stage = UsdStage(stage)
            yield open_stage
            open_stage.save()
        except Tf.ErrorException as error:
            said = "; ".join(" ".join(str(each.commentary).split()) for each in error.args)
            raise CannotWrite(
                f"cannot write {path}: USD says: {said[:200]}; see that there is room, or choose another name"
            ) from error


def vec3f_from_camera(vectors: Array, up: MeshUpAxis = MeshUpAxis.Y) -> Any:
    """Return a USD array of (n, 3) vectors turned from the camera frame to y or z up."""
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(graphics_from_camera(np.asarray(vectors, dtype=np.float32), up))


def add_material(stage: Any, surface: Any, mesh: Mesh, texture: SurfaceTexture | None) -> None:
    """Define a matte UsdPreviewSurface and bind the surface to it.

    Its colour is the texture's, else that of the primvar `displayColor`; without either there is none.
    """
    from pxr import Gf, Sdf, UsdShade

    if mesh.colours is None and texture is None:
        return
    kinds = Sdf.ValueTypeNames
    material = UsdShade.Material.Define(stage, CLOTH)

    def node(name: str, kind: str) -> Any:
        shader = UsdShade.Shader.Define(stage, f"{CLOTH}/{name}")
        shader.CreateIdAttr(kind)
        return shader

    def primvar(name: str, varname: str, size: int) -> Any:
        reader = node(name, f"UsdPrimvarReader_float{size}")
        reader.CreateInput("varname", kinds.String).Set(varname)
        return reader.CreateOutput("result", kinds.Float3 if size == 3 else kinds.Float2)

    def texels(name: str, file: Path, space: str) -> tuple[Any, Any]:
        image = node(name, "UsdUVTexture")
        image.CreateInput("file", kinds.Asset).Set(Sdf.AssetPath(f"./{file.name}"))
        image.CreateInput("sourceColorSpace", kinds.Token).Set(space)
        for wrap in ("wrapS", "wrapT"):
            image.CreateInput(wrap, kinds.Token).Set("clamp")
        image.CreateInput("st", kinds.Float2).ConnectToSource(st)
        return image, image.CreateOutput("rgb", kinds.Float3)

    shader = node("Matte", "UsdPreviewSurface")
    colour = shader.CreateInput("diffuseColor", kinds.Color3f)
    shader.CreateInput("roughness", kinds.Float).Set(1.0)
    shown_texture = texture if mesh.uv is not None else None
    if mesh.colours is not None and (shown_texture is None or shown_texture.albedo is None):
        colour.ConnectToSource(primvar("Colour", "displayColor", 3))
    if shown_texture is not None:
        st = primvar("Places", "st", 2)
        if shown_texture.albedo is not None:
            colour.ConnectToSource(texels("Albedo", shown_texture.albedo, "sRGB")[1])
        image, output = texels("Normal", shown_texture.normal, "raw")
        image.CreateInput("scale", kinds.Float4).Set(Gf.Vec4f(2, 2, 2, 1))
        image.CreateInput("bias", kinds.Float4).Set(Gf.Vec4f(-1, -1, -1, 0))
        shader.CreateInput("normal", kinds.Normal3f).ConnectToSource(output)
    shown = shader.CreateOutput("surface", kinds.Token)
    material.CreateSurfaceOutput().ConnectToSource(shown)
    UsdShade.MaterialBindingAPI.Apply(surface.GetPrim()).Bind(material)


_APERTURE_MM = 36.0


def add_camera(
    stage: Any, camera: ViewedFrom, metres_per_unit: float = 1.0, up: MeshUpAxis = MeshUpAxis.Y
) -> None:
    """Define the camera that filmed; its position is in the file's lengths, and so is the scene's offset."""
    from pxr import Gf, Sdf, UsdGeom

    prim = UsdGeom.Camera.Define(stage, CAMERA)
    turn = graphics_from_camera(np.eye(3), up).T
    matrix = np.eye(4)
    matrix[:3, :3] = turn @ camera.rotation @ np.diag([1.0, -1.0, -1.0])
    matrix[:3, 3] = turn @ camera.position
    prim.AddTransformOp().Set(Gf.Matrix4d(matrix.T.tolist()))
    offset = prim.GetPrim().CreateAttribute("userProperties:vntoolkit_offset", Sdf.ValueTypeNames.Double3)
    offset.Set(Gf.Vec3d(*(turn @ camera.offset).tolist()))
    width = 10 * _APERTURE_MM * 0.001 / metres_per_unit  # USD counts apertures in tenths of its unit
    prim.CreateHorizontalApertureAttr(width)
    prim.CreateVerticalApertureAttr(width / camera.aspect_ratio)
    prim.CreateFocalLengthAttr(width * camera.camera.matrix[0, 0] / camera.camera.width)
    prim.CreateClippingRangeAttr(Gf.Vec2f(0.01 / metres_per_unit, 1000 / metres_per_unit))


def add_skeleton(
    stage: Any,
    motion: Motion,
    bind: FloatArray | None = None,
    shapes: Sequence[str] = (),
    shape_weights: FloatArray | None = None,
) -> None:
    """Define a SkelRoot with the skeleton, its rest pose and one time sample a frame.

    bind: (j, 4, 4) the pose of attachment in camera axes, else the rest pose. shapes: names of blend shapes.
    shape_weights: (frames, shapes).
    """
    from pxr import UsdSkel, Vt

    turned = motion_with_axes_turned(motion)
    named = replace(turned.skeleton, names=tuple(map(_usd_name, turned.skeleton.names)))
    paths = Vt.TokenArray(joint_paths(named))
    root = UsdSkel.Root.Define(stage, FIGURE)
    skeleton = UsdSkel.Skeleton.Define(stage, f"{FIGURE}/Skeleton")
    skeleton.CreateJointsAttr(paths)
    turn = np.diag([1.0, -1.0, -1.0, 1.0])
    bound = rest_pose(turned.skeleton) if bind is None else np.asarray(turn @ bind @ turn)
    skeleton.CreateBindTransformsAttr(_matrices(bound))
    matrices = np.tile(np.eye(4), (len(turned.skeleton.names), 1, 1))
    matrices[:, :3, 3] = turned.skeleton.offsets
    skeleton.CreateRestTransformsAttr(_matrices(matrices))
    _author_extents(root, skeleton, turned)
    animation = UsdSkel.Animation.Define(stage, f"{FIGURE}/Skeleton/Motion")
    animation.CreateJointsAttr(paths)
    animation.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(np.ones((len(paths), 3), dtype=np.float16)))
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    translations, rotations = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    # Quatf.FromNumpy takes (x, y, z, w), the order in memory of USD's quaternions.
    quaternions = np.ascontiguousarray(turned.rotations, dtype=np.float32)
    if shapes and shape_weights is not None:
        animation.CreateBlendShapesAttr(Vt.TokenArray(list(shapes)))
        sliders = animation.CreateBlendShapeWeightsAttr()
        for frame, weights in enumerate(np.asarray(shape_weights, dtype=np.float32)):
            sliders.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(weights)), float(frame))
    for frame, root_position in enumerate(motion.root_positions):
        offsets = np.array(motion.skeleton.offsets)
        offsets[0] = root_position
        translations.Set(vec3f_from_camera(offsets), float(frame))
        rotations.Set(Vt.QuatfArray.FromNumpy(quaternions[frame]), float(frame))


def _author_extents(root: Any, skeleton: Any, turned: Motion) -> None:
    """Give both boxes that hold the figure in every frame: no joint is farther than the skeleton's reach."""
    from pxr import Vt

    reach = float(np.abs(turned.skeleton.offsets[1:]).sum() + np.abs(turned.skeleton.tip_offsets).sum())
    low, high = turned.root_positions.min(axis=0) - reach, turned.root_positions.max(axis=0) + reach
    box = Vt.Vec3fArray.FromNumpy(np.stack([low, high]).astype(np.float32))
    root.CreateExtentAttr(box)
    skeleton.CreateExtentAttr(box)


def _usd_name(name: str) -> str:
    """Turn a joint's name into one that USD accepts: a slash in it would make a joint of each half."""
    plain = re.sub(r"[^A-Za-z0-9_]", lambda m: f"_{ord(m.group()):x}_", name)
    return plain if not plain[0].isdigit() else f"_{plain}"


def _matrices(target_from_source: FloatArray) -> Any:
    """Return a USD array; USD multiplies row vectors, so every matrix is transposed."""
    from pxr import Vt

    return Vt.Matrix4dArray.FromNumpy(np.ascontiguousarray(target_from_source.transpose(0, 2, 1)))

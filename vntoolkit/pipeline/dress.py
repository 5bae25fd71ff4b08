"""A captured garment on an animated skeleton: fit, weights, skinning, output, one frame at a time."""

import logging
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit import progress
from vntoolkit.arrays import Float32Array, Points, Vector3
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera, ViewedFrom
from vntoolkit.geometry.garment_fit import GarmentFit
from vntoolkit.geometry.mesh import Mesh, MeshSequence, vertex_normals
from vntoolkit.geometry.motion import Motion, Skeleton, bone_segments, pose_of_frame
from vntoolkit.geometry.skinned_clip import SkinnedClip, blend_shapes
from vntoolkit.io.atomic import require_writable_folder
from vntoolkit.io.footage.frame_range import sampled
from vntoolkit.io.maps_and_meshes.glb import write_glb, write_glb_skin
from vntoolkit.io.maps_and_meshes.meshes import write_material, write_mesh
from vntoolkit.io.maps_and_meshes.texture import SurfaceTexture
from vntoolkit.io.maps_and_meshes.usd import write_usd_sequence, write_usd_skin
from vntoolkit.io.motion.asf import read_asf_amc
from vntoolkit.io.motion.bvh import read_bvh
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.options.dressing import AnimationStorage, Blend, DressOptions, Garment, MotionUpAxis
from vntoolkit.pipeline.texture_files import read_texture, texture_of_tracks, with_captured_colours
from vntoolkit.pipeline.tracked_folder import read_track_record, read_tracks, recorded_camera
from vntoolkit.shipped import shipped_files
from vntoolkit.skinning import clock as clocks
from vntoolkit.skinning.alignment import CapturedMotion, parts_of
from vntoolkit.skinning.anatomy import anatomy_of, legs_of
from vntoolkit.skinning.attachment import GarmentCover, weights_without_web
from vntoolkit.skinning.blending import skinned_vertices
from vntoolkit.skinning.findings import DressingFindings, DressingMeter
from vntoolkit.skinning.fitting import Fitting, fit_garment_to_figure
from vntoolkit.skinning.sleeves import regions_of_garment
from vntoolkit.skinning.weights import SkinWeights

logger = logging.getLogger(__name__)
_FLOOR_SAMPLES = 50
_FOLDS = 16  # blend shapes: what is left out of the folds of a walking jumper is below a millimetre
_FRAMES_LOOKED_AT = 12  # for sleeves or legs that stand apart
_KEPT_BYTES = 1 << 28  # frames of a clip of some seconds; of a longer one the others are made anew
_WEB_SAMPLES = 32  # poses of the motion in which web is looked for
_Z_UP_TO_Y_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # in camera axes: −z becomes −y
_FILE_SUFFIXES, _SEQUENCE_SUFFIXES = (".usdc", ".usd", ".glb"), (".ply", ".obj")


@dataclass(frozen=True, kw_only=True, eq=False)
class DressedFigure:
    """The garment on the figure; metres, camera axes, in the world of the motion.

    cloth: as captured, less the web that was cut. cut_triangles: how many those were. motion: the skeleton's,
    already on the clock. attached_in: the captured frame in which the cloth was attached. fitting: how that
    frame was brought onto the figure, and R of equation 8. captured: takes the captured frames into the pose
    of attachment.
    """

    cloth: MeshSequence
    motion: Motion
    clock: clocks.Clock
    fitting: Fitting
    weights: SkinWeights
    blend: Blend
    captured: CapturedMotion
    carrier: AnimationStorage
    attached_in: int = 0
    is_centred: bool = False
    cut_triangles: int = 0

    def __len__(self) -> int:
        return len(self.clock)

    @cached_property
    def template(self) -> Mesh:
        """Topology, colours and texture coordinates, with the attached frame in the pose of attachment."""
        on_figure = self.fitting.rest_from_cloth.apply(self.cloth[self.attached_in].vertices)
        return self.cloth.template.with_vertices(self.captured.first_at_rest(on_figure))

    def meter(self) -> DressingMeter:
        """Return what measures posed frames of this garment."""
        on_figure = self.fitting.rest_from_cloth.apply(self.cloth[self.attached_in].vertices)
        kind, skeleton = self.fitting.garment, self.motion.skeleton
        bare = kind.is_lower or kind is Garment.SLEEVELESS
        return DressingMeter(self.template, on_figure, self.fitting.sleeved, skeleton, has_sleeves=not bare)

    def frames(self) -> Iterator[Points]:
        """Return the vertices (n, 3) of each frame of the clock, one after the other."""
        return map(self.frame, range(len(self)))

    def frame(self, index: int) -> Points:
        """Return the vertices (n, 3) of one frame of the clock."""
        pose, rest = pose_of_frame(self.motion, index), self.rest_frame(index)
        return skinned_vertices(rest, self.weights, pose, self.fitting.rest_from_model, self.blend)

    @cached_property
    def _kept(self) -> dict[int, Float32Array]:
        """Frames in the pose of attachment: findings, blend shapes and pictures all need them."""
        return {}

    def rest_frame(self, index: int) -> Points:
        """Return the captured cloth (n, 3) in a frame of the clock, in the pose of attachment."""
        if index in self._kept:
            return self._kept[index]
        captured = next(clocks.resampled_vertices(self.cloth, self.clock.cloth_s[index : index + 1]))
        rest = self.captured.at_rest(self.fitting.rest_from_cloth.apply(captured)).astype(np.float32)
        if (len(self._kept) + 1) * rest.nbytes <= _KEPT_BYTES:
            self._kept[index] = rest
        return rest

    @cached_property
    def offset(self) -> Vector3:
        """(3,) by which files hold it moved: the root begins above the origin, the feet are on the floor."""
        if not self.is_centred:
            return np.zeros(3)
        x, _, z = self.motion.root_positions[0]
        return -np.array([x, floor_height(self.motion), z])

    def viewed_from(self, camera: Camera) -> ViewedFrom | None:
        """Return the camera of the capture before the figure of the first frame; None without perspective."""
        if not camera.is_perspective:
            return None
        attached, first = self.fitting.rest_from_model[0], pose_of_frame(self.motion, 0)[0]
        ahead = first[:3, :3] @ attached[:3, :3].T @ np.array([0.0, 0.0, 1.0])
        turn = np.eye(3)
        if np.hypot(ahead[0], ahead[2]) > 1e-6:  # else the figure lies down
            turn = Rotation.from_rotvec([0.0, np.arctan2(ahead[0], ahead[2]), 0.0]).as_matrix()
        placed = self.fitting.rest_from_cloth.rigid
        return ViewedFrom(
            camera=camera,
            position=turn @ (placed.translation - attached[:3, 3]) + first[:3, 3] + self.offset,
            rotation=turn @ placed.rotation,
            offset=self.offset,
        )

    def skin(self) -> SkinnedClip:
        """Return the garment as other programs animate it: joint weights, and blend shapes for its folds."""
        template = self.template
        count = min(_FOLDS, len(self.cloth) - 1)
        base, shapes, weights, error = blend_shapes(
            template.vertices, lambda: map(self.rest_frame, range(len(self))), count
        )
        normals = vertex_normals(template.vertices, template.faces)
        return SkinnedClip(
            mesh=replace(template, vertices=base, normals=normals),
            joints=self.weights.joints,
            weights=self.weights.weights,
            rest_from_model=self.fitting.rest_from_model,
            motion=self.motion,
            shapes=shapes,
            shape_weights=weights,
            shape_error=error,
        )


def dress(
    cloth: MeshSequence, motion: Motion, options: DressOptions | None = None, fit: GarmentFit | None = None
) -> DressedFigure:
    """Attach a moving garment to a moving skeleton (Section VII-C of brostow2011); nothing is skinned yet.

    Weights are found once, in the pose of attachment, on the first captured frame in which sleeves or legs
    stand apart.
    """
    options, fit = options or DressOptions(), fit or GarmentFit()
    motion = _upright(motion, options.up_axis).in_metres(options.figure_height)
    if not len(cloth):
        raise BadInput("the garment has no frame")
    attached_in = 0 if fit.landmarks else _telling_frame(cloth, options.fitting.garment)
    garment = cloth[attached_in]
    fitting = fit_garment_to_figure(garment, motion, fit, options.fitting, named_joints(options.map))
    if options.fitting.garment is Garment.AUTO and fitting.garment is Garment.SWEATER and not fitting.sleeved:
        logger.warning(
            "neither sleeves nor legs stand out from the garment's outline: it is worn as a sweater; film "
            "them apart, track from a frame where they are (track --template), or name the garment, as "
            "--garment skirt"
        )
    attached = garment.with_vertices(fitting.rest_from_cloth.apply(garment.vertices))
    clock = clocks.clock_from_recordings(cloth, motion, options.clock)
    played = clocks.resampled_motion(motion, clock.motion_s, clock.frame_rate_hz)
    skeleton = motion.skeleton
    frames = sampled(range(len(played)), _WEB_SAMPLES)
    weights, faces = weights_without_web(
        attached,
        skeleton,
        fitting.rest_from_model,
        options.weights,
        poses=np.stack([pose_of_frame(played, frame) for frame in frames]),
        max_stretch=options.max_stretch,
        cover=_cover(fitting, skeleton),
    )
    cut = len(attached.faces) - len(faces)
    logger.info("%d frames at %g Hz; %d triangles cut", len(clock), clock.frame_rate_hz, cut)
    legs = legs_of(skeleton, anatomy_of(skeleton)) if fitting.garment is Garment.TROUSERS else ()
    parts = parts_of(options.anchor, anatomy_of(skeleton), fitting.sleeved, skeleton, legs)
    return DressedFigure(
        cloth=replace(cloth, template=replace(cloth.template, faces=faces)),
        motion=played,
        clock=clock,
        fitting=fitting,
        weights=weights,
        blend=options.blend,
        carrier=options.carrier if options.blend is Blend.LINEAR else AnimationStorage.CACHE,
        attached_in=attached_in,
        captured=CapturedMotion(attached.vertices, weights, parts, fitting.rest_from_first, faces),
        is_centred=options.centre,
        cut_triangles=cut,
    )


def _telling_frame(cloth: MeshSequence, kind: Garment) -> int:
    """Return the first of some frames that shows both sleeves or both legs apart, else the best of them."""
    if kind not in (Garment.AUTO, Garment.TROUSERS, Garment.SWEATER):
        return 0
    most, best = -1, 0
    for frame in sampled(range(len(cloth)), _FRAMES_LOOKED_AT):
        regions = regions_of_garment(cloth[frame])
        shown = len(regions.sleeves) if regions.hems is None else 2
        if shown > most:
            most, best = shown, frame
        if most == 2:
            break
    return best


def named_joints(pairs: tuple[str, ...]) -> dict[str, str]:
    """Return the joints by role of `--map left-upper-arm=Bone7 …`. Raises `BadInput`."""
    named = {}
    for pair in pairs:
        role, equals, joint = pair.partition("=")
        if not (role and equals and joint):
            raise BadInput(f"map: expected ROLE=JOINT, such as left-upper-arm=Bone7, got {pair!r}")
        named[role] = joint
    return named


def _cover(fitting: Fitting, skeleton: Skeleton) -> GarmentCover:
    """Tell the weights which cloth covers what; where one arm has a sleeve, one without moves no cloth."""
    sleeved, anatomy = {one.arm.side for one in fitting.sleeved}, anatomy_of(skeleton)
    bare = [joint for arm in fitting.arms if arm.side not in sleeved for joint in arm.joints]
    if fitting.garment.is_lower:
        bare = [joint for joint in range(1, len(skeleton.names)) if joint not in anatomy.legs]
    elif not sleeved and fitting.garment is not Garment.SLEEVELESS:
        bare = []  # tubes and sheets whose sleeves do not stand out hang on the nearest bones
    return GarmentCover(
        sleeves=fitting.sleeved,
        trunk=fitting.regions.trunk,
        bones_from_pose=np.linalg.inv(fitting.rest_from_first),
        bare=tuple(bare),
    )


def floor_height(motion: Motion) -> float:
    """Return y of the lowest bone over the whole motion, sampled: that is where the figure stands."""
    poses = (pose_of_frame(motion, moment) for moment in sampled(range(len(motion)), _FLOOR_SAMPLES))
    return max(float(bone_segments(motion.skeleton, pose)[2][:, 1].max()) for pose in poses)


def _upright(motion: Motion, up_axis: MotionUpAxis) -> Motion:
    points = np.concatenate([motion.skeleton.rest_positions, motion.skeleton.rest_tips])
    extent = np.ptp(points, axis=0)
    is_z = up_axis is MotionUpAxis.Z or (up_axis is MotionUpAxis.AUTO and extent[2] > extent[1])
    return motion.turned(_Z_UP_TO_Y_UP) if is_z else motion


@dataclass(frozen=True, kw_only=True)
class DressSummary:
    """What was written.

    frames: how many. findings: what was measured of them. fold_error: of a skin, what its blend shapes leave
    out of the folds, 95th percentile, metres; None for a cache.
    """

    frames: int
    findings: DressingFindings
    fold_error: float | None = None


def write_dressed_figure(
    dressed: DressedFigure,
    out: Path | str,
    camera: Camera | None = None,
    texture: SurfaceTexture | None = None,
) -> DressSummary:
    """Write `.usdc`/`.usd` (with skeleton), `.glb`, or one `.ply`/`.obj` a frame (`cloth_%04d.ply`).

    camera, texture: for the file, as `captured_look` finds them beside the tracks.
    """
    out = Path(out)
    require_figure_name(out)
    require_writable_folder(out.parent)
    rate, meter, offset = dressed.clock.frame_rate_hz, dressed.meter(), dressed.offset
    texture = texture if dressed.template.uv is not None else None
    is_glb, is_file = out.suffix.lower() == ".glb", out.suffix.lower() in _FILE_SUFFIXES
    if texture is not None and is_file and not is_glb:
        texture = texture.beside(out)

    def frames() -> Iterator[Points]:
        for index, vertices in enumerate(progress.counted(dressed.frames(), "dress", len(dressed))):
            meter.add(vertices, pose_of_frame(dressed.motion, index))
            yield vertices + offset

    viewed = None if camera is None else dressed.viewed_from(camera)
    shown: dict[str, Any] = {"camera": viewed, "texture": texture}
    if dressed.carrier is AnimationStorage.SKIN and is_file:
        clip = dressed.skin().moved(offset)
        count = (write_glb_skin if is_glb else write_usd_skin)(out, clip, **shown)
        for _ in frames():
            pass  # measured
        return DressSummary(frames=count, findings=meter.findings, fold_error=clip.shape_error)
    match out.suffix.lower():
        case ".glb":
            count = write_glb(out, dressed.template, frames(), frame_rate_hz=rate, **shown)
        case suffix if suffix in _SEQUENCE_SUFFIXES:
            count = _write_files(dressed.template, frames(), out, texture)
        case _:
            shown["motion"] = replace(dressed.motion, root_positions=dressed.motion.root_positions + offset)
            count = write_usd_sequence(out, dressed.template, frames(), frame_rate_hz=rate, **shown)
    return DressSummary(frames=count, findings=meter.findings)


def require_figure_name(out: Path) -> None:
    """Raise `BadInput` unless `write_dressed_figure` can tell from the name what to write."""
    suffix = out.suffix.lower()
    if suffix in _FILE_SUFFIXES:
        return
    if suffix not in _SEQUENCE_SUFFIXES:
        raise BadInput(f"{out}: expected .usdc, .usd, .glb, or a pattern such as cloth_%04d.ply (or .obj)")
    try:
        names = {out.name % 0, out.name % 1}
    except (TypeError, ValueError):
        names = set()
    if len(names) != 2:
        raise BadInput(f"{out.name}: expected one place for the frame number, as in cloth_%04d.ply")


def _write_files(
    template: Mesh, frames: Iterable[Points], pattern: Path, texture: SurfaceTexture | None
) -> int:
    count, material = 0, None
    if texture is not None and pattern.suffix.lower() == ".obj":
        shared = pattern.with_name(f"{pattern.stem.split('%')[0].rstrip('_') or 'cloth'}.mtl")
        texture, material = texture.beside(shared), shared.name
        write_material(shared, texture.albedo, texture.normal)
    for count, vertices in enumerate(frames, start=1):
        normals = vertex_normals(vertices, template.faces)
        mesh = replace(template, vertices=vertices, normals=normals)
        write_mesh(pattern.with_name(pattern.name % (count - 1)), mesh, material=material)
    return count


def read_motion(path: Path | str, skeleton: Path | str | None = None) -> Motion:
    """Read `.bvh`, or `.amc` with its `.asf` (by default the one of the same name, or the only one there).

    `data/walk.bvh`, where no such file is, is the walk that the package ships.
    """
    path = _given_or_shipped(Path(path))
    match path.suffix.lower():
        case ".bvh":
            return read_bvh(path)
        case ".amc":
            return read_asf_amc(Path(skeleton) if skeleton else _skeleton_beside(path), path)
        case suffix:
            raise BadInput(f"{path}: expected a motion in .bvh or .amc, got {suffix or 'no suffix'}")


def _given_or_shipped(path: Path) -> Path:
    """Return the file, or the one of that name that the package ships in data/."""
    if not path.exists() and len(path.parts) == 2 and path.parts[0] == "data":
        return shipped_files().get(path.name, path)
    return path


def _skeleton_beside(path: Path) -> Path:
    """Find the skeleton of an AMC file: same name, else the longest name that begins the motion's."""
    candidates = [
        file
        for file in sorted(path.parent.glob("*.[aA][sS][fF]"))
        if path.stem.lower().startswith(file.stem.lower())
    ]
    if not candidates:
        raise BadInput(f"{path}: no skeleton (.asf) of that name beside it; name one with --skeleton")
    return max(candidates, key=lambda file: len(file.stem))


def captured_look(folder: Path | str) -> tuple[Camera | None, SurfaceTexture | None]:
    """Return the camera and the texture of tracks, as far as the folder of `read_tracked_cloth` has them."""
    track = _track_folder(Path(folder))
    if not (track / "track.json").exists():
        return None, None
    record = read_track_record(track)
    camera = recorded_camera(record).without_distortion() if "camera" in record else None
    return camera, texture_of_tracks(track)


def read_tracked_cloth(folder: Path | str) -> MeshSequence:
    """Open the registered mesh that `track` left in a folder (or the folder `track` itself)."""
    track = _track_folder(Path(folder))
    if not (track / "track.json").exists():
        return read_mesh_sequence(track)
    tracks = read_tracks(track)
    if tracks.template_vertices is None:
        return tracks.sequence
    if "camera" in tracks.record:
        tracks = tracks.with_uv(tracks.camera.without_distortion())
    return replace(tracks.sequence, template=with_captured_colours(tracks, read_texture(track)))


def _track_folder(folder: Path) -> Path:
    if not folder.is_dir():
        raise BadInput(f"{folder}: expected a folder written by `vntoolkit track`")
    inside = folder / "track"
    if not inside.is_dir() and not (folder / "sequence.json").exists():
        raise BadInput(f"{folder}: holds no registered mesh: run `vntoolkit track {folder}` first")
    return inside if inside.is_dir() else folder

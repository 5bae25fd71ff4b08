"""Open what `dress` writes in Blender, and compare what arrives there with what was written.

    python scripts/check_in_blender.py TRACK --motion walk.bvh --blender /path/to/python [--out DIR]

TRACK is a folder that `vntoolkit track` wrote. --blender names a Python that has Blender as its module
`bpy` (`pip install bpy` into an environment of its own: it needs another numpy). Without one nothing is
checked, which is said. Half a second of the motion is dressed, written as USD and as GLB, and imported
with Blender's own defaults. Prints one line a property; exit code 1 where one does not arrive. With Blender
5.0.1 all do, but for the rate of a USD: Blender keeps its scene's, 24 frames a second. A GLB keeps its speed.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.motion import pose_of_frame
from vntoolkit.io.maps_and_meshes.texture import SurfaceTexture
from vntoolkit.options.dressing import ClockOptions, DressOptions
from vntoolkit.pipeline.dress import (
    DressedFigure,
    captured_look,
    dress,
    read_motion,
    read_tracked_cloth,
    write_dressed_figure,
)
from vntoolkit.skinning.blending import skinned_vertices

BLENDER_FROM_CAMERA = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # z up, away from the viewer is +y
CLIP_S = 0.5
PROBE = Path(__file__).with_name("blender_probe.py")
WITHIN = {"vertices": 1e-5, "heads": 5e-6, "colours": 1e-6, "uv": 1e-6}  # m, m, full scale, texture
GLB_VERTICES_WITHIN = 1e-4  # its weights have 16 bits, and Blender rebuilds the joints
GLB_COLOURS_WITHIN = 0.0045  # Blender keeps those in 8 bits of sRGB: half a step near white
_HINT = "pip install bpy, in an environment of its own"


def has_blender(python: str) -> bool:
    """Return whether a Python imports `bpy`."""
    try:
        return subprocess.run([python, "-c", "import bpy"], capture_output=True, check=False).returncode == 0
    except OSError:
        return False


def expected(dressed: DressedFigure, frames: list[int]) -> dict[str, np.ndarray]:
    """Return what Blender should find in these frames, in its world: z up, metres. exact: without a skin."""
    template, clip = dressed.template, dressed.skin()
    by_name = np.argsort(dressed.motion.skeleton.names)
    poses = [pose_of_frame(dressed.motion, frame)[by_name, :3, 3] for frame in frames]
    skinned = [
        skinned_vertices(
            clip.mesh.vertices + np.einsum("m,mnc->nc", clip.shape_weights[frame], clip.shapes),
            dressed.weights,
            pose_of_frame(dressed.motion, frame),
            clip.rest_from_model,
            dressed.blend,
        )
        for frame in frames
    ]
    truth = {
        "vertices": np.stack(skinned) @ BLENDER_FROM_CAMERA.T,
        "exact": np.stack([dressed.frame(frame) for frame in frames]) @ BLENDER_FROM_CAMERA.T,
        "stated": np.array(clip.shape_error),
        "heads": np.stack(poses) @ BLENDER_FROM_CAMERA.T,
        "faces": template.faces,
    }
    if template.colours is not None:
        truth["colours"] = np.asarray(template.colours)[template.faces.ravel()]
    if template.uv is not None:
        truth["uv"] = np.asarray(template.uv)[template.faces.ravel()]
    return truth


def compare(
    found: dict[str, np.ndarray],
    truth: dict[str, np.ndarray],
    within: dict[str, float],
    camera: Camera | None,
    texture: SurfaceTexture | None,
) -> list[tuple[str, bool]]:
    """Return a line for each property, and whether it arrived."""
    lines = [(f"triangles {len(found['faces'])}", np.array_equal(found["faces"], truth["faces"]))]
    for name, limit in within.items():
        if name in truth and name in found:
            error = float(np.abs(found[name] - truth[name]).max())
            lines.append((f"{name}: off by at most {error:.2g}", error <= limit))
        elif name in truth and name != "heads":
            lines.append((f"{name}: missing", False))
    left = np.linalg.norm(found["vertices"] - truth["exact"], axis=2)
    left, stated = float(np.percentile(left, 95)), float(truth["stated"])
    lines.append(
        (f"folds within {1000 * left:.2g} mm, {1000 * stated:.2g} stated", left < 1.5 * stated + 1e-4)
    )
    bound = bool(found["has_armature"]) and int(found["groups"]) > 0
    lines.append((f"an armature moves it by {int(found['groups'])} groups of weights", bound))
    lines.append(("it is shaded smooth", bool(found["is_smooth"])))
    if texture is not None and texture.albedo is not None:
        lines.append(("the material shows the texture", bool(found["material_reads_texture"])))
        lines.append(("the material shows the relief", bool(found["material_reads_relief"])))
    elif "colours" in truth:
        lines.append(("the material shows the colours", bool(found["material_reads_colours"])))
    if camera is not None and camera.is_perspective:
        lines.append(("the camera", bool(found["has_camera"])))
    lines.append((f"{float(found['metres']):g} m a unit", float(found["metres"]) == 1.0))
    return lines


def check(
    dressed: DressedFigure, camera: Camera | None, texture: SurfaceTexture | None, python: str, folder: Path
) -> bool:
    """Write, import and compare both formats; print the findings; return whether everything arrived."""
    frames = sorted({0, 1, len(dressed) // 2, len(dressed) - 1})
    truth, arrived = expected(dressed, frames), True
    (folder / "frames.json").write_text(json.dumps(frames))
    for name in ("cloth.usdc", "cloth.glb"):
        write_dressed_figure(dressed, folder / name, camera, texture)
        arguments = [str(folder / name), str(folder / "frames.json"), str(folder / f"{name}.npz")]
        within = WITHIN
        if name.endswith(".glb"):  # its key frames lie at seconds: Blender's rate decides at which frames
            rate = dressed.clock.frame_rate_hz
            (folder / "frames.json").write_text(json.dumps([frame * 24 / rate for frame in frames]))
            within = {**WITHIN, "colours": GLB_COLOURS_WITHIN, "vertices": GLB_VERTICES_WITHIN}
            if texture is not None and texture.albedo is not None:
                within.pop("colours")  # a GLB has the texture instead
        subprocess.run([python, str(PROBE), *arguments, str(folder / f"{name}.png")], check=True, stdout=2)
        with np.load(folder / f"{name}.npz") as loaded:
            found = dict(loaded)
        if "heads" in found:
            found["heads"] = found["heads"][:, np.argsort(found["joints"])]
        lines = compare(found, truth, within, camera, texture)
        if name.endswith(".usdc"):
            lines.append(("the skeleton moves", "heads" in found))
            last = int(found["scene_range"][1])
            lines.append((f"frames 0 to {last}", tuple(found["scene_range"]) == (0, len(dressed) - 1)))
        print(f"{name} in Blender {found['version']}; its scene runs at {float(found['scene_rate']):g} Hz:")
        for line, good in lines:
            print(f"  {'arrives' if good else 'FAILS  '}  {line}")
            arrived &= good
    return arrived


def main() -> int:
    """Dress half a second, check both formats, and return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("track", type=Path, help="folder that `vntoolkit track` wrote")
    parser.add_argument("--motion", type=Path, required=True, help=".bvh, or .amc beside its .asf")
    parser.add_argument("--blender", default=sys.executable, help="a Python that has `bpy`")
    parser.add_argument("--out", type=Path, help="folder to keep files and pictures in (default: temporary)")
    arguments = parser.parse_args()
    if not has_blender(arguments.blender):
        print(f"nothing checked: {arguments.blender} has no module `bpy` ({_HINT})")
        return 0
    options = DressOptions(clock=ClockOptions(stop=CLIP_S), centre=False)
    dressed = dress(read_tracked_cloth(arguments.track), read_motion(arguments.motion), options)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.out or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        camera, texture = captured_look(arguments.track)
        return 0 if check(dressed, camera, texture, arguments.blender, folder) else 1


if __name__ == "__main__":
    sys.exit(main())

"""Draw what `dress` wrote as Blender shows it.

    python3.11 -m venv blender && blender/bin/pip install bpy==5.0.1
    blender/bin/python scripts/blender_picture.py cloth.usdc --out docs/img/blender.jpg [--frame 40]

Blender's Python module needs another numpy than vntoolkit, so it has an environment of its own. The file is
imported with Blender's defaults. Sticks join the armature's joints, since bones do not show in a rendering.
"""

import argparse
from pathlib import Path

import bpy
from mathutils import Vector

SIZE_PX = (720, 600)
SAMPLES = 48
BONE_RADIUS_M = 0.012
TURNED = (0.55, -1.0, 0.12)  # from the figure to the camera: before it, a little to the side and above


def main(source: Path, out: Path, frame: int) -> None:
    """Import a USD or GLB, and render one frame of it."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    read = bpy.ops.import_scene.gltf if source.suffix.lower() == ".glb" else bpy.ops.wm.usd_import
    read(filepath=str(source.resolve()))
    scene = bpy.context.scene
    scene.frame_set(frame)
    meshes = [each for each in scene.objects if each.type == "MESH"]
    armatures = [each for each in scene.objects if each.type == "ARMATURE"]
    for armature in armatures:
        for bone in armature.pose.bones:
            if bone.parent is not None:
                add_stick(armature.matrix_world @ bone.parent.head, armature.matrix_world @ bone.head)
    corners = [each.matrix_world @ Vector(corner) for each in meshes for corner in each.bound_box]
    corners += [a.matrix_world @ bone.head for a in armatures for bone in a.pose.bones]
    low, high = (Vector(pick(axis) for axis in zip(*corners, strict=True)) for pick in (min, max))
    add_floor(low.z)
    add_camera(scene, (low + high) / 2, (high - low).length)
    add_lights(scene)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = SAMPLES, False
    scene.render.resolution_x, scene.render.resolution_y = SIZE_PX
    scene.render.image_settings.file_format = "JPEG"
    scene.render.filepath = str(out.resolve())
    bpy.ops.render.render(write_still=True)
    print(out)


def add_stick(head: Vector, tail: Vector) -> None:
    """Add a cylinder between two joints."""
    along = tail - head
    if along.length < BONE_RADIUS_M:
        return
    bpy.ops.mesh.primitive_cylinder_add(radius=BONE_RADIUS_M, depth=along.length, location=(head + tail) / 2)
    stick = bpy.context.object
    stick.rotation_mode = "QUATERNION"
    stick.rotation_quaternion = along.to_track_quat("Z", "Y")
    stick.data.materials.append(plain((0.08, 0.2, 0.5, 1.0)))


def plain(colour: tuple[float, float, float, float]) -> bpy.types.Material:
    """Return a material of one colour."""
    material = bpy.data.materials.new("plain")
    material.diffuse_color = colour
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = colour
    return material


def add_floor(height: float) -> None:
    """Add a grey floor."""
    bpy.ops.mesh.primitive_plane_add(size=20, location=(0, 0, height))
    bpy.context.object.data.materials.append(plain((0.5, 0.52, 0.55, 1.0)))


def add_camera(scene: bpy.types.Scene, middle: Vector, across: float) -> None:
    """Look at the middle of the figure, so that all of it is seen."""
    away = Vector(TURNED).normalized()
    bpy.ops.object.camera_add(location=middle + 1.9 * across * away)
    camera = bpy.context.object
    camera.rotation_euler = (-away).to_track_quat("-Z", "Y").to_euler()
    camera.data.lens = 50
    scene.camera = camera


def add_lights(scene: bpy.types.Scene) -> None:
    """Add a sun from the upper left, and an even sky."""
    bpy.ops.object.light_add(type="SUN", rotation=(0.8, -0.4, 0.3))
    bpy.context.object.data.energy, bpy.context.object.data.angle = 3.0, 0.1
    scene.world = bpy.data.worlds.new("sky")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.75, 0.8, 0.9, 1.0)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.5


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("source", type=Path, help="what `vntoolkit dress` or recipe figure11 wrote")
    parser.add_argument("--out", type=Path, required=True, help="the picture to write, .jpg")
    parser.add_argument("--frame", type=int, default=40)
    arguments = parser.parse_args()
    main(arguments.source, arguments.out, arguments.frame)

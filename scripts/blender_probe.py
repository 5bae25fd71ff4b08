"""Report what Blender reads from an animated file; run by `check_in_blender.py`, by a Python with `bpy`.

    python scripts/blender_probe.py CLOTH.usdc FRAMES.json FOUND.npz [PICTURE.png]

FRAMES.json lists the frames to look at. Pictures are rendered of the first, a middle and the last of them:
PICTURE_0.png, PICTURE_1.png and PICTURE.png.
"""

import json
import math
import sys
from pathlib import Path

import bpy
import numpy as np


def main(path: str, frames: list[float], found: str, picture: str | None) -> None:
    """Import a file, save what is in it at some frames, and render three of them."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    (bpy.ops.import_scene.gltf if path.endswith(".glb") else bpy.ops.wm.usd_import)(filepath=path)
    meshes = [thing for thing in bpy.data.objects if thing.type == "MESH"]
    surface = max(meshes, key=lambda thing: len(thing.data.vertices))  # not the shape of a bone
    figure = next((thing for thing in bpy.data.objects if thing.type == "ARMATURE"), None)
    result = {
        "version": bpy.app.version_string,
        "scene_rate": scene.render.fps / scene.render.fps_base,
        "scene_range": (scene.frame_start, scene.frame_end),
        "metres": scene.unit_settings.scale_length,
        "vertices": np.stack([vertices_of(surface, seek(frame)) for frame in frames]),
        "material_reads_colours": any(
            link.from_node.bl_idname in ("ShaderNodeAttribute", "ShaderNodeVertexColor")
            and link.to_socket.name == "Base Color"
            for material in bpy.data.materials
            for link in material.node_tree.links
        ),
        "material_reads_texture": any(
            link.from_node.bl_idname == "ShaderNodeTexImage" and link.to_socket.name == "Base Color"
            for material in bpy.data.materials
            for link in material.node_tree.links
        ),
        "material_reads_relief": any(
            link.from_node.bl_idname == "ShaderNodeNormalMap" and link.to_socket.name == "Normal"
            for material in bpy.data.materials
            for link in material.node_tree.links
        ),
        "has_camera": any(thing.type == "CAMERA" for thing in bpy.data.objects),
        "is_smooth": all(polygon.use_smooth for polygon in surface.data.polygons),
        "groups": len(surface.vertex_groups),
        "has_armature": any(modifier.type == "ARMATURE" for modifier in surface.modifiers),
        **corners_of(surface.data),
    }
    if figure is not None:
        result["joints"] = np.array([bone.name for bone in figure.data.bones])
        result["heads"] = np.stack([heads_of(figure, seek(frame)) for frame in frames])
    np.savez(found, **result)
    if picture:
        stem = picture.removesuffix(".png")
        names = (f"{stem}_0.png", f"{stem}_1.png", picture)
        for place, name in zip((0, len(frames) // 2, -1), names, strict=True):
            seek(frames[place])
            render(surface, name)


def seek(frame: float) -> object:
    """Go to a frame, or between two, and return the evaluated scene."""
    whole = math.floor(frame)
    bpy.context.scene.frame_set(whole, subframe=frame - whole)
    return bpy.context.evaluated_depsgraph_get()


def vertices_of(surface, graph) -> np.ndarray:
    """Return the (n, 3) positions in Blender's world, z up."""
    evaluated = surface.evaluated_get(graph)
    mesh = evaluated.to_mesh()
    flat = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", flat)
    evaluated.to_mesh_clear()
    return in_world(evaluated, flat.reshape(-1, 3))


def heads_of(figure, graph) -> np.ndarray:
    """Return where each bone begins, (j, 3), in Blender's world."""
    evaluated = figure.evaluated_get(graph)
    return in_world(evaluated, np.array([bone.head for bone in evaluated.pose.bones]))


def in_world(thing, points: np.ndarray) -> np.ndarray:
    """Return points (n, 3) of an object in Blender's world."""
    world = np.array(thing.matrix_world)
    return points @ world[:3, :3].T + world[:3, 3]


def corners_of(mesh) -> dict[str, np.ndarray]:
    """Return each triangle corner's vertex, colour and texture coordinates, where there are any."""
    vertex = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", vertex)
    corners = {"faces": vertex.reshape(-1, 3)}
    if mesh.color_attributes:
        layer = mesh.color_attributes[0]
        colour = np.array([item.color[:3] for item in layer.data])
        corners["colours"] = colour if layer.domain == "CORNER" else colour[vertex]
    if mesh.uv_layers:
        uv = np.empty(2 * len(mesh.loops), np.float32)
        mesh.uv_layers[0].data.foreach_get("uv", uv)
        corners["uv"] = uv.reshape(-1, 2)
    return corners


def render(surface, picture: str) -> None:
    """Render the surface from the front and a little above, a few samples a pixel."""
    points = vertices_of(surface, bpy.context.evaluated_depsgraph_get())
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = (low + high) / 2, float(max(high - low))
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.location = middle + np.array([0.0, -2.4 * size, 0.5 * size])
    camera.rotation_euler = (math.pi / 2 - math.atan2(0.5, 2.4), 0.0, 0.0)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy, sun.rotation_euler = 3.0, (0.8, 0.3, 0.4)
    for thing in (camera, sun):
        scene.collection.objects.link(thing)
    scene.camera = camera
    scene.world = bpy.data.worlds.new("World")
    scene.world.color = (0.4, 0.4, 0.4)
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.device = 16, "CPU"
    scene.view_settings.view_transform = "Standard"
    scene.render.resolution_x = scene.render.resolution_y = 480
    scene.render.threads_mode, scene.render.threads = "FIXED", 2
    scene.render.filepath = picture
    bpy.ops.render.render(write_still=True)
    for thing in (camera, sun):
        bpy.data.objects.remove(thing)


if __name__ == "__main__":
    source, listed, target, *pictures = sys.argv[1:]
    main(source, json.loads(Path(listed).read_text()), target, pictures[0] if pictures else None)

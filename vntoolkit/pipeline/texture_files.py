"""The texture of a registered surface, which `track` leaves and every later verb takes."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vntoolkit.arrays import Colours
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.maps_and_meshes.texture import SurfaceTexture
from vntoolkit.io.results.manifest import ReconstructionFolder

if TYPE_CHECKING:
    from vntoolkit.pipeline.tracked_folder import Tracks

_LOGGER = logging.getLogger(__name__)


def read_texture(track_folder: Path) -> SurfaceTexture | None:
    """Return the files of the texture that `track` left; None where they are missing or older than it."""
    folder, tracks = track_folder / "texture", track_folder / "vertices.npy"
    albedo, normal = folder / "albedo.png", folder / "normal.png"
    if not normal.exists() or normal.stat().st_mtime < tracks.stat().st_mtime:
        return None
    return SurfaceTexture(albedo=albedo if albedo.exists() else None, normal=normal)


def texture_of_tracks(track_folder: Path) -> SurfaceTexture | None:
    """Return the files of the texture, and say where there is none of the tracks that are there now."""
    texture = read_texture(track_folder)
    if texture is None and (track_folder / "track.json").exists():
        _LOGGER.warning(
            "%s: no texture of these tracks; run `vntoolkit track %s` again to make it",
            track_folder,
            track_folder.parent,
        )
    return texture


def with_captured_colours(tracks: "Tracks", texture: SurfaceTexture | None) -> Mesh:
    """Return the template with the colours of its texture, else those that its own frame's mesh has there."""
    template, vertices = tracks.sequence.template, tracks.template_vertices
    albedo = colours_from_texture(texture, template)
    if albedo is not None:
        return replace(template, colours=albedo)
    own = ReconstructionFolder(root=tracks.folder.parent).file("mesh", tracks.template)
    if template.colours is not None or vertices is None or not own.exists():
        return template
    from scipy.spatial import cKDTree

    from vntoolkit.io.maps_and_meshes.meshes import read_mesh

    mesh = read_mesh(own)
    if mesh.colours is None:
        return template
    _, nearest = cKDTree(mesh.vertices).query(vertices, workers=-1)
    return replace(template, colours=np.asarray(mesh.colours)[nearest])


def colours_from_texture(texture: SurfaceTexture | None, mesh: Mesh) -> Colours | None:
    """Return (n, 3), the colour of each vertex as the albedo has it; None without one."""
    if texture is None or texture.albedo is None or mesh.uv is None:
        return None
    from vntoolkit.io.footage.images import read_image
    from vntoolkit.tracking.slopes import sample_image

    picture = read_image(texture.albedo)
    pixels = picture.astype(np.float32) / np.float32(np.iinfo(picture.dtype).max)
    height, width = pixels.shape[:2]
    places = np.column_stack([mesh.uv[:, 0] * width - 0.5, (1 - mesh.uv[:, 1]) * height - 0.5])
    return sample_image(pixels, places).astype(np.float32)

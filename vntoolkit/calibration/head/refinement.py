"""The head's shape refined by its own normals, and M fitted again (nehab2005; brostow2011, Section IV).

Stereo knows where the skin is, but not its relief: its windows blur it, and noise ripples it.
Normals know the relief but not the place: their errors add up with distance. Silhouettes know the place,
where the surface turns away from a viewer. The positions sought agree with all three, each as far as its own
error allows. A vertex moves along its normal, by d. Every edge should be at right angles to its mean normal,
and d should be small, or what a contour tells: linear in d.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from vntoolkit import progress
from vntoolkit.arrays import Array, FloatArray
from vntoolkit.calibration.head import skin as skins
from vntoolkit.calibration.head.light import HeadLight, light_of_response
from vntoolkit.calibration.head.light_correction import corrected_light
from vntoolkit.calibration.head.positions import LEAST_NOISE, UNKNOWN_NOISE, PositionSolver, areas
from vntoolkit.calibration.head.rims import rim_targets
from vntoolkit.calibration.head.samples import HeadSamples, LightFrame, SkinColours, skin_colours
from vntoolkit.calibration.head.shape_noise import (
    LEAST_SEEN,
    PATCH_PX,
    SHARED_NOISE,
    mean_edge,
    measured_noise,
    patches_of,
)
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.geometry.rays import RayScene
from vntoolkit.options.head import HeadSteps
from vntoolkit.photometry.response import LightResponse
from vntoolkit.spread import NINE_OF_TEN_IN_PLANE

_ROUNDS, _PASSES = 6, 2  # colours are taken anew in so many: later, vertices hardly move
_CONVERGED = 0.002  # change of M, as a share, that ends the rounds
_EDGE_PX = 1.6  # mean length of an edge, about: two samples of a relief of a few pixels
_COARSE = 4.0  # edges while M is sought: a relief too fine for them says nothing of M
_MOST_VERTICES = 300_000
# Normals that are off by 1 degree, as a good M leaves them, bend positions by half a pixel over half of
# this wavelength. Stereo's ripples are of a pixel and more, and up to a dozen windows long.
_CROSSOVER_PX, _CROSSOVER_NOISE = 200.0, 0.02
_LARGEST_CROSSOVER = 1.0 / 3.0  # of the mesh's diagonal: M is fitted to what longer waves say
_LEAST_PATCH = 0.1  # of its side squared: less is a sliver


@dataclass(frozen=True, kw_only=True, eq=False)
class RefinedHead:
    """A head whose shape agrees with its normals. mesh: head frame, with normals, colours and `error_deg`.

    light, samples: M fitted to this mesh, and its samples, patches of skin instead of points. changes:
    relative change of M in every round. error_percent: (n,) standard deviation of the positions, % of the
    diagonal.
    """

    mesh: Mesh
    light: HeadLight
    samples: HeadSamples
    changes: tuple[float, ...]
    error_percent: FloatArray


def refine_head(
    shape: Mesh,
    camera: Camera,
    frames: Callable[[], Iterable[LightFrame]],
    light: HeadLight,
    steps: HeadSteps,
    rng: np.random.Generator,
) -> RefinedHead:
    """Alternate normals from colours, positions from normals and stereo, and M; then refine a finer mesh.

    shape: of stereo. frames: reads the frames that normals are taken from, in passes. light: M and what the
    first fit made of the samples.
    """
    depth = float(np.median(next(iter(frames())).camera_from_head.apply(shape.vertices)[:, 2]))
    pixel = depth / float(camera.matrix[0, 0])
    coarse = _COARSE * _EDGE_PX * pixel
    stereo = thinned(divided(shape, coarse), coarse)
    crossover = min(_CROSSOVER_PX * pixel, _LARGEST_CROSSOVER * stereo.diagonal)
    lit, surface, seen = skins.SkinLight(response=light.response), stereo, None
    changes: list[float] = []
    progress.begin("refinement", _ROUNDS + 1)
    for number in range(_ROUNDS):
        if number < _PASSES or seen is None:
            seen = skin_colours(surface, camera, frames())
        colours = skins.without_shadow(seen, surface, lit.response)
        skin = skins.skin_normals(colours, lit)
        before = lit.response
        lit = corrected_light(lit, light.response, colours, skin, stereo, PATCH_PX * pixel)
        solver = PositionSolver(stereo.vertices, stereo.faces, skin, crossover)
        surface = stereo.with_vertices(solver.positions())
        changes.append(_relative_change(before, lit.response))
        progress.step()
        if changes[-1] < _CONVERGED:
            break
    density, shared = measured_noise(surface, stereo.vertices, skin, pixel)
    spread = solver.spread(surface, density, shared, rng)
    fine, colours, skin = _refined_finely(shape, surface, camera, frames, lit, density, crossover, pixel)
    samples = patch_samples(fine, camera, colours, skin, PATCH_PX * pixel)
    return RefinedHead(
        mesh=replace(fine, colours=_skin_colour(skin, lit.response), error_deg=_expected_error_deg(skin)),
        light=light_of_response(samples, lit.response, steps),
        samples=samples,
        changes=tuple(changes),
        error_percent=100.0 * spread[cKDTree(surface.vertices).query(fine.vertices)[1]] / fine.diagonal,
    )


def _refined_finely(
    shape: Mesh,
    surface: Mesh,
    camera: Camera,
    frames: Callable[[], Iterable[LightFrame]],
    lit: skins.SkinLight,
    density: float,
    crossover: float,
    pixel: float,
) -> tuple[Mesh, SkinColours, skins.SkinNormals]:
    """Solve a mesh of two edges a pixel and a half, with contours; return it, its colours and normals."""
    stereo = divided(shape, _EDGE_PX * pixel)
    nearest = RayScene((surface.vertices, surface.faces)).closest(stereo.vertices)
    placed = stereo.with_vertices(nearest)  # stereo's ripples would mix the colours of what lies around
    colours = skins.without_shadow(skin_colours(placed, camera, frames()), placed, lit.response)
    skin = skins.skin_normals(colours, lit)
    solver = PositionSolver(
        stereo.vertices,
        stereo.faces,
        skin,
        crossover * _CROSSOVER_NOISE / LEAST_NOISE,  # errors as they are measured make it shorter
    )
    solver.add_contours(*rim_targets(placed, camera, frames(), lit.response), density)
    return stereo.with_vertices(solver.positions()), colours, skin


def divided(mesh: Mesh, edge: float) -> Mesh:
    """Divide every triangle in four (loop1987) until edges have this mean length or vertices get too many."""
    while len(mesh.vertices) * 4 < _MOST_VERTICES and 0.7 * mean_edge(mesh) > edge:
        finer = Mesh.from_open3d(replace(mesh, normals=None, colours=None).to_open3d().subdivide_loop(1))
        mesh = replace(finer, normals=vertex_normals(finer.vertices, finer.faces))
    return mesh


def thinned(mesh: Mesh, edge: float) -> Mesh:
    """Collapse edges (garland1997) until they have about this mean length."""
    share = (mean_edge(mesh) / edge) ** 2
    if share >= 1.0:
        return mesh
    plain = replace(mesh, normals=None, colours=None).to_open3d()
    thinner = Mesh.from_open3d(plain.simplify_quadric_decimation(int(share * len(mesh.faces))))
    return replace(thinner, normals=vertex_normals(thinner.vertices, thinner.faces))


def _relative_change(first: LightResponse, second: LightResponse) -> float:
    """Change of M as a share, but for its scale, which is the skin's albedo."""
    a, b = first.matrix / np.linalg.norm(first.matrix), second.matrix / np.linalg.norm(second.matrix)
    return float(np.linalg.norm(a - b))


def patch_samples(
    mesh: Mesh, camera: Camera, colours: SkinColours, skin: skins.SkinNormals, side: float
) -> HeadSamples:
    """Average normals and colours, less albedo, over patches of skin, as samples for the fit of M.

    The mean normal of a patch hangs on its outline alone, so relief that the mesh misses and noise within the
    patch do not shorten slopes and bend M; the mean colour is M times it. side: of a patch, length units.
    """
    assert mesh.normals is not None
    patch, first = patches_of(mesh, side)
    area = areas(mesh.vertices, mesh.faces)
    whole = np.bincount(patch, area)
    columns: list[tuple[Array, ...]] = []
    for number, pose in enumerate(colours.camera_from_head):
        weight = np.where(skin.agrees[number], area, 0.0)
        seen = np.bincount(patch, weight)
        kept = np.flatnonzero((seen > LEAST_SEEN * whole) & (whole > _LEAST_PATCH * side**2))
        place, normal, rgb = (
            np.stack([np.bincount(patch, weight * column)[kept] / seen[kept] for column in values.T], axis=1)
            for values in (mesh.vertices, mesh.normals, colours.rgb[number] / skin.albedo)
        )
        pixel = camera.project(pose.apply(place))
        columns.append((first[kept], np.full(len(kept), number), pose.rotate(normal), rgb, pixel))
    point, frame, normals, rgb, pixel = (np.concatenate(each) for each in zip(*columns, strict=True))
    return HeadSamples(
        point=point,
        frame=frame,
        normals_in_camera=normals,
        rgb=rgb,
        position_px=pixel,
        camera_from_head=colours.camera_from_head,
    )


def _skin_colour(skin: skins.SkinNormals, response: LightResponse) -> FloatArray:
    """Return the skin's colour (n, 3), 0 to 1, under these lamps: albedo times each channel's light."""
    brightness = np.linalg.norm(response.matrix, axis=1)
    colour = skin.albedo * (brightness / brightness.max())
    return np.clip(colour / np.percentile(colour.max(axis=1), 99), 0.0, 1.0).astype(np.float32)


def _expected_error_deg(skin: skins.SkinNormals) -> FloatArray:
    noise = np.where(np.isfinite(skin.noise), np.hypot(skin.noise, SHARED_NOISE), UNKNOWN_NOISE)
    return np.rad2deg(NINE_OF_TEN_IN_PLANE * noise).astype(np.float32)

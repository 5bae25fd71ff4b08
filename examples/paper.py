"""Equations 1 to 8 of the paper (brostow2011) on a small simulated capture, with one figure for each.

    python examples/paper.py        # writes no file; 10 s of processor time

Two frames of 160×120 pixels show legs that step under three coloured lamps. The camera is ideal. Given for
free: spectra and places of the lamps, true normals (equations 1 and 4), mean depth (6, 7).
"""

import numpy as np

from vntoolkit import DepthIntegrator, DepthMap, LightResponse, fit_response, normals_from_frame
from vntoolkit.geometry.mesh import graph_laplacian
from vntoolkit.geometry.motion import pose_of_frame
from vntoolkit.options.calibration import ResponseFitOptions, ResponseModel
from vntoolkit.options.dressing import Falloff, WeightOptions
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.photometry.response import rgb_from_normals
from vntoolkit.pipeline.dress import read_motion
from vntoolkit.simulation.image_formation import light_colour, response_matrix
from vntoolkit.simulation.lights import rgb_pigments
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene
from vntoolkit.skinning.blending import skinned_vertices
from vntoolkit.skinning.weights import weights_from_distances
from vntoolkit.tracking.flow import advected_positions, flow_between, targets_on_surface
from vntoolkit.tracking.regularisers import LaplacianRegulariser
from vntoolkit.tracking.template import template_from_maps


def show(equation: str, value: float, unit: str) -> None:
    """Print one figure."""
    print(f"equation {equation:<52}{value:7.2f} {unit}")


def length(vectors: np.ndarray) -> float:
    """Return the mean length of vectors (n, 3) or (n, 2)."""
    return float(np.linalg.norm(vectors, axis=1).mean())


scene = build_scene("spandex", SceneOptions(width=160, height=120))
camera, lamps, cloth = scene.camera, scene.lights, scene.surface
ideal = Nuisances(**{**vars(Nuisances.none()), "crosstalk": True})
seen = [render_frame(scene, number, nuisances=ideal) for number in (0, 1)]
truth, lit = seen[0].truth, seen[0].truth.normals.mask & (seen[0].truth.labels == 7)
normals, rgb = truth.normals.normals_in_camera[lit], seen[0].linear.rgb[lit]
colours = np.array([light_colour(s, cloth.reference_weights @ rgb_pigments()) for s in lamps.spectra])
towards = lamps.positions - scene.centre
matrix = response_matrix(colours, towards / np.linalg.norm(towards, axis=1, keepdims=True))
true = LightResponse(matrix=matrix * scene.exposure_level / np.linalg.norm(matrix, axis=1).max())
show("1  r = M n: error of r / full scale, mean", 100 * length(rgb - rgb_from_normals(normals, true)), "%")
show("2  c_k of the red lamp: green over red", 100 * colours[0, 1] / colours[0, 0], "%")
show("3  M = Σ c_k l_kᵀ: condition number", true.condition_number, "(a ratio)")
response = fit_response(normals, rgb, ResponseFitOptions(model=ResponseModel.AMBIENT)).response
error = np.linalg.norm(response.matrix - true.matrix) / np.linalg.norm(true.matrix)
show("4  3×4 M from pairs of n and r: error of M", 100 * error, "%")
found = [normals_from_frame(s.linear, response, s.truth.normals.mask) for s in seen]
depth = [DepthIntegrator(camera).integrate(each) for each in found]
true_depth = [s.truth.depth for s in seen]
scale = [t.depth[t.mask].mean() for t in true_depth]  # normals alone leave it free
depth = [DepthMap(depth=d.depth * k, mask=d.mask) for d, k in zip(depth, scale, strict=True)]
template = template_from_maps(found[0], depth[0], camera)
start, (u, v) = template.vertices_in_camera, template.pixels.T
moved = advected_positions(template.positions_px, flow_between(*found))
truly = template.positions_px + truth.flow_px[v, u]
show("5  u + d(u): error of the position, mean", length(moved - truly), "px")
targets, _ = targets_on_surface(moved, depth[1], camera, start[:, 2])
goal, _ = targets_on_surface(truly, true_depth[1], camera, start[:, 2])
show("6  y on the surface: error of the point, mean", 1000 * length(targets - goal), "mm")
laplacian = graph_laplacian(template.edges, len(start))
solver = LaplacianRegulariser(laplacian, beta=1e-3)
registered = start + solver.solve(targets - start)
show("7  [L; βI] X = [Q; βY]: error of the vertex, mean", 1000 * length(registered - goal), "mm")
motion = read_motion("data/walk.bvh").in_metres(1.73)
rest, posed = pose_of_frame(motion, 0), pose_of_frame(motion, 18)
attached = start - start.mean(axis=0) + rest[:, :3, 3].mean(axis=0)
inverse = WeightOptions(falloff=Falloff.INVERSE)
weights = weights_from_distances(attached, motion.skeleton, rest, inverse)
walked = skinned_vertices(attached, weights, posed, rest)
show("8  v' = Σ w S R⁻¹ v: way in 0.3 s of a walk, mean", 100 * length(walked - attached), "cm")

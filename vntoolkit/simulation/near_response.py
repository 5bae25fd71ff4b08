"""The true response of near lights as polynomials of the pixel: what a perfect calibration would find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.variation import ResponseVariation, powers_to_degree
from vntoolkit.simulation.image_formation import exposure_of_scene, light_colours_of, true_response
from vntoolkit.simulation.nuisances import Nuisances
from vntoolkit.simulation.scene import Scene

_GRID = 15  # samples across and down the image


def true_varying_response(scene: Scene, nuisances: Nuisances, degree: int = 2) -> LightResponse:
    """Return M over the image where the surface stands in the plane through the scene's centre.

    M = Σ_k c_k l_kᵀ (d_k / |p_k − x|)², with each light's position p_k, its distance d_k from the centre and
    its direction l_k from x; the polynomials of `degree` fit it by least squares. With parallel light it is
    `true_response`.
    """
    response = true_response(scene, nuisances)
    if not nuisances.near_lights or degree < 1:
        return response
    camera = scene.camera
    size = np.array([camera.width, camera.height])
    u, v = np.meshgrid(*(np.linspace(0, side - 1, _GRID) for side in size))
    pixels = np.stack([u.ravel(), v.ravel()], axis=-1)
    points = camera.unproject(pixels, np.full(len(pixels), scene.centre[2]))
    matrices = _matrices_at(points, scene, nuisances)
    centre, scale = (size - 1.0) / 2, float(max(size)) / 2
    powers = powers_to_degree(degree)
    places = (pixels - centre) / scale
    monomials = np.column_stack([np.ones(len(places)), (places[:, None, :] ** powers).prod(axis=-1)])
    terms = np.linalg.lstsq(monomials, matrices.reshape(-1, 9), rcond=None)[0].reshape(-1, 3, 3)
    variation = ResponseVariation(
        powers=powers,
        matrices=terms[1:],
        ambients=np.zeros((len(powers), 3)),
        centre_px=centre,
        scale_px=scale,
    )
    return replace(response, matrix=terms[0], variation=variation)


def _matrices_at(points: FloatArray, scene: Scene, nuisances: Nuisances) -> FloatArray:
    """M (n, 3, 3) of the reference material at points (n, 3) in the camera frame."""
    exposure = exposure_of_scene(scene, nuisances)
    towards = scene.lights.positions - points[:, None]
    distances = np.linalg.norm(towards, axis=2)
    directions = towards / distances[..., None]
    falloff = (exposure.distances_m / distances) ** 2
    return np.einsum("kc,nkx,nk->ncx", light_colours_of(scene, exposure), directions, falloff)

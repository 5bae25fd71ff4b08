"""Equations 2 and 3 over wavelength: colours and M from the spectra of lamps, pigments and sensor."""

from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import FloatArray, Matrix3, Vector3
from vntoolkit.errors import BadInput
from vntoolkit.options.simulation import Nuisances
from vntoolkit.photometry.response import LightResponse, ResponseVariation, powers_to_degree
from vntoolkit.simulation.lights import colour_from_spectrum, rgb_pigments
from vntoolkit.simulation.scene import Scene

_GRID = 15  # samples across and down the image


@dataclass(frozen=True, kw_only=True, eq=False)
class Exposure:
    """Every integral over wavelength that shading needs, in full scale = 1.

    pigment_colours: (k, b, 3) colour of pigment b facing lamp k at the scene's centre. ambient_colours:
    (b, 3) of pigment b in the room's glow. gloss_colours: (k, 3) of a white mirror under lamp k.
    directions: (k, 3) unit vectors from the centre to the lamps; distances_m: (k,) how far they are.
    """

    pigment_colours: FloatArray
    ambient_colours: FloatArray
    gloss_colours: FloatArray
    directions: FloatArray
    distances_m: FloatArray


def light_colour(spectrum: FloatArray, reflectance: FloatArray) -> Vector3:
    """Equation 2: ∫ S_k(λ) ρ(λ) ν_i(λ) dλ for i = red, green, blue; (3,)."""
    return colour_from_spectrum(np.asarray(spectrum) * reflectance)


def response_matrix(light_colours: FloatArray, directions: FloatArray) -> Matrix3:
    """Equation 3: M = Σ_k M^k with M^k = c_k l_kᵀ. Both (k, 3), one row per light."""
    return sum((np.outer(c, d) for c, d in zip(light_colours, directions, strict=True)), np.zeros((3, 3)))


def exposure_of_scene(scene: Scene, nuisances: Nuisances) -> Exposure:
    """Integrate the scene's spectra and scale them to its exposure level.

    The exposure is that of the full scene whichever nuisance is off, so that nothing else changes.
    """
    lights, pigments = scene.lights, rgb_pigments()
    colours = np.array([[light_colour(s, p) for p in pigments] for s in lights.spectra])
    ambient = np.array([light_colour(lights.ambient_spectrum, p) for p in pigments])
    gloss = colour_from_spectrum(lights.spectra)
    towards = lights.positions - scene.centre
    distances = np.linalg.norm(towards, axis=1)
    directions = towards / distances[:, None]
    full = colours
    if scene.exposed_for is not None:
        full = np.array([[light_colour(s, p) for p in pigments] for s in scene.exposed_for.spectra])
    reference = np.einsum("kbi,b->ki", full, scene.surface.reference_weights)
    brightest = np.linalg.norm(response_matrix(reference, directions), axis=1).max()
    if not brightest > 0:
        raise BadInput(f"scene {scene.name}: its reference material reflects none of the light")
    gain = scene.exposure_level / brightest
    if not nuisances.crosstalk and len(lights) > 1:
        own = np.eye(3)[list(lights.bits)]
        colours, gloss = colours * own[:, None, :], gloss * own
    return Exposure(
        pigment_colours=colours * gain,
        ambient_colours=ambient * (gain if nuisances.ambient else 0.0),
        gloss_colours=gloss * gain,
        directions=directions,
        distances_m=distances,
    )


def light_colours_of(scene: Scene, exposure: Exposure) -> FloatArray:
    """Return c_k, (k, 3): the reference material's colour under each lamp at the centre."""
    return np.einsum("kbi,b->ki", exposure.pigment_colours, scene.surface.reference_weights)


def true_response(scene: Scene, nuisances: Nuisances) -> LightResponse:
    """Return M, ambient and light colours of the reference material at the scene's centre.

    Raises `BadRig` where M is singular, as under a single white lamp.
    """
    exposure = exposure_of_scene(scene, nuisances)
    colours = light_colours_of(scene, exposure)
    return LightResponse(
        matrix=response_matrix(colours, exposure.directions),
        ambient=scene.surface.reference_weights @ exposure.ambient_colours,
        light_colours=colours if len(colours) == 3 else None,
    )


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

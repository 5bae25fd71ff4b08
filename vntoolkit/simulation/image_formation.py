"""Equations 1 to 3, integrated over wavelength: from lamps, pigments and sensor to colours and M."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Matrix3, Vector3
from vntoolkit.errors import BadInput
from vntoolkit.photometry.response import LightResponse
from vntoolkit.simulation.nuisances import Nuisances
from vntoolkit.simulation.scene import Scene
from vntoolkit.simulation.spectra import colour_from_spectrum


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


def light_share(spectrum: FloatArray, reflectance: FloatArray, sensitivities: FloatArray) -> Vector3:
    """Equation 2's integral over wavelength: ∫ S_k(λ) ρ(λ) ν_i(λ) dλ for i = red, green, blue; (3,)."""
    return colour_from_spectrum(np.asarray(spectrum) * reflectance, sensitivities)


def response_matrix(light_colours: FloatArray, directions: FloatArray) -> Matrix3:
    """Equation 3: M = Σ_k M^k with M^k = c_k l_kᵀ. Both (k, 3), one row per light."""
    return sum((np.outer(c, d) for c, d in zip(light_colours, directions, strict=True)), np.zeros((3, 3)))


def exposure_of_scene(scene: Scene, nuisances: Nuisances) -> Exposure:
    """Integrate the scene's spectra and scale them to its exposure level.

    The exposure is that of the full scene whichever nuisance is off, so that nothing else changes.
    """
    lights, pigments, sensor = scene.lights, scene.surface.pigments, scene.sensitivities
    colours = np.array([[light_share(s, p, sensor) for p in pigments] for s in lights.spectra])
    ambient = np.array([light_share(lights.ambient_spectrum, p, sensor) for p in pigments])
    gloss = colour_from_spectrum(lights.spectra, sensor)
    towards = lights.positions - scene.centre
    distances = np.linalg.norm(towards, axis=1)
    directions = towards / distances[:, None]
    reference = np.einsum("kbi,b->ki", colours, scene.surface.reference_weights)
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

"""The lamps and the camera of every scene: spectra, positions, and the studio where they stand.

The curves are ours, made from a few bands each, with the shapes that published measurements have: a
tungsten lamp behind dichroic filters whose skirts overlap; a single-chip camera's colour filter array with
its long tails (jiang2013); pigments that change slowly with wavelength. None is a copy of a measurement.
"""

from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import FloatArray, Points, read_only
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.options.simulation import Lighting, SceneOptions

FRAME_RATE_HZ = 60.0  # of the camera
WAVELENGTHS_NM = np.arange(380.0, 731.0, 5.0)
_STEP_NM = 5.0
_AMBIENT_LEVEL = 0.02
_LAMP_TEMPERATURE_K = 3200.0
_SECOND_RADIATION_CONSTANT_NM_K = 1.4387769e7


def camera_sensitivities() -> FloatArray:
    """Return ν_i(λ), (3, λ): red, green, blue channels of a single-chip camera, green's peak = 1."""
    red = 0.86 * _band(605, 18, 34) + 0.10 * _band(455, 30, 28) + 0.10 * _band(530, 28, 20)
    green = 1.00 * _band(530, 32, 36) + 0.06 * _band(430, 22, 22) + 0.05 * _band(655, 20, 25)
    blue = 0.82 * _band(462, 26, 27) + 0.05 * _band(545, 22, 26) + 0.015 * _band(640, 25, 25)
    infrared_cut = 1.0 / (1.0 + np.exp((WAVELENGTHS_NM - 682.0) / 8.0))
    return np.stack([red, green, blue]) * infrared_cut


def coloured_lamps() -> FloatArray:
    """Return S_k(λ), (3, λ): a tungsten lamp behind a red, a green and a blue filter.

    Each is as strong as makes a white surface that faces it 1 in its own channel (red, green, blue).
    """
    red = _edge(600, 7) * 0.92 + 0.012 + 0.02 * _band(450, 15, 15)
    green = 0.72 * _band(532, 17, 22) + 0.012 + 0.05 * _edge(705, 8)
    blue = 0.62 * _band(452, 24, 21) + 0.008 + 0.04 * _edge(700, 8)
    lamps = np.stack([red, green, blue]) * _tungsten()
    own_channel = np.einsum("kl,kl->k", lamps, camera_sensitivities()) * _STEP_NM
    return lamps / own_channel[:, None]


def white_lamp() -> FloatArray:
    """Return (λ,) a lamp that the camera sees as white: a white surface that faces it is 1 in all channels.

    Daylight-like: tungsten's light with its blue, green and red bands weighed against the camera.
    """
    bands = rgb_pigments() * _tungsten()
    seen = colour_from_spectrum(bands)
    return np.linalg.solve(seen.T, np.ones(3)) @ bands


def room_glow() -> FloatArray:
    """Return (λ,) ambient light, a share of a white lamp's light."""
    return _AMBIENT_LEVEL * white_lamp()


def colour_from_spectrum(power: FloatArray) -> FloatArray:
    """Integrate power (..., λ) against the camera's sensitivities over wavelength: (..., 3)."""
    return np.asarray(power) @ camera_sensitivities().T * _STEP_NM


def rgb_pigments() -> FloatArray:
    """Return (3, λ) smooth red, green, blue reflectances that add up to 1 at every wavelength.

    With weights (r, g, b) from 0 to 1 they are a spectrum for any RGB texture; (1, 1, 1) is white.
    """
    red = _edge(582, 9)
    blue = 1.0 - _edge(490, 9)
    return np.stack([red, 1.0 - red - blue, blue])


def _band(centre_nm: float, below_nm: float, above_nm: float) -> FloatArray:
    """Bell with unequal flanks: standard deviations below and above the centre."""
    width = np.where(centre_nm > WAVELENGTHS_NM, below_nm, above_nm)
    return np.exp(-0.5 * ((WAVELENGTHS_NM - centre_nm) / width) ** 2)


def _edge(centre_nm: float, width_nm: float) -> FloatArray:
    """Long-pass filter: 0 below, 1 above, a logistic edge."""
    return 1.0 / (1.0 + np.exp(-(WAVELENGTHS_NM - centre_nm) / width_nm))


def _tungsten() -> FloatArray:
    """Planck's law at a studio lamp's temperature, 1 at 560 nm."""
    exponent = _SECOND_RADIATION_CONSTANT_NM_K / _LAMP_TEMPERATURE_K
    power = WAVELENGTHS_NM**-5 / np.expm1(exponent / WAVELENGTHS_NM)
    return power / power[WAVELENGTHS_NM == 560.0]


MOST_LIGHTS = 3  # a visibility label has one bit for each of three lights


_ALONE = (Lighting.RED, Lighting.GREEN, Lighting.BLUE)


@dataclass(frozen=True, kw_only=True, eq=False)
class Lights:
    """Point lights and an ambient glow.

    positions: (k, 3) metres in the camera frame. spectra: (k, λ) relative power S_k(λ) at the scene's
    centre, on `WAVELENGTHS_NM`. ambient_spectrum: (λ,) on the same scale; it reaches every surface point
    alike, whatever its normal. bits: the bit of each light in a visibility label, default 0, 1, 2.
    """

    positions: Points
    spectra: FloatArray
    ambient_spectrum: FloatArray
    bits: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.positions)
        if not 1 <= count <= MOST_LIGHTS:
            raise BadInput(f"lights: expected 1 to {MOST_LIGHTS} of them, got {count}")
        shapes = {
            "positions": (count, 3),
            "spectra": (count, len(WAVELENGTHS_NM)),
            "ambient_spectrum": (len(WAVELENGTHS_NM),),
        }
        for name, shape in shapes.items():
            values = np.array(getattr(self, name), dtype=np.float64)
            require_shape(values, shape, f"lights: {name}")
            require_finite(values, f"lights: {name}")
            object.__setattr__(self, name, read_only(values))
        if self.spectra.min() < 0 or self.ambient_spectrum.min() < 0:
            raise BadInput("lights: expected spectra without negative power")
        object.__setattr__(self, "bits", self.bits or tuple(range(count)))

    def __len__(self) -> int:
        return len(self.positions)

    def under(self, lighting: Lighting) -> "Lights":
        """Return these lights, one of them alone, or one of their places with a white lamp (Figure 6)."""
        if lighting is Lighting.COLOURED:
            return self
        if lighting in _ALONE:
            on = np.arange(len(self)) == _ALONE.index(lighting)
            return replace(self, spectra=self.spectra * on[:, None])
        place = int(lighting.value[-1]) - 1
        if place >= len(self):
            raise BadInput(f"lighting {lighting.value}: the scene has {len(self)} lights")
        return Lights(
            positions=self.positions[place : place + 1],
            spectra=white_lamp()[None],
            ambient_spectrum=self.ambient_spectrum,
            bits=(place,),
        )


CAMERA_DISTANCE_M = 5.0
_LIGHT_DISTANCES_M = (5.2, 4.8, 5.4)
_LIGHT_AZIMUTHS_DEG = (155.0, 35.0, 270.0)  # about the optical axis, 0 = right, 90 = down, seen by the camera
_LIGHT_OFF_AXIS_DEG = 18.0  # on a cone of 18° the lights are 30° to 32° apart, and not in one plane


def studio_camera(options: SceneOptions, field_width_m: float) -> Camera:
    """Return a pinhole camera that sees `field_width_m` across at the subject, 5 m away.

    The options may ask for another width. Where the image is flatter than 4:3 the field's height is kept at
    3/4 of its width, so that the subject stays whole.
    """
    field_width_m = options.field_width_m or field_width_m
    pixels_per_metre = min(options.width / field_width_m, options.height / (0.75 * field_width_m))
    return Camera.pinhole(
        width=options.width, height=options.height, focal_px=pixels_per_metre * CAMERA_DISTANCE_M
    )


def studio_centre() -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return (3,) the place of the subject in the camera frame, metres."""
    return np.array([0.0, 0.0, CAMERA_DISTANCE_M])


def studio_lights() -> Lights:
    """Return the red, green and blue lamp round the camera, about 30° apart seen from the subject."""
    off_axis = np.deg2rad(_LIGHT_OFF_AXIS_DEG)
    azimuth = np.deg2rad(_LIGHT_AZIMUTHS_DEG)
    towards = np.stack(
        [
            np.sin(off_axis) * np.cos(azimuth),
            np.sin(off_axis) * np.sin(azimuth),
            np.full(3, -np.cos(off_axis)),
        ],
        axis=1,
    )
    positions = studio_centre() + np.array(_LIGHT_DISTANCES_M)[:, None] * towards
    return Lights(positions=positions, spectra=coloured_lamps(), ambient_spectrum=room_glow())

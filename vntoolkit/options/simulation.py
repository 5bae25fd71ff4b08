"""What is filmed by the simulator, and what spoils its picture."""

from dataclasses import dataclass, fields, replace
from enum import Enum
from typing import Annotated, Literal, TypeAlias

from vntoolkit.errors import BadInput
from vntoolkit.options.base import Limit, Named, Options, named, within
from vntoolkit.photometry.transfer import Transfer


class Lighting(Enum):
    """Which lamps are on: the coloured ones, all or one alone, or a white lamp at one of the three places."""

    COLOURED = "coloured"
    RED = "red"
    GREEN = "green"
    BLUE = "blue"
    WHITE_1 = "white-1"
    WHITE_2 = "white-2"
    WHITE_3 = "white-3"


LightingName: TypeAlias = Literal["coloured", "red", "green", "blue", "white-1", "white-2", "white-3"]


@dataclass(frozen=True, kw_only=True)
class SceneOptions(Options):
    """Options of every scene."""

    width: Annotated[int, within(16)] = 640
    """Image size in pixels."""
    height: Annotated[int, within(16)] = 480
    """Image size in pixels."""
    seed: int = 0
    """Seed of the scene's own randomness (motion, texture)."""
    lighting: Named[Lighting, LightingName] = named(Lighting.COLOURED)
    """The coloured lamps together, or a white lamp in one of the three places."""
    field_width_m: Annotated[float | None, within(0.01, 5.0, "0.01 to 5 m across")] = None
    """Width of the field of view at the subject, metres. Default: the scene's own. The board is printed in
    proportion, so that one zoom films the board and another scene."""
    sample: str | None = None
    """Scene whose material lies in the board's hole. Default: a grey cloth or paper."""


@dataclass(frozen=True, kw_only=True)
class RenderOptions(Options):
    """How a frame is rendered."""

    samples: Annotated[int, Limit("1, 5 or 9 per pixel", lambda value: value in (1, 5, 9))] = 5
    """Rays per pixel: 1, 5 or 9."""
    threads: int = 0
    """For ray casting, 0 = all cores."""


STORED_BITS = (8, 10, 12, 16)


@dataclass(frozen=True, kw_only=True)
class Nuisances(Options):
    """Effects between surface and file that equation 1 does not model."""

    near_lights: bool = True
    """The lamps are points, and their light weakens with the square of the distance. Off: light is parallel
    and of one strength everywhere."""
    shadows: bool = True
    """Parts of the subject cast shadows on others."""
    ambient: bool = True
    """A little light comes from everywhere."""
    crosstalk: bool = True
    """Every channel sees all three lamps. Off: only its own."""
    texture: bool = True
    """The reflectance varies over the surface. Off: it is the reference material's everywhere."""
    gloss: bool = True
    """Glossy parts of the scene reflect the lamps."""
    blur_px: Annotated[float, within(0.0, 20.0)] = 0.6
    """Standard deviation of the lens's blur in pixels, 0 for none."""
    noise: bool = True
    """Shot and read noise."""
    full_well_electrons: Annotated[float, within(1.0, 1e9)] = 15000.0
    """Electrons that a sensor pixel holds at full scale."""
    read_noise_electrons: Annotated[float, within(0.0, 1e6)] = 4.0
    """Standard deviation of the read noise."""
    bayer: bool = True
    """A pixel measures one colour and the others are interpolated."""
    clipping: bool = True
    """Light above full scale is lost. It matters without quantisation only, since integers clip."""
    quantisation: bool = True
    """Samples are rounded to integers. Off: the file has 16 bits."""
    bits: Annotated[int, Limit("one of 8, 10, 12, 16", lambda value: value in STORED_BITS)] = 8
    """8, 10, 12 or 16 per sample."""
    transfer: str = "linear"
    """Curve of the stored values, linear, srgb, bt709 or gamma:G."""
    black_level: Annotated[float, within(0.0, 0.5)] = 0.0
    """Linear value that means no light, 0 to 0.5."""

    def __post_init__(self) -> None:
        super().__post_init__()
        Transfer.from_text(self.transfer)

    @property
    def file_transfer(self) -> Transfer:
        """The transfer that a reader of the file must undo."""
        return replace(Transfer.from_text(self.transfer), black_level=self.black_level)

    @property
    def file_bits(self) -> int:
        """Significant bits of the file's samples."""
        return self.bits if self.quantisation else 16

    @classmethod
    def none(cls) -> "Nuisances":
        """Return the model of equation 1: every nuisance off (attached shadow remains)."""
        return replace(cls(), **_SWITCHES)  # type: ignore[arg-type]

    def without(self, name: str) -> "Nuisances":
        """Return these with one turned off. name: a boolean field's, or `blur_px`, or `transfer`."""
        if name not in _SWITCHES:
            raise BadInput(f"nuisance '{name}': expected one of {', '.join(_SWITCHES)}")
        return replace(self, **{name: _SWITCHES[name]})  # type: ignore[arg-type]

    def only(self, name: str) -> "Nuisances":
        """Return the model of equation 1 with only this nuisance on (noise with its levels)."""
        self.without(name)  # refuses another name
        off = {other: value for other, value in _SWITCHES.items() if other != name}
        return replace(self, **off)  # type: ignore[arg-type]


# nuisance -> the value that turns it off
_SWITCHES: dict[str, object] = {
    **{f.name: False for f in fields(Nuisances) if f.type is bool},
    "blur_px": 0.0,
    "transfer": "linear",
}


def nuisance_names() -> tuple[str, ...]:
    """Return the names that can be turned off one at a time."""
    return tuple(_SWITCHES)

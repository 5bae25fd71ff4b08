"""What keeps a real photograph from obeying r = M n: each can be turned off alone."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

from vntoolkit.checks import require_in_range
from vntoolkit.errors import BadInput
from vntoolkit.photometry.transfer import Transfer

STORED_BITS = (8, 10, 12, 16)


@dataclass(frozen=True, kw_only=True)
class Nuisances:
    """Everything between the surface and the file that equation 1 leaves out.

    near_lights: light spreads from points and weakens with the square of the distance; off, it is parallel
    and of one strength everywhere. shadows: parts of the subject throw shadows on others. ambient: a little
    light comes from everywhere. crosstalk: every lamp is seen by all three channels; off, by its own only.
    texture: the reflectance varies over the surface; off, it is the reference material's everywhere.
    gloss: the surface mirrors the lamps a little, where the scene says so. blur_px: standard deviation of
    the lens's blur in pixels, 0 for none. noise: shot and read noise. full_well_electrons: electrons that
    a sensor pixel holds at full scale. read_noise_electrons: standard deviation of the read noise.
    bayer: a pixel measures one colour and the others are interpolated. clipping: light above full scale is
    lost; matters without quantisation only, since integers clip. quantisation: samples are rounded to
    integers; off, the file has 16 bits. bits: 8, 10, 12 or 16 per sample. transfer: curve of the stored
    values, linear, srgb, bt709 or gamma:G. black_level: linear value that means no light, 0 to 0.5.
    """

    near_lights: bool = True
    shadows: bool = True
    ambient: bool = True
    crosstalk: bool = True
    texture: bool = True
    gloss: bool = True
    blur_px: float = 0.6
    noise: bool = True
    full_well_electrons: float = 15000.0
    read_noise_electrons: float = 4.0
    bayer: bool = True
    clipping: bool = True
    quantisation: bool = True
    bits: int = 8
    transfer: str = "linear"
    black_level: float = 0.0

    def __post_init__(self) -> None:
        require_in_range(self.blur_px, 0.0, 20.0, "blur_px")
        require_in_range(self.full_well_electrons, 1.0, 1e9, "full_well_electrons")
        require_in_range(self.read_noise_electrons, 0.0, 1e6, "read_noise_electrons")
        require_in_range(self.black_level, 0.0, 0.5, "black_level")
        if self.bits not in STORED_BITS:
            raise BadInput(f"bits: expected one of {', '.join(map(str, STORED_BITS))}, got {self.bits}")
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
    def none(cls) -> Nuisances:
        """Return the world of equation 1: every nuisance off (attached shadow remains)."""
        nuisances = cls()
        for name in _SWITCHES:
            nuisances = nuisances.without(name)
        return nuisances

    def without(self, name: str) -> Nuisances:
        """Return these with one turned off. name: a boolean field's, or `blur_px`, or `transfer`."""
        if name not in _SWITCHES:
            raise BadInput(f"nuisance '{name}': expected one of {', '.join(_SWITCHES)}")
        return replace(self, **{name: _SWITCHES[name]})  # type: ignore[arg-type]

    def only(self, name: str) -> Nuisances:
        """Return the world of equation 1 with this one nuisance as it is here (noise with its levels)."""
        alone = replace(
            Nuisances.none(),
            bits=self.bits,
            full_well_electrons=self.full_well_electrons,
            read_noise_electrons=self.read_noise_electrons,
        )
        if name not in _SWITCHES:
            raise BadInput(f"nuisance '{name}': expected one of {', '.join(_SWITCHES)}")
        return replace(alone, **{name: getattr(self, name)})


# nuisance -> the value that turns it off
_SWITCHES: dict[str, object] = {
    **{f.name: False for f in fields(Nuisances) if f.type == "bool"},
    "blur_px": 0.0,
    "transfer": "linear",
}


def nuisance_names() -> tuple[str, ...]:
    """Return the names that can be turned off one at a time."""
    return tuple(_SWITCHES)


def each_turned_off(nuisances: Nuisances) -> Iterator[tuple[str, Nuisances]]:
    """Yield ("all", as given), then (name, all but that one) for every nuisance, then ("none", none)."""
    yield "all", nuisances
    for name in nuisance_names():
        yield name, nuisances.without(name)
    yield "none", Nuisances.none()

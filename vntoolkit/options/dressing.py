"""How a tracked garment is put on a skeleton."""

from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Literal, TypeAlias

from vntoolkit.options.base import Limit, Named, Options, named, positive, within


class Garment(Enum):
    """What is dressed. AUTO: trousers where the outline has two legs, else a SWEATER: what has sleeves."""

    AUTO = "auto"
    SWEATER = "sweater"
    SLEEVELESS = "sleeveless"
    TROUSERS = "trousers"
    SKIRT = "skirt"
    OVERALL = "overall"

    @property
    def is_lower(self) -> bool:
        """Whether it hangs from the waist."""
        return self in (Garment.TROUSERS, Garment.SKIRT)


GarmentName: TypeAlias = Literal["auto", "sweater", "sleeveless", "trousers", "skirt", "overall"]


@dataclass(frozen=True, kw_only=True)
class GarmentFitOptions(Options):
    """How the garment is brought onto the figure."""

    garment: Named[Garment, GarmentName] = named(Garment.AUTO)
    """What it is. Upper garments hang from the neck, and their sleeves on the arms: sweater stands for shirts
    and jackets too. Sleeveless ones leave the arms alone. Trousers and skirts hang from the waist and follow
    the legs. auto tells trousers by the outline, but not a skirt."""
    fullness: Annotated[float | None, positive()] = None
    """Height of the garment over the height of what it covers, hips to neck or hips to feet. Default: 1.3;
    trousers 1.05, a skirt 0.65."""


class Falloff(Enum):
    """How the weights of a vertex are computed.

    HEAT: by heat that spreads along the cloth from where each bone lies under it, baran2007: a flank does
    not follow the arm beside it. INVERSE: by 1/distance through the air to the nearest bones, as published;
    the cloth tears where the set of nearest bones changes, and hangs like a web under a raised arm.
    """

    HEAT = "heat"
    INVERSE = "inverse"


_BONES = {Falloff.HEAT: 8, Falloff.INVERSE: 4}


@dataclass(frozen=True, kw_only=True)
class WeightOptions(Options):
    """Options of the skinning weights."""

    falloff: Named[Falloff, Literal["heat", "inverse"]] = named(Falloff.HEAT)
    """How a vertex weighs its bones: heat, by heat along the cloth; inverse, by the inverse distance as
    published."""
    neighbours: Annotated[int | None, within(1, words="at least 1")] = None
    """Number of bones that a vertex follows. Default: 8 by heat, else the 4 nearest."""
    exclude: tuple[str, ...] = ()
    """Joints whose bones get no weight, as names or patterns (`*Hand*`)."""

    @property
    def bones(self) -> int:
        """Number of bones a vertex follows."""
        return _BONES[self.falloff] if self.neighbours is None else self.neighbours


class Loop(Enum):
    """What the cloth does after its last frame."""

    NONE = "none"
    REPEAT = "repeat"
    PING_PONG = "ping-pong"


@dataclass(frozen=True, kw_only=True)
class ClockOptions(Options):
    """Start, end and rate of the result."""

    start: Annotated[float, within(0, words="seconds from 0 on")] = 0.0
    """Second of the motion at which the result begins."""
    stop: Annotated[float | None, within(0, words="seconds from 0 on")] = None
    """Second of the motion at which it ends. Default: the motion's end."""
    speed: Annotated[float, positive()] = 1.0
    """Seconds of motion per second of result."""
    loop: Named[Loop, Literal["none", "repeat", "ping-pong"]] = named(Loop.NONE)
    """What the cloth does after its last frame where the motion is longer. none ends there; repeat starts
    again; ping-pong plays back and forth, so that nothing jumps."""
    frame_rate_hz: Annotated[float | None, positive()] = None
    """Frames per second of the result. Default: the cloth's. Blender plays a file at its scene's rate, 24
    unless you set it to the file's."""


class Anchor(Enum):
    """Which part of the performer's motion is removed from the cloth."""

    BONES = "bones"  # the rigid motion of the cloth over the trunk, each upper arm and each forearm
    TRUNK = "trunk"
    NONE = "none"


class Blend(Enum):
    """How a vertex mixes the motions of its bones: LINEAR as published, DUAL_QUATERNION rigidly."""

    LINEAR = "linear"
    DUAL_QUATERNION = "dual-quaternion"


FIGURE_HEIGHT_M = 1.65  # toes to crown of an average adult, as skeletons measure it


class AnimationStorage(Enum):
    """What moves the cloth in a USD or GLB."""

    SKIN = "skin"
    CACHE = "cache"


class MotionUpAxis(Enum):
    """Which axis of the motion file points up; AUTO takes the longer of y and z of the rest pose."""

    AUTO = "auto"
    Y = "y"
    Z = "z"


@dataclass(frozen=True, kw_only=True)
class DressOptions(Options):
    """Options of `dress`, beyond those of its stages."""

    blend: Named[Blend, Literal["linear", "dual-quaternion"]] = named(Blend.LINEAR)
    """How a vertex mixes the motions of its bones."""
    anchor: Named[Anchor, Literal["bones", "trunk", "none"]] = named(Anchor.BONES)
    """Which part of the performer's motion is removed from the cloth. bones: the motion of trunk and arms, so
    that sleeves follow the figure's arms alone; folds keep moving. trunk: the motion of the trunk; captured
    sleeves swing on top of the figure's. none: nothing, the performer's steps stay."""
    figure_height: Annotated[float, positive("positive metres")] = FIGURE_HEIGHT_M
    """Metres from the toes to the crown, for motion files that carry no unit."""
    up_axis: Named[MotionUpAxis, Literal["auto", "y", "z"]] = named(MotionUpAxis.AUTO)
    """Which axis of the motion file points up."""
    max_stretch: Annotated[float, Limit("a factor above 1, or 0", lambda value: value == 0 or value > 1)] = (
        3.0
    )
    """Largest stretch of a triangle's edge where the parts of two bones meet. A triangle that the motion
    stretches more is cut: the capture joined what only touched, such as sleeve and flank. 0 cuts nothing;
    weights by distance cut nothing either."""
    carrier: Named[AnimationStorage, Literal["skin", "cache"]] = named(AnimationStorage.SKIN)
    """What moves the cloth in USD and GLB: a skin (joint weights, and blend shapes for the folds), or a cache
    of every vertex in every frame, exact and large. Dual quaternions are written as a cache."""
    centre: bool = True
    """The figure begins above the origin of the file and stands on its floor."""
    map: tuple[str, ...] = ()
    """Joints of the arms, where their names and lengths do not tell: left-upper-arm=JOINT, left-forearm,
    left-hand, right-upper-arm and so on; once for each."""
    fitting: GarmentFitOptions = field(default_factory=GarmentFitOptions)
    weights: WeightOptions = field(default_factory=WeightOptions)
    clock: ClockOptions = field(default_factory=ClockOptions)

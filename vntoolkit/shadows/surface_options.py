"""What is asked of the surface under the shadows: weights of its energy, and how long it is minimised."""

from __future__ import annotations

from dataclasses import dataclass

from vntoolkit.checks import require_in_range, require_positive
from vntoolkit.errors import BadInput

_POSITIVE = (
    "noise", "least_noise", "shadow_step_softness", "smooth_px", "doubt_reach", "damping", "steepest",
)  # fmt: skip
_NOT_NEGATIVE = (
    "noise_per_slope", "albedo_spread", "own_albedo_spread", "step_softness", "smoothness", "tolerance",
)  # fmt: skip
_AT_LEAST_ONE = ("iterations", "start_pixels", "middle_iterations", "large_iterations", "cycles")


@dataclass(frozen=True, kw_only=True)
class SurfaceOptions:
    """The energy and how long it is minimised.

    noise: standard deviation of a light's share, the share of a surface that faces the light being 1; it
    stands for camera noise and for what the model leaves out (interreflection, gloss). noise_per_slope,
    least_noise: on frames whose normals are cleaner `surface_from_either_start` lowers the noise to
    noise_per_slope times that of a slope, but not below least_noise. albedo_spread: relative standard
    deviation of the albedo continued into a shadow. own_albedo_spread: the same where all three lights
    arrive; large, as there the colour's length is the albedo. step_softness: χ² at which a depth gradient
    counts a quarter, because it crosses a step in depth; 0 makes the surface continuous everywhere.
    shadow_step_softness: the same under two lights, where the slope hangs on the albedo around.
    trust_by_lights: weight of the colour of a pixel that 0, 1, 2, 3 lights reach, in
    `surface_from_either_start`: one light alone hangs on the albedo; few pixels under two must hold
    against many around. smoothness: weight of a shadowed pixel's slope being its surroundings' mean;
    smooth_px: radius (standard deviation, pixels) of that mean. doubt_trust: weight of a light that is
    labelled missing where the surface would return about what is seen, as it does where it turns from the
    light; doubt_reach: difference of shares at which that weight ends. damping: holds the slope back
    where nothing else is known. iterations: Gauss–Newton steps. start_pixels: frames larger than this are
    halved until they are not, and compare starts there; middle_iterations, large_iterations: steps that
    follow at every larger size, and at the frame's own. cycles: multigrid cycles per step. tolerance:
    relative residual that ends a step early. steepest: largest slope, the tangent of the angle from the
    viewing ray.
    """

    noise: float = 0.03
    noise_per_slope: float = 1.7
    least_noise: float = 0.01
    albedo_spread: float = 0.15
    own_albedo_spread: float = 3.0
    step_softness: float = 10.0
    shadow_step_softness: float = 40.0
    trust_by_lights: tuple[float, float, float, float] = (1.0, 0.2, 2.0, 1.0)
    smoothness: float = 3.0
    smooth_px: float = 2.0
    doubt_trust: float = 0.3
    doubt_reach: float = 0.2
    damping: float = 1.0
    iterations: int = 8
    start_pixels: int = 15_000
    middle_iterations: int = 4
    large_iterations: int = 3
    cycles: int = 5
    tolerance: float = 3e-3
    steepest: float = 8.0

    def __post_init__(self) -> None:
        for name in _POSITIVE:
            require_positive(getattr(self, name), f"surface: {name}")
        for name in _NOT_NEGATIVE:
            require_in_range(getattr(self, name), 0.0, 1e6, f"surface: {name}")
        require_in_range(self.doubt_trust, 0.0, 1.0, "surface: doubt_trust")
        for weight in self.trust_by_lights:
            require_in_range(weight, 0.0, 1e6, "surface: trust by lights")
        for name in _AT_LEAST_ONE:
            if getattr(self, name) < 1:
                raise BadInput(f"surface: expected {name} of at least 1, got {getattr(self, name)}")

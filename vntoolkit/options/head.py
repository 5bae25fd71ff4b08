"""How a rig is fitted to a head that turns."""

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Annotated, Literal, Self

from vntoolkit.options.base import Limit, Named, Options, named
from vntoolkit.options.calibration import ResponseModel, ResponseModelName


class Features(Enum):
    """What is matched between frames."""

    TRACKS = "tracks"  # skin followed by optical flow, poses by factorisation: up to 4 degrees a frame
    SIFT = "sift"  # features matched, poses by COLMAP's mapping: photographs, up to 20 degrees apart; slower


class HeadShape(Enum):
    """Which shape gives the normals."""

    HULL = "hull"  # silhouettes alone: quick, and enough for M on a well-lit head
    FUSED = "fused"  # silhouettes and stereo
    REFINED = "refined"  # fused, then corrected by the normals that its colours give, in turns with M


@dataclass(frozen=True, kw_only=True)
class HeadSteps:
    """Numbers of the stages, for pictures of 640 pixels and more across; no person turns them.

    Tracks: most corners at a time, their least distance and the side of the window that is compared, least
    distance from the silhouette's edge, pixels. Poses: tracks drawn for the solution, and the smallest turn
    that carries a calibration. Hull: cells along the longest side. Stereo: views that get a depth map, turns
    to the views that each is compared with, to both sides, side of the compared window, how far before and
    behind the hull depth is searched, as shares of its diagonal (0.07 is 2 to 3 cm of a head), least
    correlation, standard deviation of the smoothing. Fusion: levels of Poisson's octree (7 resolves a 100th
    of the head), distance as a share of the diagonal within which points of so many other views confirm a
    point, and within which the hull is no surface. Light: frames and points of the samples, random hypotheses
    of M, largest colour error of an inlier over its colour's length.
    """

    corners: int = 2000
    corner_spacing_px: float = 7.0
    window_px: int = 13
    margin_px: int = 9
    pose_tracks: int = 2000
    least_turn_deg: float = 40.0
    hull_cells: int = 128
    references: int = 11
    neighbour_angles_deg: tuple[float, ...] = (10.0, 16.0)
    stereo_window_px: int = 13
    before: float = 0.010
    behind: float = 0.070
    least_correlation: float = 0.6
    smoothing_px: float = 2.0
    fusion_depth: int = 7
    agreement: float = 0.004
    confirmations: int = 1
    hull_gap: float = 0.008
    light_frames: int = 14
    light_points: int = 3000
    light_draws: int = 1500
    light_inlier: float = 0.12

    def closely(self) -> Self:
        """Return the numbers of the second pass of stereo: about the first one's mesh, in small windows."""
        return replace(
            self,
            before=_CLOSE,
            behind=_CLOSE,
            neighbour_angles_deg=_CLOSER_ANGLES_DEG,
            stereo_window_px=_CLOSER_WINDOW_PX,
            smoothing_px=_LESS_SMOOTH * self.smoothing_px,
        )


# Of the second pass: neighbours from well correlated to precise in depth, and smaller windows.
_CLOSER_ANGLES_DEG = (6.0, 12.0, 18.0)
_CLOSER_WINDOW_PX, _LESS_SMOOTH = 5, 0.5
_CLOSE = 0.012  # of the diagonal: how far it searches to both sides


@dataclass(frozen=True, kw_only=True)
class HeadOptions(Options):
    """How a rig is fitted to a head."""

    head_shape: Named[HeadShape, Literal["hull", "fused", "refined"]] = named(HeadShape.REFINED)
    """Shape that gives the normals: from silhouettes only, fused with stereo, or refined by the normals of
    all frames."""
    features: Named[Features, Literal["tracks", "sift"]] = named(Features.TRACKS)
    """What is matched between frames: tracks of the skin (video), or SIFT features (photographs up to 20
    degrees apart)."""
    threshold: Annotated[float | None, Limit("a share between 0 and 1", lambda share: 0 < share < 1)] = None
    """Mean of the channels, 0 to 1 of full scale, above which a pixel is subject. The contour is then moved
    to the edge beside it. Default: found from the image's border."""
    light_model: Named[ResponseModel, ResponseModelName] = named(ResponseModel.LINEAR)
    """3×3; or 3×4, which adds ambient light. Take 3×4 for skin of one colour only: on bare skin it takes
    changes of the albedo for ambient light."""
    steps: HeadSteps = field(default_factory=HeadSteps)

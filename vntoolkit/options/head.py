"""How a rig is fitted to a head that turns."""

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Literal, Self

from vntoolkit.errors import BadInput
from vntoolkit.options.base import Named, Options, named
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
class SilhouetteOptions(Options):
    """Options of the silhouettes."""

    threshold: float | None = None
    """Mean of the channels, 0 to 1 of full scale, above which a pixel is subject. The contour is then moved
    to the edge beside it. Default: found from the image's border."""

    def _require_valid(self) -> None:
        if self.threshold is not None and not 0 < self.threshold < 1:
            raise BadInput(f"silhouette threshold: expected 0 to 1, got {self.threshold:g}")


@dataclass(frozen=True, kw_only=True)
class TrackOptions(Options):
    """Options of the tracks."""

    corners: int = 2000
    """Most corners followed at a time."""
    corner_spacing_px: float = 7.0
    """Least distance between corners, pixels."""
    window_px: int = 13
    """Side of the window that is compared, pixels."""
    margin_px: int = 9
    """Least distance of a corner from the silhouette's edge, pixels."""

    def _require_valid(self) -> None:
        if self.corners < 50 or self.window_px < 5 or self.corner_spacing_px < 1 or self.margin_px < 0:
            raise BadInput("tracks: expected at least 50 corners, a window of 5 px and no negative distance")


@dataclass(frozen=True, kw_only=True)
class FollowOptions(Options):
    """How frames are matched."""

    features: Named[Features, Literal["tracks", "sift"]] = named(Features.TRACKS)
    """What is matched between frames: tracks of the skin (video), or SIFT features (photographs up to 20
    degrees apart)."""
    silhouettes: SilhouetteOptions = field(default_factory=SilhouetteOptions)
    tracks: TrackOptions = field(default_factory=TrackOptions)


LEAST_TRACKS = 60


@dataclass(frozen=True, kw_only=True)
class PoseOptions(Options):
    """Options of the poses."""

    pose_tracks: int = 2000
    """Tracks drawn at random for the solution; more cost time and gain little."""
    least_turn_deg: float = 40.0
    """Least turn of the head from one end to the other, in degrees. A smaller turn is refused."""

    def _require_valid(self) -> None:
        if self.pose_tracks < LEAST_TRACKS or not 0 < self.least_turn_deg < 180:
            raise BadInput(
                f"poses: expected at least {LEAST_TRACKS} tracks and a least turn from 0 to 180 degrees"
            )


@dataclass(frozen=True, kw_only=True)
class HullOptions(Options):
    """How finely the hull is carved."""

    hull_cells: int = 128
    """Cells along the longest side of the box."""

    def _require_valid(self) -> None:
        if not 16 <= self.hull_cells <= 512:
            raise BadInput(f"hull: expected 16 to 512 cells, got {self.hull_cells}")


# Of the second pass: neighbours from well correlated to precise in depth, and smaller windows.
_CLOSER_ANGLES_DEG = (6.0, 12.0, 18.0)
_CLOSER_WINDOW_PX, _LESS_SMOOTH = 5, 0.5
_CLOSE = 0.012  # of the diagonal: how far it searches to both sides


@dataclass(frozen=True, kw_only=True)
class StereoOptions(Options):
    """Options of the search for depth."""

    references: int = 11
    """Views that get a depth map, evenly over the turn."""
    neighbour_angles_deg: tuple[float, ...] = (10.0, 16.0)
    """Turn between a reference and the views it is compared with, to both sides."""
    stereo_window_px: int = 13
    """Side of the compared window."""
    before: float = 0.010
    """How far in front of the hull depth is searched, as a share of its diagonal. Little is needed, since the
    head lies inside the hull. Raise it where the silhouettes cut into the head."""
    behind: float = 0.070
    """How far beneath the hull depth is searched, as a share of its diagonal; 0.07 is 2 to 3 cm of a head.
    Raise it where hollows such as eye sockets come out filled. Lower it where dents appear that the head does
    not have."""
    least_correlation: float = 0.6
    """Correlation of the compared windows, 0 to 1, below which a pixel gets no depth. Lower it to 0.5 where
    smooth or dark skin leaves holes. Raise it to 0.7 where wrong points roughen the surface."""
    smoothing_px: float = 2.0
    """Standard deviation of the smoothing of the depth in a map."""

    def _require_valid(self) -> None:
        if self.references < 1 or self.stereo_window_px < 5 or self.stereo_window_px % 2 == 0:
            raise BadInput("stereo: expected at least one reference and an odd window of 5 px or more")
        if not self.neighbour_angles_deg or min(self.neighbour_angles_deg) <= 0:
            raise BadInput("stereo: expected neighbours at positive angles")
        if min(self.before, self.behind, self.smoothing_px) <= 0:
            raise BadInput("stereo: expected positive depths and smoothing")
        if not 0 < self.least_correlation < 1:
            raise BadInput("stereo: expected a correlation from 0 to 1")

    def closely(self) -> Self:
        """Return the options of the second pass, about the mesh of the first, in small windows."""
        return replace(
            self,
            before=_CLOSE,
            behind=_CLOSE,
            neighbour_angles_deg=_CLOSER_ANGLES_DEG,
            stereo_window_px=_CLOSER_WINDOW_PX,
            smoothing_px=_LESS_SMOOTH * self.smoothing_px,
        )


@dataclass(frozen=True, kw_only=True)
class FusionOptions(Options):
    """How depths become a mesh."""

    fusion_depth: int = 7
    """Levels of Poisson's octree; 7 resolves about a 100th of the head."""
    agreement: float = 0.004
    """Distance, as a share of the hull's diagonal, within which points of another view must confirm a point.
    """
    confirmations: int = 1
    """How many other views must confirm a point for it to be kept. Raise it to 2 or 3 where single wrong
    points leave bumps. Lower it to 0 where parts are missing that few views saw."""
    hull_gap: float = 0.008
    """Where stereo gives no depth within this distance, the hull is taken for the surface. As a share of the
    hull's diagonal."""

    def _require_valid(self) -> None:
        if not 4 <= self.fusion_depth <= 12 or self.confirmations < 0:
            raise BadInput("fusion: expected a depth of 4 to 12 and no negative number of confirmations")
        if min(self.agreement, self.hull_gap) <= 0:
            raise BadInput("fusion: expected a positive agreement and hull gap")


@dataclass(frozen=True, kw_only=True)
class SampleOptions(Options):
    """Where colours are taken."""

    light_frames: int = 14
    """Frames, spread over the turn."""
    light_points: int = 3000
    """Points of the skin, spread over orientations."""

    def _require_valid(self) -> None:
        if self.light_frames < 3 or self.light_points < 100:
            raise BadInput("light: expected at least 3 frames and 100 points")


@dataclass(frozen=True, kw_only=True)
class LightOptions(Options):
    """Options of the fit of M to skin."""

    light_model: Named[ResponseModel, ResponseModelName] = named(ResponseModel.LINEAR)
    """3×3; or 3×4, which adds ambient light. Take 3×4 for skin of one colour only: on bare skin it takes
    changes of the albedo for ambient light."""
    light_draws: int = 1500
    """Random hypotheses of M that are tried."""
    light_inlier: float = 0.12
    """Largest colour error of an inlier over its colour's length."""

    def _require_valid(self) -> None:
        if self.light_draws < 1 or not 0 < self.light_inlier < 1:
            raise BadInput("light: expected at least one draw and an inlier share from 0 to 1")


@dataclass(frozen=True, kw_only=True)
class HeadOptions(Options):
    """Options of all stages."""

    head_shape: Named[HeadShape, Literal["hull", "fused", "refined"]] = named(HeadShape.REFINED)
    """Shape that gives the normals: from silhouettes only, fused with stereo, or refined by the normals of
    all frames."""
    following: FollowOptions = field(default_factory=FollowOptions)
    poses: PoseOptions = field(default_factory=PoseOptions)
    hull: HullOptions = field(default_factory=HullOptions)
    stereo: StereoOptions = field(default_factory=StereoOptions)
    fusion: FusionOptions = field(default_factory=FusionOptions)
    samples: SampleOptions = field(default_factory=SampleOptions)
    light: LightOptions = field(default_factory=LightOptions)

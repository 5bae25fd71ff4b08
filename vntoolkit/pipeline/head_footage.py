"""Silhouettes and tracks of a turning head, frame by frame."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum

import numpy as np
import numpy.typing as npt

from vntoolkit.calibration.head.contrast import ContrastOptions, local_contrast
from vntoolkit.calibration.head.sift import SiftBuilder, SiftOptions, require_features
from vntoolkit.calibration.head.silhouettes import (
    Silhouette,
    SilhouetteOptions,
    find_silhouette,
    require_head,
)
from vntoolkit.calibration.head.tracks import TrackBuilder, TrackOptions, Tracks, require_tracks
from vntoolkit.geometry.camera import Camera
from vntoolkit.photometry.frame import LinearFrame


class Features(Enum):
    """What is recognised from frame to frame."""

    TRACKS = "tracks"  # skin followed by optical flow: video, up to 4 degrees from frame to frame
    SIFT = "sift"  # features matched: photographs, up to 20 degrees apart; slower


@dataclass(frozen=True, kw_only=True)
class FollowOptions:
    """How footage is followed. features: skin followed from frame to frame, or features matched."""

    features: Features = Features.TRACKS
    contrast: ContrastOptions = field(default_factory=ContrastOptions)
    silhouettes: SilhouetteOptions = field(default_factory=SilhouetteOptions)
    tracks: TrackOptions = field(default_factory=TrackOptions)
    sift: SiftOptions = field(default_factory=SiftOptions)


@dataclass(frozen=True, kw_only=True, eq=False)
class HeadFootage:
    """What is kept of the footage: per frame used its number, silhouette and 8-bit local contrast."""

    numbers: tuple[int, ...]
    silhouettes: tuple[Silhouette, ...]
    contrasts: tuple[npt.NDArray[np.uint8], ...]


def follow_frames(
    frames: Iterable[LinearFrame], camera: Camera, options: FollowOptions
) -> tuple[HeadFootage, Tracks]:
    """Find silhouettes and tracks in undistorted frames; raise `BadCalibration` where either is no use."""
    sift = options.features is Features.SIFT
    builder = (
        SiftBuilder(camera=camera, options=options.sift) if sift else TrackBuilder(options=options.tracks)
    )
    numbers, silhouettes, contrasts = [], [], []
    for frame in frames:
        silhouette = find_silhouette(frame.rgb, options.silhouettes)
        builder.add(local_contrast(frame.rgb, options.contrast), silhouette.mask)
        numbers.append(frame.number)
        silhouettes.append(silhouette)
        contrasts.append(builder.image)
    require_head(silhouettes)
    tracks = builder.finish()
    (require_features if sift else require_tracks)(tracks)
    footage = HeadFootage(numbers=tuple(numbers), silhouettes=tuple(silhouettes), contrasts=tuple(contrasts))
    return footage, tracks

"""Named trackers: the default, those of the paper, and ARAP, for comparison."""

from __future__ import annotations

from enum import Enum

from vntoolkit.tracking.options import (
    Confidence,
    DriftCorrection,
    DriftOptions,
    FlowMethod,
    FlowOptions,
    LaplacianKind,
    Regulariser,
    RestShape,
    Tears,
    TrackingOptions,
)

# sqrt(1.5 / β) for the paper's β = 1e-3 on edges of length 1
PUBLISHED_SMOOTHING_LENGTH = 38.7
PUBLISHED_DATA_SHARE = 0.9


class Tracker(Enum):
    """A whole method by name."""

    DEFAULT = "default"
    NO_REGISTRATION = "no-registration"
    FLOW = "flow"
    TRANSLATION = "translation"
    LAPLACIAN_TEMPLATE = "laplacian-template"
    LAPLACIAN_PREVIOUS = "laplacian-previous"
    LAPLACIAN_COTANGENT = "laplacian-cotangent"
    ARAP = "arap"


def options_of(tracker: Tracker) -> TrackingOptions:
    """Return the options of a named tracker (`brostow2011` section V; ARAP: `sorkine2007`)."""
    if tracker is Tracker.DEFAULT:
        return TrackingOptions()
    flow = FlowMethod.NONE if tracker is Tracker.NO_REGISTRATION else FlowMethod.LATTICE
    return TrackingOptions(
        regulariser=_REGULARISERS.get(tracker, Regulariser.LAPLACIAN),
        laplacian=LaplacianKind.COTANGENT
        if tracker is Tracker.LAPLACIAN_COTANGENT
        else LaplacianKind.UNIFORM,
        rest=RestShape.TEMPLATE if tracker is Tracker.LAPLACIAN_TEMPLATE else RestShape.PREVIOUS,
        confidence=Confidence.NONE,
        smoothing_length=PUBLISHED_SMOOTHING_LENGTH,
        data_share=PUBLISHED_DATA_SHARE,
        tears=Tears.NONE,
        flow=FlowOptions(method=flow),
        drift=DriftOptions(correction=DriftCorrection.NONE),
    )


_REGULARISERS = {
    Tracker.NO_REGISTRATION: Regulariser.NONE,
    Tracker.FLOW: Regulariser.NONE,
    Tracker.TRANSLATION: Regulariser.TRANSLATION,
    Tracker.ARAP: Regulariser.ARAP,
}

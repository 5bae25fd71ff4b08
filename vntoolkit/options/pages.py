"""What pages show, where they are served, and what a camera is asked for."""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Literal, TypeAlias

from vntoolkit.options.base import Options, positive, within


@dataclass(frozen=True, kw_only=True)
class ViewerOptions(Options):
    """Where the page is served."""

    host: str = "127.0.0.1"
    """Address to listen on; 127.0.0.1 is seen by this machine only, 0.0.0.0 by the whole network."""
    port: Annotated[int, within(1, 65535, "1 to 65535")] = 8080
    """Port of the page; the next free one is taken where it is in use."""


@dataclass(frozen=True, kw_only=True)
class ScenePageOptions(Options):
    """How much of a reconstruction goes into an offline page."""

    vertices: Annotated[int, within(4)] = 12_000
    """Most vertices of a frame's mesh on the page of --html; finer ones are thinned."""
    most_frames: Annotated[int, within(1)] = 150
    """Most frames on that page, evenly spread over the sequence. With 12,000 vertices and four pictures of
    640 pixels, a frame takes about 0.3 MB."""


@dataclass(frozen=True, kw_only=True)
class ReportOptions(Options):
    """What the report shows."""

    samples: Annotated[int, within(1)] = 4
    """Frames shown as pictures, evenly spread."""
    footage: str = ""
    """Where the footage is now, if not where it was when it was reconstructed."""


@dataclass(frozen=True, kw_only=True)
class CameraOptions(Options):
    """What is asked of a camera, which gives the nearest that it can."""

    width: Annotated[int, within(1)] = 1280
    """Width in pixels of the picture that the camera is asked for; after crop and rectification it must be
    the rig's. Not for a video, which has its own."""
    height: Annotated[int, within(1)] = 720
    """The same for the height."""
    rate: Annotated[float, positive()] = 30.0
    """Frames per second that the camera is asked for. A video plays at its own rate with --realtime, else as
    fast as it can be read."""


class PageSize(Enum):
    """Paper, (width, height) in millimetres, upright."""

    A4 = (210.0, 297.0)
    A3 = (297.0, 420.0)
    A2 = (420.0, 594.0)
    LETTER = (215.9, 279.4)
    TABLOID = (279.4, 431.8)


PageSizeName: TypeAlias = Literal["a4", "a3", "a2", "letter", "tabloid"]

"""A self-contained HTML page of sections: figures and pictures lie inside it, nothing is fetched."""

from __future__ import annotations

import base64
import datetime
import hashlib
import io
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import vntoolkit
from vntoolkit.arrays import ByteArray
from vntoolkit.errors import BadInput
from vntoolkit.io.atomic import write_text
from vntoolkit.io.files import read_bytes
from vntoolkit.io.footage.image_writing import encoded_image
from vntoolkit.io.results.manifest import now_utc
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig
from vntoolkit.report.pictures import report_style
from vntoolkit.report.rendering import rendered

if TYPE_CHECKING:
    from matplotlib.figure import Figure
_CONDITION = (10.0, 30.0)  # good up to the first, poor beyond the second
_KINDS = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".webp": "image/webp",
    ".svg": "image/svg+xml",
}


@dataclass(frozen=True, kw_only=True)
class PageFigure:
    """A picture with its caption. svg: the text of an inline SVG; or image: a data URI. wide: a whole row."""

    caption: str
    svg: str = ""
    image: str = ""
    wide: bool = False


@dataclass(frozen=True, kw_only=True)
class PageTable:
    """Rows of text under headings. right: places of the columns that are set to the right.

    folded: shown only when this line is clicked; empty for shown at once.
    """

    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    folded: str = ""
    right: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True)
class PageNumber:
    """One number that matters: shown large, with what it is and how to read it. grade: good, fair or poor."""

    value: str
    label: str
    remark: str = ""
    grade: str = ""


def graded(label: str, shown: str, value: float, bounds: tuple[float, float], remark: str) -> PageNumber:
    """Return a number that is good up to the first bound, fair up to the second, else poor.

    Where the first bound is the larger one, good is what lies above it.
    """
    sign = 1.0 if bounds[0] <= bounds[1] else -1.0
    good, fair = (sign * value <= sign * bound for bound in bounds)
    grade = "good" if good else "fair" if fair else "poor"
    return PageNumber(value=shown, label=label, remark=remark, grade=grade)


@dataclass(frozen=True, kw_only=True)
class PageNotice:
    """A line that must be seen. severity: note, warning or fatal, as doctor's. more: opens beneath it."""

    severity: str
    text: str
    more: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class PageSection:
    """A part of the page, shown in this order: paragraphs, numbers, notices, figures, tables."""

    title: str
    paragraphs: tuple[str, ...] = ()
    numbers: tuple[PageNumber, ...] = ()
    notices: tuple[PageNotice, ...] = ()
    figures: tuple[PageFigure, ...] = ()
    tables: tuple[PageTable, ...] = ()


def condition_of(response: LightResponse) -> PageNumber:
    """Return M's condition number, graded."""
    number, of_lights = response.condition_number, "set by the lights' directions and colours"
    return graded("condition number of M", f"{number:.1f}", number, _CONDITION, of_lights)


def table_of_sources(heading: str, rig: Rig) -> PageTable:
    """Return the files that a rig was calibrated from."""
    rows = tuple((source.file, source.sha256[:16] + "…") for source in rig.sources)
    return PageTable(headings=(heading, "SHA-256"), rows=rows)


def figure_from_plot(figure: Figure, caption: str, *, wide: bool = False) -> PageFigure:
    """Put a matplotlib figure on a page, as inline SVG."""
    return PageFigure(caption=caption, svg=svg_from_figure(figure), wide=wide)


def figure_from_pixels(
    pixels: ByteArray, caption: str, *, suffix: str = ".jpg", wide: bool = False
) -> PageFigure:
    """Put (h, w, 3) uint8 RGB pixels on a page."""
    return PageFigure(caption=caption, image=data_uri(encoded_image(pixels, suffix), suffix), wide=wide)


def figure_from_file(path: Path, caption: str, *, wide: bool = False) -> PageFigure:
    """Put a PNG, JPEG, WebP or SVG file on a page."""
    suffix = path.suffix.lower()
    if suffix not in _KINDS:
        raise BadInput(f"{path}: a figure is one of {', '.join(_KINDS)}")
    return PageFigure(caption=caption, image=data_uri(read_bytes(path), suffix), wide=wide)


def data_uri(content: bytes, suffix: str) -> str:
    """Return the bytes of an image file as a URI that holds them."""
    return f"data:{_KINDS[suffix]};base64,{base64.b64encode(content).decode('ascii')}"


def write_page(
    path: Path, title: str, sections: list[PageSection], *, subtitle: str = "", numbers: Any = ()
) -> None:
    """Write the page, atomically. numbers: `PageNumber`s under the title. All text is escaped."""
    written = datetime.datetime.fromisoformat(now_utc()).strftime("%Y-%m-%d %H:%M UTC")
    text = rendered(
        "page.html.j2",
        title=title,
        subtitle=subtitle,
        numbers=tuple(numbers),
        sections=sections,
        written=written,
        version=vntoolkit.__version__,
    )
    write_text(path, text)


def svg_from_figure(figure: Figure) -> str:
    """Return `<svg …>…</svg>` without prolog, comments, dates or metadata, its ids unlike any other figure's.

    The same figure gives the same text.
    """
    stream = io.StringIO()
    with report_style(**{"svg.hashsalt": "vntoolkit"}):
        figure.savefig(
            stream,
            format="svg",
            transparent=True,
            metadata={"Date": None, "Creator": None, "Format": None, "Type": None},
        )
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    mark = "f" + hashlib.sha256(text.encode()).hexdigest()[:8]
    text = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{mark}-", text)
    # the page sets the width; the viewBox keeps the proportions
    head, tail = text.split(">", 1)
    head = re.sub(r'\s(width|height)="[^"]*"', "", head)
    return f'{head} role="img">{tail}'.strip()

"""Matplotlib figures as SVG that stands inside a page."""

from __future__ import annotations

import hashlib
import io
import re
from typing import TYPE_CHECKING

from vntoolkit.report.style import report_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure


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

"""What the live page says of itself: rate, latency, dropped frames, recording, and what to change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from vntoolkit.pipeline.live import LiveFigures

_WARNING = "background:#4a3300;border-left:4px solid #e69f00;color:#ffe0a3"
_RECORDING = "background:#4d1f06;border-left:4px solid #d55e00;color:#ffd2ba"
_BOX = "margin:.35rem .75rem;padding:.4rem .6rem;border-radius:4px;font-size:.86rem"
_NUMBER = "font-size:1.25rem;font-weight:650;line-height:1.2;font-variant-numeric:tabular-nums"


@dataclass(frozen=True, kw_only=True)
class LiveStatus:
    """What is to be said. figures: of frames worked on. shown_hz: frames a second that go to the page.

    shown_s: seconds from a frame's arrival until it goes to the page, median. warnings: one line each.
    recording: name of the file being written, empty where none is.
    """

    figures: LiveFigures
    shown_hz: float
    shown_s: float
    warnings: Sequence[str] = ()
    recording: str = ""

    def html(self) -> str:
        """Return it as HTML with its own styles; all texts escaped."""
        figures = self.figures
        median, high = (1000 * seconds for seconds in figures.latency_s)
        lost = f", {figures.failed:,} failed" if figures.failed else ""
        dropped = f"{100 * figures.dropped / max(1, figures.arrived):.1f} %"
        cards = (
            (f"{figures.rate_hz:.1f}", "frames a second", f"{figures.processed:,} so far"),
            (f"{median:.0f} ms", "latency of a frame", f"95 %: {high:.0f} ms"),
            (f"{figures.dropped:,}", "frames dropped", f"of {figures.arrived:,}, {dropped}{lost}"),
            (f"{self.shown_hz:.1f}", "a second on this page", f"{1000 * self.shown_s:.0f} ms after arrival"),
        )
        boxes = [_box(_RECORDING, f"● recording {self.recording}")] if self.recording else []
        boxes += [_box(_WARNING, f"▲ {warning}") for warning in self.warnings]
        grid = "display:grid;grid-template-columns:repeat(2,1fr);gap:.4rem .8rem;padding:.2rem .75rem .4rem"
        return f'<div style="{grid}">{"".join(_card(*card) for card in cards)}</div>{"".join(boxes)}'


def _card(value: str, what: str, beside: str) -> str:
    small = "font-size:.72rem;line-height:1.3"
    return (
        f'<div><div style="{small};opacity:.75">{escape(what)}</div>'
        f'<div style="{_NUMBER}">{escape(value)}</div>'
        f'<div style="{small};opacity:.75">{escape(beside)}</div></div>'
    )


def _box(style: str, text: str) -> str:
    return f'<div role="status" style="{_BOX};{style}">{escape(text)}</div>'

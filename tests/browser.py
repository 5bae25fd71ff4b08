"""A headless Chromium that counts what a page asks of the network and says on its console."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

_FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-unsafe-swiftshader",  # WebGL without a graphics card
]


@dataclass
class Visit:
    """An open page. requests: addresses asked for, data and blob URIs aside. complaints: console errors."""

    page: Any
    requests: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    def picture(self, selector: str = "") -> np.ndarray:
        """Return a screenshot (h, w, 3) uint8 RGB of the window, or of one element."""
        target = self.page.locator(selector) if selector else self.page
        content = np.frombuffer(target.screenshot(), np.uint8)
        return cv2.cvtColor(cv2.imdecode(content, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)

    def strange_requests(self, *known: str) -> list[str]:
        """Return the requests that go anywhere but to addresses that begin as given."""
        return [address for address in self.requests if not address.startswith(known)]


@contextlib.contextmanager
def visit(address: str | Path, width: int = 1200, height: int = 900) -> Iterator[Visit]:
    """Open a file or address in Chromium; skip the test, saying so, where there is none."""
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        pytest.skip("chromium is not installed: pages are not looked at")
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright (dev) is not installed")
    if isinstance(address, Path):
        address = address.resolve().as_uri()
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=_FLAGS)
        page = browser.new_page(viewport={"width": width, "height": height})
        seen = Visit(page=page)
        page.on("request", lambda request: seen.requests.append(request.url))
        page.on("console", lambda m: seen.complaints.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: seen.complaints.append(str(error)))
        page.goto(address)
        seen.requests[:] = [url for url in seen.requests if not url.startswith(("data:", "blob:"))]
        try:
            yield seen
        finally:
            browser.close()

"""Pages of the templates in this folder, with script and style inside."""

import base64
import hashlib
import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from typing import Any


def page_from_template(template: str, *, script: str, title: str, setup: Mapping[str, Any]) -> str:
    """Return a page as HTML, script and style inside. setup: what template and script must know."""
    data = json.dumps(dict(setup), separators=(",", ":"))
    return rendered(
        template,
        **{
            **setup,
            "title": title,
            "setup": data.replace("<", "\\u003c"),  # no end of the script in it
            "style": scene_text("scene.css"),
            "script": scene_text(script),
            "policy": content_policy(script) if setup["mode"] == "file" else None,
        },
    )


def rendered(name: str, /, **values: Any) -> str:
    """Return a template of this folder with its values; all text is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("vntoolkit.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(name).render(**values)


@cache
def content_policy(script: str) -> str:
    """Return a policy by which a page's own script and style count alone, and nothing is fetched."""

    def digest(name: str) -> str:
        return base64.b64encode(hashlib.sha256(scene_text(name).encode()).digest()).decode()

    return (
        f"default-src 'none'; script-src 'sha256-{digest(script)}'; "
        f"style-src 'sha256-{digest('scene.css')}'; img-src data:; base-uri 'none'; form-action 'none'"
    )


@cache
def scene_text(name: str) -> str:
    """Return a page's script or style, such as `scene.js`."""
    return (files("vntoolkit.report") / "templates" / name).read_text("utf-8")

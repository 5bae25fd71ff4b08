"""Pages of the templates in this folder, and what a browser may run on the scene's."""

import base64
import hashlib
from functools import cache
from importlib.resources import files
from typing import Any


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
def scene_policy() -> str:
    """Return a policy by which the scene's own script and style count alone, and nothing is fetched."""

    def digest(name: str) -> str:
        return base64.b64encode(hashlib.sha256(scene_text(name).encode()).digest()).decode()

    return (
        f"default-src 'none'; script-src 'sha256-{digest('scene.js')}'; "
        f"style-src 'sha256-{digest('scene.css')}'; img-src data:; base-uri 'none'; form-action 'none'"
    )


@cache
def scene_text(name: str) -> str:
    """Return the scene's script or style, such as `scene.js`."""
    return (files("vntoolkit.report") / "templates" / name).read_text("utf-8")

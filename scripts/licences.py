"""Write the page of licences: every package that requirements.lock pins, and what its own metadata says.

    python scripts/licences.py        # writes docs/licences.md; after `make lock`, in the environment it made

A package for another system, which is not installed here, is listed with the licence that `ELSEWHERE` states.
"""

import re
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs" / "licences.md"
# Not installed on the machine that wrote the page: looked up in their repositories.
ELSEWHERE = {
    "appnope": "BSD-2-Clause",
    "cffi": "MIT-0",
    "colorama": "BSD-3-Clause",
    "open3d": "MIT",
    "open3d-cpu": "MIT",
    "pycparser": "BSD-3-Clause",
}
# Metadata without a word, or with a whole text in its place: read in the package's own licence file.
READ = {
    "cycler": "BSD-3-Clause",
    "jupyterlab-widgets": "BSD-3-Clause",
    "kiwisolver": "BSD-3-Clause",
    "matplotlib": "PSF-based (matplotlib)",
    "openexr": "BSD-3-Clause",
    "ptyprocess": "ISC",
    "pymeshlab": "GPL-3.0",
    "rawpy": "MIT, with LibRaw inside: LGPL-2.1 or CDDL-1.0",
    "reportlab": "BSD-3-Clause",
    "scipy": "BSD-3-Clause",
    "surfalize": "GPL-3.0",
    "usd-core": "TOST-1.0 (Apache-2.0 with another trademark clause)",
}
# Classifiers by their SPDX names; "BSD License" does not say which.
SHORT = {
    "MIT License": "MIT",
    "BSD License": "BSD",
    "ISC License (ISCL)": "ISC",
    "Apache Software License": "Apache-2.0",
    "Mozilla Public License 2.0 (MPL 2.0)": "MPL-2.0",
}
HEAD = """# Licences

vntoolkit is under the MIT licence. Its dependencies keep their own.

!!! warning "Where a licence binds you"

    **pymeshlab is under the GPL 3.** vntoolkit imports it only where it is used: `export --clean`,
    `evaluate mesh` and `Mesh.to_pymeshlab`. Nothing else needs it. Whoever ships a program together with
    pymeshlab ships the whole under the GPL. **surfalize**, of `pip install 'vntoolkit[roughness]'`, is under
    the GPL 3 too: `export --to roughness`, `sur` and `x3p` import it. Leave both out, and no dependency is
    under the GPL.

    certifi, hypothesis, pathspec and tqdm are under the MPL 2.0, which binds their own files only. usd-core
    is under the Tomorrow Open Source Technology licence: Apache 2.0 with another clause on trademarks. rawpy
    brings LibRaw, under the LGPL 2.1 or the CDDL 1.0.

This page is made by `scripts/licences.py` from the metadata of the locked packages.

| package | licence |
| --- | --- |
"""


def locked() -> list[str]:
    """Return the pinned packages in order of their names."""
    lock = (ROOT / "requirements.lock").read_text("utf-8")
    return sorted(set(re.findall(r"(?m)^([a-z0-9][\w.-]*)==", lock)))


def licence_of(name: str) -> str:
    """Return the licence that a package states."""
    if name in READ:
        return READ[name]
    try:
        said = metadata(name)
    except PackageNotFoundError:
        return ELSEWHERE[name]
    if said["License-Expression"]:
        return str(said["License-Expression"])
    classes = [c.split(" :: ")[-1] for c in said.get_all("Classifier") or [] if c.startswith("License ::")]
    stated = ", ".join(classes) or str(said["License"] or "").splitlines()[0]
    return SHORT.get(stated, stated)


def page() -> str:
    """Return the page."""
    rows = [f"| {name} | {licence_of(name)} |" for name in locked()]
    return HEAD + "\n".join(rows) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), "utf-8")
    print(PAGE.relative_to(ROOT))

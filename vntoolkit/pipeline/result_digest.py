"""Which reconstruction is it? What is made of one, tracks and exports, is not mixed with that of another."""

from __future__ import annotations

import hashlib
import json

from vntoolkit.io.manifest import Manifest


def result_digest(manifest: Manifest) -> str:
    """Return the SHA-256 of what shapes a reconstruction: footage, mask, background, rig and options.

    Frames may be added and the footage may be named otherwise, as for `io.manifest.changes_between`.
    """
    content = [
        [file.model_dump() for file in manifest.input.files],
        manifest.input.frame_rate_hz,
        {name: file.model_dump() for name, file in manifest.extra_files.items()},
        manifest.rig.model_dump(exclude={"quality", "sources"}),
        manifest.options,
    ]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()

"""`vntoolkit schema`: print the JSON schema of rig.json or reconstruction.json."""

from __future__ import annotations

import json
import sys
from typing import Literal


def schema(file: Literal["rig", "reconstruction"] = "rig", /) -> int:
    """Print the JSON schema of a file: every key with its meaning and unit.

    Parameters
    ----------
    file
        rig (rig.json) or reconstruction (reconstruction.json).
    """
    from vntoolkit.io.results.manifest import Manifest
    from vntoolkit.io.rigs import RigFile

    model = RigFile if file == "rig" else Manifest
    sys.stdout.write(json.dumps(model.model_json_schema(), indent=2) + "\n")
    return 0

"""`vntoolkit schema` and `vntoolkit data`: what the package holds for other programs, and for a first try."""

import json
import sys
from pathlib import Path
from typing import Any, Literal

from vntoolkit.cli.output import print_next, say
from vntoolkit.errors import BadInput, CannotWrite


def json_schema(file: Literal["rig", "reconstruction"] = "rig") -> dict[str, Any]:
    """Return the JSON schema of rig.json or reconstruction.json: every key with its meaning and unit."""
    from vntoolkit.io.results.manifest import Manifest
    from vntoolkit.io.rigs import RigFile

    return (RigFile if file == "rig" else Manifest).model_json_schema()


def schema_command(file: Literal["rig", "reconstruction"] = "rig", /) -> int:
    """Print the JSON schema of a file: every key with its meaning and unit.

    Parameters
    ----------
    file
        rig (rig.json) or reconstruction (reconstruction.json).
    """
    sys.stdout.write(json.dumps(json_schema(file), indent=2) + "\n")
    return 0


def copy_data(name: str, out: Path | str | None = None) -> Path:
    """Copy a file that the package ships, such as walk.bvh, to `out` or here; return where it is.

    A file that is there is kept.
    """
    from vntoolkit.io.atomic import write_bytes
    from vntoolkit.shipped import shipped_files

    files = shipped_files()
    if name not in files:
        raise BadInput(f"data: expected one of {', '.join(files)}, got '{name}'")
    target = Path(name) if out is None else Path(out)
    content = files[name].read_bytes()
    if target.exists() and target.read_bytes() != content:
        raise CannotWrite(f"{target}: is another file; choose another --out")
    write_bytes(target, content)
    return target


def data_command(name: str = "", /, *, out: Path | None = None) -> None:
    """Copy a file that the package ships into this folder, such as the walk that `dress` plays.

    Parameters
    ----------
    name
        Name of the file, such as walk.bvh. Without it, the names are listed.
    out
        The file to write; default: the same name, here. A file that is there is kept.
    """
    from vntoolkit.shipped import shipped_files

    if not name:
        print("\n".join(shipped_files()))
        return
    target = copy_data(name, out)
    say(target)
    print_next("dress", "result/track", "--motion", target, "--out", "cloth.usdc")

"""Flags that are no more: each is answered by one line that says what to do instead."""

from vntoolkit.errors import BadInput

REMOVED: dict[str, str] = {
    "--distance-power": "was removed: weights follow the published 1/distance; take --falloff heat for "
    "limbs that move more independently",
    "--refine-albedo": "was removed, since it left normals as they were; leave it out, "
    "`vntoolkit reconstruct` takes paint out of every frame",
    "--fit-method": "is --method now",
    "--faces": "is --most-faces now",
    "--field-width": "is --field-width-m now",
    "--frame-rate": "is --frame-rate-hz now",
}


def require_no_removed(*words: str) -> None:
    """Raise `BadInput` for a flag that was removed; what follows `--` is no flag."""
    for word in words:
        if word == "--":
            return
        flag = word.partition("=")[0]
        if flag in REMOVED:
            raise BadInput(f"{flag}: {REMOVED[flag]}")

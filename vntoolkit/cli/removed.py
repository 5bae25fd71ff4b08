"""Verbs and flags that are no more: each is answered by one line that says what to do instead."""

from vntoolkit.errors import BadInput

REMOVED: dict[str, str] = {
    "circles": "was removed; `vntoolkit calibrate presses --overlay circles.png` draws them over a grid, "
    "--circle NAME u v radius corrects one",
    "--distance-power": "was removed: weights follow the published 1/distance; take --falloff heat for "
    "limbs that move more independently",
    "--refine-albedo": "was removed, since it left normals as they were; leave it out, "
    "`vntoolkit reconstruct` takes paint out of every frame",
    "--pose-start": "was removed: it follows from --features; give --features sift for frames far apart",
    "--fit-method": "is --method now",
    "--faces": "is --most-faces now",
    "--field-width": "is --field-width-m now",
    "--frame-rate": "is --frame-rate-hz now",
    "--rim-share": "was removed: leave it out; give --mask where the outline is not found well",
    "--largest-error-px": "was removed: leave it out, or give --camera where frames are left out",
    "--flat-share": "was removed: leave it out; `vntoolkit calibrate presses` draws what it needs",
    "--square-px": "was removed: leave it out; texture.png is the file to put another pattern into",
    "--picture-px": "was removed: leave it out; --most-frames and --vertices make the page smaller",
    "--picture-height": "was removed: leave it out; `vntoolkit view` shows pictures in full",
}
_CONSTANT = (
    "albedo-tolerance steepest-slope-deg least-weight precision tolerance most-iterations depth-offset "
    "shadow-share outlier-sigmas inlier-share tangential contact-share data-share smoothing-length arms"
)
REMOVED |= {
    "demo --width": "was removed, as was --height: leave it out; `vntoolkit simulate --size` films larger",
    "demo --height": "was removed, as was --width: leave it out; `vntoolkit simulate --size` films larger",
    "dress --depth": "was removed: leave it out; --fit corrects the place of the garment",
    "evaluate --lost-px": "was removed: give it to `vntoolkit track`",
    "calibrate --samples": "was removed: leave it out; its default is a constant now",
    "evaluate --samples": "was removed: leave it out; its default is a constant now",
}
_OF_HEADS = (
    "corner-spacing-px window-px margin-px pose-tracks least-turn-deg hull-cells references stereo-window-px "
    "before behind least-correlation smoothing-px fusion-depth agreement confirmations hull-gap light-frames "
    "light-points light-draws light-inlier"
)
REMOVED |= dict.fromkeys(
    (f"--{name}" for name in _CONSTANT.split()), "was removed: leave it out; its default is a constant now"
)
REMOVED |= dict.fromkeys(
    (f"--{name}" for name in _OF_HEADS.split()),
    "was removed: `vntoolkit calibrate head` knows it; leave it out, and film closely what comes out badly",
)


def require_no_removed(*words: str) -> None:
    """Raise `BadInput` for a verb or flag that was removed; what follows `--` is no flag."""
    for place, word in enumerate(words):
        if word == "--":
            return
        flag = word.partition("=")[0]
        why = REMOVED.get(flag) or REMOVED.get(f"{words[0]} {flag}")
        if why is not None and (place == 0 or flag.startswith("--")):
            raise BadInput(f"{flag}: {why}")

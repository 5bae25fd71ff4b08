"""Are the usual mistakes found, their remedy named, and clean captures left in peace?

python -m benchmarks.mistakes [FOLDER ...] [--seeds 1 2] [--scenes face jacket] [--out DIR]    # 4 min

Every scene of the simulator is filmed (four frames of 480×360) with the true M of the middle of the picture.
FOLDER: a capture of your own with its right rig, `rig.json`, the frames as `capture.mkv` or in `frames/`, and
`mask.png` where there is one; the first eight frames are taken. Each mistake is made in memory, and the
checks of `reconstruct` and `doctor` are asked; those with a star are beyond the list of which 95
% are to be found. A mistake counts as found where a warning or an error names its remedy, and as silent where
there is neither. A capture counts as clean where no warning is given, but for clipped pixels that are there.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from vntoolkit.calibration.fit import fit_response
from vntoolkit.diagnosis.finding import Finding, Level
from vntoolkit.diagnosis.inspection import findings_from_clipping, findings_from_frames
from vntoolkit.diagnosis.rig_checks import check_residual
from vntoolkit.diagnosis.sharpness import findings_from_sharpness, fit_sharpness
from vntoolkit.diagnosis.transfer_match import check_transfer_of_samples
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.maps_and_meshes.masks import read_mask
from vntoolkit.io.rigs import read_rig
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer, encoded_from_linear, linear_from_encoded
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import SCENES, build_scene

LINEAR, SRGB = Transfer(), Transfer.from_text("srgb")
FRAMES, LAST = 4, 30
AT_MOST = 8
LEFT_OUT = {"board", "board_sweep", "gel"}  # no matte surface of one colour; a gel is read against itself


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """A capture as the checks get it: linear frames (h, w, 3), rig, the curve they were read with, mask."""

    frames: list[np.ndarray]
    rig: Rig
    transfer: Transfer = LINEAR
    mask: np.ndarray | None = None

    def with_matrix(self, change: Callable[[np.ndarray], np.ndarray]) -> Shot:
        """Return it read with another M."""
        response = replace(self.rig.response, matrix=change(self.rig.response.matrix))
        return replace(self, rig=replace(self.rig, response=response))

    def with_light(self, change: Callable[[np.ndarray], np.ndarray]) -> Shot:
        """Return it with every frame changed."""
        return replace(self, frames=[change(frame) for frame in self.frames])

    def findings(self) -> list[Finding]:
        """Return the warnings and errors that the checks give."""
        frames = [
            LinearFrame(rgb=f.astype(np.float32), clipped=(f >= 0.999).any(axis=2), number=k)
            for k, f in enumerate(self.frames)
        ]
        clipping = findings_from_clipping(frames, self.mask)
        found = findings_from_frames(frames, self.rig, self.transfer, self.mask)
        sharpness = fit_sharpness(frames, self.mask)
        if sharpness is not None:
            found += findings_from_sharpness(sharpness)
        return [f for f in (*clipping, *found) if f.level is not Level.NOTE]


def in_8_bits(light: np.ndarray) -> np.ndarray:
    return np.rint(np.clip(light, 0.0, 1.0) * 255) / 255


def blurred(light: np.ndarray, pixels: float) -> np.ndarray:
    return np.stack([gaussian_filter(light[..., k], pixels) for k in range(3)], axis=-1)


def glossy(light: np.ndarray, rig: Rig) -> np.ndarray:
    """Add highlights of a fifth of the matte light, by the normals that the rig finds."""
    normals = (light - rig.response.ambient) @ rig.response.inverse.T
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    rows = rig.response.matrix
    strengths = np.linalg.norm(rows, axis=1)
    colours = np.diag(strengths) if rig.response.light_colours is None else rig.response.light_colours
    towards = (
        rows / strengths[:, None] if rig.response.light_colours is None else rig.response.light_directions
    )
    bright = light.max(axis=2) > 0.1 * light.max()
    added = light.copy()
    for colour, lamp in zip(colours, towards, strict=True):
        between = lamp + np.array([0, 0, -1])
        lobe = np.clip(blurred(normals, 1.0) @ between / np.linalg.norm(between), 0, 1) ** 40 * bright
        added += 0.2 * lobe[..., None] * colour
    return in_8_bits(added / max(1.0, np.percentile(added.max(axis=2), 99.9)))


def turned(degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def mistakes(shot: Shot, subject: np.ndarray, rng: np.random.Generator) -> Iterator[tuple[str, str, Shot]]:
    """Yield each mistake's name, words that its remedy must hold, and the capture with it."""
    mirrored = "axis mirrored"  # which axis only the outline tells
    yield "M mirrored in x", mirrored, shot.with_matrix(lambda m: m @ np.diag([-1, 1, 1]))
    yield "y up for down", mirrored, shot.with_matrix(lambda m: m @ np.diag([1, -1, 1]))
    yield "M transposed", "transposed", shot.with_matrix(lambda m: m.T)
    yield "red and green exchanged", "red and green exchanged", shot.with_matrix(lambda m: m[[1, 0, 2]])
    for degrees in (60, -60):
        name = f"lamps turned by {degrees} degrees"
        yield name, "turned about", shot.with_matrix(lambda m, by=degrees: m @ turned(by))
    decoded = shot.with_light(lambda light: linear_from_encoded(light, SRGB))
    yield "--transfer srgb on linear footage", "--transfer", replace(decoded, transfer=SRGB)
    encoded = shot.with_light(lambda light: in_8_bits(encoded_from_linear(light, SRGB)))
    yield "sRGB footage read as linear", "--transfer", encoded
    yield "noise", "noise", shot.with_light(lambda light: rng.random(light.shape))
    facing = np.array([0.1, 0.05, -1.0]) / np.linalg.norm([0.1, 0.05, -1.0])
    colour = np.maximum(shot.rig.response.matrix @ facing, 0.02)
    wall = colour / max(1.0, 1.1 * colour.max())
    level = 1 / 255
    yield (
        "a flat wall",
        "flat",
        shot.with_light(lambda light: in_8_bits(wall + rng.normal(0, level, light.shape))),
    )
    if subject.mean() < 0.9:
        yield "mask inverted", "invert", replace(shot, mask=~subject)
    top = np.percentile(shot.frames[0].max(axis=2)[subject], 73)
    yield "27 % clipped", "exposure", shot.with_light(lambda light: np.minimum(light / top, 1.0))
    yield "lamps behind", "sign of z", shot.with_matrix(lambda m: m @ np.diag([1, 1, -1]))
    # beyond the list
    yield "* blurred by 2 pixels", "focus", shot.with_light(lambda light: blurred(light, 2.0))
    yield (
        "* sharpened",
        "switch sharpening off",
        shot.with_light(lambda light: np.clip(2 * light - blurred(light, 1.0), 0, 1)),
    )
    yield (
        "* full range read as limited",
        "full range",
        shot.with_light(lambda light: in_8_bits((255 * in_8_bits(light) - 16) / 219)),
    )
    yield (
        "* limited range read as full",
        "limited range",
        shot.with_light(lambda light: in_8_bits((219 * light + 16) / 255)),
    )
    yield "* glossy", "powder", replace(shot, frames=[glossy(frame, shot.rig) for frame in shot.frames])
    yield "* x and y reversed", "look reversed", shot.with_matrix(lambda m: m @ np.diag([-1, -1, 1]))
    yield "* red and blue exchanged", "red and blue exchanged", shot.with_matrix(lambda m: m[[2, 1, 0]])
    hue = (1.0, 0.82, 0.68)
    yield "* subject of another hue", "another colour", shot.with_light(lambda light: in_8_bits(light * hue))
    yield (
        "* calibrated as srgb, both linear",
        "--transfer",
        replace(decoded, transfer=SRGB, rig=replace(shot.rig, transfer=SRGB)),
    )


def mistakes_of_calibration(shot: Shot, subject: np.ndarray) -> Iterator[tuple[str, str, list[Finding]]]:
    """Yield the same of `calibrate`: another curve over a ball and a board; what is no ball taken for one."""
    normals = ball(100)
    light = np.clip(normals @ shot.rig.response.matrix.T + shot.rig.response.ambient, 0, None)
    rgb = in_8_bits(encoded_from_linear(0.9 * light / light.max(), SRGB))
    yield "* ball in sRGB read as linear", "--transfer", check_transfer_of_samples(normals, rgb, LINEAR)
    few = slice(None, None, len(normals) // 48)
    found = check_transfer_of_samples(normals[few], rgb[few], LINEAR)
    yield "* board in sRGB read as linear", "--transfer", found
    v, u = np.nonzero(subject)
    radius = np.sqrt(len(v) / np.pi)
    x, y = (u - u.mean()) / radius, (v - v.mean()) / radius
    near = x**2 + y**2 < 0.9
    guessed = np.stack([x, y, -np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=1)[near]
    fit = fit_response(guessed, shot.frames[0][v, u][near])
    yield "* taken for a ball", "calibration object", check_residual(replace(shot.rig, quality=fit.quality))


def ball(size: int) -> np.ndarray:
    """Normals (n, 3) of a ball, up to 72 degrees."""
    y, x = np.mgrid[-1 : 1 : size * 1j, -1 : 1 : size * 1j]
    inside = x**2 + y**2 < 0.9
    return np.stack([x, y, -np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1)[inside]


def simulated(name: str, seed: int) -> tuple[Shot, np.ndarray]:
    """Return the capture and where its subject is, (h, w)."""
    scene = build_scene(name, SceneOptions(width=480, height=360, seed=seed))
    numbers = np.linspace(0, min(scene.frame_count - 1, LAST), FRAMES).astype(int)
    frames = [render_frame(scene, int(number)) for number in numbers]
    rig = Rig(camera=scene.camera, response=true_response(scene, Nuisances()))
    return Shot(frames=[np.asarray(f.linear.rgb) for f in frames], rig=rig), frames[0].truth.normals.mask


def read(folder: Path) -> tuple[Shot, np.ndarray]:
    """Return the capture in a folder, and where its subject is, (h, w)."""
    rig = read_rig(folder / "rig.json")
    footage = folder / "capture.mkv"
    capture = open_capture(
        footage if footage.exists() else folder / "frames", CaptureOptions(transfer=rig.transfer)
    )
    frames = [np.asarray(capture.frame(n).rgb) for n in capture.present[:AT_MOST]]
    subject = frames[0].max(axis=2) > 0.05
    if (mask := folder / "mask.png").exists():
        subject = read_mask(mask)
    return Shot(frames=frames, rig=rig), subject


def clean_ones(shot: Shot, subject: np.ndarray) -> Iterator[Shot]:
    """Yield the capture as it is, with a mask, and each of its frames as a capture of its own."""
    yield shot
    if subject.mean() < 0.98:
        yield replace(shot, mask=subject)
    for frame in shot.frames:
        yield replace(shot, frames=[frame])


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    scenes = sorted(set(SCENES) - LEFT_OUT)
    parser.add_argument("folders", nargs="*", type=Path, metavar="FOLDER")
    parser.add_argument("--seeds", nargs="*", type=int, default=[1, 2])
    parser.add_argument("--scenes", nargs="*", choices=scenes, default=scenes)
    parser.add_argument("--out", type=Path, help="folder for numbers.json")
    arguments = parser.parse_args()
    sources: list[tuple[str, Callable[[], tuple[Shot, np.ndarray]]]] = []
    for folder in arguments.folders:
        sources.append((folder.name, lambda folder=folder: read(folder)))
    for name in arguments.scenes:
        for seed in arguments.seeds:
            sources.append((f"{name}, seed {seed}", lambda name=name, seed=seed: simulated(name, seed)))
    found: dict[str, list[bool]] = defaultdict(list)
    silent: dict[str, int] = defaultdict(int)
    missed: list[str] = []
    seconds: list[float] = []
    for name, load in sources:
        shot, subject = load()
        rng = np.random.default_rng(0)
        for clean in clean_ones(shot, subject):
            started = time.process_time()
            said = [f.text for f in clean.findings() if f.check != "clipping"]
            seconds.append(time.process_time() - started)
            found["clean, nothing said"].append(not said)
            missed += [f"{name}: clean: {text}" for text in said]
        shot = replace(shot, frames=shot.frames[:: max(1, len(shot.frames) // 3)][:3])
        made = [(what, words, made.findings()) for what, words, made in mistakes(shot, subject, rng)]
        if not name.startswith("sphere"):
            made += mistakes_of_calibration(shot, subject)
        for what, words, findings in made:
            texts = [f.text for f in findings]
            named = any(words in text for text in texts)
            found[what].append(named)
            silent[what] += not texts
            if not named:
                missed.append(f"{name}: {what}: {' | '.join(texts) or 'nothing said'}")
        print(f"{name}: done", flush=True)
    print("\n".join(missed))
    for what, each in found.items():
        without = f"   {silent[what]} silent" if silent[what] else ""
        print(f"{what:38s} {sum(each):4d} of {len(each):4d}{without}")
    if arguments.out:
        counts = {what: f"{sum(each)} of {len(each)}" for what, each in found.items()}
        write_numbers(arguments.out, [number(what, count, "captures") for what, count in counts.items()])
    print(f"processor time of the checks of a clean capture: median {np.median(seconds):.2f} s, ", end="")
    print(f"most {max(seconds):.2f} s")


if __name__ == "__main__":
    main()

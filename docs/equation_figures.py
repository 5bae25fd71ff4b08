"""Draw the pictures of *How it works* from the run of `examples/paper.py`.

python docs/equation_figures.py        # writes docs/img/*.png; 15 s of processor time
"""

import runpy
from pathlib import Path

import matplotlib as mpl

mpl.use("agg")
import matplotlib.pyplot as plt
import numpy as np

from vntoolkit.photometry.response import rgb_from_normals

HERE = Path(__file__).parent
OUT = HERE / "img"
COLOURS = ("#d33", "#3a3", "#36d")
run = runpy.run_path(str(HERE.parent / "examples" / "paper.py"))
camera, response, template = run["camera"], run["true"], run["template"]
truth, frame = run["truth"], run["seen"][0].linear


def save(figure: plt.Figure, equation: int) -> None:
    """Write one figure."""
    OUT.mkdir(exist_ok=True)
    figure.savefig(OUT / f"equation{equation}.png", dpi=110, bbox_inches="tight", facecolor="white")
    plt.close(figure)


def shown(linear: np.ndarray) -> np.ndarray:
    """Return linear colours as a screen shows them."""
    return np.clip(linear / frame.rgb.max(), 0, 1) ** (1 / 2.2)


def image_of(values: np.ndarray) -> np.ndarray:
    """Return one number a vertex as an image, NaN elsewhere."""
    image = np.full((camera.height, camera.width), np.nan)
    image[template.pixels[:, 1], template.pixels[:, 0]] = values
    return image


def pair(titles: tuple[str, str]) -> tuple[plt.Figure, list[plt.Axes]]:
    """Return two axes for pictures."""
    figure, axes = plt.subplots(1, 2, figsize=(7.2, 2.8))
    for axis, title in zip(axes, titles, strict=True):
        axis.set_title(title, fontsize=10)
        axis.set_axis_off()
    return figure, list(axes)


def errors(values: list[np.ndarray], titles: tuple[str, ...], unit: str, equation: int) -> None:
    """Draw one error image a title, on one scale."""
    figure, axes = plt.subplots(1, len(values), figsize=(3.8 * len(values), 2.8), squeeze=False)
    most = float(np.percentile(np.concatenate(values), 95))
    for axis, value, title in zip(axes[0], values, titles, strict=True):
        drawn = axis.imshow(image_of(value), cmap="viridis", vmin=0, vmax=most)
        axis.set_title(title, fontsize=10)
        axis.set_axis_off()
    figure.colorbar(drawn, ax=axes, label=unit, shrink=0.85)
    save(figure, equation)


figure, (left, right) = pair(("rendered frame", "M n, from the true normals"))
left.imshow(shown(frame.rgb))
computed = np.where(
    truth.normals.mask[..., None], rgb_from_normals(truth.normals.normals_in_camera, response), 0
)
right.imshow(shown(np.clip(computed, 0, None)))
save(figure, 1)

figure, axis = plt.subplots(figsize=(6.4, 2.6))
wavelengths = np.linspace(400, 700, len(run["lamps"].spectra[0]))
for number, (spectrum, colour) in enumerate(zip(run["lamps"].spectra, COLOURS, strict=True)):
    axis.plot(wavelengths, spectrum / np.max(spectrum), color=colour, label=f"lamp {number}")
    said = ", ".join(f"{c:.2f}" for c in run["colours"][number] / run["colours"][number].max())
    axis.text(402, 0.9 - 0.13 * number, f"c = ({said})", color=colour, fontsize=9)
axis.set(xlabel="wavelength, nm", ylabel="relative power")
save(figure, 2)

figure, axis = plt.subplots(figsize=(3.4, 3.2))
for row, colour, name in zip(response.matrix, COLOURS, ("red", "green", "blue"), strict=True):
    axis.annotate("", xy=(row[0], -row[1]), xytext=(0, 0), arrowprops={"color": colour, "width": 2})
    axis.text(row[0] * 1.15, -row[1] * 1.15, name, color=colour, ha="center")
reach = 1.4 * np.abs(response.matrix[:, :2]).max()
axis.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
axis.set(xlabel="right", ylabel="up", title="rows of M, as the camera sees them")
save(figure, 3)

figure, axis = plt.subplots(figsize=(3.6, 3.2))
fitted = rgb_from_normals(run["normals"], run["response"])
for channel, colour in enumerate(COLOURS):
    axis.plot(run["rgb"][:, channel], fitted[:, channel], ".", ms=1.5, color=colour)
axis.plot([0, 1], [0, 1], color="#999", lw=0.8)
axis.set(xlabel="measured", ylabel="M n + a, fitted", aspect="equal", xlim=(0, 1), ylim=(0, 1))
save(figure, 4)

figure, axis = plt.subplots(figsize=(4.4, 3.2))
axis.imshow(shown(frame.rgb))
some = slice(None, None, 23)
u, v = template.positions_px[some].T
du, dv = (run["moved"] - template.positions_px)[some].T
axis.quiver(u, v, du, dv, angles="xy", scale_units="xy", scale=0.15, color="#fd0", width=0.006)
axis.set_axis_off()
save(figure, 5)

apart = 1000 * np.linalg.norm(run["targets"] - run["goal"], axis=1)
after = 1000 * np.linalg.norm(run["registered"] - run["goal"], axis=1)
errors([apart], ("target against true point",), "mm", 6)
errors([apart, after], ("targets, equation 6", "registered, equation 7"), "mm", 7)

figure, axes = pair(("at rest", "in a step of a walk"))
joints = (run["rest"][:, :3, 3], run["posed"][:, :3, 3])
for axis, points, bones in zip(axes, (run["attached"], run["walked"]), joints, strict=True):
    axis.scatter(points[:, 0], points[:, 1], c=points[:, 2], s=1, cmap="cividis")
    axis.plot(bones[:, 0], bones[:, 1], "o", ms=3, color="#d33")
    axis.set_aspect("equal")
    axis.invert_yaxis()  # y points down, as in the camera frame
save(figure, 8)

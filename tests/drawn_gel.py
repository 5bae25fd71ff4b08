"""Pictures of a tactile gel, drawn from a known M: untouched or with a ball pressed in, printed with dots."""

import numpy as np

MATRIX = np.array([[0.4, 0.1, -0.42], [-0.2, 0.35, -0.45], [-0.15, -0.35, -0.5]])
HEIGHT, WIDTH, MARGIN = 180, 140, 20  # of the gel in pixels of 0.1 mm, and what is filmed around it
RADIUS_PX = 24.0
V, U = np.indices((HEIGHT, WIDTH))
DOTS = (U % 20 < 4) & (V % 20 < 4)


def press_on_ball(
    shape: tuple[int, ...], u: float, v: float, ball_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """Normals (h, w, 3) of a ball pressed in at (u, v), and the distance (h, w) from there."""
    rows, columns = np.indices(shape)
    off = np.stack([columns - u, rows - v], axis=-1)
    distance = np.linalg.norm(off, axis=-1)
    height = np.sqrt(np.maximum(ball_px**2 - distance**2, 0))
    return np.concatenate([off, -height[..., None]], axis=-1) / ball_px, distance


def sine_of_slope(distance: np.ndarray, contact_px: float, rest_px: float = 8.0) -> np.ndarray:
    """The ball inside its contact, around it a gel that comes to rest within some pixels."""
    away = np.maximum(distance - contact_px, 0)
    return np.minimum(distance, contact_px) / RADIUS_PX * np.exp(-((away / rest_px) ** 2))


def picture(
    rng: np.random.Generator,
    u: float,
    v: float,
    contact_px: float,
    drift: float = 0.0,
    rest_px: float = 8.0,
    moved_px: int = 0,
) -> np.ndarray:
    """The sensor's picture with a ball at (u, v) of the gel; contact 0 for none.

    moved_px: of the material, down.
    """
    distance = np.hypot(U - u, V - v)
    sine = sine_of_slope(distance, contact_px, rest_px)[..., None]
    outward = np.stack([U - u, V - v], axis=-1) / np.maximum(distance, 1e-9)[..., None]
    rgb = np.concatenate([sine * outward, -np.sqrt(1 - sine**2)], axis=-1) @ MATRIX.T
    rgb = rgb + drift * np.stack([U / WIDTH, V / HEIGHT, np.ones(U.shape)], axis=-1)
    rgb[np.roll(DOTS, moved_px, axis=0)] *= 0.4
    whole = np.zeros((HEIGHT + 2 * MARGIN, WIDTH + 2 * MARGIN, 3))
    whole[MARGIN:-MARGIN, MARGIN:-MARGIN] = rgb
    whole += rng.normal(0, 0.002, whole.shape)
    return np.round(255 * np.clip(whole, 0, 1)).astype(np.uint8)

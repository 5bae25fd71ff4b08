"""Errors of slopes hold where what is not explained is as wide as the subject."""

import numpy as np

from vntoolkit.diagnosis.surface_pixels import SurfacePixels, regress_lengths

SIZE, SIDE = 60, 6


def _pixels():
    v, u = (np.mgrid[:SIZE, :SIZE].reshape(2, -1) - (SIZE - 1) / 2) / (SIZE / 2)
    blocks = ((v + 1) * SIDE / 2).astype(int) * SIDE + ((u + 1) * SIDE / 2).astype(int)
    nothing = np.zeros(SIZE**2, np.int64)
    return SurfacePixels(
        rgb=np.zeros((SIZE**2, 3)),
        inverse=np.eye(3),
        ambient=np.zeros(3),
        blocks=blocks,
        frames=nothing,
        blocks_a_side=SIDE,
        positions=np.stack([u, v], axis=1),
    )


def _within(rng, wavelength, *, widely):
    """Return how often a slope that is 0 lies within two of its errors, under patterns of a wavelength."""
    pixels = _pixels()
    u, v = pixels.positions.T
    held = []
    for _ in range(60):
        pattern = 0.02 * rng.normal(size=len(u))
        for _ in range(6):
            angle, phase = rng.uniform(0, 2 * np.pi, 2)
            pattern += 0.05 * np.cos(2 * np.pi / wavelength * (u * np.cos(angle) + v * np.sin(angle)) + phase)
        column = u * np.cos(3 * v) + v * np.sin(3 * u)
        fit = regress_lengths(column[:, None], pattern, pixels, 2, widely=widely)
        held.append(abs(fit.slopes[0]) < 2 * fit.errors[0])
    return np.mean(held)


def test_patterns_wider_than_a_block_are_part_of_the_error(rng):
    narrow = _within(rng, 0.3, widely=False)
    assert narrow > 0.85
    assert _within(rng, 2.0, widely=True) > max(_within(rng, 2.0, widely=False) + 0.1, 0.7)
    assert _within(rng, 0.3, widely=True) >= narrow - 0.05

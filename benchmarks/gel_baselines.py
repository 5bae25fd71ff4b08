"""What others fit to presses of a ball: a small network, and a polynomial of colour and place.

Both learn slopes from pixels inside found contact circles and from flat gel, each with its colour and place.
The network is of the size that open kits of tactile sensors use (5 inputs, layers of 128, 32 and 32): it sees
the colour as filmed, and what it says of the untouched gel is subtracted. The polynomial is of second degree
in the change of colour and the place.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations_with_replacement, pairwise

import numpy as np

from vntoolkit.arrays import FloatArray

LAYERS = (128, 32, 32)
EPOCHS, BATCH, RATE = 60, 512, 3e-3
HELD_BACK = 5  # every fifth press tells when to stop
Predict = Callable[[FloatArray], FloatArray]


def network(inputs: FloatArray, slopes: FloatArray, presses: FloatArray, seed: int = 0) -> Predict:
    """Fit slopes (n, 2) to inputs (n, 5) by Adam; of all epochs, the best on presses held back is kept."""
    rng = np.random.default_rng(seed)
    middle, spread = inputs.mean(axis=0), inputs.std(axis=0)
    unit = slopes.std()
    out = presses % HELD_BACK == 0
    x, y = (inputs - middle) / spread, slopes / unit
    sizes = (inputs.shape[1], *LAYERS, 2)
    weights = [rng.normal(0, np.sqrt(2 / a), (a, b)) for a, b in pairwise(sizes)]
    weights += [np.zeros(b) for b in sizes[1:]]
    first, second = ([np.zeros_like(w) for w in weights] for _ in range(2))
    best, best_loss, step = [w.copy() for w in weights], np.inf, 0
    own = np.flatnonzero(~out)
    for _ in range(EPOCHS):
        for chosen in np.array_split(rng.permutation(own), max(1, len(own) // BATCH)):
            step += 1
            for k, gradient in enumerate(_gradients(weights, x[chosen], y[chosen])):
                first[k] += 0.1 * (gradient - first[k])
                second[k] += 0.001 * (gradient**2 - second[k])
                root = np.sqrt(second[k] / (1 - 0.999**step)) + 1e-8
                weights[k] -= RATE * first[k] / (1 - 0.9**step) / root
        loss = float(np.abs(_forward(weights, x[out])[-1] - y[out]).mean())
        if loss < best_loss:
            best, best_loss = [w.copy() for w in weights], loss
    return lambda asked: unit * _forward(best, (asked - middle) / spread)[-1]


def _forward(weights: list[FloatArray], x: FloatArray) -> list[FloatArray]:
    layers, depth = [x], len(weights) // 2
    for k in range(depth):
        values = layers[-1] @ weights[k] + weights[depth + k]
        layers.append(np.maximum(values, 0) if k < depth - 1 else values)
    return layers


def _gradients(weights: list[FloatArray], x: FloatArray, y: FloatArray) -> list[FloatArray]:
    layers, depth = _forward(weights, x), len(weights) // 2
    back = 2 * (layers[-1] - y) / len(x)
    of_weights, of_offsets = [], []
    for k in reversed(range(depth)):
        of_weights.append(layers[k].T @ back)
        of_offsets.append(back.sum(axis=0))
        back = (back @ weights[k].T) * (layers[k] > 0)
    return [*reversed(of_weights), *reversed(of_offsets)]


def polynomial(inputs: FloatArray, slopes: FloatArray) -> Predict:
    """Least squares of second degree in inputs (n, 5): change of colour and place."""
    spread = inputs.std(axis=0)
    fitted = np.linalg.lstsq(_terms(inputs / spread), slopes, rcond=None)[0]
    return lambda asked: _terms(asked / spread) @ fitted


def _terms(x: FloatArray) -> FloatArray:
    pairs = combinations_with_replacement(range(x.shape[1]), 2)
    return np.column_stack([np.ones(len(x)), x, *(x[:, a] * x[:, b] for a, b in pairs)])

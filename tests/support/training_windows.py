"""Training windows whose best possible result is known."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from heaved.samples import TrainingWindow

Array = NDArray[np.float64]


def sea(samples: int, seed: int) -> Array:
    """A seaway of 60 components between 0.06 and 0.35 Hz at 10 Hz, standard deviation about 1 m."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples) / 10.0
    f = rng.uniform(0.06, 0.35, 60)
    return np.asarray(np.sin(2 * np.pi * np.outer(t, f) + rng.uniform(0, 2 * np.pi, 60)).sum(axis=1) / np.sqrt(30.0))


def delayed_residual(rows: int, width: int = 50, noise: float = 0.05, seed: int = 3) -> tuple[Array, Array]:
    """Inputs (rows, width) and targets 0.3 x, five samples late, plus white noise."""
    x = sea(rows + width - 1, seed)
    inputs = np.lib.stride_tricks.sliding_window_view(x, width)
    targets = 0.3 * inputs[:, -6] + noise * np.random.default_rng(seed + 1).normal(size=rows)
    return np.ascontiguousarray(inputs), targets


RAMP = np.arange(12.0).reshape(4, 3)
"""The smallest usable inputs."""


def window(rows: Array, residuals: Array, **changes: object) -> TrainingWindow:
    fields: dict[str, object] = {
        "number": 1,
        "inputs": rows.astype("<f8").tobytes(),
        "targets": residuals.astype("<f8").tobytes(),
        "rows": rows.shape[0],
        "width": rows.shape[1],
        "hidden": 10,
        "learning_rate": 0.01,
        "epochs": 1000,
        "output": "linear",
        "seed": 7,
    }
    return TrainingWindow(**(fields | changes))  # type: ignore[arg-type]

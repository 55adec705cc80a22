"""``python -m heaved.workers.train_correction``: training of the residual network. The only place that knows torch.

Plain full-batch gradient descent, as the source has it.

Source: Zhang et al. 2022 (UKF multi-step + BP), section 3.3 and 4: 50-10-1, gradient descent, learning rate 0.01, at
most 1000 epochs. The loss is the *mean* squared error in standardised units; with the sum the same learning rate
diverges within a few epochs. Single precision reaches the same error as double, to three digits, in two thirds of the
time. Every window starts afresh from its seed, so a bad window leaves no trace in later networks.
"""

from __future__ import annotations

import sys
from math import isfinite, sqrt
from time import process_time

import numpy as np
import torch
from numpy.typing import NDArray

from heaved.estimation.heave.laser.network import SIGMOID_PER_STD, Network, Output
from heaved.samples import TrainedNetwork, TrainingWindow
from heaved.workers.serve import serve

Array = NDArray[np.float64]
Weights = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]

PATIENCE_EPOCHS = 50
LEAST_GAIN = 1e-5
"""Training ends early when the loss has fallen by less than this fraction over PATIENCE_EPOCHS."""


class WindowError(ValueError):
    """Nothing can be learned from this window; the message says why."""


def fit(window: TrainingWindow) -> TrainedNetwork:
    """Train on every row of the window. Whatever is wrong with the window is the message of the result."""
    started = process_time()
    try:
        network = _train(window)
    except WindowError as error:
        return TrainedNetwork(number=window.number, message=str(error), seconds=process_time() - started)
    return TrainedNetwork(
        number=window.number,
        weights=network.to_bytes(),
        width=window.width,
        hidden=window.hidden,
        output=window.output,
        seconds=process_time() - started,
    )


def _train(window: TrainingWindow) -> Network:
    inputs, targets = _arrays(window)
    input_mean, input_std = float(inputs.mean()), float(inputs.std())
    target_mean, target_std = float(targets.mean()), float(targets.std())
    if not (input_std > 0.0 and target_std > 0.0):
        raise WindowError(f"training window: constant (deviations {input_std} and {target_std} m): nothing to learn")
    output = Output(window.output)
    torch.set_num_threads(1)  # one core belongs to the 10 ms tick; and the sums keep their order
    x = torch.from_numpy((inputs - input_mean) / input_std).to(torch.float32)
    t = torch.from_numpy((targets - target_mean) / target_std).to(torch.float32)
    weights = _initial_weights(window)
    _descend(weights, x, t, output, window.learning_rate, window.epochs)
    W1, b1, w2, b2 = (tensor.detach().numpy().astype(np.float64) for tensor in weights)
    return Network(
        W1=W1,
        b1=b1,
        w2=w2,
        b2=float(b2[0]),
        input_mean_m=input_mean,
        input_std_m=input_std,
        target_mean_m=target_mean,
        target_std_m=target_std,
        output=output,
    )


def _arrays(window: TrainingWindow) -> tuple[Array, Array]:
    """Inputs (n, d) and targets (n,), metres."""
    if window.rows < 2 or window.width < 1 or window.hidden < 1:
        raise WindowError(
            f"training window: {window.rows} rows, {window.width} inputs, {window.hidden} hidden units;"
            " at least 2, 1 and 1 are needed"
        )
    if len(window.inputs) != 8 * window.rows * window.width or len(window.targets) != 8 * window.rows:
        raise WindowError(
            f"training window: {len(window.inputs)} and {len(window.targets)} bytes do not hold"
            f" {window.rows} rows of {window.width} inputs and one target"
        )
    if not (isfinite(window.learning_rate) and window.learning_rate > 0.0 and window.epochs >= 1):
        raise WindowError(
            f"training window: learning rate {window.learning_rate} and {window.epochs} epochs must be positive"
        )
    if window.output not in [kind.value for kind in Output]:
        raise WindowError(f"training window: unknown output {window.output!r}")
    inputs = np.frombuffer(window.inputs, "<f8").astype(np.float64).reshape(window.rows, window.width)
    targets = np.frombuffer(window.targets, "<f8").astype(np.float64)
    if not (np.isfinite(inputs).all() and np.isfinite(targets).all()):
        raise WindowError("training window: a value is not finite")
    return inputs, targets


def _initial_weights(window: TrainingWindow) -> Weights:
    """Uniform within 1/sqrt(fan-in), thresholds zero; drawn in double precision from the window's seed."""
    generator = torch.Generator().manual_seed(window.seed)

    def uniform(fan_in: int, *shape: int) -> torch.Tensor:
        unit = 2.0 * torch.rand(shape, generator=generator, dtype=torch.float64) - 1.0
        return (unit / sqrt(fan_in)).to(torch.float32)

    tensors = (
        uniform(window.width, window.hidden, window.width),
        torch.zeros(window.hidden),
        uniform(window.hidden, window.hidden),
        torch.zeros(1),
    )
    for tensor in tensors:
        tensor.requires_grad_()
    return tensors


def _descend(weights: Weights, x: torch.Tensor, t: torch.Tensor, output: Output, rate: float, epochs: int) -> None:
    """Gradient descent in place, eq. (15), (16)."""
    W1, b1, w2, b2 = weights
    previous = float("inf")
    for epoch in range(epochs):
        estimate = torch.sigmoid(x @ W1.T - b1) @ w2 - b2
        if output is Output.SIGMOID:
            estimate = (torch.sigmoid(estimate) - 0.5) / SIGMOID_PER_STD
        loss = torch.mean((estimate - t) ** 2)
        if epoch % PATIENCE_EPOCHS == 0:
            current = float(loss.detach())
            if not current <= previous * (1.0 - LEAST_GAIN):  # nan ends it too
                break
            previous = current
        with torch.no_grad():
            for tensor, gradient in zip(weights, torch.autograd.grad(loss, weights), strict=True):
                tensor.sub_(rate * gradient)
    if not all(bool(torch.isfinite(tensor).all()) for tensor in weights):
        raise WindowError(f"training diverged: the learning rate {rate} is too high for this window")


if __name__ == "__main__":
    sys.exit(serve("trainer", TrainingWindow, fit))

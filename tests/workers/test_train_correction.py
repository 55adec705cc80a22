"""What training reaches, against linear least squares on the same rows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from training_windows import RAMP, Array, delayed_residual, window

from heaved.estimation.heave.laser.network import Network
from heaved.workers.train_correction import fit

if TYPE_CHECKING:
    from heaved.samples import TrainedNetwork


def network_of(result: TrainedNetwork) -> Network:
    assert result.message == ""
    return Network.from_bytes(result.weights, result.width, result.hidden, result.output)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("output", ["linear", "sigmoid"])
def test_it_learns_a_known_residual_on_rows_it_never_saw(output: str) -> None:
    inputs, targets = delayed_residual(3000)
    train, test = slice(0, 2000), slice(2000, 3000)
    result = fit(window(inputs[train], targets[train], output=output))
    learnt = rms(targets[test] - network_of(result).predict_many(inputs[test]))
    design = np.hstack((inputs, np.ones((3000, 1))))
    coefficients, *_ = np.linalg.lstsq(design[train], targets[train], rcond=None)
    best = rms(targets[test] - design[test] @ coefficients)
    assert rms(targets[test]) > 4.0 * best
    assert learnt < 1.3 * best
    assert result.number == 1
    assert result.seconds > 0.0


def test_the_same_window_gives_the_same_bytes_and_another_seed_others() -> None:
    inputs, targets = delayed_residual(400)
    first, second = (fit(window(inputs, targets, epochs=50)) for _ in range(2))
    assert first.weights == second.weights != b""
    assert fit(window(inputs, targets, epochs=50, seed=8)).weights != first.weights


def test_one_epoch_is_one_step_down_the_gradient() -> None:
    """The step from epochs = 1 to epochs = 2, against differences of the mean squared error in standardised units."""
    inputs, targets = delayed_residual(300, width=6)
    before = network_of(fit(window(inputs, targets, epochs=1, hidden=2)))
    after = network_of(fit(window(inputs, targets, epochs=2, hidden=2)))
    z = (inputs - inputs.mean()) / inputs.std()
    t = (targets - targets.mean()) / targets.std()

    def loss(W1: Array) -> float:
        hidden = 1.0 / (1.0 + np.exp(-(z @ W1.T - before.b1)))
        return float(np.mean((hidden @ before.w2 - before.b2 - t) ** 2))

    for index in np.ndindex(before.W1.shape):
        nudge = np.zeros_like(before.W1)
        nudge[index] = 1e-5
        slope = (loss(before.W1 + nudge) - loss(before.W1 - nudge)) / 2e-5
        assert after.W1[index] - before.W1[index] == pytest.approx(-0.01 * slope, abs=2e-6)


def test_training_stops_when_nothing_is_gained() -> None:
    """With a vanishing rate the loss stands still, so a thousand epochs end where the first hundred did."""
    inputs, targets = delayed_residual(300)
    short = fit(window(inputs, targets, epochs=51, learning_rate=1e-9))
    long = fit(window(inputs, targets, epochs=1000, learning_rate=1e-9))
    assert network_of(long).to_bytes() == network_of(short).to_bytes()


ONES = np.ones((4, 3))
UNUSABLE = {
    "constant input": (window(ONES, np.arange(4.0)), "nothing to learn"),
    "constant target": (window(RAMP, np.ones(4)), "nothing to learn"),
    "nan": (window(np.full((4, 3), np.nan), np.arange(4.0)), "not finite"),
    "infinite target": (window(RAMP, np.full(4, np.inf)), "not finite"),
    "one row": (window(RAMP[:1], np.ones(1)), "at least"),
    "no hidden unit": (window(RAMP, np.arange(4.0), hidden=0), "at least"),
    "negative width": (window(RAMP, np.arange(4.0), width=-3), "at least"),
    "short inputs": (window(RAMP, np.arange(4.0), inputs=b"\0" * 95), "bytes"),
    "short targets": (window(RAMP, np.arange(4.0), targets=b""), "bytes"),
    "rate": (window(RAMP, np.arange(4.0), learning_rate=0.0), "learning rate"),
    "nan rate": (window(RAMP, np.arange(4.0), learning_rate=float("nan")), "learning rate"),
    "epochs": (window(RAMP, np.arange(4.0), epochs=0), "epochs"),
    "output": (window(RAMP, np.arange(4.0), output="relu"), "output"),
    "divergence": (window(*delayed_residual(100), learning_rate=1e30), "diverged"),
}


@pytest.mark.parametrize(("bad", "reason"), UNUSABLE.values(), ids=UNUSABLE.keys())
def test_an_unusable_window_is_a_message(bad: object, reason: str) -> None:
    result = fit(bad)  # type: ignore[arg-type]
    assert reason in result.message
    assert result.weights == b""
    assert result.number == 1

"""The residual network against its formulas written out unit by unit."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from heaved.estimation.heave.laser.network import Network, Output


def random_network(output: Output, width: int = 5, hidden: int = 3, seed: int = 1) -> Network:
    rng = np.random.default_rng(seed)
    return Network(
        W1=rng.normal(size=(hidden, width)),
        b1=rng.normal(size=hidden),
        w2=rng.normal(size=hidden),
        b2=0.3,
        input_mean_m=0.1,
        input_std_m=1.7,
        target_mean_m=-0.02,
        target_std_m=0.05,
        output=output,
    )


def by_hand(network: Network, window: list[float]) -> float:
    """Eq. (15), (16) in scalars."""
    z = [(value - network.input_mean_m) / network.input_std_m for value in window]
    total = -network.b2
    for j in range(len(network.w2)):
        net = sum(network.W1[j, i] * z[i] for i in range(len(z))) - network.b1[j]
        total += network.w2[j] / (1.0 + math.exp(-net))
    if network.output is Output.SIGMOID:
        total = (1.0 / (1.0 + math.exp(-total)) - 0.5) * 10.0
    return float(network.target_mean_m + network.target_std_m * total)


@pytest.mark.parametrize("output", Output)
def test_it_computes_the_formulas(output: Output) -> None:
    network = random_network(output)
    windows = np.random.default_rng(2).normal(scale=2.0, size=(20, 5))
    expected = [by_hand(network, row) for row in windows.tolist()]
    assert [network.predict(row) for row in windows] == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(network.predict_many(windows), expected, rtol=1e-12)


@pytest.mark.parametrize("output", Output)
def test_absurd_inputs_saturate_without_a_warning(output: Output) -> None:
    network = random_network(output)
    for value in (1e300, -1e300):
        assert math.isfinite(network.predict(np.full(5, value)))


def test_a_sigmoid_output_is_bounded_by_five_deviations() -> None:
    huge = Network.from_bytes(struct.pack("<8d", 0.0, 0.0, 1e3, 0.0, 0.0, 1.0, 2.0, 0.5), 1, 1, "sigmoid")
    assert huge.predict(np.zeros(1)) == pytest.approx(2.0 + 5.0 * 0.5)


@pytest.mark.parametrize("output", Output)
def test_the_bytes_hold_everything_in_the_documented_order(output: Output) -> None:
    network = random_network(output)
    weights = network.to_bytes()
    values = [*network.W1.ravel(), *network.b1, *network.w2, 0.3, 0.1, 1.7, -0.02, 0.05]
    assert weights == struct.pack(f"<{len(values)}d", *values)
    copy = Network.from_bytes(weights, network.width, network.hidden, output.value)
    assert copy.to_bytes() == weights
    assert copy.output is output
    window = np.linspace(-1.0, 1.0, 5)
    assert copy.predict(window) == network.predict(window)


GOOD = struct.pack("<8d", 1, 2, 3, 4, 0, 1, 0, 1)  # width 1, hidden 1: W1, b1, w2, b2 and the four statistics


@pytest.mark.parametrize(
    ("weights", "width", "hidden", "output", "reason"),
    [
        (GOOD, 1, 1, "relu", "output"),
        (GOOD, 0, 1, "linear", "at least 1"),
        (GOOD, 1, -1, "linear", "at least 1"),
        (GOOD[:63], 1, 1, "linear", "63 bytes"),
        (GOOD + b"\0" * 8, 1, 1, "linear", "72 bytes"),
        (b"", 1, 1, "linear", "0 bytes"),
        (struct.pack("<8d", math.nan, 2, 3, 4, 0, 1, 0, 1), 1, 1, "linear", "finite"),
        (struct.pack("<8d", 1, 2, 3, 4, 0, 1, math.inf, 1), 1, 1, "linear", "finite"),
        (struct.pack("<8d", 1, 2, 3, 4, 0, 0, 0, 1), 1, 1, "linear", "positive"),
        (struct.pack("<8d", 1, 2, 3, 4, 0, 1, 0, -1), 1, 1, "linear", "positive"),
    ],
)
def test_bytes_from_elsewhere_are_checked(weights: bytes, width: int, hidden: int, output: str, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Network.from_bytes(weights, width, hidden, output)

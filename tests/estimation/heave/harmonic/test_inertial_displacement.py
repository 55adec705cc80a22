import numpy as np
import pytest
from scipy.signal import lsim

from heaved.estimation.heave.harmonic.inertial_displacement import DAMPING, InertialDisplacement


def run(times: np.ndarray, a: np.ndarray, highpass_period_s: float) -> np.ndarray:
    inertial = InertialDisplacement(highpass_period_s)
    dts = np.diff(times, prepend=times[0])
    return np.array([inertial.step(dt, value) for dt, value in zip(dts, a, strict=True)])


def test_equals_scipy_for_piecewise_linear_input_at_irregular_times() -> None:
    rng = np.random.default_rng(2)
    w = 2 * np.pi / 16.0
    fine = np.arange(0.0, 60.0, 0.01)
    keep = np.sort(np.concatenate(([0], rng.choice(np.arange(1, len(fine)), 2500, replace=False))))
    times = fine[keep]
    a = np.sin(1.1 * times) + 0.2 * rng.standard_normal(len(times)) + 0.4
    oscillator = ([1.0], [1.0, 2 * DAMPING * w, w**2])
    truth = lsim(oscillator, np.interp(fine, times, a), fine, X0=None, interp=True)[1]
    # scipy starts from zero, we from the resting point of the first sample: the difference is the free decay.
    start = lsim(oscillator, np.full(len(fine), a[0]), fine, interp=True)[1]
    ours = run(times, a, 16.0)
    assert np.allclose(ours - a[0] / w**2, (truth - start)[keep], atol=1e-9)


@pytest.mark.parametrize("period_s", [5.0, 8.0, 14.0])
def test_response_is_what_a_sine_shows(period_s: float) -> None:
    omega = 2 * np.pi / period_s
    times = np.arange(0.0, 40 * period_s, 0.02)
    z = run(times, -(omega**2) * np.sin(omega * times), 16.0)
    tail = times > 20 * period_s
    basis = np.exp(1j * omega * times[tail])
    measured = 2j * np.mean(z[tail] * basis.conj())
    assert measured == pytest.approx(InertialDisplacement(16.0).response(omega), abs=2e-3)
    assert measured.imag > 0.0  # it leads


def test_refuses_what_is_not_a_number() -> None:
    inertial = InertialDisplacement(16.0)
    with pytest.raises(ValueError, match="nan"):
        inertial.step(0.01, float("nan"))
    with pytest.raises(ValueError, match="-1"):
        inertial.step(-1.0, 0.0)

"""Oracle: a laser made from the observer's own output, moved and scaled by known amounts."""

from math import cos, pi, sin

import numpy as np
import pytest

from heaved.estimation.heave.laser.lead import Comparison, LeadTracker, Params, compare

OMEGA = 2.0 * pi / 6.0


def readings(
    rng: np.random.Generator, lead_s: float, gain: float, noise_m: float, span_s: float = 60.0, share: float = 0.5
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Times, early observer (heave, velocity) and laser = gain * truth + 12 m + noise, with holes in it."""
    t = np.sort(rng.choice(np.arange(0.0, span_s, 0.05), int(share * span_s / 0.05), replace=False)) + 5000.0
    phase = rng.uniform(0.0, 2.0 * pi)
    early = OMEGA * (t + lead_s) + phase
    truth = 0.04 * np.sin(OMEGA * t + phase)
    laser = 12.0 + gain * truth + noise_m * rng.standard_normal(len(t))
    return t, 0.04 * np.sin(early), 0.04 * OMEGA * np.cos(early), laser


@pytest.mark.parametrize("lead_s", [-0.9, -0.1, 0.0, 0.25, 1.0])
@pytest.mark.parametrize("gain", [0.8, 1.0, 1.3])
def test_a_known_lead_and_gain_are_found_exactly_without_noise(lead_s: float, gain: float) -> None:
    shown = compare(*readings(np.random.default_rng(1), lead_s, gain, 0.0), OMEGA)
    assert shown is not None
    assert shown.lead_s == pytest.approx(lead_s, abs=1e-9)  # positive: the estimate is early
    assert shown.gain == pytest.approx(gain, abs=1e-9)
    assert shown.coherence == pytest.approx(1.0, abs=1e-9)
    assert shown.lead_std_s < 1e-9


def test_a_constant_and_a_slope_of_the_laser_do_not_count() -> None:
    t, heave, velocity, laser = readings(np.random.default_rng(2), 0.2, 1.0, 0.0)
    shown = compare(t, heave, velocity, laser - 30.0 + 0.01 * (t - 5000.0), OMEGA)
    assert shown is not None
    assert (shown.lead_s, shown.coherence) == pytest.approx((0.2, 1.0), abs=1e-6)


def test_with_noise_and_gaps_the_lead_lies_within_its_own_standard_error() -> None:
    """Over 100 records no bias, and the claimed error is not below the realised one (it allows for slow residuals)."""
    rng = np.random.default_rng(3)
    normalised = []
    for _ in range(100):
        shown = compare(*readings(rng, 0.3, 1.1, 0.01, share=rng.uniform(0.2, 0.9)), OMEGA)
        assert shown is not None
        normalised.append((shown.lead_s - 0.3) / shown.lead_std_s)
    z = np.array(normalised)
    assert abs(np.mean(z)) < 0.3
    assert np.mean(np.abs(z) < 1.96) > 0.9


def test_with_residuals_as_narrow_as_the_sea_it_still_does() -> None:
    """Waves beside the dominant frequency are what the residual is made of; they are as slow as the sea itself."""
    rng = np.random.default_rng(4)
    normalised = []
    for _ in range(100):
        t, heave, velocity, laser = readings(rng, 0.3, 1.0, 0.0, span_s=90.0, share=1.0)
        beside = rng.uniform(1.05, 1.3) * OMEGA
        laser = (
            laser
            + 0.008 * np.sin(beside * t + rng.uniform(0.0, 2.0 * pi))
            + 0.008 * np.sin(rng.uniform(0.7, 0.95) * OMEGA * t + rng.uniform(0.0, 2.0 * pi))
        )
        shown = compare(t, heave, velocity, laser, OMEGA)
        assert shown is not None
        normalised.append((shown.lead_s - 0.3) / shown.lead_std_s)
    assert np.mean(np.abs(np.array(normalised)) < 1.96) > 0.9


def test_a_laser_that_shows_the_middle_of_the_waves_alone_knows_the_lead_better_than_the_gain() -> None:
    """Each standard error against what a hundred draws of the noise make of its own number."""
    rng = np.random.default_rng(8)
    found = []
    for _ in range(100):
        t, heave, velocity, laser = readings(rng, 0.1, 1.0, 0.0, share=1.0)
        middle = np.abs(heave) < 0.012
        for low, high in ((1.05, 1.3), (0.7, 0.95)):
            laser = laser + 0.003 * np.sin(rng.uniform(low, high) * OMEGA * t + rng.uniform(0.0, 2.0 * pi))
        shown = compare(t[middle], heave[middle], velocity[middle], laser[middle], OMEGA)
        assert shown is not None
        found.append(((shown.gain - 1.0) / shown.gain_std, (shown.lead_s - 0.1) / shown.lead_std_s,
                      shown.gain_std / (shown.lead_std_s * OMEGA)))  # fmt: skip
    gain, lead, ratio = np.array(found).T
    assert np.mean(np.abs(gain) < 1.96) > 0.9
    assert np.mean(np.abs(lead) < 1.96) > 0.9
    assert float(np.median(ratio)) > 3.0


def test_too_few_readings_or_no_motion_give_no_comparison() -> None:
    t, heave, velocity, laser = readings(np.random.default_rng(5), 0.0, 1.0, 0.0)
    assert compare(t[:7], heave[:7], velocity[:7], laser[:7], OMEGA) is None
    assert compare(t[:0], heave[:0], velocity[:0], laser[:0], OMEGA) is None
    assert compare(t, 0.0 * heave, 0.0 * velocity, laser, OMEGA) is None


@pytest.mark.parametrize("distance_m", [0.0, 1e-3, 0.1, 12.0, 1803.7])
@pytest.mark.parametrize("slope_mps", [0.0, 0.013])
def test_the_rounding_of_a_laser_that_stands_still_is_no_motion(distance_m: float, slope_mps: float) -> None:
    """Its own rounding can look as coherent as one likes; a laser that moves by less than it resolves can be real."""
    t, heave, velocity, laser = readings(np.random.default_rng(5), 0.0, 1.0, 0.0)
    still = distance_m + slope_mps * (t - 5000.0)
    assert compare(t, heave, velocity, still, OMEGA) is None
    shown = compare(t, heave, velocity, still + 1e-3 * (laser - 12.0), OMEGA)  # 40 µm
    assert shown is not None
    assert shown.coherence == pytest.approx(1.0, abs=1e-4)


def comparison(lead_s: float, lead_std_s: float = 0.01, coherence: float = 0.95) -> Comparison:
    return Comparison(lead_s=lead_s, lead_std_s=lead_std_s, gain=1.0, coherence=coherence)


def test_what_is_learned_is_the_lead_beyond_the_design() -> None:
    tracker = LeadTracker(Params())
    assert tracker.update(comparison(0.5), design_lead_s=0.4)
    assert tracker.learned_s == pytest.approx(0.1)
    tracker = LeadTracker(Params())
    assert tracker.update(comparison(0.2), design_lead_s=0.4)
    assert tracker.learned_s == pytest.approx(-0.2)


def test_the_first_comparisons_are_averaged_and_then_followed_slowly() -> None:
    p = Params(refresh_s=10.0, time_constant_s=100.0)
    tracker = LeadTracker(p)
    values = [0.1, 0.3, 0.2, 0.0]
    for n, value in enumerate(values, 1):
        tracker.update(comparison(value), 0.0)
        assert tracker.learned_s == pytest.approx(np.mean(values[:n]))
    for _ in range(200):
        tracker.update(comparison(0.1), 0.0)
    tracker.update(comparison(0.2), 0.0)
    assert tracker.learned_s == pytest.approx(0.1 + 0.1 * (1.0 - np.exp(-0.1)), abs=1e-6)


@pytest.mark.parametrize(
    "poor",
    [
        None,
        comparison(0.3, coherence=0.2),
        comparison(0.3, lead_std_s=0.2),
        comparison(3.0),  # a laser of the wrong sign is half a period off
        comparison(-1.2),
    ],
)
def test_what_is_not_believable_is_not_learned(poor: Comparison | None) -> None:
    tracker = LeadTracker(Params())
    tracker.update(comparison(0.1), 0.0)
    assert not tracker.update(poor, 0.0)
    assert tracker.learned_s == pytest.approx(0.1)
    assert tracker.updates == 1


def test_restored_is_bounded_and_soon_overruled() -> None:
    tracker = LeadTracker(Params())
    tracker.restore(7.0)
    assert tracker.learned_s == 1.0
    tracker.restore(-0.4)
    for _ in range(60):
        tracker.update(comparison(0.1), 0.0)
    assert tracker.learned_s == pytest.approx(0.1, abs=1e-3)


def test_the_sign_is_that_of_the_multistep() -> None:
    """A pair that is early by L, moved by F^(-L), lies on the laser."""
    t, heave, velocity, laser = readings(np.random.default_rng(7), 0.6, 1.0, 0.0)
    shown = compare(t, heave, velocity, laser, OMEGA)
    assert shown is not None
    L = -shown.lead_s
    moved = heave * cos(OMEGA * L) + velocity / OMEGA * sin(OMEGA * L)
    assert moved == pytest.approx(laser - 12.0, abs=1e-9)


@pytest.mark.parametrize(
    ("ratio", "shift_s", "says"),
    [
        (1000.0, 0.0, "it shows 1000 times the heave: is it in mm?"),
        (3.2808, 0.0, "it shows 3.28 times the heave: is it in feet?"),
        (0.5, 0.0, "it shows 0.5 times the heave: scale?"),
        (1.2, 0.0, "it shows 1.2 times the heave: scale?"),
        (-1.0, 0.0, "it moves against the heave: sign?"),
        (1.0, 1.4, "it is 1.4 s behind the accelerometer: latency_ms?"),
    ],
)
def test_what_is_no_laser_on_the_heave_is_refused_with_what_is_likely(ratio: float, shift_s: float, says: str) -> None:
    t, heave, velocity, laser = readings(np.random.default_rng(8), shift_s, 1.0, 1e-4)
    tracker = LeadTracker(Params())
    assert not tracker.update(compare(t, heave, velocity, ratio * laser, OMEGA), 0.0, has_true_gain=True)
    assert (tracker.gain, tracker.learned_s, tracker.updates) == (1.0, 0.0, 0)
    assert tracker.refused == says
    assert tracker.update(compare(t, heave, velocity, laser, OMEGA) if shift_s == 0.0 else comparison(0.1), 0.0)
    assert tracker.refused == ""

"""Seas with directions: the coherence that a name asks for, by counting waves and by records; a turn by its parts."""

from __future__ import annotations

from math import cos, degrees, inf, radians, sin

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.signal import csd

from heaved.simulate.directional import HEADINGS_RAD, NAMES, Turn, directional, directions, moments, spread_of
from heaved.simulate.seaway import motion_spectra, seaway


@pytest.mark.parametrize("coherence", [0.0, 0.5, 0.8, 0.95, 0.99])
@pytest.mark.parametrize("heading", ["bow", "beam"])
def test_the_spreading_has_the_coherence_that_is_asked_for(coherence: float, heading: str) -> None:
    """By quadrature over the directions: the share of 1 that a sum of sine and cosine tells."""
    s, main = spread_of(coherence), HEADINGS_RAD[heading]

    def density(angle: float) -> float:
        return float(abs(cos((angle - main) / 2.0)) ** (2.0 * s))

    def mean(of: object) -> float:
        assert callable(of)
        return float(quad(lambda a: of(a) * density(a), main - np.pi, main + np.pi, points=[main])[0]) / area

    area = quad(density, main - np.pi, main + np.pi, points=[main])[0]
    cross = np.array([mean(sin), mean(cos)])
    among = np.array(
        [
            [mean(lambda a: sin(a) ** 2), mean(lambda a: sin(a) * cos(a))],
            [mean(lambda a: sin(a) * cos(a)), mean(lambda a: cos(a) ** 2)],
        ]
    )
    assert cross @ np.linalg.solve(among, cross) == pytest.approx(coherence, abs=1e-6)
    found_cross, found_among = moments(coherence, main)
    np.testing.assert_allclose(found_cross, cross, atol=1e-6)
    np.testing.assert_allclose(found_among, among, atol=1e-6)
    drawn = directions(2000, coherence, main, np.random.default_rng(3))
    assert [np.mean(np.sin(drawn)), np.mean(np.cos(drawn))] == pytest.approx(cross, abs=2e-3)
    few = drawn[700:721]  # neighbours in frequency already have all of it
    assert [np.mean(np.sin(few)), np.mean(np.cos(few))] == pytest.approx(cross, abs=0.1)


def test_waves_of_one_direction_are_wholly_coherent() -> None:
    assert spread_of(1.0) == inf
    assert np.all(directions(5, 1.0, 0.3, np.random.default_rng(1)) == 0.3)
    cross, among = moments(1.0, 0.3)
    np.testing.assert_allclose(among, np.outer(cross, cross), atol=1e-12)


@pytest.mark.parametrize("name", ["S6S-bow-0.8", "SL-beam-0.95", "S6-bow-0"])
def test_a_long_record_has_the_spectra_that_are_told(name: str) -> None:
    motion = seaway(name, seed=7).motion(np.arange(0.0, 40_000.0, 0.8))
    series = (motion.heave_m, motion.roll_rad, motion.pitch_rad)
    f = np.linspace(0.0, 0.625, 201)
    told = motion_spectra(name, f)
    band = told[:, 0, 0].real > 0.1 * told[:, 0, 0].real.max()
    for j, x in enumerate(series):
        for k, y in enumerate(series):
            # SciPy's cross-spectrum is that of conj(X) Y.
            _, found = csd(y, x, fs=1.25, nperseg=400)
            size = np.sqrt(told[band, j, j].real.sum() * told[band, k, k].real.sum())
            assert abs(found[band].sum() - told[band, j, k].sum()) < 0.12 * size


@pytest.mark.parametrize("coherence", ["0", "0.8", "1"])
def test_heave_is_that_of_the_same_sea_without_directions(coherence: str) -> None:
    t = np.arange(0.0, 700.0, 0.5)
    plain = seaway("S6S", 4, start_s=100.0).motion(t)
    for heading in HEADINGS_RAD:
        found = seaway(f"S6S-{heading}-{coherence}", 4, start_s=100.0).motion(t)
        np.testing.assert_allclose(found.heave_m, plain.heave_m, atol=1e-9)
        np.testing.assert_allclose(found.heave_acceleration_mps2, plain.heave_acceleration_mps2, atol=1e-9)


def test_a_turn_goes_from_one_heading_to_the_other_and_every_rate_is_a_derivative() -> None:
    bow, beam, turn = (seaway(f"S6S-{heading}-0.8", 2) for heading in ("bow", "beam", "turn"))
    early, late = np.arange(0.0, 480.0), np.arange(600.0, 900.0)
    angles = ("roll_rad", "pitch_rad", "surge_acceleration_mps2", "sway_acceleration_mps2", "pitch_rate_radps")
    for field in angles:
        np.testing.assert_allclose(getattr(turn.motion(early), field), getattr(bow.motion(early), field), atol=1e-9)
        np.testing.assert_allclose(getattr(turn.motion(late), field), getattr(beam.motion(late), field), atol=1e-9)
    turned = turn.motion(late).yaw_rad - beam.motion(late).yaw_rad
    assert degrees(float(turned[0])) == pytest.approx(60.0)
    h = 4e-4
    for t0 in (300.0, 500.0, 540.0, 590.0):
        m = turn.motion(t0 + np.arange(-20.0, 21.0) * h)
        for value, rate in (
            (m.heave_m, m.heave_velocity_mps),
            (m.roll_rad, m.roll_rate_radps),
            (m.pitch_rad, m.pitch_rate_radps),
            (m.yaw_rad, m.yaw_rate_radps),
        ):
            np.testing.assert_allclose((value[2:] - value[:-2]) / (2.0 * h), rate[1:-1], atol=1e-6)
        one = turn.at(t0)
        for field in m.__struct_fields__:
            assert getattr(one, field) == pytest.approx(getattr(m, field)[20], abs=1e-10)
    halfway, fastest = Turn().at(np.array(540.0))
    assert float(halfway) == pytest.approx(radians(30.0))
    assert float(fastest) == pytest.approx(radians(60.0) / 120.0 * 1.875)


def test_without_attitude_there_is_no_turn_either() -> None:
    motion = seaway("SL-turn-0.5", 1, attitude=False).motion(np.arange(0.0, 700.0, 1.0))
    assert not np.any(motion.roll_rad)
    assert not np.any(motion.pitch_rad)
    assert np.ptp(motion.yaw_rad) == 0.0


NOTHING = "S6S-bow S6S-stern-0.8 S6S-bow-1.2 S6S-bow-nan S6S-bow--0.1 S6S- T1-bow-0.8 SX-bow-0.8 -"


@pytest.mark.parametrize("name", NOTHING.split())
def test_a_name_that_says_nothing_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=r"SEA-HEADING-COHERENCE|have no directions"):
        seaway(name)


def test_the_standard_names_are_read_as_they_are_written() -> None:
    assert len(set(NAMES)) == 20
    for name in NAMES:
        asked = directional(name)
        assert asked is not None
        assert f"{asked.sea}-{asked.heading}-{asked.coherence:g}" == name
    assert directional("S6S") is None

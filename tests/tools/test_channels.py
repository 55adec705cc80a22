"""tools/accuracy.py channels: its limits against those of one channel and of records, its errors against heave itself,
and a ship's record against the sea that it was made of.
"""

from __future__ import annotations

import json
from math import inf, sqrt
from typing import TYPE_CHECKING

import accuracy
import numpy as np
import pytest
from evidence import channels, scenarios
from evidence.channel_limits import PITCH, ROLL, causal_limits, measured_spectra
from evidence.heave import estimators
from evidence.scenarios import triplet

from heaved.samples import GRAVITY_MPS2
from heaved.simulate.seaway import motion_spectra, seaway
from heaved.simulate.sensors import ImuModel, record

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from heaved.samples import Sample

RATE_HZ = 3.0


@pytest.mark.parametrize(("sea", "sensor"), [("S6S", "A"), ("SL", "B"), ("SL", "C")])
def test_alone_is_the_limit_of_one_channel_whatever_the_directions(sea: str, sensor: str) -> None:
    alone, *others = channels.limits_at_sea(f"{sea}-bow-0.8", sensor).errors_m
    known = scenarios.sea_limits(sea, sensor, 20.0)
    assert alone == pytest.approx((known.causal_m, *known.forecast_m.values()), rel=1e-4)
    both = others[-1]
    assert all(more < less for more, less in zip(both, alone, strict=True))


def test_a_turn_begins_and_ends_at_the_limits_of_the_two_headings() -> None:
    before, after = (channels.limits_at_sea("SL-turn-0.8", "C", np.radians(60.0) * part).errors_m for part in (0, 1))
    np.testing.assert_allclose(before, channels.limits_at_sea("SL-bow-0.8", "C").errors_m, rtol=1e-9)
    np.testing.assert_allclose(after, channels.limits_at_sea("SL-beam-0.8", "C").errors_m, rtol=1e-9)


def test_what_is_attainable_lies_between_the_limits() -> None:
    """A list that wanders hides something, and what is learned of ten minutes is not all."""
    both, alone = (channels.limits_at_sea("SL-bow-0.95", "A").errors_m[k][0] for k in (-1, 0))
    wandering_m, learned_m = channels.attainable_at_sea("SL-bow-0.95", "A")
    assert 1.02 * both < wandering_m < learned_m < 0.9 * alone
    _, nothing_m = channels.attainable_at_sea("SL-bow-0", "A")
    assert 0.97 * alone < nothing_m < 1.05 * alone


def test_weights_fitted_to_one_record_come_near_the_limit_on_another() -> None:
    """Simulator, sensor and limit agree: no filter is below the limit on a record that it has not seen, and the best
    weights on 40 s of the three channels, from the covariances of a long record, come close to it.
    """
    name, noise, angle_std = "S6-bow-0.9", 1e-4, 1e-3
    sensor = ImuModel(noise_mps2_rthz=sqrt(noise), attitude_noise_rad=angle_std)
    count, duration_s = round(40.0 * RATE_HZ), 12_000.0

    def measured(seed: int) -> tuple[np.ndarray, np.ndarray]:
        made = record(seaway(name, seed), duration_s, imu_rate_hz=RATE_HZ, sensor=sensor, laser="off", seed=seed + 10)
        # The tilt is taken out with the true angles: what its noise adds is not the limit's.
        up = np.cos(made.truth.roll_rad) * np.cos(made.truth.pitch_rad) * made.az_mps2
        up += np.sin(made.truth.roll_rad) * np.cos(made.truth.pitch_rad) * made.ay_mps2
        up += np.sin(made.truth.pitch_rad) * made.ax_mps2 - GRAVITY_MPS2
        return np.stack([up, made.roll_rad, made.pitch_rad]), made.truth.heave_m

    def past(series: np.ndarray) -> np.ndarray:
        windows = np.lib.stride_tricks.sliding_window_view(series, count, axis=1)
        return np.concatenate(list(windows), axis=1)

    f = np.linspace(0.0, RATE_HZ / 2.0, 2**12 + 1)
    spectra = measured_spectra(f, motion_spectra(name, f), noise, angle_std**2 / (RATE_HZ / 2.0), (ROLL, PITCH))
    (limit_m,) = causal_limits(spectra)
    (alone_m,) = causal_limits(measured_spectra(f, motion_spectra(name, f), noise, 1.0))
    seen, heave = measured(1)
    columns = past(seen)
    weights = np.linalg.solve(columns.T @ columns, columns.T @ heave[count - 1 :])
    seen, heave = measured(2)
    error_m = float(np.std(past(seen) @ weights - heave[count - 1 :]))
    assert limit_m < error_m * 1.03
    assert error_m < 0.95 * alone_m


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("SL-bow-0.8", {"": (300, 900)}),
        ("SL-turn-0.8", {"before": (300, 480), "turning": (480, 600), "after": (600, 900)}),
    ],
)
def test_the_errors_of_whoever_says_zero_are_the_heave_itself(
    name: str, parts: dict[str, tuple[int, int]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def says_zero(_: str, samples: Sequence[Sample], conditions: estimators.Conditions) -> list[estimators.Trace]:
        zero = np.zeros(len(samples))
        ahead = {horizon_s: estimators.Ahead(zero, zero) for horizon_s in conditions.horizons_s}
        return [estimators.Trace(estimator="zero", heave_m=zero, std_m=zero + 0.2, forecast=ahead)]

    monkeypatch.setattr(estimators, "traces", says_zero)
    task = channels.Task(scenario=name, sensor="A", observer="sea", number=2, duration_s=None, folder=None)
    found = channels.run(task)
    start_s = float(np.random.default_rng(triplet(2).start).uniform(0.0, scenarios.STARTS_WITHIN_S))
    heave_m = seaway("SL", 2, start_s=start_s).motion(np.arange(0.0, 900.0, 0.05)).heave_m
    assert list(found) == list(parts)
    for part, (from_s, end_s) in parts.items():
        there = heave_m[20 * from_s : 20 * end_s]
        assert found[part].errors_m[0] == pytest.approx(sqrt(np.mean(there**2)))
        assert found[part].errors_m[3] == pytest.approx(sqrt(np.mean(there[40:] ** 2)))
        assert found[part].within == pytest.approx(np.mean(np.abs(there) <= 1.96 * 0.2))


def test_roll_and_pitch_are_in_use_again_when_their_weight_stays() -> None:
    t = 600.0 + np.arange(0.0, 300.0, 0.5)
    weight = np.where(t < 620.0, 0.9, 0.2)  # Of the old heading; a blip; and for good.
    weight[(t >= 650.0) & (t < 660.0)] = 0.8
    weight[t >= 700.0] = 0.6
    assert channels.again_s(t, weight) == 100.0
    assert channels.again_s(t, np.full(t.size, 0.5)) == inf
    assert channels.again_s(t, np.ones(t.size)) == 0.0


def test_records_are_put_together_by_their_squares() -> None:
    found = channels.together([channels.Part((3.0, 1.0), 0.9), channels.Part((4.0, 1.0), 1.0)])
    assert found.errors_m == pytest.approx((sqrt(12.5), 1.0))
    assert found.within == pytest.approx(0.95)


def ship(folder: Path, heave_m: np.ndarray, roll_rad: np.ndarray, pitch_rad: np.ndarray) -> Path:
    """A record of a ship as it comes: 1 Hz, degrees, heave positive down."""
    path = folder / "palmer" / "ship.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = np.stack(
        [
            np.arange(heave_m.size, dtype=np.float64), np.degrees(roll_rad), np.degrees(pitch_rad),
            np.full(heave_m.size, 90.0), -heave_m, heave_m,
        ],
        axis=1,
    )  # fmt: skip
    np.savetxt(path, rows, delimiter=",", header="t,roll,pitch,heading,heave,altitude", comments="")
    return path


@pytest.mark.parametrize("coherence", [0.8, 0.95])
def test_a_ship_has_the_limits_of_the_sea_that_it_was_in(tmp_path: Path, coherence: float) -> None:
    name = f"S6-bow-{coherence:g}"
    motion = seaway(name, 3).motion(np.arange(4000.0))
    path = ship(tmp_path, motion.heave_m, motion.roll_rad, motion.pitch_rad)
    f = scenarios.grid(20.0)
    found = channels.ship_spectra(path, f)
    assert channels.coherence_of(found) == pytest.approx(coherence, abs=0.03)
    limit, true = channels.limits(f, found, "C"), channels.limits_at_sea(name, "C")
    assert limit.sigma_m == pytest.approx(true.sigma_m, rel=0.1)
    gain, true_gain = (1.0 - one.errors_m[-1][0] / one.errors_m[0][0] for one in (limit, true))
    assert gain == pytest.approx(true_gain, abs=0.05)


def test_angles_of_another_sea_tell_a_ship_nothing(tmp_path: Path) -> None:
    """Ten minutes, as long as the real one: the means over few pieces find a coherence, which is taken off."""
    shares = []
    for seed in range(1, 9):
        heave, other = (seaway("S6-bow-0.8", seed).motion(np.arange(620.0)) for seed in (seed, seed + 100))
        path = ship(tmp_path, heave.heave_m, other.roll_rad, other.pitch_rad)
        shares.append(channels.coherence_of(channels.ship_spectra(path, np.linspace(0.0, 1.0, 201))))
    assert np.mean(shares) < 0.12


def test_too_short_a_ship_is_refused(tmp_path: Path) -> None:
    motion = seaway("S6", 3).motion(np.arange(200.0))
    with pytest.raises(ValueError, match="too short"):
        channels.ship_spectra(ship(tmp_path, motion.heave_m, motion.roll_rad, motion.pitch_rad), np.array([0.0, 0.1]))


def test_the_command_prints_limits_and_leaves_lines_to_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["channels", "SL-turn-0.8", "SL-beam-0.95", "--sensors", "C", "--limits-only", "--no-figures"]
    assert accuracy.main([*words, "--out", str(tmp_path)]) == 0
    text = capsys.readouterr().out
    assert "| SL-turn-0.8, after | C |" in text
    assert "ours" not in text
    lines = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert [(line["scenario"], line["part"]) for line in lines] == [
        ("SL-turn-0.8", "before"), ("SL-turn-0.8", "turning"), ("SL-turn-0.8", "after"), ("SL-beam-0.95", ""),
    ]  # fmt: skip
    assert lines[3]["roll_m"] == pytest.approx(lines[3]["both_m"])  # abeam, pitch has nothing of heave
    assert lines[3]["pitch_m"] == pytest.approx(lines[3]["alone_m"])
    before, turning, after = (line["unaware_m"][0] / line["both_m"][0] for line in lines[:3])
    assert before == pytest.approx(1.0, rel=1e-6)
    assert 1.0 < turning < after
    assert lines[3]["both_m"][0] < 0.65 * lines[3]["alone_m"][0]


def test_ours_is_shown_beside_the_limits() -> None:
    ours = channels.Part((0.05, 0.06, 0.07, 0.08, 0.09), 0.96)
    (row,) = channels.rows(["SL-bow-0.8"], ["C"], {("SL-bow-0.8", "C"): [{"": ours}]})
    text = channels.report([row])
    ratios = [0.05 / limit_m for limit_m in (row.alone_m[0], row.both_m[0], row.learned_m)]
    times = f"| **{5.0 / row.sigma_m:.2f}** | {' | '.join(f'{ratio:.2f}' for ratio in ratios)} | 96% |"
    assert times in text
    assert f"{100.0 * row.alone_m[4] / row.sigma_m:.1f} / {100.0 * row.both_m[4] / row.sigma_m:.1f} / " in text


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["S6S"], "no sea with directions"),
        (["S6S-stern-0.8"], "SEA-HEADING-COHERENCE"),
        (["T1-bow-0.8"], "T1"),
        (["palmer", "--data", "/nowhere"], "give its folder by --data"),
    ],
)
def test_what_is_asked_wrongly_is_said(
    words: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert accuracy.main(["channels", *words, "--limits-only", "--no-figures", "--out", str(tmp_path)]) == 1
    assert said in capsys.readouterr().err

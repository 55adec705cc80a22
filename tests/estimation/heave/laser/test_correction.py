"""Oracle: residuals that are a known multiple of the observer's output, and networks made by hand that know it."""

from collections.abc import Callable
from math import inf, nan, pi, sin

import msgspec
import numpy as np
import pytest

from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.heave.laser import ridge
from heaved.estimation.heave.laser.correction import Params, ResidualCorrection, _Evidence
from heaved.estimation.heave.laser.network import Network, Output
from heaved.samples import CorrectionState, TrainedNetwork, TrainingWindow
from heaved.workers.train_correction import fit

OMEGA = 2.0 * pi / 6.0
TAPS = 10
PARAMS = Params(taps=TAPS, step_s=0.1, hidden=1, window_s=60.0, min_laser_s=20.0, period_s=10.0)
CONSTANT_M = 12.0
Signal = Callable[[float], float]


def gain_network(number: int, gain: float, taps: int = TAPS) -> TrainedNetwork:
    """Residual = gain * newest input: one hidden unit, driven where the sigmoid is straight."""
    epsilon = 1e-3
    W1 = np.zeros((1, taps))
    W1[0, -1] = epsilon
    network = Network(
        W1=W1,
        b1=np.zeros(1),
        w2=np.array([4.0 * gain / epsilon]),
        b2=2.0 * gain / epsilon,
        input_mean_m=0.0,
        input_std_m=1.0,
        target_mean_m=0.0,
        target_std_m=1.0,
        output=Output.LINEAR,
    )
    return TrainedNetwork(number=number, weights=network.to_bytes(), width=taps, hidden=1)


def wave(t: float) -> float:
    return 0.1 * sin(OMEGA * t)


class Rig:
    """Runs a correction at 20 Hz on an observer output x(t); the laser shows ``residual(t)`` where it is on."""

    def __init__(self, params: Params = PARAMS, step_s: float = 0.05) -> None:
        self.outputs = RingBuffer(int(10.0 / step_s), 3)
        self.correction = ResidualCorrection(params, self.outputs)
        self.step_s = step_s
        self.n = 0
        self.history: list[tuple[float, float]] = []
        self.values: list[tuple[float, float]] = []
        self.windows: list[tuple[float, TrainingWindow]] = []

    @property
    def t_s(self) -> float:
        return self.n * self.step_s

    def run(
        self, until_s: float, residual: Signal | None = None, x: Signal = wave, omega: float = OMEGA, due: bool = False
    ) -> None:
        while self.t_s < until_s - 1e-9:
            t = self.t_s
            self.history.append((t, x(t)))
            self.values.append((t, self.step(t, x(t), omega)))
            if residual is not None:
                self.learn(t, residual(t) + CONSTANT_M, CONSTANT_M)
            if due and (window := self.correction.due(t, omega)) is not None:
                self.windows.append((t, window))
            self.n += 1

    def step(self, t: float, observer_m: float, omega: float = OMEGA) -> float:
        value_m = self.correction.step(t, observer_m, omega)
        self.outputs.push((t, observer_m, self.correction.raw_m))
        return value_m

    def learn(self, t: float, residual_m: float, constant_m: float) -> None:
        _, observer_m, raw_m = self.outputs.at(t).tolist()
        self.correction.learn(t, residual_m, constant_m, observer_m, raw_m)

    def reset(self) -> None:
        self.outputs.clear()
        self.correction.reset()

    def learned(self, gain: float, residual: Signal, until_s: float = 30.0) -> str:
        """Run to the first window, and offer a network of this gain."""
        self.run(until_s, residual)
        window = self.correction.due(self.t_s, OMEGA)
        assert window is not None
        return self.correction.accept(gain_network(window.number, gain))

    def rms(self, start_s: float, end_s: float = inf) -> float:
        return float(np.sqrt(np.mean([v**2 for t, v in self.values if start_s <= t < end_s])))


def arrays(window: TrainingWindow) -> tuple[np.ndarray, np.ndarray]:
    return np.frombuffer(window.inputs).reshape(window.rows, window.width), np.frombuffer(window.targets)


def third(t: float) -> float:
    return 0.3 * wave(t)


WAVE_RMS = 0.1 / np.sqrt(2.0)


@pytest.fixture
def every_window(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows are handed out though a regression says that there is nothing to learn in them."""
    monkeypatch.setattr(ridge, "TUNING", msgspec.structs.replace(ridge.TUNING, linear=inf))


# --- the rows --------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("every_window")
def test_rows_are_the_outputs_before_each_reading_oldest_first() -> None:
    """Readings between the samples, and a residual that tells the time of its row: both rebuilt by hand."""
    rng = np.random.default_rng(1)
    rig = Rig()
    times = np.cumsum(rng.uniform(0.03, 0.07, 700))
    x = 0.1 * np.sin(OMEGA * times) + 0.02 * rng.standard_normal(len(times))

    def clock(t: float) -> float:
        return 1e-4 * t

    for before, t, value in zip(times[:-1].tolist(), times[1:].tolist(), x[1:].tolist(), strict=True):
        rig.step(t, value)
        between = before + 0.37 * (t - before)
        rig.learn(between, clock(between) + CONSTANT_M, CONSTANT_M)
    window = rig.correction.due(times[-1], OMEGA)
    assert window is not None
    assert (window.width, window.hidden, window.epochs, window.learning_rate) == (TAPS, 1, 1000, 0.01)
    inputs, targets = arrays(window)
    assert np.mean(targets) == pytest.approx(0.0, abs=1e-12)
    spacing = np.diff(targets) / 1e-4
    assert np.all(spacing >= 0.095 - 1e-9)
    assert np.all(spacing < 0.25)
    readings = times[:-1] + 0.37 * np.diff(times)
    # The targets give the times but for one constant: the first row's time.
    first = next(t for t in readings if t > times[1] + 0.9)
    at = first + (targets - targets[0]) / 1e-4
    assert np.min(np.abs(readings[:, None] - at), axis=0).max() < 1e-6
    lags = 0.1 * np.arange(TAPS - 1, -1, -1)
    expected = np.array([np.interp(t - lags, times[1:], x[1:]) for t in at])
    assert inputs == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("step_s", [0.05, 0.1, 0.2, 0.25])
def test_the_network_sees_in_use_what_it_saw_in_training(step_s: float) -> None:
    """Slower than the spacing of the inputs, too: those between samples are interpolated, in both."""
    rig = Rig(step_s=step_s)
    rig.run(80.0, third)
    window = rig.correction.due(rig.t_s, OMEGA)
    assert window is not None
    seen: list[np.ndarray] = []

    class Spy:
        def predict(self, inputs: np.ndarray) -> float:
            seen.append(inputs.copy())
            return 0.0

    assert rig.correction.accept(gain_network(window.number, 0.3)) == "accepted"
    rig.correction.network = Spy()  # type: ignore[assignment]
    rig.run(81.0)
    times, x = np.array(rig.history).T
    lags = 0.1 * np.arange(TAPS - 1, -1, -1)
    assert len(seen) == round(1.0 / step_s)
    for t, inputs in zip(times[-len(seen) :], seen, strict=True):
        assert inputs == pytest.approx(np.interp(t - lags, times, x), abs=1e-12)


@pytest.mark.usefixtures("every_window")
def test_the_newest_quarter_is_held_out_with_a_gap_before_it() -> None:
    """The residual changes its sign for the last quarter: none of those rows may be in the window, but they judge."""
    changed_s = 22.5  # rows from 0.9 s to 30 s: the held-out quarter starts just before

    def residual(t: float) -> float:
        return third(t) if t < changed_s else -third(t)

    for gain, verdict in ((0.3, "rejected"), (-0.3, "accepted")):
        rig = Rig()
        rig.run(30.0, residual)
        window = rig.correction.due(rig.t_s, OMEGA)
        assert window is not None
        inputs, targets = arrays(window)
        assert targets == pytest.approx(0.3 * (inputs[:, -1] - np.mean(inputs[:, -1])), abs=1e-9)
        assert len(targets) < 0.75 * 300 - TAPS + 1
        assert rig.correction.accept(gain_network(window.number, gain)) == verdict


def test_windows_come_when_enough_is_new() -> None:
    rig = Rig()
    rig.run(60.0, third, due=True)
    times = [t for t, _ in rig.windows]
    assert times[0] == pytest.approx(20.0 + 0.9, abs=0.2)
    assert np.diff(times) == pytest.approx(10.0, abs=0.06)
    assert [w.number for _, w in rig.windows] == [1, 2, 3, 4]
    rig.run(62.0, third, due=True)
    assert len(rig.windows) == 5
    rig.run(100.0, due=True)  # no laser: nothing new to learn
    assert len(rig.windows) == 5
    rig.run(110.0, third, due=True)
    assert rig.windows[5][0] == pytest.approx(100.0 + 10.0 / 3.0, abs=1.5)


def test_a_window_with_nothing_to_learn_is_counted_and_not_handed_out() -> None:
    """Before there is a network, because what is left is noise; with one, because that leaves nothing."""
    rng = np.random.default_rng(3)
    rig = Rig()
    rig.run(60.0, lambda t: 0.01 * rng.standard_normal(), due=True)
    assert not rig.windows
    assert (rig.correction.windows, rig.correction.nothing_to_learn) == (0, 4)
    rig = Rig()
    assert rig.learned(0.3, lambda t: third(t) + 0.003 * rng.standard_normal()) == "accepted"
    rig.run(120.0, lambda t: third(t) + 0.003 * rng.standard_normal(), due=True)
    found = rig.correction
    assert found.windows + found.nothing_to_learn == 9
    assert found.nothing_to_learn >= 6  # Of so short windows chance takes five hundredths now and then.
    rig.run(180.0, lambda t: -third(t) + 0.003 * rng.standard_normal(), due=True)
    assert rig.windows  # Another sensor, another thing to learn.


def test_memory_is_bounded_by_the_window() -> None:
    rig = Rig()
    rig.run(200.0, third)
    window = rig.correction.due(rig.t_s, OMEGA)
    assert window is not None
    assert window.rows <= 0.75 * PARAMS.window_s / PARAMS.step_s


@pytest.mark.parametrize("laser", ["stuck", "inverted"])
def test_nothing_is_learned_from_a_laser_that_does_not_follow(laser: str) -> None:
    """A stuck laser shows residual = -x, one of wrong sign -2x: both are easily learned, and must not be."""
    rig = Rig()
    rig.run(30.0, third, due=True)
    assert len(rig.windows) == 1
    residual = (lambda t: -wave(t)) if laser == "stuck" else (lambda t: -2.0 * wave(t))
    rig.run(230.0, residual, due=True)
    worst = 0.0
    for _, window in rig.windows:
        inputs, targets = arrays(window)
        worst = min(worst, float(np.polyfit(inputs[:, -1], targets, 1)[0]))
    assert worst > -0.3
    assert all(t < 70.0 for t, _ in rig.windows)


def test_without_a_constant_nothing_is_learned() -> None:
    rig = Rig()
    for n in range(1000):
        rig.step(0.05 * n, wave(0.05 * n))
        rig.learn(0.05 * n, third(0.05 * n), nan)
    assert rig.correction.due(50.0, OMEGA) is None


# --- the guard -------------------------------------------------------------------------------------------------------


def test_a_network_that_helps_is_accepted_faded_in_and_right() -> None:
    rig = Rig()
    assert rig.correction.state(laser_is_fresh=True) is CorrectionState.LEARNING
    assert rig.learned(0.3, third) == "accepted"
    rig.run(60.0, third)
    first = [v for t, v in rig.values if t >= 30.0][:4]
    assert max(map(abs, first)) < 0.3 * 0.1 * 0.1  # faded in, not switched
    late = [(t, v) for t, v in rig.values if t > 50.0]
    assert np.array([v for _, v in late]) == pytest.approx(np.array([third(t) for t, _ in late]), abs=1e-3)
    assert rig.correction.state(laser_is_fresh=True) is CorrectionState.ACTIVE
    assert rig.correction.state(laser_is_fresh=False) is CorrectionState.HOLDING


@pytest.mark.parametrize("gain", [-0.3, 0.0, 0.7, 0.01])
def test_a_network_that_does_not_help_is_rejected(gain: float) -> None:
    rig = Rig()
    assert rig.learned(gain, third) == "rejected"
    rig.run(60.0, third)
    assert rig.rms(30.0) == 0.0


def test_a_better_network_replaces_the_one_in_use_and_a_worse_one_does_not() -> None:
    rig = Rig()
    assert rig.learned(0.2, third) == "accepted"
    verdicts = []
    for gain in (0.15, 0.2, 0.3):
        rig.run(rig.t_s + 15.0, third)
        window = rig.correction.due(rig.t_s, OMEGA)
        assert window is not None
        verdicts.append(rig.correction.accept(gain_network(window.number, gain)))
    assert verdicts == ["rejected", "rejected", "accepted"]


def test_a_replacement_is_faded_too() -> None:
    """No step of the correction is larger than the sea and the fading make it."""
    rig = Rig()
    assert rig.learned(0.2, third) == "accepted"
    rig.run(55.0 + 1.5, third)  # on a crest: the networks differ by 0.01 m there
    window = rig.correction.due(rig.t_s, OMEGA)
    assert window is not None
    assert rig.correction.accept(gain_network(window.number, 0.3)) == "accepted"
    rig.run(90.0, third)
    steps = np.abs(np.diff([v for t, v in rig.values if t > 50.0]))
    assert steps.max() < 0.05 * 0.3 * 0.1 * OMEGA + 0.01 * 0.05 / 2.0 + 1e-4
    assert rig.rms(80.0) == pytest.approx(0.3 * WAVE_RMS, rel=0.05)


def test_a_network_that_has_gone_bad_is_faded_out_by_the_laser() -> None:
    rig = Rig()
    assert rig.learned(0.3, third) == "accepted"
    rig.run(60.0, third)
    assert rig.rms(50.0) > 0.25 * WAVE_RMS
    rig.run(240.0, lambda t: -third(t))
    assert rig.rms(150.0) < 0.03 * WAVE_RMS
    assert rig.correction.state(laser_is_fresh=True) is CorrectionState.HOLDING


@pytest.mark.parametrize("moved", [{"gain": 0.2}, {"phase_rad": -0.2}, {"by_m": 0.2 * WAVE_RMS}])
def test_a_network_goes_when_what_it_corrects_is_another_output(moved: dict[str, float]) -> None:
    """Without the laser nothing else would say that its correction has been made already; it is faded out."""
    rig = Rig()
    assert rig.learned(0.3, third) == "accepted"
    rig.run(60.0, third)
    rig.correction.move(**moved)
    rig.run(80.0)
    steps = np.abs(np.diff([v for t, v in rig.values if t > 55.0]))
    assert steps.max() < 0.05 * 0.3 * 0.1 * OMEGA + 0.3 * 0.1 * 0.05 / 2.0 + 1e-4
    assert rig.rms(70.0) < 0.01 * WAVE_RMS
    assert rig.correction.state(laser_is_fresh=True) is CorrectionState.LEARNING
    assert rig.correction.saved() is None


def test_a_network_outlives_small_moves_until_they_add_up() -> None:
    rig = Rig()
    assert rig.learned(0.3, third) == "accepted"
    for _ in range(20):
        rig.correction.move(gain=0.02)
        rig.correction.move(gain=-0.02)
    assert rig.correction.network is not None
    for _ in range(20):
        rig.correction.move(gain=0.02)
    assert rig.correction.network is None


def beating(rng: np.random.Generator, t: np.ndarray) -> np.ndarray:
    """Waves of 7 s that grow and fade over a minute: 20 lines, 1/60 Hz wide (standard deviation 0.4 of that)."""
    f, phase = 1.0 / 7.0 + rng.normal(0.0, 0.4 / 60.0, 20), rng.uniform(0.0, 2.0 * np.pi, 20)
    waves: np.ndarray = np.cos(2.0 * np.pi * np.outer(t, f) + phase).sum(axis=1) / np.sqrt(10.0)
    return waves


@pytest.mark.parametrize("laser_s", [30.0, 60.0, 90.0])
def test_agreement_by_chance_is_hardly_ever_applied(laser_s: float) -> None:
    """A correction that has nothing to do with the residual, both narrow-banded: two standard errors are exceeded in
    2.3 % of cases. One that is half of the residual's mean square is applied for the most part.
    """
    rng = np.random.default_rng(1)
    t = np.arange(0.0, laser_s, 0.1)
    harm: list[float] = []
    kept: list[float] = []
    for _ in range(200):
        y, other = beating(rng, t), rng.standard_normal(len(t))
        for residual, found in ((beating(rng, t) + other, harm), (y + other, kept)):
            evidence = _Evidence()
            for row in zip(t.tolist(), residual.tolist(), y.tolist(), strict=True):
                evidence.push(*row)
            found.append(evidence.share())
    assert np.mean(np.array(harm) > 0.0) < 0.12
    assert laser_s < 90.0 or np.mean(kept) > 0.65


def test_the_correction_is_clipped() -> None:
    rig = Rig()
    assert rig.learned(0.3, third) == "accepted"
    rig.run(60.0, third)
    rig.run(90.0, third, x=lambda t: 2.0 * sin(OMEGA * t))
    limit = 3.0 * 0.3 * WAVE_RMS
    assert 0.8 * limit < max(abs(v) for t, v in rig.values if t >= 60.0) <= 1.03 * limit


@pytest.mark.usefixtures("every_window")
def test_results_that_do_not_belong_or_did_not_come_about() -> None:
    rig = Rig()
    assert rig.correction.accept(gain_network(1, 0.3)) == "rejected"  # nobody asked
    rig.run(30.0, third)
    window = rig.correction.due(rig.t_s, OMEGA)
    assert window is not None
    good = gain_network(window.number, 0.3)
    assert rig.correction.accept(gain_network(window.number + 1, 0.3)) == "rejected"
    assert rig.correction.accept(TrainedNetwork(number=window.number, message="diverged")) == "failed"
    assert rig.correction.network is None
    assert rig.correction.accept(good) == "accepted"
    assert rig.correction.accept(good) == "rejected"  # each window is judged once
    for spoilt in (
        msgspec.structs.replace(good, weights=good.weights[:-8]),
        msgspec.structs.replace(good, weights=b"\xff" * len(good.weights)),
        msgspec.structs.replace(good, output="softmax"),
        gain_network(0, 0.3, taps=TAPS + 1),
    ):
        rig.run(rig.t_s + 12.0, third)
        window = rig.correction.due(rig.t_s, OMEGA)
        assert window is not None
        assert rig.correction.accept(msgspec.structs.replace(spoilt, number=window.number)) == "failed"
    assert rig.correction.network is not None


def test_forgotten_rows_take_their_pending_network_with_them() -> None:
    rig = Rig()
    rig.run(30.0, third)
    window = rig.correction.due(rig.t_s, OMEGA)
    assert window is not None
    rig.correction.reset_rows()
    assert rig.correction.accept(gain_network(window.number, 0.3)) == "rejected"
    rig.run(45.0, third)
    assert rig.correction.due(rig.t_s, OMEGA) is None


def test_after_a_restart_of_the_observer_the_correction_starts_from_nothing() -> None:
    rig = Rig()
    assert rig.learned(0.3, third) == "accepted"
    rig.run(60.0, third)
    rig.reset()
    rig.run(62.0)
    assert max(abs(v) for t, v in rig.values if 60.0 <= t < 60.9) == 0.0  # not before all inputs are new ones


def test_disabled_is_off() -> None:
    rig = Rig(msgspec.structs.replace(PARAMS, enabled=False))
    rig.run(60.0, third, due=True)
    assert not rig.windows
    assert rig.rms(0.0) == 0.0
    assert rig.correction.state(laser_is_fresh=True) is CorrectionState.OFF


# --- without the laser -----------------------------------------------------------------------------------------------


def test_it_goes_on_through_an_outage_on_the_same_sea() -> None:
    rig = Rig()
    assert rig.learned(0.3, third) == "accepted"
    rig.run(60.0, third)
    rig.run(360.0, None)
    assert rig.rms(300.0) == pytest.approx(0.3 * WAVE_RMS, rel=0.05)


@pytest.mark.parametrize(
    ("factor", "omega_factor"), [(2.5, 1.0), (0.4, 1.0), (1.0, 1.35), (1.0, 0.7)], ids=["more", "less", "short", "long"]
)
def test_it_ends_when_the_sea_is_another(factor: float, omega_factor: float) -> None:
    rig = Rig()
    assert rig.learned(0.3, third) == "accepted"
    rig.run(60.0, third)
    omega = OMEGA * omega_factor
    rig.run(240.0, None, x=lambda t: factor * 0.1 * sin(omega * t), omega=omega)
    assert rig.rms(200.0) < 1e-3 * WAVE_RMS


# --- memory ----------------------------------------------------------------------------------------------------------


def test_a_restored_network_works_as_before_and_the_laser_has_the_last_word() -> None:
    first = Rig()
    assert first.learned(0.3, third) == "accepted"
    saved = first.correction.saved()
    assert saved is not None
    for residual, expected in ((third, 0.3), (lambda t: -third(t), 0.0)):
        rig = Rig()
        rig.correction.restore(saved)
        rig.run(60.0)
        assert rig.rms(50.0) == pytest.approx(0.3 * WAVE_RMS, rel=0.05)  # on the likeness of the sea alone
        rig.run(180.0, residual)
        assert rig.rms(150.0) == pytest.approx(expected * WAVE_RMS, abs=0.02 * WAVE_RMS)
        assert rig.correction.saved() == saved


@pytest.mark.parametrize(
    "changed", [{"taps": 12}, {"hidden": 3}, {"output": "sigmoid"}, {"step_s": 0.05}], ids=lambda c: next(iter(c))
)
def test_a_network_of_another_shape_is_refused(changed: dict[str, object]) -> None:
    rig = Rig()
    assert rig.learned(0.3, third) == "accepted"
    saved = rig.correction.saved()
    assert saved is not None
    other = Rig(msgspec.structs.replace(PARAMS, **changed)).correction
    with pytest.raises(ValueError, match=r"saved network 10-1-1 \(linear, 0\.1 s\) does not fit the configured"):
        other.restore(saved)
    assert other.network is None
    with pytest.raises(ValueError, match="network: 8 bytes"):
        Rig().correction.restore(msgspec.structs.replace(saved, weights=b"\0" * 8))


# --- with the real trainer -------------------------------------------------------------------------------------------


def test_what_the_trainer_makes_of_a_window_removes_the_residual() -> None:
    """The residual is the observer's output 0.4 s ago: gradient descent finds most of it."""
    rig = Rig(msgspec.structs.replace(PARAMS, hidden=10))

    def residual(t: float) -> float:
        return 0.2 * wave(t - 0.4) + 2e-3 * sin(31.7 * t)

    rig.run(60.0, residual)
    window = rig.correction.due(rig.t_s, OMEGA)
    assert window is not None
    assert rig.correction.accept(fit(window)) == "accepted"
    rig.run(140.0, residual)
    left = [residual(t) - v for t, v in rig.values if t > 110.0]
    assert np.sqrt(np.mean(np.square(left))) < 0.35 * 0.2 * WAVE_RMS

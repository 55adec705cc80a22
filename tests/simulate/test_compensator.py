"""The compensator in a closed loop with the winch: on a stream that knows the truth, and on one that fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from typing import NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt
import pytest
from numpy.typing import NDArray

from heaved.demo.hook import HookMotion, Lift
from heaved.outputs.wire import encode_motion
from heaved.samples import CorrectionState, HeaveForecast, HeaveState, LaserState, MotionFrame, Quality
from heaved.simulate.compensator import Ahead, CompensatorParams, Source, Trust, Update, curve
from heaved.simulate.seaway import seaway
from heaved.simulate.winch import WinchParams

Array = NDArray[np.float64]

HORIZONS_S = (0.05, 0.1, 0.15, 0.5, 1.0, 2.0, 5.0)
PERIOD_S, LATENCY_S = 0.01, 0.005
WINCH, PARAMS = WinchParams(), CompensatorParams()
SETTLED_S = 20.0
"""Faded in, and the rope where it belongs."""
PERFECT_LEAD_S = LATENCY_S + WINCH.dead_time_s + WINCH.lag_s + PERIOD_S / 2.0


class Arrival(NamedTuple):
    """What happens to the controller at one moment."""

    at_s: float
    update: Update


class Run(NamedTuple):
    t_s: np.ndarray
    heave: np.ndarray
    rope: np.ndarray
    rope_speed: np.ndarray
    rope_acceleration: np.ndarray
    authority: np.ndarray

    @property
    def hook(self) -> np.ndarray:
        return np.asarray(self.heave + self.rope)


def raised(heave_m: float | None, by_m: float) -> float:
    assert heave_m is not None
    return heave_m + by_m


class Wave:
    """A regular wave of 1 m."""

    def __init__(self, period_s: float) -> None:
        self.w = 2.0 * np.pi / period_s

    def heave(self, t: npt.ArrayLike) -> Array:
        return np.asarray(np.cos(self.w * np.asarray(t)))

    def speed(self, t: npt.ArrayLike) -> Array:
        return np.asarray(-self.w * np.sin(self.w * np.asarray(t)))


class Sea:
    """An irregular sea or a wave train."""

    def __init__(self, name: str) -> None:
        self._sea = seaway(name, 1)

    def heave(self, t: npt.ArrayLike) -> Array:
        return self._sea.motion(np.asarray(t)).heave_m

    def speed(self, t: npt.ArrayLike) -> Array:
        return self._sea.motion(np.asarray(t)).heave_velocity_mps


@cache
def lines(sea: Wave | Sea, end_s: float, lead_s: float = 0.0) -> tuple[Arrival, ...]:
    """A stream that knows the truth, at 100 Hz, as it arrives."""
    t = np.arange(round(end_s / PERIOD_S)) * PERIOD_S
    ahead = np.array([sea.heave(t + h) for h in HORIZONS_S])
    heave, speed = sea.heave(t + lead_s), sea.speed(t + lead_s)
    return tuple(
        Arrival(
            at + LATENCY_S,
            Update(
                mono_s=at,
                age_s=LATENCY_S,
                quality=Trust(heave=HeaveState.VALID),
                heave_m=float(heave[k]),
                heave_velocity_mps=float(speed[k]),
                compensation_lead_s=lead_s or None,
                forecast=tuple(Ahead(horizon_s=h, heave_m=float(ahead[i, k])) for i, h in enumerate(HORIZONS_S)),
            ),
        )
        for k, at in enumerate(t.tolist())
    )


@cache
def sea_of(name: str) -> Sea:
    return Sea(name)


def run(
    sea: Wave | Sea,
    arrivals: Sequence[Arrival],
    *,
    source: Source = Source.FORECAST,
    pause: tuple[float, float] = (0.0, 0.0),
    reconnect: Sequence[float] = (),
) -> Run:
    """The loop at 100 Hz, each line when it arrives; without a controller during ``pause``."""
    lift = Lift(source)
    ticks = np.arange(1, round(arrivals[-1].at_s / PERIOD_S) + 1) * PERIOD_S
    coming, connections = iter([*arrivals, Arrival(np.inf, arrivals[-1].update)]), list(reconnect)
    following, rows = next(coming), []
    for now in ticks.tolist():
        while following.at_s <= now:
            if connections and following.at_s >= connections[0]:
                lift.compensator.connected()
                connections.pop(0)
            lift.compensator.take(following.update, following.at_s)
            following = next(coming)
        state = lift.winch.advance(now) if pause[0] <= now < pause[1] else lift.tick(now)
        rows.append((state.position_m, state.velocity_mps, state.acceleration_mps2, lift.compensator.authority))
    return Run(ticks, sea.heave(ticks), *np.array(rows).T)


def rms(values: npt.ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def share(result: Run, from_s: float = SETTLED_S) -> float:
    kept = result.t_s >= from_s
    return rms(result.hook[kept]) / rms(result.heave[kept])


# --- the curve -------------------------------------------------------------------------------------------------------


def test_the_curve_is_the_polynomial_through_the_points() -> None:
    polynomial = np.polynomial.Polynomial([0.3, -1.0, 2.0, 0.7, -0.4, 0.05])
    points = [(h, float(polynomial(h))) for h in HORIZONS_S[:6]]
    for at in (0.0, 0.16, 0.5, 1.7):
        expected = [polynomial(at), polynomial.deriv(1)(at), polynomial.deriv(2)(at)]
        assert curve(points, at) == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_far_points_do_not_matter() -> None:
    near = [(h, h**3) for h in HORIZONS_S[:6]]
    assert curve([*near, (30.0, 1e6)], 0.2) == pytest.approx((0.008, 0.12, 1.2), rel=1e-9)


# --- how still the hook is -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["S6", "T3"])
def test_with_a_perfect_forecast_the_winch_leaves_nothing(name: str) -> None:
    """What is left is the polynomial's and the hold of a set-point over 10 ms: below a thousandth."""
    sea = sea_of(name)
    assert share(run(sea, lines(sea, 80.0))) < 1e-3


@pytest.mark.parametrize("name", ["S6", "T3"])
def test_a_stream_shifted_by_the_actuators_delay_serves_as_well(name: str) -> None:
    """Left is what moving by the lag is not of inverting it: (w lag)^2 / 2, 1 % at 4.5 s, less at the peak."""
    sea = sea_of(name)
    assert share(run(sea, lines(sea, 80.0, PERFECT_LEAD_S), source=Source.SHIFTED)) < 0.01


@pytest.mark.parametrize("period_s", [5.0, 9.0])
def test_without_lead_the_hook_keeps_what_the_delay_leaves(period_s: float) -> None:
    """The loop in the frequency domain: trim 1/T and feed-forward of a heave that is D old, through the lag.

    The position that is asked for, p = -h (s + 1/T) / (s (1 + lag s) + 1/T), comes D later, D the dead time, the age of
    a line at its tick (one period here) and half a period of holding.
    """
    sea = Wave(period_s)
    s = 1j * sea.w
    p = -(s + 1.0 / PARAMS.trim_time_s) / (s * (1.0 + s * WINCH.lag_s) + 1.0 / PARAMS.trim_time_s)
    delay_s = WINCH.dead_time_s + PERIOD_S + PERIOD_S / 2.0
    expected = abs(1.0 + p * np.exp(-s * delay_s))
    result = run(sea, lines(sea, 25.0 + 4 * period_s), source=Source.PRESENT)
    assert share(result, 25.0) == pytest.approx(expected, rel=0.03)
    assert expected > 0.1


@pytest.mark.parametrize("drift", [-90e-6, 90e-6], ids=["slow", "fast"])
def test_lines_that_come_late_and_a_clock_of_another_machine_cost_nothing(drift: float) -> None:
    """For two thirds of the time lines are 5 to 150 ms old when read; the daemon's clock is that of another machine."""
    sea = sea_of("S6")
    rng = np.random.default_rng(5)
    late, free_s = [], 0.0
    for number, arrival in enumerate(lines(sea, 80.0)):
        waits_s = rng.uniform(0.0, 0.145) if number % 100 < 67 else 0.0
        free_s = max(free_s, arrival.at_s + waits_s)  # Lines do not overtake one another.
        mono_s = 54_321.0 + arrival.update.mono_s * (1.0 + drift)
        late.append(Arrival(free_s, msgspec.structs.replace(arrival.update, mono_s=mono_s)))
    assert share(run(sea, late)) < 2e-3
    # The age is what is made up for: the same lines, taken for fresh, are worth a tenth less of the heave.
    fresh = [Arrival(a.at_s, msgspec.structs.replace(a.update, mono_s=a.at_s, age_s=0.0)) for a in late]
    assert share(run(sea, fresh)) > 0.05


def test_what_the_published_heave_has_beyond_the_forecasts_is_held() -> None:
    """A correction of 0.2 m, which no forecast has: the rope goes by it, and so 0.2 m beyond the truth."""
    sea = sea_of("S4")
    corrected = [
        Arrival(a.at_s, msgspec.structs.replace(a.update, heave_m=raised(a.update.heave_m, 0.2)))
        for a in lines(sea, 40.0)
    ]
    result = run(sea, corrected)
    settled = result.t_s >= SETTLED_S
    assert result.hook[settled] == pytest.approx(-0.2, abs=1e-3)


def test_it_reads_the_lines_of_the_daemon() -> None:
    frame = MotionFrame(
        t_s=12.5,
        quality=Quality(heave=HeaveState.DEGRADED, laser=LaserState.OFF, correction=CorrectionState.OFF),
        heave_m=0.25,
        heave_velocity_mps=-0.5,
        forecast=(HeaveForecast(horizon_s=0.05, heave_m=0.2), HeaveForecast(horizon_s=0.1)),
    )
    line = encode_motion(frame, seq=1, utc_s=1.7e9, sent_mono_s=12.504)
    assert msgspec.json.decode(line, type=Update) == Update(
        mono_s=12.5,
        age_s=0.004,
        quality=Trust(heave=HeaveState.DEGRADED),
        heave_m=0.25,
        heave_velocity_mps=-0.5,
        forecast=(Ahead(horizon_s=0.05, heave_m=0.2), Ahead(horizon_s=0.1)),
    )


# --- disasters -------------------------------------------------------------------------------------------------------

BEGIN_S, END_S = 30.0, 80.0
Stream = Sequence[Arrival]


def silence(length_s: float) -> Callable[[Stream], Iterator[Arrival]]:
    return lambda stream: (a for a in stream if not BEGIN_S <= a.at_s < BEGIN_S + length_s)


def backlog(length_s: float) -> Callable[[Stream], Iterator[Arrival]]:
    """Nothing, and then all of it at once."""
    return lambda stream: (
        Arrival(BEGIN_S + length_s, a.update) if BEGIN_S <= a.at_s < BEGIN_S + length_s else a for a in stream
    )


def said(length_s: float, **changes: object) -> Callable[[Stream], Iterator[Arrival]]:
    """Lines that are otherwise for a time."""

    def change(stream: Stream) -> Iterator[Arrival]:
        for a in stream:
            during = BEGIN_S <= a.at_s < BEGIN_S + length_s
            yield Arrival(a.at_s, msgspec.structs.replace(a.update, **changes)) if during else a

    return change


def restart(stream: Stream) -> Iterator[Arrival]:
    """Gone for 3 s, back without a heave for 15 s; its clock begins at 0, as after a reboot of its machine."""
    for a in stream:
        if a.at_s < BEGIN_S:
            yield a
        elif a.at_s >= BEGIN_S + 3.0:
            update = msgspec.structs.replace(a.update, mono_s=a.update.mono_s - BEGIN_S)
            blank = {"quality": Trust(heave=HeaveState.SETTLING), "heave_m": None, "forecast": ()}
            yield Arrival(a.at_s, update if a.at_s >= BEGIN_S + 18.0 else msgspec.structs.replace(update, **blank))


def flicker(stream: Stream) -> Iterator[Arrival]:
    """Invalid every other fifth of a second."""
    for a in stream:
        off = BEGIN_S <= a.at_s < BEGIN_S + 10.0 and int(5.0 * a.at_s) % 2 == 0
        invalid = msgspec.structs.replace(a.update, quality=Trust(heave=HeaveState.INVALID))
        yield Arrival(a.at_s, invalid) if off else a


def leap(offset_m: float) -> Callable[[Stream], Iterator[Arrival]]:
    """An estimator that starts over: all at once it says another heave, and later the true one again."""

    def change(stream: Stream) -> Iterator[Arrival]:
        for a in stream:
            off = offset_m if BEGIN_S <= a.at_s < BEGIN_S + 10.0 else 0.0
            ahead = tuple(Ahead(horizon_s=f.horizon_s, heave_m=raised(f.heave_m, off)) for f in a.update.forecast)
            yield Arrival(
                a.at_s, msgspec.structs.replace(a.update, heave_m=raised(a.update.heave_m, off), forecast=ahead)
            )

    return change


INVALID = {"quality": Trust(heave=HeaveState.INVALID), "heave_m": None, "heave_velocity_mps": None, "forecast": ()}
DISASTERS = {
    "nothing for 0.3 s": silence(0.3),
    "nothing for 2 s": silence(2.0),
    "nothing for 15 s": silence(15.0),
    "2 s late, then all at once": backlog(2.0),
    "10 s late, then all at once": backlog(10.0),
    "the daemon restarts": restart,
    "invalid for 5 s": said(5.0, **INVALID),
    "invalid for one line": said(PERIOD_S, **INVALID),
    "invalid on and off": flicker,
    "settling for 5 s": said(5.0, quality=Trust(heave=HeaveState.SETTLING)),
    "no forecast for 5 s": said(5.0, forecast=()),
    "the estimate leaps by 1.5 m": leap(1.5),
}
FADE_S = 1.5
"""At least; the steepest slope of the fade is 1.5 over this."""
REACTS_WITHIN_S = PARAMS.stale_s + PARAMS.fade_out_s + WINCH.dead_time_s + 5.0 * WINCH.lag_s


@pytest.mark.parametrize("source", [Source.FORECAST, Source.SHIFTED], ids=lambda source: source.value)
@pytest.mark.parametrize("disaster", DISASTERS)
def test_the_hook_does_not_jump(disaster: str, source: Source) -> None:
    if source is Source.SHIFTED and "forecast" in disaster:
        pytest.skip("it needs none")
    sea = sea_of("S4")  # Gentle enough for the bounds to be well within what the winch could do.
    stream = lines(sea, END_S, PERFECT_LEAD_S if source is Source.SHIFTED else 0.0)
    reconnect = (BEGIN_S + 3.0,) if DISASTERS[disaster] is restart else ()
    result = run(sea, list(DISASTERS[disaster](stream)), source=source, reconnect=reconnect)
    speed, acceleration = sea.speed(result.t_s), np.gradient(sea.speed(result.t_s), PERIOD_S)
    fastest, hardest = np.max(np.abs(speed)), np.max(np.abs(acceleration))
    # Never faster than a hook that is not compensated at all, but for what works off a wrong position.
    assert np.max(np.abs(speed + result.rope_speed)) < fastest + PARAMS.trim_speed_mps
    # Never rougher than to follow the sea and to fade meanwhile; a leap is worked off by a step of the trim's speed.
    leaps_mps = PARAMS.trim_speed_mps if "leaps" in disaster else 0.0
    rough = hardest + 1.5 * (fastest + PARAMS.trim_speed_mps) / FADE_S + leaps_mps / WINCH.lag_s
    assert np.max(np.abs(result.rope_acceleration)) < rough
    # And in the end as still as before.
    recovered = result.t_s > END_S - 10.0
    assert rms(result.hook[recovered]) < 0.02 * rms(result.heave[recovered])
    before = (result.t_s > SETTLED_S) & (result.t_s < BEGIN_S)
    assert rms(result.hook[before]) < 0.02 * rms(result.heave[before])


@pytest.mark.parametrize("disaster", ["nothing for 15 s", "the daemon restarts", "invalid for 5 s", "settling for 5 s"])
def test_the_rope_rests_while_there_is_nothing_to_go_by(disaster: str) -> None:
    sea = sea_of("S5")
    stream = list(DISASTERS[disaster](lines(sea, BEGIN_S + 20.0)))
    result = run(sea, stream, reconnect=(BEGIN_S + 3.0,) if DISASTERS[disaster] is restart else ())
    rests = (result.t_s > BEGIN_S + REACTS_WITHIN_S) & (result.t_s < BEGIN_S + 5.0)
    assert np.any(rests)
    assert np.max(np.abs(result.rope_speed[rests])) < 0.01
    assert np.all(result.authority[rests] == 0.0)


def test_what_is_short_is_bridged_by_the_forecast() -> None:
    sea = sea_of("S5")
    result = run(sea, list(silence(0.3)(lines(sea, BEGIN_S + 5.0))))
    assert np.max(np.abs(result.hook[result.t_s > BEGIN_S])) < 0.01 * np.max(np.abs(result.heave))


def test_a_controller_that_stops_leaves_a_rope_at_rest_and_begins_again_gently() -> None:
    sea = sea_of("S4")
    end_s = BEGIN_S + 5.0
    result = run(sea, lines(sea, END_S), pause=(BEGIN_S, end_s))
    rests = (result.t_s > BEGIN_S + WINCH.watchdog_s + WINCH.dead_time_s + 1.0) & (result.t_s < end_s)
    assert np.max(np.abs(result.rope_speed[rests])) < 0.01
    speed, acceleration = sea.speed(result.t_s), np.gradient(sea.speed(result.t_s), PERIOD_S)
    fastest = np.max(np.abs(speed)) + PARAMS.trim_speed_mps
    assert np.max(np.abs(speed + result.rope_speed)) < fastest
    again = result.t_s > end_s
    assert np.max(np.diff(result.authority[again])) < 1.6 * PERIOD_S / PARAMS.fade_in_s
    assert result.authority[again][0] < 0.01
    assert np.max(np.abs(result.rope_acceleration[again])) < np.max(np.abs(acceleration)) + 1.5 * fastest / FADE_S
    assert share(result, END_S - 10.0) < 0.01


def test_a_heave_that_is_never_usable_moves_nothing() -> None:
    sea = sea_of("S6")
    stream = [Arrival(a.at_s, msgspec.structs.replace(a.update, **INVALID)) for a in lines(sea, 10.0)]
    result = run(sea, stream)
    assert not np.any(result.rope)
    assert not np.any(result.authority)


# --- what is said of it ----------------------------------------------------------------------------------------------


def noted(motion: HookMotion, start_s: float, end_s: float, heave_m: float, hook_m: float, authority: float) -> None:
    """Sinusoids of whole periods: their RMS is their amplitude over the root of two."""
    for t in np.arange(round(start_s * 10), round(end_s * 10)) / 10:
        sine = np.sin(2.0 * np.pi * t / 5.0)
        motion.note(float(t), float(heave_m * sine), float(hook_m * sine), authority)


def test_the_line_says_what_the_last_minute_was() -> None:
    motion = HookMotion()
    assert motion.news() == "hook motion: settling"
    noted(motion, 0.0, 30.0, 2.0, 2.0, 0.0)
    assert motion.news() is None
    noted(motion, 30.0, 35.0, 2.0, 1.0, 0.5)
    noted(motion, 35.0, 45.0, 2.0, 1.0, 1.0)  # The rope is still on its way.
    assert motion.news() is None
    noted(motion, 45.0, 65.1, 2.0, 0.1, 1.0)
    assert motion.news() == "hook motion, last 20 s: 1.41 m uncompensated, 0.07 m compensated (5.0 %)"
    noted(motion, 65.1, 130.0, 0.04, 0.001, 1.0)
    assert motion.news() == "hook motion, last 60 s: 0.0283 m uncompensated, 0.0007 m compensated (2.5 %)"
    noted(motion, 130.0, 131.0, 2.0, 2.0, 0.4)
    assert motion.news() == "hook motion: the heave cannot be used, the winch holds"
    assert motion.news() is None


def test_of_a_still_sea_it_gives_no_percentage() -> None:
    motion = HookMotion()
    noted(motion, 0.0, 40.0, 0.0, 0.0, 1.0)
    assert motion.news() == "hook motion, last 30 s: 0.0000 m uncompensated, 0.0000 m compensated"

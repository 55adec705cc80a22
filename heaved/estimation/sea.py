"""The sea observer, the default: heave straight from the vertical acceleration, by a model of the sea's spectrum.

Same idea as the harmonic observer (the spectrum of the recent past keeps updating the transition matrix, F^m moves the
estimate in time) with three changes: the model is a spectrum instead of a few lines (:mod:`sea_model`), the
measurement is the acceleration itself, so that no integrator can drift, and what the model leaves open is known, so
that every number has a standard deviation. Fitting is done beside the event loop (:mod:`sea_window`):
:meth:`SeaObserver.due` hands out the past, :meth:`SeaObserver.accept` takes what came of it and changes over without a
jump.

Samples are averaged into *beats* of about 50 ms, far below the waves: the filter runs once per beat, whatever the rate
of the sensor, and every sample gets its own output, moved from the last beat.
"""

from __future__ import annotations

from collections import Counter
from math import exp, hypot, inf, isfinite, nan, pi, sqrt
from typing import Annotated, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.beat import BEAT_MIN_S, BEAT_S, Beat
from heaved.estimation.outlook import Outlook, at_index
from heaved.estimation.ring import Ring
from heaved.estimation.sea_filter import Offset, SeaFilter
from heaved.estimation.sea_model import SeaModel, SeaSystem, Steady, heave_std, measurement_variance
from heaved.estimation.sea_window import Candidate, SeaFit, SeaWindow
from heaved.estimation.smoother import Divergence, FixedLagSmoother
from heaved.samples import DelayedHeave, SeaState

Array = NDArray[np.float64]

STALE_BEAT_S: Final = 1.0
"""Samples that come without a beat for this long are not in the heave any more."""
EARLY_EVERY_S: Final = 10.0
"""Between fits, until EARLY_S of record: each sees much more than the one before."""
EARLY_S: Final = 120.0
CHANGED: Final = 3.0
"""Whiteness of the innovations above which the sea is changing: the next fit comes sooner."""
CHANGED_NOW: Final = 9.0
"""The same in the last seconds, which are fewer."""
SPLICE_S: Final = 1.5
"""Time constant with which the difference between old and new model is faded out."""
STILL_LIKELIHOOD: Final = 15.0
"""Waves must make the record that much likelier than noise alone (nine parameters give half of it by chance)."""
STILL_SHARE: Final = 0.5
"""Nor is it a sea when the error of the heave is that share of the heave itself."""
OVERCONFIDENCE: Final = 1.12
"""Published over modelled standard deviation: the fitted spectrum is an estimate too (see tools/accuracy.py heave)."""
SCALE_LIMIT: Final = 10.0
NEEDED_S: Final = 60.0
DIVERGED: Final = 2.5
"""RMS difference from the delayed heave, over the modelled standard deviation, from which the output is in doubt; the
published standard deviation has grown with it by then."""
AIDING_LATE_S: Final = 1.0
"""An aiding laser that comes later than this is not worth the process noise that it would miss."""
AIDING_WALK_M2PS: Final = (0.01**2) / 60.0
"""How the constant of a laser wanders: a centimetre in a minute (tide, a target that gives way)."""
NO_OFFSET: Final = (0.0, 0.0, 0.0)
SMALL_M: Final = 0.01
"""Differences below this are well whatever the sea."""
LONGEST_PEAK_S: Final = 28.0
"""Longer waves than this are not told from the drift of the sensor."""
CUT_BEATS: Final = 4
"""Beats left out of the record where it is cut: a hole for whoever fits it."""
CONVERGED: Final = 1.5
"""The covariance has converged when the error of the heave is within this factor of that of the steady filter."""


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[heave.sea]``: the sea observer."""

    stages: Annotated[int, msgspec.Meta(ge=3, le=12)] = 7
    """Resonators in a chain (M): the steeper the spectrum towards long waves, the more."""
    components: Annotated[int, msgspec.Meta(ge=1, le=4)] = 2
    """Chains (K)."""
    windows_s: tuple[Annotated[float, msgspec.Meta(ge=60, le=1800)], ...] = (120.0, 300.0, 600.0)
    """Lengths of the past that are fitted side by side."""
    first_fit_s: Annotated[float, msgspec.Meta(ge=30, le=300)] = 40.0
    """Seconds of samples before the first fit, and the first heave."""
    refresh_s: Annotated[float, msgspec.Meta(ge=5, le=300)] = 30.0
    """Interval of the fits."""
    bias_walk_mps2_rts: Annotated[float, msgspec.Meta(gt=0, le=1)] = 3e-5
    """Random walk of the accelerometer's bias, m/s2 per root second (data sheet: bias instability)."""
    delay_s: Annotated[float, msgspec.Meta(ge=10, le=300)] = 60.0
    """Age of the delayed heave."""
    max_gap_s: Annotated[float, msgspec.Meta(gt=0, le=600)] = 60.0
    """After a longer gap the past is forgotten; the model stays until there is a new one."""


class Motion(msgspec.Struct, frozen=True, gc=False):
    """Heave at one moment."""

    heave_m: float
    velocity_mps: float


class SeaObserver:
    """Feed it vertical acceleration in order of time; ask it for heave at any moment near the last one.

    Attributes:
        t_s: time of the last sample.
        resets: by reason.
        sea: the newest sea state, or None.
        delayed: the newest delayed heave, or None.
    """

    design_lead_s: Final = 0.0
    """There is no integrator whose phase had to be undone."""

    def __init__(self, params: Params, horizons_s: tuple[float, ...], lead_s: float = 0.0) -> None:
        """``horizons_s``: of the forecasts. ``lead_s``: what :meth:`at` is mostly asked for, after the last sample."""
        self._params = params
        self._horizons_s, self._lead_s = horizons_s, lead_s
        longest = max(params.windows_s)
        self._record = Ring(int(longest / BEAT_MIN_S), 2)
        self._said = Ring(int((params.delay_s + 5.0) / BEAT_MIN_S), 3)
        self.resets: Counter[str] = Counter()
        self._number = 0
        self._filter: SeaFilter | None = None
        self._unaided: SeaFilter | None = None
        """The same without the laser, when that is aiding: the smoother's weights are those without it."""
        self._candidates: tuple[Candidate, ...] = ()
        self._beat = Beat()
        self._start_over()

    def _start_over(self) -> None:
        """Forget the past; a model that is there stays in use, with a state that knows nothing but its spectrum."""
        self.t_s = nan
        self.acceleration_mps2 = nan
        self._beat = Beat(self._beat.period_s)
        self._cut = 0
        self._record.clear()
        self._said.clear()
        self._looked_s = self._asked_s = self._started_s = nan
        self.refreshes = 0
        self.sea: SeaState | None = None
        self.delayed: DelayedHeave | None = None
        self.divergence = Divergence()
        self._smoother: FixedLagSmoother | None = None
        self._whiteness, self._waves, self._is_still = 1.0, inf, False
        self._offset, self._spliced_s = NO_OFFSET, -inf
        self._aided_s, self._unaided = nan, None
        self._number += 1
        self._pending_number = -1
        if self._filter is not None:
            kept = self._filter
            self._install(kept.system, kept.steady, nan, np.zeros(len(kept.x)), kept.system.stationary.copy())

    # --- input -------------------------------------------------------------------------------------------------------

    def step(self, t_s: float, a_up_mps2: float) -> None:
        """Take the vertical acceleration at ``t_s`` (later than the last one; nan: missing, nothing happens)."""
        if not isfinite(a_up_mps2):
            return
        if t_s - self.t_s > self._params.max_gap_s:
            self._reset("gap")
        if not isfinite(self._started_s):
            self._started_s = self._asked_s = t_s
        self.t_s = t_s
        bias = float(self._filter.x[-1]) if self._filter is not None else nan
        self.acceleration_mps2 = a_up_mps2 - bias
        beat = self._beat.take(t_s, a_up_mps2)
        if beat is not None:
            self._take(*beat)

    def _take(self, t_s: float, a_mps2: float) -> None:
        """One beat: stored for the fits, and through the filter."""
        newest = self._record.last(1)
        if len(newest) and t_s <= newest[0, 0]:
            return
        if self._filter is None:
            self._store(t_s, a_mps2)
            return
        if not isfinite(self._filter.t_s):
            self._filter.t_s = t_s - self._filter.steady.dt_s
        missed = t_s - self._filter.t_s - self._filter.steady.dt_s
        rejected = self._filter.rejected
        predicted_m, innovation = self._filter.step(t_s, a_mps2)
        if self._filter.rejected == rejected:
            self._store(t_s, a_mps2)
        if self._unaided is not None:
            predicted_m, innovation = self._unaided.step(t_s, a_mps2)
        if not self._filter.is_sound():
            self._filter = None
            self._reset("not finite")
            return
        self._moved()
        if self._smoother is not None:
            self._smooth(t_s, missed, predicted_m, innovation)

    def aid(self, t_s: float, laser_m: float, std_m: float) -> None:
        """Take a laser as a measurement of the heave at ``t_s``, its sign applied; its constant is estimated too."""
        if self._filter is None or not isfinite(self._filter.t_s) or not self.is_settled:
            return
        tau_s = t_s - self._filter.t_s
        if abs(tau_s) > AIDING_LATE_S:
            return
        elapsed = min(t_s - self._aided_s, 60.0) if isfinite(self._aided_s) else 0.0
        self._aided_s = t_s
        row = self._outlook.derivatives((tau_s,))[0, 0]
        if self._unaided is None:
            f = self._filter
            self._unaided = SeaFilter(f.system, f.steady, f.t_s, f.x, None if f.P is None else f.P.copy())
        self._filter.aid(row, laser_m, std_m**2, AIDING_WALK_M2PS * max(elapsed, 0.0))
        self._moved()

    @property
    def is_settled(self) -> bool:
        """Whether the covariance says what is known, so that a laser may be weighed against it."""
        return self.settled_s >= NEEDED_S

    def _store(self, t_s: float, a_mps2: float) -> None:
        """For the fits. What the gate has kept out is missing there too: half a second of it would spoil minutes."""
        if self._cut > 0:
            self._cut -= 1
        else:
            self._record.push((t_s, a_mps2))

    def cut(self) -> None:
        """What comes is measured otherwise than what was: no spectrum is taken across."""
        self._cut = CUT_BEATS

    def _smooth(self, t_s: float, missed_s: float, predicted_m: float, innovation: float) -> None:
        assert self._filter is not None
        assert self._smoother is not None
        dt = self._filter.steady.dt_s
        for i in range(min(round(missed_s / dt), 1000), 0, -1):
            self._smoother.push(t_s - i * dt, nan, 0.0)
        # The weights are those of the steady filter: what an unsure one predicted has no place among them.
        self._smoother.push(t_s, predicted_m if self.is_converged else nan, innovation)
        said_m = float(self._filter.system.heave.dot(self._filter.x)) + self._offset_at(t_s)[0]
        self._said.push((t_s, said_m, at_index(self._stds, self._outlook.index(0.0))))
        delayed = self._smoother.value()
        if delayed is not None and (self.delayed is None or delayed.t_s > self.delayed.t_s):
            self.delayed = delayed
            then = self._said.interpolate(delayed.t_s)
            self.divergence.compare(delayed, float(then[1]), float(then[2]))

    def _reset(self, reason: str) -> None:
        self.resets[reason] += 1
        self._start_over()

    # --- fits --------------------------------------------------------------------------------------------------------

    def due(self) -> SeaWindow | None:
        """The past, when it is time for another look at it; each is given out once."""
        p = self._params
        seconds = self.settled_s
        if not seconds >= p.first_fit_s:
            return None
        early = seconds < EARLY_S or self.surprise > CHANGED
        every = min(EARLY_EVERY_S, p.refresh_s) if early else p.refresh_s
        if self._asked_s > self._started_s and self.t_s - self._asked_s < every:
            return None
        self._asked_s = self.t_s
        self._number += 1
        self._pending_number = self._number
        rows = self._record.since(self.t_s - max(p.windows_s))
        return SeaWindow(
            number=self._number,
            t_s=np.ascontiguousarray(rows[:, 0]).tobytes(),
            a_mps2=np.ascontiguousarray(rows[:, 1]).tobytes(),
            stages=p.stages,
            components=p.components,
            windows_s=p.windows_s,
            bias_walk_psd=p.bias_walk_mps2_rts**2,
            delay_s=p.delay_s,
            looked_s=self._looked_s,
            candidates=self._candidates,
        )

    def accept(self, fit: SeaFit) -> str:
        """Change over to what was fitted: "accepted", "rejected" (a late answer) or "failed"."""
        if fit.message or fit.model is None:
            return "failed"
        if fit.number != self._pending_number:
            return "rejected"
        self._pending_number = -1
        system = SeaSystem(fit.model)
        n = len(system.H)
        steady = _steady(system, fit.dt_s, np.frombuffer(fit.steady_P).reshape(n, n))
        before = self.at(0.0) if self._filter is not None else None
        before_std_m = at_index(self._stds, self._outlook.index(0.0)) if self._filter is not None else nan
        P = np.frombuffer(fit.P).reshape(n, n).copy() if fit.P else None
        aided = self._filter.offset if self._filter is not None else None
        self._install(system, steady, fit.t_s, np.frombuffer(fit.x).copy(), P)
        if aided is not None:
            # What the laser taught is in the old model's state; its constant stays, and brings the new state back.
            self._filter_in_use().offset = Offset(aided.value_m, aided.variance_m2, n)
            self._filter_in_use().P = self._filter_in_use().covariance.copy()
            unaided_P = None if P is None else P.copy()
            self._unaided = SeaFilter(system, steady, fit.t_s, np.frombuffer(fit.x).copy(), unaided_P)
        self._candidates, self._looked_s = fit.candidates, fit.t_s
        self._whiteness, self._waves = fit.whiteness, fit.waves
        self._is_still = self._sees_no_waves()
        self.refreshes += 1
        self._smoother = FixedLagSmoother(system, steady, self._params.delay_s)
        self._smoother.fill(fit.t_s, np.frombuffer(fit.predicted_m), np.frombuffer(fit.innovation))
        self._catch_up(fit.t_s)
        self._offset, self._spliced_s = NO_OFFSET, -inf
        if aided is not None and before is not None:
            # The laser's knowledge of the heave itself comes over; the rest of the state it teaches again.
            row = self._outlook.derivatives((self.t_s - self._filter_in_use().t_s,))[0, 0]
            self._filter_in_use().aid(row, before.heave_m + aided.value_m, before_std_m**2, 0.0)
            self._moved()
        if before is not None and isfinite(before.heave_m):
            after = self.at(0.0)
            self._offset = (before.heave_m - after.heave_m, before.velocity_mps - after.velocity_mps, self.t_s)
            self._spliced_s = self.t_s + 12.0 * SPLICE_S
        if fit.sea is not None:
            self.sea = msgspec.structs.replace(
                fit.sea,
                t_s=fit.t_s,
                window_s=min(fit.window_s, fit.record_s),
                model=f"{len(fit.model.damping)} chains of {fit.model.stages} resonators",
                is_still=self._is_still,
            )
        return "accepted"

    def _catch_up(self, from_s: float) -> None:
        """Through the beats that came while the fit was under way."""
        assert self._filter is not None
        assert self._smoother is not None
        for t_s, a_mps2 in self._record.since(from_s).tolist():
            if t_s > self._filter.t_s:
                said = self._filter.step(t_s, a_mps2)
                self._smoother.push(t_s, *(said if self._unaided is None else self._unaided.step(t_s, a_mps2)))
        self._moved()

    def _filter_in_use(self) -> SeaFilter:
        assert self._filter is not None
        return self._filter

    def _install(self, system: SeaSystem, steady: Steady, t_s: float, x: Array, P: Array | None) -> None:
        rejected = 0 if self._filter is None else self._filter.rejected
        self._filter = SeaFilter(system, steady, t_s, x, P)
        self._filter.rejected = rejected
        self._heave_std_m = sqrt(float(system.heave @ system.stationary @ system.heave))
        self._outlook = Outlook(system, max((*self._horizons_s, self._lead_s, 0.0)) + 3.0)
        self._omega = sqrt(float(system.velocity @ system.stationary @ system.velocity)) / self._heave_std_m
        self._plain = self._outlook.derivatives((0.0,))[0]
        self._learned_s = nan
        self._usual: dict[float, int] = {}
        self._stds = self._steady_stds = self._outlook.stds(SeaFilter(system, steady, t_s, x, None).covariance)
        self._moved()

    def _moved(self) -> None:
        """The state has changed: what is derived from it."""
        self._values: list[list[float]] | None = None
        self._modelled: dict[float, float] = {}
        assert self._filter is not None
        self._stds = self._steady_stds if self._filter.is_steady else self._outlook.stds(self._filter.covariance)

    # --- output ------------------------------------------------------------------------------------------------------

    def at(self, shift_s: float, learned_lead_s: float = 0.0) -> Motion:
        """Heave ``shift_s`` after the last sample, X* = F^m X; ``learned_lead_s``: how early the sensor is.

        nan before the first fit.
        """
        return self.outlook((shift_s,), learned_lead_s)[0]

    def outlook(self, shifts_s: tuple[float, ...], learned_lead_s: float = 0.0) -> list[Motion]:
        """:meth:`at` for several moments at once; cheap for zero, the lead and the horizons of the constructor."""
        if self._filter is None or not isfinite(self._filter.t_s):
            return [Motion(nan, nan) for _ in shifts_s]
        if learned_lead_s != self._learned_s:
            usual = (0.0, self._lead_s, *self._horizons_s)
            self._usual = {shift: i for i, shift in enumerate(usual)}
            self._rows = self._outlook.derivatives([shift - learned_lead_s for shift in usual])
            self._learned_s, self._values = learned_lead_s, None
        if self._values is None:
            self._values = (self._rows @ self._filter.x).tolist()
        values, usual_places, late = self._values, self._usual, self.t_s - self._filter.t_s
        if late > STALE_BEAT_S:
            return [Motion(nan, nan) for _ in shifts_s]
        motions = []
        for shift in shifts_s:
            place = usual_places.get(shift)
            if place is not None:
                motion = _along(values[place], late)
            else:
                rows = self._outlook.derivatives([shift - learned_lead_s])[0]
                motion = _along((rows @ self._filter.x).tolist(), late)
            if self.t_s < self._spliced_s:
                offset, drift = self._offset_at(self.t_s + shift)
                motion = Motion(motion.heave_m + offset, motion.velocity_mps + drift)
            motions.append(motion)
        return motions

    def unshifted(self) -> Motion:
        """What the laser is compared with: nothing learned taken out."""
        if self._filter is None or not isfinite(self._filter.t_s):
            return Motion(nan, nan)
        return _along((self._plain @ self._filter.x).tolist(), self.t_s - self._filter.t_s)

    def error_std_m(self, shift_s: float, scale: float = 1.0) -> float:
        """Standard deviation of the error of :meth:`at`; nan before the first fit.

        From the covariance of the filter, times what recent innovations and the delayed heave have shown, times
        ``scale``: what the laser has shown.
        """
        if self._filter is None or not isfinite(self._filter.t_s):
            return nan
        if self.t_s - self._filter.t_s > STALE_BEAT_S:
            return nan
        modelled = self._modelled.get(shift_s)
        if modelled is None:
            learned = self._learned_s if isfinite(self._learned_s) else 0.0
            tau_s = shift_s + self.t_s - self._filter.t_s - learned
            modelled = at_index(self._stds, self._outlook.index(tau_s)) * self._own_scale()
            if shift_s in self._usual:
                self._modelled[shift_s] = modelled  # Until the next beat: it changes less within one than it is known.
        if self.t_s < self._spliced_s:
            modelled = hypot(modelled, self._offset_at(self.t_s + shift_s)[0])
        return modelled * scale

    def _own_scale(self) -> float:
        shown = max(1.0, sqrt(0.5 * self.surprise), self.divergence.ratio)
        return OVERCONFIDENCE * min(shown, SCALE_LIMIT)

    def _offset_at(self, t_s: float) -> tuple[float, float]:
        """What is left at ``t_s`` of the difference between the old model and the new: heave and velocity."""
        heave, velocity, since_s = self._offset
        if not t_s < self._spliced_s:
            return 0.0, 0.0
        elapsed = max(t_s - since_s, 0.0)
        fade, slope = exp(-elapsed / SPLICE_S), velocity + heave / SPLICE_S
        return (heave + slope * elapsed) * fade, (slope - (heave + slope * elapsed) / SPLICE_S) * fade

    # --- what it knows of the sea ------------------------------------------------------------------------------------

    def heave_std_m(self) -> float:
        """Standard deviation of the heave of the fitted sea; nan before the first fit."""
        return self._heave_std_m if self._filter is not None else nan

    @property
    def omega_radps(self) -> float:
        """Mean frequency of the heave: standard deviation of its velocity over that of itself."""
        return self._omega if self._filter is not None else 2.0 * pi / 8.0

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Centre frequencies of the chains."""
        return self._filter.system.model.frequency_hz if self._filter is not None else ()

    @property
    def settled_s(self) -> float:
        """Seconds of record since the start or the last reset; nan before the first sample."""
        return self.t_s - self._started_s

    @property
    def is_converged(self) -> bool:
        """Whether the covariance of the heave is near what it will be."""
        if self._filter is None or self._filter.is_steady:
            return self._filter is not None
        place = self._outlook.index(0.0)
        return at_index(self._stds, place) < CONVERGED * at_index(self._steady_stds, place)

    def _sees_no_waves(self) -> bool:
        error_m = at_index(self._steady_stds, self._outlook.index(0.0))
        return self._waves < STILL_LIKELIHOOD or error_m > STILL_SHARE * self._heave_std_m

    @property
    def surprise(self) -> float:
        """Variance of the averaged innovations over the model's, at the last fit or in the last seconds."""
        return max(self._whiteness, self._filter.surprise if self._filter is not None else 1.0)

    needed_s: Final = NEEDED_S
    """Seconds of record from which it counts as settled."""

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is held against the output, for people."""
        found = []
        if self._filter is not None and not self.is_converged and self.settled_s > NEEDED_S:
            found.append("recovering from a gap")
        if self._whiteness > CHANGED or self.surprise > CHANGED_NOW:
            found.append("the sea or the sensor is changing")
        if self.divergence.ratio > DIVERGED and self.divergence.rms_m > SMALL_M:
            found.append(f"{self.divergence.ratio:.1f} times its standard deviation off the delayed heave")
        if self.sea is not None and not self.sea.is_still and self.sea.peak_period_s > LONGEST_PEAK_S:
            found.append(f"swell of {self.sea.peak_period_s:.0f} s: longer than the sensor can follow")
        return tuple(found)

    @property
    def notes(self) -> tuple[str, ...]:
        """What people should know, and no reason to trust the output less."""
        return ("still: no motion above the noise of the sensor",) if self._is_still else ()

    @property
    def rejected(self) -> int:
        """Samples that the gate has kept out, since the start or the last reset."""
        return self._filter.rejected if self._filter is not None else 0

    # --- memory ------------------------------------------------------------------------------------------------------

    @property
    def model(self) -> SeaModel | None:
        """The model in use, for a restart to begin with."""
        return self._filter.system.model if self._filter is not None else None

    def restore(self, model: SeaModel, dt_s: float = BEAT_S) -> None:
        """Begin with the model of an earlier run; call before the first sample.

        Raises:
            ValueError: it is no model of this configuration, or its filter does not converge.
        """
        p = self._params
        if model.stages != p.stages or not 0 < len(model.damping) <= p.components:
            found = f"{len(model.damping)} chains of {model.stages}"
            raise ValueError(f"saved sea of {found} does not fit the configured {p.components} of {p.stages}")
        system = SeaSystem(model)
        steady = system.steady(dt_s) if isfinite(heave_std(model)) else None
        if steady is None:
            raise ValueError("the filter of the saved sea does not converge")
        self._install(system, steady, nan, np.zeros(len(system.H)), system.stationary.copy())


def _along(series: list[float], d: float) -> Motion:
    """Heave and velocity ``d`` seconds on, from heave and its derivatives over factorials."""
    c0, c1, c2, c3, c4, c5 = series
    heave = ((((c5 * d + c4) * d + c3) * d + c2) * d + c1) * d + c0
    return Motion(heave, (((5.0 * c5 * d + 4.0 * c4) * d + 3.0 * c3) * d + 2.0 * c2) * d + c1)


def _steady(system: SeaSystem, dt_s: float, P: Array) -> Steady:
    """The steady filter from its covariance before a sample."""
    F, Q = system.transition(dt_s)
    PH = P @ system.H
    S = float(system.H @ PH) + measurement_variance(system.model.noise_psd, dt_s)
    return Steady(dt_s=dt_s, F=F, Q=Q, P=P, K=PH / S, S=S)

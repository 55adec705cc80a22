"""Hull deformation between two IMUs, one amidships and one at the crane base, from their angular rates alone.

Source: Xu, Wang & Shan 2017 (hull deformation by CKF); its method is ``ckf`` and ``ukf`` (``euler``), ours ``so3``.
Around the filter, the same for all of them: what is slow in either rate, free of vibration, spikes and holes
(``slow_motion``); an alignment that finds the rotation and the delay from the first seconds, a record, and from it a
fit of the flexure (``markov``) with which the record is gone through again. Until then the flexure is taken to be
broad, which costs little accuracy and no consistency.

What rates cannot tell: a deformation that is coherent with the waves on one common period is the same as a static
misalignment, and an IMU pair that is swapped is the same as one mounted the other way round. The first is covered by
``coherent_floor_arcsec`` in the published deviations, the second is named when the mounting is configured.

Frames: both IMUs right-handed, the one amidships x forward, y port, z up. C takes midships components to local ones,
C = R3(z) R2(y) R1(x), passive. Standard deviations are about the hull's axes x, y, z, hence defined at any mounting.
"""

from __future__ import annotations

from collections import Counter
from copy import copy
from math import floor, inf, isfinite, isnan, nan, pi, radians, sqrt
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.common.rotations import ARCSEC, to_euler
from heaved.estimation.hull.consistency import Consistency
from heaved.estimation.hull.estimate import HullEstimate, HullState, Method, Params, ResetReason, Start
from heaved.estimation.hull.markov import Flexure
from heaved.estimation.hull.refit import (
    Filter,
    RefitJob,
    RefitResult,
    about_two_axes,
    advance,
    align_record,
    first_filter,
    make_filter,
    refit,
    run,
)
from heaved.estimation.hull.remembered import SavedHull, Trial, saved, three
from heaved.estimation.hull.slow_motion import COLUMNS, SlowMotion, SlowPair, SlowReading
from heaved.estimation.hull.so3 import Noise, So3Filter
from heaved.estimation.hull.streams import RateCheck, RatePair, Stream, TwoStreams
from heaved.estimation.hull.tuning import TUNING
from heaved.samples import HullAngles

Array = NDArray[np.float64]

DEG_H: Final = pi / 180.0 / 3600.0
"""One degree per hour, rad/s."""
DEG_RTH: Final = pi / 180.0 / 60.0
"""One degree per root hour, rad per root second."""


class HullDeformation:
    """Takes pairs of rates on one time base (``step``), or the IMUs as they come (``push_midships``, ``push_local``).

    The refit of the flexure takes a few tenths of a second. ``refit_inline``: :meth:`step` does it where it is due,
    which keeps a replay deterministic. Otherwise :attr:`due_refit` holds the job until :meth:`accept` is given the
    result of ``refit`` on it, from whatever process.
    """

    def __init__(self, params: Params | None = None, refit_inline: bool = True) -> None:
        """
        Raises:
            ValueError: ``start = "zero"`` with so3, which has no use for it.
        """
        self._params = p = params or Params()
        if p.start == Start.ZERO and p.method == Method.SO3:
            raise ValueError('hull: start = "zero" is for ckf and ukf; so3 needs an alignment')
        self._refit_inline = refit_inline
        self._prior = Flexure(
            np.full(3, p.flexure_std_arcsec * ARCSEC),
            np.full(3, p.flexure_mu_radps),
            np.full(3, 2.0 * pi * p.flexure_hz),
        )
        self._streams = TwoStreams(p.rate_hz)
        self._checks = (RateCheck(), RateCheck())
        self._consistency = Consistency(p)
        self.resets: Counter[ResetReason] = Counter()
        self.latest: HullEstimate | None = None
        self._t_s = self._published_s = -inf
        self._generation = 0
        self._remembered: SavedHull | None = None
        """Of an earlier run, while it is neither confirmed nor refuted,"""
        self._remembered_age_s = 0.0
        """and how old it was"""
        self._heard_s = nan
        """with the first pair."""
        self._take_rate(p.rate_hz)

    def _take_rate(self, rate_hz: float) -> None:
        """Pairs come at this rate: begin."""
        p, self._rate_hz = self._params, rate_hz
        record_s = max(p.refit_after_s, TUNING.forecast_window_s) + 2.0 * TUNING.longest_start_s
        self._ring = RingBuffer(int(record_s * rate_hz), 9)
        self._out_hz = self._new_pair().out_hz
        self._least_noise = sqrt(2.0 * self._out_hz) * p.gyro_noise_deg_rth * DEG_RTH
        self._slow = RingBuffer(int(TUNING.forecast_window_s * self._out_hz), 4)
        """Slow rates midships."""
        self._start_over()

    def _start_over(self) -> None:
        self._filter: Filter | None = None
        self._trial: Trial | None = None
        """The filter that begins with what is remembered; :attr:`_filter` knows nothing of it."""
        self._provisional = True
        self._pair, self._learned = self._new_pair(), False
        self._slow.clear()
        self._noise = self._noise_of(np.full(3, self._least_noise))
        self._flexure = self._prior
        self._record_s = self._began_s = self._filtered_s = nan
        self._whole = True
        self._next_try_s = TUNING.first_try_s
        self._first_s = nan
        self._updated_s = nan
        self._refit_s = nan
        self._refits = 0
        self.due_refit: RefitJob | None = None
        self._forecast_s = -inf
        self._consistency.reset()

    def _reset(self, reason: ResetReason) -> None:
        self.resets[reason] += 1
        self._generation += 1
        if reason is ResetReason.TIME:
            self._remembered = None  # Nobody knows how old it is.
        self._ring.clear()
        self.latest = None
        self._start_over()

    def _new_pair(self) -> SlowPair:
        least = sqrt(self._rate_hz) * self._params.gyro_noise_deg_rth * DEG_RTH
        return SlowPair(SlowMotion(self._rate_hz, least), SlowMotion(self._rate_hz, least))

    def _noise_of(self, sample_radps: Array) -> Noise:
        p = self._params
        return Noise(
            alignment_rad=radians(p.alignment_std_deg),
            bias_radps=p.gyro_bias_deg_h * DEG_H,
            scale=p.scale_ppm * 1e-6,
            delay_s=p.delay_ms * 1e-3,
            static_walk_rad_rts=p.static_walk_arcsec_rth * ARCSEC / 60.0,
            bias_walk_radps_rts=p.bias_walk_deg_h_rth * DEG_H / 60.0,
            delay_walk_s_rts=p.delay_walk_us_rts * 1e-6,
            sample_radps=np.maximum(sample_radps, self._least_noise),
            left=np.ones(3),
            ordinary=np.full(3, inf),
        )

    # --- input -------------------------------------------------------------------------------------------------------

    def push_midships(self, t_s: float, rates_radps: Array) -> HullEstimate | None:
        """Take a reading (3,) of the midships IMU; returns an estimate when it completes a pair or more."""
        return self._push(self._streams.midships, t_s, rates_radps)

    def push_local(self, t_s: float, rates_radps: Array) -> HullEstimate | None:
        """Take a reading (3,) of the IMU at the crane base; returns as :meth:`push_midships`."""
        return self._push(self._streams.local, t_s, rates_radps)

    def _push(self, stream: Stream, t_s: float, rates_radps: Array) -> HullEstimate | None:
        stream.push(t_s, rates_radps)
        estimate = None
        for pair in self._streams.due():
            if self._rate_hz != self._streams.rate_hz:
                self._take_rate(self._streams.rate_hz)
            self._take(pair)
            # The grid may be faster than what is asked for.
            known_s, rate_hz = self._known_s(), self._params.rate_hz
            due_s = floor((known_s if isfinite(known_s) else pair.t_s) * rate_hz + 1e-6) / rate_hz
            if due_s != self._published_s:
                self._published_s = due_s
                estimate = self.latest = self._publish(min(due_s, known_s))
        return estimate

    def step(self, t_s: float, midships_radps: Array, local_radps: Array) -> HullEstimate:
        """Take both rates (3,) at ``t_s``, body axes, about ``rate_hz`` apart; nan: missing.

        Never raises on data: what cannot be used is named in the estimate, a filter that breaks down starts over.
        """
        if self._take(RatePair(t_s, midships_radps, local_radps)) or self.latest is None:
            self.latest = self._publish(self._known_s())
        return self.latest

    def _take(self, pair: RatePair) -> bool:
        """False: it is not later than the last one."""
        t_s = pair.t_s
        if not isfinite(t_s) or t_s <= self._t_s:
            if not isfinite(t_s) or self._t_s - t_s < TUNING.longest_gap_s:
                return False
            self._reset(ResetReason.TIME)
        elif len(self._ring) and t_s - self._t_s > TUNING.longest_gap_s:
            self._break_record()
        self._t_s = t_s
        if isnan(self._heard_s):
            self._heard_s = t_s
        midships = self._checks[0].checked(t_s, pair.midships_radps)
        local = self._checks[1].checked(t_s, pair.local_radps)
        self._ring.push((t_s, *midships, *local, pair.midships_after_s, pair.local_after_s))
        ahead = self._pair.ahead
        rows = self._ring.last(self._pair.back + ahead + 1)
        due = len(rows) > ahead + TUNING.shortest_window and self._pair.is_due(
            float(rows[-2 - ahead, 0]), float(rows[-1 - ahead, 0])
        )
        if due:
            self._step_slow(rows)
        return True

    def _known_s(self) -> float:
        """Up to here both rates are known from both sides; -inf: nowhere yet."""
        rows = self._ring.last(self._pair.ahead + 1)
        return float(rows[0, 0]) if len(rows) > self._pair.ahead else -inf

    def _break_record(self) -> None:
        """Go on behind a gap: the filter stays, the record begins anew."""
        self._ring.clear()
        self._slow.clear()
        self._record_s, self._whole = nan, False
        if self._filter is None or self._provisional:
            self._start_over()

    def _step_slow(self, rows: Array) -> None:
        t = float(rows[-1 - self._pair.ahead, 0])
        if isnan(self._record_s):
            self._record_s = t
        if isnan(self._began_s):
            self._began_s, self._first_s = t, float(rows[0, 0])
            self._filtered_s = t
            if self._params.start == Start.ZERO:
                self._learned = True
                self._begin(make_filter(self._params.method, np.eye(3), 0.0, self._prior, self._noise), t)
        if self._learned:
            reading = self._pair.at(rows, self._pair.ahead)
            self._strike(rows, reading)
            slow = reading[1]
            self._slow.push((t, *(slow.motion[0] if slow is not None else (nan, nan, nan))))
            if self._filter is not None and t > self._filtered_s:
                dt_s = t - self._filtered_s
                self._judge(advance(self._filter, dt_s, reading, t - self._began_s), t)
                self._weigh(dt_s, reading)
        self._filtered_s = max(t, self._filtered_s)
        if self._provisional and self._t_s - self._first_s >= self._next_try_s - 1e-6:
            self._try_to_start(t)
        if t - self._forecast_s >= TUNING.forecast_every_s and t - self._began_s >= TUNING.retry_s:
            self._forecast(t)
        if self._params.refit_after_s > 0.0 and not self._provisional:
            self._refit_when_due(t)

    def _strike(self, rows: Array, reading: SlowReading) -> None:
        """Readings that are none are not to be met again."""
        for slow, columns in zip(reading[1:], COLUMNS, strict=True):
            if slow is not None:
                for row in slow.wrong:
                    self._ring.strike(float(rows[row, 0]), columns)

    def _learn(self, rows: Array, to_end: bool) -> list[SlowReading]:
        """Learn from a record of which nothing is known yet what vibrates."""
        self._pair, self._learned = self._new_pair(), True
        return self._pair.learn(rows.copy(), to_end)

    def _judge(self, nis: float | None, t: float) -> None:
        """Does the filter still explain what is measured?"""
        if nis is None:
            return
        if isnan(nis):
            self._reset(ResetReason.COVARIANCE)
            return
        self._updated_s = t
        if not self._consistency.judge(nis) and not self._provisional:
            self._reset(ResetReason.INCONSISTENT)

    def _forecast(self, t: float) -> None:
        self._forecast_s = t
        if self._learned:
            self._pair.identify(self._ring.since(t - TUNING.identified_s))
        noise = self._noise if self._filter is None else self._filter.noise
        self._consistency.forecast(
            self._slow.last(len(self._slow))[:, 1:], self._out_hz, self._flexure, noise.sample_radps
        )
        if self._filter is not None and not self._provisional:
            drifts = self._consistency.delay(t, self._filter.delay_s, self._filter.delay_std_s)
            if drifts and noise.delay_walk_s_rts < TUNING.drifting_walk_s_rts:
                self._filter.noise = msgspec.structs.replace(noise, delay_walk_s_rts=TUNING.drifting_walk_s_rts)

    # --- start -------------------------------------------------------------------------------------------------------

    def _try_to_start(self, t: float) -> None:
        """Align on the record so far; from ``start_s`` on a good alignment is the start, before, a provisional one."""
        p = self._params
        elapsed = self._t_s - self._first_s
        final = elapsed >= p.start_s - 1e-6
        self._next_try_s = elapsed + TUNING.retry_s if final else min(elapsed + TUNING.first_try_s, p.start_s)
        if not final and self._filter is not None:
            return
        record = self._learn(self._ring.since(t - TUNING.longest_start_s), to_end=not final)
        if not record:
            return
        # Only so3 knows of a delay; and a second of record does not tell it from a rotation.
        search_s = TUNING.longest_delay / p.rate_hz if final and p.method == Method.SO3 else 0.0
        found = align_record(record, self._out_hz, search_s)
        if found is None:
            return
        self._consistency.misfit = found.misfit if about_two_axes(record) else 0.0
        if found.misfit > TUNING.worst_misfit:
            self._filter = None  # what a provisional one makes of it is worth nothing
            return
        if found.std_rad > TUNING.good_alignment_rad:
            return
        self._noise = self._noise_of(found.noise_radps)
        filter = first_filter(p.method, found, record, self._prior, self._noise, passes=2 if final else 1)
        if filter is None:
            return
        self._filter = filter
        self._updated_s = self._filtered_s = record[-1][0]
        if final:
            self._begin(filter, record[0][0])
            self._try_remembered(filter, record)

    def _begin(self, filter: Filter, began_s: float) -> None:
        self._filter, self._provisional = filter, False
        self._record_s = self._began_s = began_s
        self._whole = True
        self._consistency.began()

    # --- what an earlier run has found -------------------------------------------------------------------------------

    def restore(self, remembered: SavedHull, age_s: float) -> None:
        """Begin with what an earlier run has found ``age_s`` ago (nan: not known), once it has been checked and for as
        long as the readings agree with it. What is too old is not taken, nor anything once readings have come.
        """
        age_s += remembered.unconfirmed_s
        if isfinite(self._t_s) or self._params.method != Method.SO3 or not age_s <= TUNING.remembered_s:
            return
        self._remembered, self._remembered_age_s = remembered, age_s

    def saved(self) -> SavedHull | None:
        """What a restart shall remember; None: nothing is known that is worth it."""
        if (remembered := self._remembered) is not None:
            return msgspec.structs.replace(remembered, unconfirmed_s=self._age_s())
        if not isinstance(self._filter, So3Filter) or self._provisional:
            return None
        return saved(self._filter, None if self._flexure is self._prior else self._flexure)

    def _age_s(self) -> float:
        """Of what is remembered."""
        return self._remembered_age_s + (self._t_s - self._heard_s if isfinite(self._heard_s) else 0.0)

    def _try_remembered(self, cold: Filter, record: list[SlowReading]) -> None:
        """Put what is remembered on trial beside a filter that has just begun."""
        if self._remembered is None or not isinstance(cold, So3Filter):
            return
        if self._age_s() > TUNING.remembered_s:
            self._remembered = None
            return
        self._trial = Trial(self._remembered, self._age_s(), cold, record)
        self._decide(cold)

    def _weigh(self, dt_s: float, reading: SlowReading) -> None:
        """Take the trial on by a reading."""
        if self._trial is not None and isinstance(self._filter, So3Filter):
            self._trial.step(dt_s, reading)
            self._decide(self._filter)

    def _decide(self, cold: So3Filter) -> None:
        trial = self._trial
        if trial is None:
            return
        verdict = trial.weigh(cold)
        if verdict.is_refuted:
            self.resets[ResetReason.REMEMBERED] += 1
        elif verdict.is_confirmed:
            self._filter, self._flexure = trial.settled(), trial.filter.flexure
            self._whole = False  # The record does not reach back to where this filter began.
        else:
            return
        self._trial = self._remembered = None

    # --- refit -------------------------------------------------------------------------------------------------------

    def _refit_when_due(self, t: float) -> None:
        p = self._params
        waiting = not isnan(self._refit_s) and t - self._refit_s < p.refit_every_s - 1e-6
        short = t - self._record_s < p.refit_after_s - 1e-6
        if waiting or short or self.due_refit is not None or self._filter is None:
            return
        first = isnan(self._refit_s) and self._whole
        reach_s = (self._pair.ahead + 0.5) / self._rate_hz
        rows = self._ring.since((self._record_s if first else t - p.refit_after_s) - reach_s)
        self._refit_s = t
        job = RefitJob(
            rows=rows.copy(),
            pair=self._pair.copy(),
            method=p.method,
            filter=copy(self._filter),
            whole=first,
            prior=self._prior,
            least_noise_radps=self._least_noise,
            generation=self._generation,
        )
        if self._refit_inline:
            self.accept(refit(job))
        else:
            self.due_refit = job

    def accept(self, result: RefitResult | None) -> bool:
        """Take the result of ``refit(due_refit)`` and catch up with what has come since; False: it was of no use."""
        self.due_refit = None
        if result is None or result.generation != self._generation or self._filter is None:
            return False
        self._pair = pair = result.pair.copy()
        if result.filter is not None and self._whole:
            filter = copy(result.filter)
            rows = self._ring.since(result.filtered_s - (pair.back + 0.5) / self._rate_hz)
            if run(filter, pair.through(rows.copy(), result.filtered_s), self._began_s, result.filtered_s):
                self._filter = filter
        self._filter.flexure = self._flexure = result.flexure
        new = result.noise
        self._filter.noise = msgspec.structs.replace(
            self._filter.noise, sample_radps=new.sample_radps, left=new.left, ordinary=new.ordinary
        )
        if self._trial is not None:
            self._trial.filter.flexure, self._trial.filter.noise = result.flexure, self._filter.noise
        self._refits += 1
        self._consistency.began()
        return True

    # --- output ------------------------------------------------------------------------------------------------------

    def _state(self, worst_std: float) -> HullState:
        weak = self._consistency.weak or self._consistency.single
        if self._filter is None or self._provisional:
            return HullState.WEAK if weak else HullState.STARTING
        if self._filtered_s - self._updated_s > TUNING.holding_s:
            return HullState.HOLDING
        if worst_std <= self._params.converged_arcsec * ARCSEC:
            return HullState.CONVERGED
        return HullState.WEAK if weak else HullState.CONVERGING

    def _publish(self, t_s: float) -> HullEstimate:
        """The estimate as the filter stands, or as it will stand at ``t_s``, between two slow readings."""
        t = self._filtered_s if isfinite(self._filtered_s) else self._t_s
        f = self._filter if self._trial is None else self._trial.filter
        if f is not None and t_s > t:
            f, t = f.ahead(t_s - t), t_s
        if f is None:
            return HullEstimate(
                angles=HullAngles(
                    t_s=t,
                    state=self._state(inf),
                    warnings=self._consistency.warnings(None, 0.0, self._checks, self._streams),
                    reachable_std_rad=self._consistency.reachable_rad,
                    resets=self.resets.total(),
                ),
                local_from_midships=_UNKNOWN,
                static=_UNKNOWN,
                covariance_rad2=_UNKNOWN,
            )
        C, C0, covariance = f.total, f.static, f.covariance
        if self._trial is not None:
            covariance = covariance + self._trial.doubt_rad2
        std = np.hypot(np.sqrt(np.maximum(np.diag(covariance), 0.0)), self._params.coherent_floor_arcsec * ARCSEC)
        return HullEstimate(
            angles=HullAngles(
                t_s=t,
                state=self._state(float(np.max(std))),
                warnings=self._consistency.warnings(C, f.delay_s, self._checks, self._streams),
                total_rad=to_euler(C),
                static_rad=to_euler(C0),
                dynamic_rad=three(f.dynamic_rad),
                std_rad=three(std),
                reachable_std_rad=self._consistency.reachable_rad,
                delay_s=f.delay_s,
                delay_std_s=f.delay_std_s,
                refits=self._refits,
                resets=self.resets.total(),
            ),
            local_from_midships=C,
            static=C0,
            covariance_rad2=covariance,
            bias_radps=three(f.bias_radps),
        )


_UNKNOWN: Final = np.full((3, 3), nan)
_UNKNOWN.setflags(write=False)

"""Heave and pitch of a craft from several sigma-point filters on its nonlinear model, fused.

Source: CN 104787260 A: two sigma-point filters with different point sets run in parallel on the heave and pitch of a
hydrofoil catamaran (state z, z', theta, q; flaps known; z and theta measured); per state the one with the smaller
evaluation wins at every instant. The evaluation there is the squared error. The truth is not known at sea, so here it
is the squared innovation before the update, per channel; the rates, which nobody measures, go with their channel.

What that leaves open decides everything: *what differs* between the filters. Point sets make next to no difference, so
switching between them gains nothing. What the waves do to the craft differs by a factor of ten between a calm and a
rough sea, and no single filter serves both. Hence three filters of 8 states, the craft and a coloured wave acceleration
per axis, tuned to three seas, and three ways of fusing them:

* ``instant``: the patent. A single innovation says little, so the choice chatters between good and bad.
* ``ewma``: the same choice by the average of the squared innovation over 2 s.
* ``imm``: no choice: the interacting multiple model of Blom & Bar-Shalom 1988.

``bank`` says what differs; by default the point sets for ``instant``, as printed, and the seas for the others.

A reading beyond the gate of every filter is not dropped but given the weight at which it would lie on the gate (Huber
1964): its pull falls with its distance, so an outlier is harmless, and a sharp wave does not lock the filters out. Such
a reading says nothing about which filter is right.
"""

from __future__ import annotations

from collections import Counter
from enum import StrEnum
from math import isfinite, nan, sqrt
from typing import TYPE_CHECKING, Annotated, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common import sigma
from heaved.estimation.common.best_of import BestOf
from heaved.estimation.craft import filter_bank as bank
from heaved.estimation.craft.dynamics import Vessel
from heaved.estimation.craft.inputs import REJECTED, Caution, Channel, CraftInputs
from heaved.estimation.craft.model import CraftModel, State
from heaved.estimation.craft.sensor_noise import CraftNoise
from heaved.estimation.craft.tuning import TUNING
from heaved.estimation.craft.wave_force import Sea, WaveShape
from heaved.samples import CraftMotion

if TYPE_CHECKING:
    from heaved.estimation.craft.filter_bank import Bank

Array = NDArray[np.float64]

CHANNELS: Final = ((Channel.HEAVE, State.Z), (Channel.PITCH, State.THETA))
PITCH_STATES: Final = np.array([State.THETA, State.THETA_RATE, State.PITCH_WAVE, State.PITCH_WAVE_RATE])


class Source(StrEnum):
    """Where heave and pitch come from."""

    SENSORS = "sensors"
    """The craft's own sensors."""
    OWN = "own"
    """This program."""


class Mode(StrEnum):
    """How the filters are fused."""

    INSTANT = "instant"
    EWMA = "ewma"
    IMM = "imm"


class Differ(StrEnum):
    """What the filters differ by."""

    POINT_SETS = "point_sets"
    SEAS = "seas"


class ResetReason(StrEnum):
    """Why filters, or a channel of them, started again."""

    GAP = "gap"
    """A longer interval than the model bridges."""
    COVARIANCE = "covariance"
    """A covariance was none any more."""
    TIME = "time"
    """Time had been set back."""
    HEAVE = "heave"
    """Heave beyond the gate for so long that it was right after all ..."""
    PITCH = "pitch"
    """... and pitch."""


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[attitude]``: heave and pitch of the craft."""

    enabled: bool = False
    source: Source = Source.SENSORS
    mode: Mode = Mode.IMM
    bank: Differ | None = None
    """What the filters differ by; unset: "point_sets" for "instant", else "seas"."""
    seas: Annotated[tuple[Sea, ...], msgspec.Meta(min_length=1, max_length=5)] = (
        Sea(heave_rms_mps2=0.3, pitch_rms_radps2=0.03),
        Sea(heave_rms_mps2=0.9, pitch_rms_radps2=0.1),
        Sea(heave_rms_mps2=2.5, pitch_rms_radps2=0.25),
    )
    """One filter each, from calm to rough. Filters that differ by their point set are tuned to the last."""
    wave: WaveShape = WaveShape()
    mean_stay_s: Annotated[float, msgspec.Meta(ge=0.1, le=3600)] = 10.0
    """Of a sea, as ``imm`` expects."""
    average_s: Annotated[float, msgspec.Meta(gt=0, le=60)] = 2.0
    """Memory of the squared innovations by which ``ewma`` chooses."""
    margin: Annotated[float, msgspec.Meta(ge=0, lt=1)] = 0.05
    """Share by which another filter's average must be smaller for ``ewma`` to change over."""
    heave_noise_m: Annotated[float, msgspec.Meta(gt=0, le=10)] = 0.05
    """Standard deviation of a heave reading, taken as white. An error that lingers, as that of an inertial heave does,
    cannot be told from heave: the estimate keeps most of it, about twice what is published. The rates hardly suffer."""
    pitch_noise_rad: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.005
    """Standard deviation of a pitch reading, white."""
    heave_model_noise_mps2_rthz: Annotated[float, msgspec.Meta(gt=0, le=10)] = 0.02
    """Density of the heave acceleration that neither craft nor wave explains."""
    pitch_model_noise_radps2_rthz: Annotated[float, msgspec.Meta(gt=0, le=1)] = 0.002
    gate_sigma: Annotated[float, msgspec.Meta(ge=1, le=20)] = 2.5
    """A reading further than this from what every filter expects loses weight."""
    believe_after_s: Annotated[float, msgspec.Meta(gt=0, le=60)] = 1.0
    """A channel that has been beyond the gate for this long is right after all: its state starts from it."""
    stuck_after_s: Annotated[float, msgspec.Meta(ge=0, le=3600)] = 1.0
    """A reading that does not change at all for this long counts as missing; 0: never."""
    max_gap_s: Annotated[float, msgspec.Meta(gt=0, le=10)] = 2.0
    """Longest interval that is bridged by the model; after a longer one the filters start again."""
    vessel: Vessel = Vessel()


class AttitudeFusion:
    """Takes heave, pitch, speed and flaps in order of time; nan is what is not known.

    Attributes:
        resets: starts again, by reason.
        rejected_times: samples that were not later than the one before.
    """

    def __init__(self, params: Params | None = None) -> None:
        """
        Raises:
            ArithmeticError: the vessel comes to no rest at some speed.
        """
        self._params = p = params if params is not None else Params()
        size = len(State)
        if (p.bank or (Differ.POINT_SETS if p.mode == Mode.INSTANT else Differ.SEAS)) == Differ.SEAS:
            seas, sets = p.seas, [sigma.cubature(size)] * len(p.seas)
        else:
            seas, sets = (p.seas[-1],) * 2, [sigma.cubature(size), sigma.spherical_simplex(size)]
        self._count = len(seas)
        self._points = bank.stack(sets)
        white = (p.heave_model_noise_mps2_rthz, p.pitch_model_noise_radps2_rthz)
        self._model = CraftModel(p.vessel, p.wave, seas, white)
        self._R = (p.heave_noise_m**2, p.pitch_noise_rad**2)
        self._noise = CraftNoise(self._R)
        averaged = p.mode == Mode.EWMA
        memory_s, margin = (p.average_s, p.margin) if averaged else (0.0, 0.0)
        self._best = BestOf(self._count, len(Channel), memory_s, margin)
        self._inputs = CraftInputs(p.vessel, p.stuck_after_s)
        self._t_s = nan
        self._late = 0
        self.resets: Counter[ResetReason] = Counter()
        self.rejected_times = 0
        self._gated = [0, 0]
        self._forget()

    def _forget(self) -> None:
        """The motion; what was counted, the time and the last inputs remain."""
        self._started_t_s = nan
        self._bank: Bank | None = None
        self._probabilities = np.full(self._count, 1.0 / self._count)
        self._best.reset()
        self._outside_t_s = [nan, nan]

    # --- one sample --------------------------------------------------------------------------------------------------

    def step(
        self,
        t_s: float,
        heave_m: float,
        pitch_rad: float,
        speed_mps: float = nan,
        flap_fore_rad: float = nan,
        flap_aft_rad: float = nan,
    ) -> CraftMotion | None:
        """The estimate at ``t_s``. None: not later than the last sample, or nothing measured yet.

        Heave about the trim, up; pitch bow up; flaps trailing edge down.
        """
        if not self._in_time(t_s):
            return None
        cautions: list[Caution] = []
        readings = self._inputs.readings(t_s, heave_m, pitch_rad, cautions)
        readings, self._R = self._noise.step(t_s, readings)
        self._inputs.drive(speed_mps, flap_fore_rad, flap_aft_rad, cautions)
        dt_s, self._t_s = t_s - self._t_s, t_s
        if self._bank is not None and dt_s > self._params.max_gap_s:
            self._restart(ResetReason.GAP, cautions)
        if self._bank is not None and not self._predict(dt_s):
            self._restart(ResetReason.COVARIANCE, cautions)
        if self._bank is not None:
            self._update(dt_s, readings, cautions)
        elif any(isfinite(reading) for reading in readings):
            self._started_t_s = t_s
            self._bank = self._model.start(readings, self._R, self._inputs.speed_mps)
        else:
            return None
        if t_s - self._started_t_s < TUNING.settled_s:
            cautions.append(Caution.SETTLING)
        return self._estimate(cautions)

    def _in_time(self, t_s: float) -> bool:
        if isfinite(t_s) and not t_s <= self._t_s:
            self._late = 0
            return True
        self.rejected_times += 1
        self._late += isfinite(t_s)
        if self._late >= TUNING.lost_times:
            self.resets[ResetReason.TIME] += 1
            self._late, self._t_s = 0, nan
            self._inputs.forget_times()
            self._forget()
        return False

    def _restart(self, reason: ResetReason, cautions: list[Caution]) -> None:
        self.resets[reason] += 1
        cautions.append(Caution.RESET)
        self._forget()

    def _predict(self, dt_s: float) -> bool:
        """False: a covariance is none any more."""
        assert self._bank is not None
        filters = self._bank
        if self._params.mode == Mode.IMM:
            keep, move = bank.stay(self._count, dt_s, self._params.mean_stay_s)
            filters, self._probabilities = bank.mix(filters, self._probabilities, keep, move)
        inputs = self._inputs
        predicted = self._model.predict(self._points, filters, dt_s, inputs.speed_mps, inputs.flaps_rad)
        if predicted is not None:
            self._bank = predicted
        return predicted is not None

    # --- measurement update ------------------------------------------------------------------------------------------

    def _update(self, dt_s: float, readings: tuple[float, float], cautions: list[Caution]) -> None:
        assert self._bank is not None
        p, filters = self._params, self._bank
        expected = [(filters.x[:, state], filters.P[:, state, state] + self._R[channel]) for channel, state in CHANNELS]
        log_likelihood = np.zeros(self._count)
        for channel, state in CHANNELS:
            reading = readings[channel]
            if not isfinite(reading):
                continue
            before = reading - expected[channel][0]
            outside = bool(np.all(before**2 > p.gate_sigma**2 * expected[channel][1]))
            if outside and self._believed(channel, cautions):
                filters = bank.place(filters, state, reading, self._R[channel])
                continue
            innovation = reading - filters.x[:, state]
            variance = filters.P[:, state, state] + self._R[channel]
            if outside:
                variance = np.maximum(variance, (innovation / p.gate_sigma) ** 2)
            else:
                self._outside_t_s[channel] = nan
                log_likelihood -= 0.5 * (innovation**2 / variance + np.log(variance))
                if p.mode != Mode.IMM:
                    self._best.step(channel, dt_s, before)
            filters = bank.update(filters, state, innovation, variance)
        self._bank = filters
        if p.mode == Mode.IMM:
            self._probabilities = bank.reweigh(self._probabilities, log_likelihood, TUNING.least_probability)
            self._best.serve_all(int(self._probabilities.argmax()))

    def _believed(self, channel: Channel, cautions: list[Caution]) -> bool:
        """Count a reading beyond the gate; whether it has been there for so long that it must be right."""
        self._gated[channel] += 1
        cautions.append(REJECTED[channel])
        if not isfinite(self._outside_t_s[channel]):
            self._outside_t_s[channel] = self._t_s
        if self._t_s - self._outside_t_s[channel] < self._params.believe_after_s:
            return False
        self._outside_t_s[channel] = nan
        self.resets[ResetReason[channel.name]] += 1
        cautions.append(Caution.RESET)
        return True

    # --- output ------------------------------------------------------------------------------------------------------

    @property
    def serving(self) -> tuple[int, int]:
        """Which filter serves heave, and which pitch: the chosen one, or the most probable."""
        heave, pitch = self._best.serving
        return heave, pitch

    @property
    def switches(self) -> int:
        """Changes of the serving filter, both channels together."""
        return self._best.switches

    @property
    def gated(self) -> tuple[int, int]:
        """Readings beyond the gate, or impossible, heave and pitch."""
        impossible = self._inputs.impossible
        return self._gated[0] + impossible[0], self._gated[1] + impossible[1]

    @property
    def filters(self) -> Bank | None:
        """The filters as they stand; None before the first reading."""
        return self._bank

    def moments(self) -> tuple[Array, Array]:
        """Mean (8,) and covariance (8, 8) of the fused state, in the order of :class:`State`.

        Of a choice between filters: each axis from its own, and no covariance between two that differ.

        Raises:
            ValueError: nothing has been measured yet.
        """
        if self._bank is None:
            raise ValueError("no estimate yet: nothing has been measured")
        if self._params.mode == Mode.IMM:
            return bank.combine(self._bank, self._probabilities)
        heave, pitch = self.serving
        x, P = self._bank.x[heave], self._bank.P[heave]
        if heave != pitch:
            x, P, own = x.copy(), P.copy(), PITCH_STATES
            x[own] = self._bank.x[pitch, own]
            P[own, :] = P[:, own] = 0.0
            P[np.ix_(own, own)] = self._bank.P[pitch][np.ix_(own, own)]
        return x, P

    def _estimate(self, cautions: list[Caution]) -> CraftMotion:
        x, P = self.moments()
        z, z_rate, theta, theta_rate = x[:4].tolist()
        std = [sqrt(max(variance, 0.0)) for variance in P.diagonal()[:4].tolist()]
        if self._params.mode == Mode.IMM:
            probabilities = tuple(self._probabilities.tolist())
        else:
            probabilities = tuple(0.5 * self.serving.count(i) for i in range(self._count))
        return CraftMotion(
            t_s=self._t_s,
            heave_m=z,
            heave_velocity_mps=z_rate,
            pitch_rad=theta,
            pitch_rate_radps=theta_rate,
            heave_std_m=std[0],
            heave_velocity_std_mps=std[1],
            pitch_std_rad=std[2],
            pitch_rate_std_radps=std[3],
            probabilities=probabilities,
            switches=self.switches,
            resets=self.resets.total(),
            cautions=tuple(cautions),
        )

"""The harmonic heave observer: UKF on a sum of sinusoids, moved in time by a power of its transition matrix.

Source: Zhang et al. 2022 (UKF multi-step + BP), eq. (11)-(14). The inertial displacement z is the measurement; the
state is x = [h1, h1', ..., hn, hn', dh], each pair turning at omega_i, dh a random walk that takes the drift. The
published heave drops dh and is moved by F^m to undo the lead of the chain; m is real and signed, so any sampling
interval and either direction are served by one closed form.

What is ours: the phase and the gain of the high-pass and of the converged observer are known, so they are computed at
the dominant frequency, and only the rest (sensor, bus, latency) has to be learned from the laser. And the same response
gives the error that this chain makes on the sea at hand: the published standard deviation comes from the measured
spectrum, not from the filter's own P, which knows nothing of a sea that is broader than n lines.
"""

from __future__ import annotations

from cmath import phase
from collections import Counter
from math import cos, exp, hypot, isfinite, nan, pi, sin, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common import sigma
from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.common.spectrum import dominant_frequencies, heave_spectrum
from heaved.estimation.heave.harmonic.inertial_displacement import InertialDisplacement
from heaved.estimation.heave.observer import LaserAided, Motion, RollPitch, SavedObserver, Verdict, foretold

if TYPE_CHECKING:
    from heaved.estimation.heave.params import Params
    from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow
    from heaved.samples import DelayedHeave, HeaveForecast, SeaState

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of the harmonic observer, where the paper leaves it open."""

    reference_step_s: float = 0.05
    """Sampling interval for which the paper's Q and R stand; other intervals scale them to the same noise densities."""
    fill_step_s: float = 0.05
    """Step with which a gap is bridged by the model's own acceleration."""
    bias_time_s: float = 60.0
    """Time constant of the slow mean that is taken out of the published acceleration."""
    lead_range: tuple[float, float] = (-0.25, 0.5)
    """Leads that are considered, in dominant periods: a high-pass of second order leads by 0 to 0.5, the rest is
    small."""
    min_gain: float = 0.4
    """The high-pass is not undone further than this: below, it would be noise that is amplified."""
    gap_memory: float = 0.5
    """What was wrongly assumed in a gap dies with the high-pass, within this share of its period, observer included."""
    gap_converged_s: float = 3.0
    """After a gap of more than a second the filter's gain is back where it was by then: no look at it before that."""
    lead_slew_s: float = 2.0
    """Time constant with which a new lead and gain are brought in, so that no refresh shows as a step."""


TUNING: Final = Tuning()


class HarmonicObserver:
    """A :class:`heaved.estimation.heave.observer.HeaveObserver` of few lines and little else: it knows no sea state, no
    delayed heave and no bias, doubts nothing and rejects nothing.
    """

    sea: SeaState | None = None
    delayed: DelayedHeave | None = None
    laser_aided: LaserAided | None = None
    """A laser is no measurement of its inertial displacement: that one is early, and off by the drift."""
    bias_mps2: Final = 0.0
    """The high-pass of the integrator has no name for it."""
    has_true_gain: Final = False
    """The measured one of high-pass and filter is taken out, at the frequencies that were found."""
    doubts: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    rejected: Final = 0
    steps: Final = 0
    roll_pitch: Final = RollPitch()

    def __init__(self, params: Params, max_rate_hz: float = 250.0) -> None:
        self._params = params
        n = params.components
        self._points = sigma.symmetric(2 * n + 1)
        self._H = np.zeros((1, 2 * n + 1))
        self._H[0, 0 : 2 * n : 2] = self._H[0, -1] = 1.0
        self._noise = np.full(2 * n + 1, params.process_noise / TUNING.reference_step_s)
        self._noise[-1] = params.drift_process_noise_m2 / TUNING.reference_step_s
        self._inertial = InertialDisplacement(params.highpass_period_s)
        self._history_s = 4.0 * params.window_s
        self._ring = RingBuffer(int(self._history_s * max_rate_hz), 2)
        self.resets: Counter[str] = Counter()
        self._start_over(2.0 * pi / params.initial_period_s * (1.0 + 0.25 * np.arange(n, dtype=np.float64)))

    def _start_over(self, omega: Array) -> None:
        n = self._params.components
        self._omega = omega
        self._x = np.zeros(2 * n + 1)
        self._P = self._params.initial_variance * np.eye(2 * n + 1)
        self._inertial.reset()
        self._ring.clear()
        self.t_s = nan
        self._bias = self._acceleration = 0.0
        self._bias_weight = 0.0
        self._gap_error_m = 0.0
        self._refreshed_t_s = self._started_t_s = nan
        self.refreshes = 0
        self._spectrum = (np.empty(0), np.empty(0))
        self._response = np.empty((0, 2 * n + 1))
        self._dt_s = TUNING.reference_step_s
        self._target = self._shift_and_gain()
        self.design_lead_s, self._gain = self._target
        self._error_cache: dict[float, float] = {}

    # --- input -------------------------------------------------------------------------------------------------------

    def step(self, t_s: float, a_up_mps2: float, /, *_angles: float) -> None:
        """Take the vertical acceleration at ``t_s`` (later than the last one; nan: missing, nothing happens)."""
        if not isfinite(a_up_mps2):
            return
        if not isfinite(self.t_s):
            self.t_s = self._refreshed_t_s = self._started_t_s = t_s
            self._dt_s = TUNING.reference_step_s
        dt = t_s - self.t_s
        if dt > self._params.max_gap_s:
            self._reset("gap")
            self.step(t_s, a_up_mps2)
            return
        self._dt_s += 0.02 * (min(dt, 2.0 * self._dt_s) - self._dt_s) if dt > 0.0 else 0.0
        self._gap_error_m *= exp(-dt / (TUNING.gap_memory * self._params.highpass_period_s))
        if dt > max(4.0 * TUNING.fill_step_s, 3.0 * self._dt_s):
            if isfinite(guess := self.error_std_m(dt)):
                self._gap_error_m = guess
            if dt > 1.0:
                self._refreshed_t_s = max(self._refreshed_t_s, t_s + TUNING.gap_converged_s - self._params.refresh_s)
            self._bridge(t_s)
            dt = t_s - self.t_s
        self._follow_bias(dt, a_up_mps2)
        z = self._inertial.step(dt, a_up_mps2)
        self.t_s = t_s
        self._ring.push((t_s, a_up_mps2))
        if not self._filter(dt, z):
            self._reset("covariance")
            return
        blend = 1.0 - exp(-dt / TUNING.lead_slew_s)
        self.design_lead_s += blend * (self._target[0] - self.design_lead_s)
        self._gain += blend * (self._target[1] - self._gain)
        if t_s - self._refreshed_t_s >= self._params.refresh_s and t_s - self._started_t_s >= 15.0:
            self._refresh(t_s)

    def cut(self) -> None:
        """The high-pass forgets another level by itself."""

    def amend(self, t_s: Array, more_mps2: Array) -> None:
        """What is integrated stays: by the time that it is amended, the high-pass has forgotten it."""

    def disturb(self, f_hz: Array, psd: Array) -> None:
        """What is published as not known is made from the measured spectrum, in which noise counts as sea."""

    def mistake(self, t_s: float, shapes: tuple[float, float], covariance: Array) -> None:
        """Likewise."""

    def due(self) -> SeaWindow | None:
        """Nothing to fit: the frequencies are looked for with the samples."""
        return None

    def accept(self, fit: SeaFit) -> Verdict:
        """It has asked for none."""
        return Verdict.FAILED if fit.message else Verdict.REJECTED

    def _bridge(self, until_s: float) -> None:
        """Go through a gap on the model's own acceleration: the samples that are missing, not a flat line."""
        while until_s - self.t_s > 1.5 * TUNING.fill_step_s:
            # Of the heave, not of the inertial displacement: that one is early.
            row = self._output_row(TUNING.fill_step_s - self.design_lead_s) / self._gain
            row[:-1] *= np.repeat(self._omega**2, 2)
            a = self._bias - float(row @ self._x)
            self._inertial.step(TUNING.fill_step_s, a)
            self.t_s += TUNING.fill_step_s
            self._ring.push((self.t_s, a))
            F, Q = self._transition(TUNING.fill_step_s), self._process_noise(TUNING.fill_step_s)
            predicted = sigma.predict(self._points, self._x, self._P, F, Q)
            if predicted is None:
                return
            self._x, self._P = predicted.x, predicted.P

    def _filter(self, dt_s: float, z: float) -> bool:
        """One UKF step, eq. (4)-(10); False when the covariance is no longer one."""
        x, P = self._x, self._P
        if dt_s > 0.0:
            predicted = sigma.predict(self._points, x, P, self._transition(dt_s), self._process_noise(dt_s))
            if predicted is None:
                return False
            x, P = predicted.x, predicted.P
        updated = sigma.update(self._points, x, P, np.array([z]), self._H, np.array([[self._measurement_noise(dt_s)]]))
        if updated is None:
            return False
        self._x, self._P = updated.x, updated.P
        return True

    def _transition(self, dt_s: float) -> Array:
        """F = expm(A dt), eq. (12)-(13), in closed form."""
        size = len(self._x)
        F = np.zeros((size, size))
        F[-1, -1] = 1.0
        for i, w in enumerate(self._omega.tolist()):
            c, s = cos(w * dt_s), sin(w * dt_s)
            k = 2 * i
            F[k, k] = F[k + 1, k + 1] = c
            F[k, k + 1] = s / w
            F[k + 1, k] = -w * s
        return F

    def _process_noise(self, dt_s: float) -> Array:
        return np.diag(self._noise * dt_s)

    def _measurement_noise(self, dt_s: float) -> float:
        return self._params.measurement_variance_m2 * TUNING.reference_step_s / max(dt_s, 1e-3)

    def _follow_bias(self, dt_s: float, a: float) -> None:
        """Slow mean of the acceleration: bias and leftover gravity. A plain mean until it is BIAS_TIME_S long."""
        self._acceleration = a
        self._bias_weight = min(self._bias_weight + dt_s, TUNING.bias_time_s)
        if self._bias_weight > 0.0:
            self._bias += min(1.0, dt_s / self._bias_weight) * (a - self._bias)

    def _reset(self, reason: str) -> None:
        """Start again with the frequencies that were last found."""
        self.resets[reason] += 1
        self._start_over(self._omega)

    # --- model of the sea at hand ------------------------------------------------------------------------------------

    def _refresh(self, t_s: float) -> None:
        """Look for the frequencies, eq. after (14), and work out what the chain does to this sea."""
        self._refreshed_t_s = t_s
        record = self._ring.since(t_s - self._params.window_s)
        found = (
            2.0
            * pi
            * dominant_frequencies(
                record[:, 0],
                record[:, 1],
                self._params.components,
                self._params.band_hz,
                1.0 / self._params.highpass_period_s,
            )
        )
        if len(found):
            # Fewer peaks than components: the others stay where they were, but never two at one frequency.
            omega = np.sort(self._omega)
            omega[np.argsort(np.abs(omega[:, None] - found).min(axis=1))[: len(found)]] = found
            omega = np.sort(omega)
            if len(omega) == 1 or float(np.min(np.diff(omega))) > 2.0 * pi * 0.2 / self._params.window_s:
                self._omega = omega
        history = self._ring.since(t_s - self._history_s)
        self._spectrum = heave_spectrum(history[:, 0], history[:, 1], self._params.band_hz, 2.0 * self._params.window_s)
        self._response = self._state_response(2.0 * pi * self._spectrum[0])
        self._target = self._shift_and_gain()
        self._error_cache.clear()
        self.refreshes += 1

    @property
    def omega_radps(self) -> float:
        """Dominant frequency: of the pair with the largest amplitude."""
        pairs = self._x[:-1].reshape(-1, 2)
        return float(self._omega[int(np.argmax(pairs[:, 0] ** 2 + (pairs[:, 1] / self._omega) ** 2))])

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Of the lines, as they were last found."""
        return tuple(float(w) / (2.0 * pi) for w in self._omega)

    def _state_response(self, omega: Array) -> Array:
        """State over true heave, complex (k, 2n+1), at angular frequencies (k,), with the gain as it has converged."""
        dt = self._dt_s
        K = self._P @ self._H[0] / self._measurement_noise(dt)
        F = self._transition(dt)
        loop = (np.eye(len(K)) - np.outer(K, self._H[0])) @ F
        z = np.exp(1j * omega * dt)
        inertial = np.array([self._inertial.response(float(w)) for w in omega])
        left = np.eye(len(K)) - loop / z[:, None, None]
        drive = np.broadcast_to(K, (len(omega), len(K)))[..., None]
        return np.asarray(np.linalg.solve(left, drive)[..., 0] * inertial[:, None])

    def _shift_and_gain(self) -> tuple[float, float]:
        """Lead (s) and gain of integration and observer, m of eq. (14): the pair that errs least on the sea at hand.

        Minimises the integral of |1 - G(lead) / gain|^2 S df over the wave band, G the response of the chain moved back
        by the lead; for a single tone that is its phase and its amplitude. Before there is a spectrum: those, at the
        assumed frequency.
        """
        f, S = self._spectrum
        if len(f) < 2 or not float(np.sum(S)) > 0.0:
            w = self.omega_radps
            response = complex(np.sum(self._state_response(np.array([w]))[0, :-1:2]))
            return phase(response) / w, abs(response)
        leads, gain = np.linspace(*TUNING.lead_range, 61) * 2.0 * pi / self.omega_radps, 1.0
        for _ in range(3):
            G = self._response @ np.stack([self._output_row(-lead) for lead in leads], axis=1)
            cross, power = S @ G.real, S @ np.abs(G) ** 2
            best = int(np.argmax(np.where(cross > 0.0, cross**2 / power, 0.0)))
            lead, gain = float(leads[best]), float(power[best] / max(cross[best], 1e-300))
            leads = np.linspace(lead - (leads[1] - leads[0]), lead + (leads[1] - leads[0]), 11)
        return lead, max(gain, TUNING.min_gain)

    def error_std_m(self, shift_s: float, scale: float = 1.0) -> float:
        """Standard deviation of the error of :meth:`at` for a moment ``shift_s`` after the last sample.

        scale: what the laser has shown of the modelled part, as a factor.

        From the spectrum S of the measured acceleration over omega^4 and the response G of the whole chain:
        integral of |exp(j omega shift) - G|^2 S df. Noise in the wave band counts as sea, so it errs upwards. After a
        gap, what it had to be bridged with is off by the error of a forecast that long; that is added and dies down.
        nan until there is a spectrum.
        """
        key = round(shift_s, 2)
        if key not in self._error_cache:
            f, S = self._spectrum
            if len(f) < 2:
                return nan
            w = 2.0 * pi * f
            G = self._response @ self._output_row(key - self._target[0]) / self._target[1]
            self._error_cache[key] = sqrt(float(np.sum(np.abs(np.exp(1j * w * key) - G) ** 2 * S) * (f[1] - f[0])))
        return hypot(scale * self._error_cache[key], self._gap_error_m)

    def heave_std_m(self) -> float:
        """Standard deviation of the heave itself over the recent past: what knowing nothing would be off by."""
        f, S = self._spectrum
        return sqrt(float(np.sum(S) * (f[1] - f[0]))) if len(f) > 1 else nan

    # --- output ------------------------------------------------------------------------------------------------------

    def _output_row(self, shift_s: float) -> Array:
        """Row that gives heave from the state moved by ``shift_s``: H F^m without dh."""
        row = np.zeros(len(self._x))
        row[:-1:2], row[1::2] = np.cos(self._omega * shift_s), np.sin(self._omega * shift_s) / self._omega
        return row

    def at(self, shift_s: float, learned_lead_s: float = 0.0) -> Motion:
        """Heave ``shift_s`` after the last sample, X* = F^m X of eq. (14), m = (shift - lead) / T.

        ``learned_lead_s``: what the laser showed beyond the lead of the chain's own design.
        """
        heave, velocity = self._pair(shift_s - self.design_lead_s - learned_lead_s)
        return Motion(heave / self._gain, velocity / self._gain)

    def forecast(
        self, shift_s: float, learned_lead_s: float = 0.0, scale: float = 1.0, gain: float = 1.0
    ) -> tuple[HeaveForecast, ...]:
        """Heave and :meth:`error_std_m` for each horizon after a moment ``shift_s`` after the last sample, both times
        ``gain``: what the laser has shown of the sensor's scale.
        """
        found = []
        for h in self._params.forecast_horizons_s:
            heave_m, std_m = self.at(shift_s + h, learned_lead_s).heave_m, self.error_std_m(shift_s + h, scale)
            found.append(foretold(h, gain * heave_m, gain * std_m))
        return tuple(found)

    def unshifted(self) -> Motion:
        """The one-step observer: eq. (14) with m = 0, as the comparison with the laser wants it."""
        return Motion(*self._pair(0.0))

    def _pair(self, shift_s: float) -> tuple[float, float]:
        heave = velocity = 0.0
        x = self._x.tolist()
        for i, w in enumerate(self._omega.tolist()):
            h, v = x[2 * i], x[2 * i + 1]
            c, s = cos(w * shift_s), sin(w * shift_s)
            heave += h * c + v * s / w
            velocity += v * c - h * w * s
        return heave, velocity

    @property
    def inertial_m(self) -> float:
        """The inertial displacement: the measurement of the filter."""
        return self._inertial.displacement_m

    @property
    def acceleration_mps2(self) -> float:
        """The last vertical acceleration, less its slow mean."""
        return self._acceleration - self._bias

    @property
    def needed_s(self) -> float:
        """Seconds of record from which it counts as settled."""
        return self._params.window_s

    @property
    def settled_s(self) -> float:
        """Seconds of record since the start or the last reset; nan before the first sample."""
        return self.t_s - self._started_t_s

    def saved(self) -> SavedObserver:
        """The frequencies that were last found."""
        return SavedObserver(frequencies_hz=self.frequencies_hz)

    def restore(self, saved: SavedObserver, _age_s: float = nan, /) -> None:
        """Start with the frequencies that an earlier run has found, whatever their age: they soon are those of now.

        Raises:
            ValueError: their number is not that of the model, or one lies outside the wave band.
        """
        if not (frequencies_hz := saved.frequencies_hz):
            return
        low, high = self._params.band_hz
        if len(frequencies_hz) != self._params.components or not all(low <= f <= high for f in frequencies_hz):
            asked = f"{self._params.components} in {low}..{high} Hz"
            raise ValueError(f"saved frequencies {frequencies_hz} do not fit the configured {asked}")
        self._start_over(2.0 * pi * np.sort(np.array(frequencies_hz)))

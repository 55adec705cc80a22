"""How far the sea observer can be trusted: what its innovations and the delayed heave say, as a factor and in words.

A model that was not fitted to what comes now, from an earlier run or from before a long gap, is on trial first. The sea
of an hour ago is often that of now, and then serves at once; when it is not, its standard deviations are those of
another sea. What can be told in seconds is whether the acceleration is as large as the model has it, and whether it
comes as the model foretells it from sample to sample. Long swell cannot be told in seconds: until the first fit of its
own the model is trusted less than one that was fitted.
"""

from __future__ import annotations

from math import inf, isfinite, nan, sqrt
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.estimation.common.ring import History
from heaved.samples import DelayedHeave, SeaState, vibration_in_words

if TYPE_CHECKING:
    from heaved.estimation.heave.sea.filter import SeaFilter
    from heaved.estimation.heave.sea.model import SeaSystem


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """From where on the observer is doubted."""

    changed: float = 3.0
    """Whiteness of the innovations above which the sea is changing: the next fit comes sooner."""
    changed_now: float = 9.0
    """The same in the last seconds, which are fewer."""
    stubborn: float = 30.0
    """Whiteness at two fits in a row above which it is not the sea that changes, but what is measured that is no sea
    (tilt that is not removed): fitting sooner helps nothing."""
    still_likelihood: float = 15.0
    """Waves must make the record that much likelier than noise alone (ten parameters give a third of it by chance)."""
    still_share: float = 0.5
    """Nor is it a sea when the error of the heave is that share of the heave itself."""
    factor_limit: float = 10.0
    """Beyond it nothing is known: a real-time heave that is so many standard deviations off the delayed one is none."""
    counted: float = 15.0
    """One difference counts with so many standard deviations at most: what was wrong for some seconds is forgotten
    within a minute once it is right again."""
    enough_waves: float = 8.0
    """A spectrum of fewer of the longest waves is too coarse for its skirt, and the errors are as many times larger as
    the square of what is lacking (cold starts in swell of 16 and 19 s: 4 and 10 times with fewer than three of
    them)."""
    needed_s: float = 60.0
    """Seconds of record from which the observer counts as settled."""
    diverged: float = 2.5
    """RMS difference from the delayed heave, over the modelled standard deviation, from which the output is in doubt;
    the published standard deviation has grown with it by then."""
    small_m: float = 0.01
    """Differences below this are well whatever the sea."""
    known_youth: float = 1.8
    """Of a model that was fitted to six of the longest waves or more."""
    longest_peak_s: float = 28.0
    """Longer waves than this are not told from the drift of the sensor."""
    check_time_s: float = 60.0
    """Memory of the comparison with what was published."""
    check_min_s: float = 20.0
    """Seconds of it before it says anything: several waves."""
    told_s: float = 10.0
    """Nothing is said before."""
    settles_s: float = 2.0
    """Innovations of the first seconds are those of a filter that knows nothing."""
    largest: float = 4.0
    """Mean square of acceleration or innovations, over that of the model, from which it is another sea. (In ten seconds
    of waves of eight the first scatters by a factor of two.)"""
    doubt: float = 1.5
    """Published over modelled standard deviation where the model is fresh,"""
    doubt_per_hour: float = 0.5
    """More of it for each hour of its age,"""
    most_doubt: float = 3.0
    """and where it is old, or of unknown age."""
    bias_serves_s: float = 3600.0
    """For so long the bias of before is worth more than nothing: in an hour a sensor cools down, or is another one."""
    bias_repeats_mps2: float = 3e-3
    """Standard deviation by which the bias of a sensor is another after it was not heard for a while."""
    bias_agrees: float = 3.0
    """Deviations that the bias which the trial finds by itself may be off that of before."""
    apart: float = 0.5
    """Share of the difference of the two heaves that counts as uncertainty until it is known."""


TUNING: Final = Tuning()


class Divergence:
    """RMS difference of real-time and delayed heave, over the modelled standard deviation; 1 when that was right."""

    def __init__(self, capacity: int = 1) -> None:
        """``capacity``: how much that was said is kept until the delayed heave of its time is known."""
        self._square, self._seconds, self._t_s = 1.0, 0.0, nan
        self._square_m2 = 0.0
        self._said = History(capacity)

    @property
    def ratio(self) -> float:
        """1 until enough has been compared."""
        return sqrt(self._square) if self._seconds >= TUNING.check_min_s else 1.0

    @property
    def rms_m(self) -> float:
        """The same difference in metres."""
        return sqrt(self._square_m2)

    def say(self, t_s: float, realtime_m: float, modelled_std_m: float) -> None:
        """What is said in real time for ``t_s``, later than the last one."""
        self._said.push((t_s, realtime_m, modelled_std_m))

    def check(self, delayed: DelayedHeave) -> None:
        """:meth:`compare` with what was said for that moment, as far as it is known."""
        _, realtime_m, modelled_std_m = self._said.at(delayed.t_s) or (delayed.t_s, nan, nan)
        self.compare(delayed, realtime_m, modelled_std_m)

    def compare(self, delayed: DelayedHeave, realtime_m: float, modelled_std_m: float) -> None:
        """``realtime_m``: what was said in real time for the very moment of ``delayed``."""
        dt = min(delayed.t_s - self._t_s, 1.0) if isfinite(self._t_s) else 0.0
        self._t_s = delayed.t_s
        if not (isfinite(realtime_m) and modelled_std_m > 0.0 and dt > 0.0):
            return
        self._seconds = min(self._seconds + dt, TUNING.check_time_s)
        square = min((realtime_m - delayed.heave_m) ** 2 / modelled_std_m**2, TUNING.counted**2)
        self._square += dt / self._seconds * (square - self._square)
        self._square_m2 += dt / self._seconds * ((realtime_m - delayed.heave_m) ** 2 - self._square_m2)


class Consistency:
    """Step it with every sample of the filter, and tell it of every fit.

    Attributes:
        divergence: of real-time and delayed heave.
        surprise: variance of the averaged innovations over the model's, at the last fit or in the last seconds.
        factor: by which errors are larger than the model says; 1 when it is right.
        youth: the same for what the spectrum of few waves leaves open alone; inf before the first fit.
    """

    def __init__(self, delayed_samples: int) -> None:
        """``delayed_samples``: by which the delayed heave is late, at most."""
        self.divergence = Divergence(delayed_samples)
        self.surprise = self.factor = 1.0
        self._whiteness, self._waves, self._is_still = 1.0, inf, False
        self._is_stubborn = False
        self.youth = inf
        self._sea: SeaState | None = None
        self._shaken: tuple[str, ...] = ()
        self._is_recovering = False
        self._standing: tuple[str, ...] = ()

    def fitted(self, whiteness: float, waves: float, error_m: float, sea_std_m: float, waves_seen: float) -> None:
        """A fit: whiteness of its innovations, how much likelier it is than noise, error of its heave, that itself, and
        how many of the longest waves it was fitted to.
        """
        self.youth = max((TUNING.enough_waves / max(waves_seen, 1.0)) ** 2, 1.0)
        self._is_stubborn = min(whiteness, self._whiteness) > TUNING.stubborn
        self._whiteness, self._waves = whiteness, waves
        self._is_still = waves < TUNING.still_likelihood or error_m > TUNING.still_share * sea_std_m

    def step(self, surprise: float, is_recovering: bool, sea: SeaState | None, state_std_m: float = 0.0) -> None:
        """What the filter says after a sample; ``state_std_m``: how well it knows the heave, by the model."""
        self.surprise = max(self._whiteness, surprise)
        ratio = self.divergence.ratio
        if state_std_m > 0.0:
            # A newer model that knows of more errors has what the last one did not have.
            ratio = min(ratio, max(self.divergence.rms_m / state_std_m, 1.0))
        shown = min(max(1.0, sqrt(0.5 * self.surprise), ratio), TUNING.factor_limit)
        if ratio > TUNING.factor_limit and self.divergence.rms_m > TUNING.small_m:
            shown = inf
        self.factor = max(shown, self.youth) if self.youth < inf else shown
        self._is_recovering = is_recovering
        if sea is not self._sea:
            self._sea = sea
            words = "" if sea is None else vibration_in_words(sea.vibration)
            self._shaken = (words,) if words else ()
        found = []
        if self._whiteness > TUNING.changed or self.surprise > TUNING.changed_now:
            found.append("the sea or the sensor is changing")
        if ratio > TUNING.diverged and self.divergence.rms_m > TUNING.small_m:
            found.append(f"{ratio:.1f} times its standard deviation off the delayed heave")
        if sea is not None and not sea.is_still and sea.peak_period_s > TUNING.longest_peak_s:
            found.append(f"swell of {sea.peak_period_s:.0f} s: longer than the sensor can follow")
        self._standing = tuple(found)

    @property
    def is_model_known(self) -> bool:
        """Whether the model is so good that what it does not explain is not of the sea."""
        return self.youth <= TUNING.known_youth and self._whiteness <= TUNING.changed_now

    @property
    def is_changing(self) -> bool:
        """Whether the sea is not any more what was fitted, and another fit would help."""
        return self.surprise > TUNING.changed and not self._is_stubborn

    @property
    def is_still(self) -> bool:
        """Whether the last fit saw no waves."""
        return self._is_still

    def doubts(self, settled_s: float) -> tuple[str, ...]:
        """What is held against the output, for people; ``settled_s``: seconds of record."""
        if self._is_recovering and settled_s > TUNING.needed_s:
            return ("recovering from a gap", *self._standing)
        return self._standing

    @property
    def notes(self) -> tuple[str, ...]:
        """What people should know, and no reason to trust the output less."""
        still = ("still: no motion above the noise of the sensor",) if self._is_still else ()
        return (*still, *self._shaken)


class Trial:
    """A model on trial; step it with every sample until the first fit.

    Attributes:
        is_told: whether anything may be said from the model.
        is_another: whether the sea has turned out to be another one.
        factor: by which errors are larger than the model says.
        known: beside the filter that knows nothing of the bias the one that begins with the bias of before, which is
            ahead of it if that is still so; once it serves, the other one. None: there is none any more.
        apart_m: standard deviation of the heave for what the two differ by, while there are two.
    """

    def __init__(self, system: SeaSystem, age_s: float, known: SeaFilter | None = None) -> None:
        """``age_s``: of the model; nan: not known."""
        self.known = known
        self.apart_m = 0.0
        self._is_known_serving = False
        self._acceleration2 = float(system.H[:-1] @ system.stationary[:-1, :-1] @ system.H[:-1])
        self._acceleration2 += 2.0 * system.model.noise_psd
        self._doubt = (
            min(TUNING.doubt + TUNING.doubt_per_hour * age_s / 3600.0, TUNING.most_doubt)
            if isfinite(age_s)
            else TUNING.most_doubt
        )
        self._began_s: float | None = None
        self._count = 0
        self._sum = self._square = self._innovation2 = 0.0
        self.is_told = self.is_another = False
        self.factor = self._doubt

    def step(self, t_s: float, a_mps2: float, scaled: float) -> None:
        """A sample: its acceleration, and its innovation over the deviation of that."""
        if self._began_s is None:
            self._began_s = t_s
        since_s = t_s - self._began_s
        if since_s < TUNING.settles_s:
            return
        self._count += 1
        self._sum += a_mps2
        self._square += a_mps2 * a_mps2
        self._innovation2 += scaled * scaled
        if since_s < TUNING.told_s:
            return
        n = self._count
        spread = (self._square / n - (self._sum / n) ** 2) / self._acceleration2
        surprise = self._innovation2 / n
        self.is_told = True
        self.is_another = max(spread, surprise) > TUNING.largest
        self.factor = self._doubt * sqrt(max(spread, surprise, 1.0))

    def weigh(self, serving: SeaFilter, other: SeaFilter) -> bool:
        """Let the filter serve that knows the bias of before, as long as the other one, which learns it for itself,
        comes to the same; whether that is so. A sensor may have been replaced meanwhile.
        """
        if not self._is_known_serving:
            self._is_known_serving = True
            self._exchange(serving, other)
        apart = serving.x - other.x
        apart_mps2 = abs(float(apart[-1]))
        own_std_mps2 = sqrt(float(other.covariance[-1, -1]))
        is_agreed = apart_mps2 <= TUNING.bias_agrees * own_std_mps2
        # What the two differ by may be due to either, until it is known.
        self.apart_m = TUNING.apart * abs(float(serving.system.heave.dot(apart)))
        if not is_agreed:
            self._exchange(serving, other)
        if not is_agreed or own_std_mps2 < TUNING.bias_repeats_mps2:
            self.known, self.apart_m = None, 0.0
        return is_agreed

    @staticmethod
    def _exchange(one: SeaFilter, other: SeaFilter) -> None:
        kept = one.state()
        one.restore(other.state())
        other.restore(kept)

"""An independent check of the observer's forecasts: a plain regression on the observer's own heave; which is better?

Both foretell the heave that the observer itself gives a second later. The observer knows the sensor and the spectrum;
the regression (:mod:`heaved.estimation.rock.direct`) knows nothing but the past. If it is clearly the better one for a
minute, the model of the sea is wrong.
"""

from __future__ import annotations

from collections import deque
from math import inf, isfinite, isnan, nan, sqrt
from typing import TYPE_CHECKING, Final, Self

import msgspec

from heaved.estimation.rock.direct import DirectPredictor, Params

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.samples import HeaveForecast


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is compared, how often, and from when on a doubt is raised."""

    checked_s: tuple[float, float] = (0.5, 2.0)
    """The forecast of a horizon between these, the one nearest to 1 s, is compared with a plain regression's."""
    feed_s: float = 0.2
    """Least interval of what is fed and compared. With half of it the regression is 4 to 12 % better at twice the cost;
    a wrong model is doubted no more surely."""
    choice_s: float = 4.0
    """Of the regression: what is compared is a minute's errors."""
    gap_s: float = 0.5
    """A forecast for a moment between frames further apart than this is not judged."""
    memory_s: float = 60.0
    """Of the errors."""
    worse: float = 1.5
    """Ratio of the errors that raises the doubt when it lasts."""
    lasts_s: float = 60.0
    """For so long it must be that before it is said."""
    small_m: float = 0.01
    """Errors below this are well whatever the regression does: a still ship."""


TUNING: Final = Tuning()
DOUBT: Final = "forecasts worse than plain regression"


class ForecastCheck:
    """Compares forecasts for ``horizon_s``; feed it every frame."""

    def __init__(self, horizon_s: float, lead_s: float = 0.0) -> None:
        """``lead_s``: the heave given is for this long after its time."""
        self._horizon_s, self._lead_s = horizon_s, lead_s
        self._fed_s = -inf
        self.reset()

    @classmethod
    def of(cls, horizons_s: Sequence[float], lead_s: float) -> Self | None:
        """For one of the horizons of the forecasts; None: there is none that tells anything."""
        horizon_s = min(horizons_s, key=lambda h: abs(h - 1.0), default=nan)
        is_telling = TUNING.checked_s[0] <= horizon_s <= TUNING.checked_s[1] and lead_s < 0.5 * horizon_s
        return cls(horizon_s, lead_s) if is_telling else None

    def reset(self) -> None:
        """Forget everything."""
        self._regression = DirectPredictor(1, Params(horizons_s=(self._horizon_s,), choice_s=TUNING.choice_s))
        # (time that it is for, value), each by the clock of the heave that is given.
        self._observer: deque[tuple[float, float]] = deque()
        self._plain: deque[tuple[float, float]] = deque()
        self._squares, self._seconds = [nan, nan], [0.0, 0.0]
        self._last: tuple[float, float] = (-inf, nan)
        self._due_s = inf
        """When the next of them can be judged."""
        self._worse_since_s = nan

    def step(self, t_s: float, heave_m: float, forecast: Sequence[HeaveForecast]) -> None:
        """``heave_m``: the observer's now; ``forecast``: what it foretells, if that is known."""
        if t_s >= self._due_s:
            self._judge(t_s, heave_m)
        self._last = (t_s, heave_m)
        if 0.0 <= t_s - self._fed_s < 0.98 * TUNING.feed_s:
            return
        self._fed_s = t_s
        forecast_m = next((one.heave_m for one in forecast if one.horizon_s == self._horizon_s), nan)
        plain_m = float(self._regression.step(t_s, (heave_m,))[0, 0])
        # Only what can be compared is: both or none.
        if isfinite(forecast_m + plain_m):
            self._observer.append((t_s + self._horizon_s - self._lead_s, forecast_m))
            self._plain.append((t_s + self._horizon_s, plain_m))
            self._due_s = min(self._due_s, self._observer[0][0])

    def _judge(self, t_s: float, heave_m: float) -> None:
        """Take the errors of what was foretold for a time between the last heave and this one; which are greater?"""
        last_s, last_m = self._last
        gap_s = t_s - last_s
        self._due_s = inf
        for i, waiting in enumerate((self._observer, self._plain)):
            while waiting and not t_s < waiting[0][0]:
                at_s, foretold_m = waiting.popleft()
                if not (last_s <= at_s and gap_s < TUNING.gap_s):
                    continue  # It fell into a gap.
                error_m = last_m + (at_s - last_s) / gap_s * (heave_m - last_m) - foretold_m
                if isfinite(error_m):
                    square, mean = error_m * error_m, self._squares[i]
                    self._seconds[i] = min(self._seconds[i] + TUNING.feed_s, TUNING.memory_s)
                    share = TUNING.feed_s / self._seconds[i]
                    self._squares[i] = square if isnan(mean) else mean + share * (square - mean)
            if waiting:
                self._due_s = min(self._due_s, waiting[0][0])
        observer_m, plain_m = self.errors_m
        if observer_m > max(TUNING.worse * plain_m, TUNING.small_m):
            self._worse_since_s = t_s if not self._worse_since_s <= t_s else self._worse_since_s
        else:
            self._worse_since_s = nan

    @property
    def errors_m(self) -> tuple[float, float]:
        """Rolling RMS of the observer's forecasts and of the regression's, m; nan: not known."""
        return sqrt(self._squares[0]), sqrt(self._squares[1])

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is held against the forecasts, for people."""
        return (DOUBT,) if self._fed_s - self._worse_since_s >= TUNING.lasts_s else ()

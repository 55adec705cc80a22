"""An independent check of the observer's forecasts: a plain regression on the observer's own heave; which is better?

Both foretell the heave that the observer itself gives a second later. The observer knows the sensor and the spectrum;
the regression (:mod:`heaved.estimation.rock.direct`) knows nothing but the past. If it is clearly the better one for a
minute, the model of the sea is wrong.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import inf, isfinite, nan, sqrt
from typing import Final, Self

from heaved.estimation.rock.direct import DirectPredictor, Params
from heaved.samples import HeaveForecast

CHECKED_S: Final = (0.5, 2.0)
"""The forecast of a horizon between these, the one nearest to 1 s, is compared with a plain regression's."""
FEED_S: Final = 0.2
"""Least interval of what is fed and compared. With half of it the regression is 4 to 12 % better at twice the cost; a
wrong model is doubted no more surely."""
CHOICE_S: Final = 4.0
"""Of the regression: what is compared is a minute's errors."""
GAP_S: Final = 0.5
"""A forecast for a moment between frames further apart than this is not judged."""
MEMORY_S: Final = 60.0
"""Of the errors."""
WORSE: Final = 1.5
"""Ratio of the errors that raises the doubt when it lasts for LASTS_S."""
LASTS_S: Final = 60.0
SMALL_M: Final = 0.01
"""Errors below this are well whatever the regression does: a still ship."""
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
        is_telling = CHECKED_S[0] <= horizon_s <= CHECKED_S[1] and lead_s < 0.5 * horizon_s
        return cls(horizon_s, lead_s) if is_telling else None

    def reset(self) -> None:
        """Forget everything."""
        self._regression = DirectPredictor(1, Params(horizons_s=(self._horizon_s,), choice_s=CHOICE_S))
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
        if 0.0 <= t_s - self._fed_s < 0.98 * FEED_S:
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
                if not (last_s <= at_s and gap_s < GAP_S):
                    continue  # It fell into a gap.
                error_m = last_m + (at_s - last_s) / gap_s * (heave_m - last_m) - foretold_m
                if isfinite(error_m):
                    square, mean = error_m * error_m, self._squares[i]
                    self._seconds[i] = min(self._seconds[i] + FEED_S, MEMORY_S)
                    share = FEED_S / self._seconds[i]
                    self._squares[i] = square if mean != mean else mean + share * (square - mean)
            if waiting:
                self._due_s = min(self._due_s, waiting[0][0])
        observer_m, plain_m = self.errors_m
        if observer_m > max(WORSE * plain_m, SMALL_M):
            self._worse_since_s = t_s if not self._worse_since_s <= t_s else self._worse_since_s
        else:
            self._worse_since_s = nan

    @property
    def errors_m(self) -> tuple[float, float]:
        """Rolling RMS of the observer's forecasts and of the regression's, m; nan: not known."""
        return sqrt(self._squares[0]), sqrt(self._squares[1])

    @property
    def doubts(self) -> tuple[str, ...]:
        return (DOUBT,) if self._fed_s - self._worse_since_s >= LASTS_S else ()

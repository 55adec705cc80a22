"""Whether the sensor that is heard again after a gap has the bias that it had before.

Readings stop for some seconds because a line is bad, or because the sensor has lost its supply; and one that has begun
anew may have found another zero. A filter that goes on with the bias of before then takes the difference for a long
wave, and the wave state, of which nothing is known after a gap, leaves room for metres of it. So beside the one that
serves, another goes on from the same state with nothing known of the bias. Which of them explains the readings is
weighed by their likelihoods (Bayes); until it is known, what they differ by is not known either.
"""

from __future__ import annotations

from enum import Enum, auto
from math import exp, log, sqrt
from typing import Final

import msgspec

from heaved.estimation.heave.sea.filter import SeaFilter


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """When it is asked, and when it is known."""

    gap_s: float = 5.0
    """A sensor of this kind needs as long to begin anew and be found again on its line."""
    prior: float = 0.1
    """Of the gaps so many are of a sensor that has another bias then: nobody has counted."""
    known: float = 1e-3
    """Of what is less likely nobody speaks any more."""
    least_s: float = 5.0
    """Before, neither is given up: a wave has to pass."""
    longest_s: float = 60.0
    """Then the likelier one serves."""


TUNING: Final = Tuning()


class Finding(Enum):
    """What is known of the bias."""

    OPEN = auto()
    SAME = auto()
    ANOTHER = auto()


class AfterGap:
    """Made of the filter as it was before the gap; step it after that with every reading.

    Attributes:
        other: the filter that knows nothing of the bias.
        apart_m: standard deviation of the heave for what the two differ by.
        silent_s: the gap.
    """

    def __init__(self, serving: SeaFilter, t_s: float) -> None:
        """``t_s``: of the first reading after it."""
        self.other = SeaFilter(serving.system, serving.steady, serving.t_s, serving.x, None)
        self.other.restore(serving.state())
        self.other.open_bias()
        self.apart_m = 0.0
        self.silent_s = serving.t_s, t_s
        self._log_odds = log(TUNING.prior / (1.0 - TUNING.prior))

    def step(self, serving: SeaFilter, t_s: float, a_mps2: float) -> Finding:
        """Take a reading that the serving filter has just taken."""
        other = self.other
        other.step(t_s, a_mps2)
        for f, sign in ((serving, -1.0), (other, 1.0)):
            y, S = f.innovation, f.innovation_variance
            self._log_odds -= sign * 0.5 * (y * y / S + log(S))
        odds = exp(min(max(self._log_odds, -50.0), 50.0))
        likely = odds / (1.0 + odds)
        since_s = t_s - self.silent_s[1]
        # As long as it is asked, it is no less likely than it was before anything was seen.
        self.apart_m = sqrt(max(likely, TUNING.prior)) * abs(float(serving.system.heave.dot(serving.x - other.x)))
        if since_s < TUNING.least_s or (TUNING.known < likely < 1.0 - TUNING.known and since_s < TUNING.longest_s):
            return Finding.OPEN
        return Finding.ANOTHER if likely > 0.5 else Finding.SAME

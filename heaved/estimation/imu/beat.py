"""A sensor that measures nearly as often as it is polled: how old its readings are.

Two clocks that should be alike are some ten or hundred parts in a million apart. The age of what is read then goes
from nothing to a whole period and back within minutes, which no reading shows: at 20 polls a second half a period is
25 ms, and in a rough sea more than all other errors of the heave together. A sensor that is slower than its polls shows
it once in a while: a poll finds the reading of before, all of it, to the last bit. The reading was just new one poll
earlier, so that the next one is a whole period old; from then on they are less old with every poll, until that comes
again.

A repetition may also be a device that was held up, or a gateway that answers twice. So nothing is moved before
repetitions have come evenly; until then what they may mean is in the deviation. A sensor that is faster than its polls
shows nothing: its readings are up to a period old, unknown to anybody. (:mod:`heaved.estimation.imu.sensor_clock` is
for those that are much slower.)
"""

from __future__ import annotations

from math import nan, sqrt
from typing import Final

import msgspec


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Of :class:`Beat`. Without a source: chosen, and held by the tests of sensors that are a little slow."""

    fewest: int = 24
    """Polls from one repetition to the next, at least: more of them are a slower sensor's."""
    even: float = 0.05
    """Times between repetitions that are alike by this share of them, and two polls, are those of two clocks."""
    proven: int = 3
    """So many repetitions on end prove it,"""
    proven_again: int = 5
    """and so many where others have come unevenly."""
    maybe: float = 0.5
    """Before, it is as likely as not."""
    known: float = 0.05
    """How well the age is known then, in periods: clocks drift, and polls are late."""
    poll_memory: float = 50.0
    """Polls by which their interval is known."""
    late: float = 1.5
    """A poll that comes after so many of them says nothing."""


TUNING: Final = Tuning()


class Beat:
    """Feed it every poll in order of time.

    Attributes:
        age_s: by which what is read was measured earlier than it was polled.
        std_s: how well that is known.
    """

    def __init__(self) -> None:
        self.age_s = self.std_s = 0.0
        self._poll_s = self._t_s = self._began_s = nan
        self._repeats_s: list[float] = []
        """Of repetitions that are even, or may be."""
        self._needed = TUNING.proven

    def step(self, t_s: float, *, is_repeated: bool) -> None:
        """A poll; ``is_repeated``: all that it shows is as in the one before."""
        elapsed_s = t_s - self._t_s
        self._t_s = t_s
        if self._poll_s != self._poll_s:
            self._poll_s, self._began_s = elapsed_s, t_s
        elif elapsed_s < TUNING.late * self._poll_s:
            self._poll_s += (elapsed_s - self._poll_s) / TUNING.poll_memory
        if is_repeated:
            self._repeated(t_s)
        if self._repeats_s:
            self._conclude(t_s - self._repeats_s[-1])

    def _repeated(self, t_s: float) -> None:
        repeats_s = self._repeats_s
        before_s = repeats_s[-1] if repeats_s else self._began_s
        since_s = t_s - before_s
        if len(repeats_s) > 1:
            is_even = abs(since_s - self._beat_s) < TUNING.even * self._beat_s + 2.0 * self._poll_s
        else:
            # From the beginning to the first it is less than a beat.
            first_s = repeats_s[0] - self._began_s if repeats_s else 0.0
            is_even = not repeats_s or since_s > (1.0 - TUNING.even) * first_s - 2.0 * self._poll_s
        if not is_even or (repeats_s and since_s < TUNING.fewest * self._poll_s):
            self._needed, self._began_s = TUNING.proven_again, t_s
            repeats_s.clear()
            self.age_s = self.std_s = 0.0
        repeats_s.append(t_s)
        del repeats_s[: -TUNING.proven_again]

    @property
    def _beat_s(self) -> float:
        """From repetition to repetition, in the mean."""
        repeats_s = self._repeats_s
        return (repeats_s[-1] - repeats_s[0]) / (len(repeats_s) - 1)

    def _conclude(self, since_s: float) -> None:
        """How old readings are so long after the last repetition."""
        repeats_s, poll_s = self._repeats_s, self._poll_s
        if len(repeats_s) > 1 and since_s > (1.0 + TUNING.even) * self._beat_s + 2.0 * poll_s:
            self._repeats_s, self._needed, self._began_s = [], TUNING.proven_again, self._t_s
            self.age_s = self.std_s = 0.0
        elif len(repeats_s) >= self._needed:
            self.age_s = poll_s * max(1.0 - since_s / self._beat_s, 0.0)
            self.std_s = TUNING.known * poll_s
        elif self._needed == TUNING.proven:
            # The beat is longer than any time without a repetition: with 1 / beat^2 as its density beyond, the mean
            # square of 1 - since / beat is this, and there is one at all the less likely the longer it does not come.
            seen_s = max(repeats_s[0] - self._began_s, repeats_s[-1] - repeats_s[0])
            longest_s = max(seen_s, since_s, poll_s)
            x = since_s / longest_s
            square = TUNING.maybe * (1.0 - x + x * x / 3.0) * seen_s / longest_s
            self.std_s = poll_s * sqrt(max(square, 0.0))

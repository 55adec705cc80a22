"""One joint of a crane: where it is and how fast it moves, from the readings of its encoder.

A Kalman filter on position q and rate w, which is an Ornstein-Uhlenbeck process (q its integral; Singer, IEEE Trans.
AES-6, 1970, one derivative lower): left alone the rate soon dies out, and what is known of the position grows vague as
fast as a crane can move, no faster. An encoder of 0.1 degrees, read ten times a second, steps by a degree a second when
its readings are merely subtracted; jitter of their times, repeated and missing readings do worse. A filter takes all
that as it is.
"""

from __future__ import annotations

from math import exp, expm1, isfinite, nan, pi, sqrt
from typing import Final

import msgspec

TURN: Final = 2.0 * pi


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What is set by us, not by the user. Without a source: chosen on simulated cranes, held by their tests."""

    memory_s: float = 5.0
    """Of the rate: of a move of ten seconds, with ramps of one to three."""
    steady_s: float = 0.6
    """The rate goes on for so long without readings before it dies out: of 2 a second none need be missing."""
    of_fastest: float = 0.577
    """Standard deviation of the rate by the fastest: that of a rate that is anything up to it alike, 1/sqrt(3)."""
    gate: float = 5.0
    """A reading further off than so many standard deviations is a spike ..."""
    believed: int = 3
    """... unless so many in a row agree with each other: then the encoder has been set anew."""
    hold_memory: float = 0.1
    """Weight of one change of the reading in for how long readings usually stay the same, while it moves."""
    longest_hold_s: float = 0.6
    """Of an encoder of 2 readings a second."""
    usual_holds: float = 1.5
    """A reading that has stayed for so many usual times will stay."""


TUNING: Final = Tuning()


class Joint:
    """Feed it readings in order of time.

    Attributes:
        seen_s: time of the last reading that was taken; nan: there was none.
        jumps: times that it began anew because readings went on from somewhere else.
        spikes: readings that were kept out.
    """

    def __init__(self, *, std: float, fastest: float, turns: bool) -> None:
        """``std``: of one reading. ``fastest``: rate that it can have. ``turns``: an angle, the same after a turn."""
        self.seen_s = nan
        self.jumps = self.spikes = 0
        self._R = std * std
        self._rate_variance = (TUNING.of_fastest * fastest) ** 2
        self._fastest, self._turns = fastest, turns
        self._t_s = nan
        self._q = self._w = nan
        self._P = (nan, nan, nan)
        """Of q, of both, of w."""
        self._value = self._since_s = nan
        """The latest reading, and when it first came."""
        self._hold_s = 0.0
        self._refused: list[tuple[float, float]] = []
        """Readings kept out since the last one taken: time and value."""

    def step(self, t_s: float, value: float) -> None:
        """Take a reading; nan, and one that is not newer than the last, says nothing."""
        if not isfinite(value):
            return
        if not isfinite(self._t_s):
            self._begin(t_s, value)
            return
        if t_s <= self._t_s:
            return
        if self._is_repeated(t_s, value):
            if not self._refused:
                self.seen_s = t_s
            return
        q, w, (P11, P12, P22) = self._moved(t_s)
        self._t_s = t_s
        y, S = self._apart(value, q), P11 + self._R
        if y * y > TUNING.gate**2 * S:
            self._q, self._w, self._P = q, w, (P11, P12, P22)
            self._refuse(t_s, value)
            return
        self._refused.clear()
        K1, K2 = P11 / S, P12 / S
        self._q, self._w = q + K1 * y, w + K2 * y
        self._P = (P11 - K1 * P11, P12 - K1 * P12, P22 - K2 * P12)
        self.seen_s = t_s

    def at(self, t_s: float) -> tuple[float, float, float]:
        """Position, rate and the position's standard deviation at a moment; nan: nothing is known.

        Later than the last reading it has moved on, with a rate that dies out.
        """
        if t_s <= self._t_s:
            return self._q + (t_s - self._t_s) * self._w, self._w, sqrt(self._P[0])
        q, w, P = self._moved(t_s)
        return q, w, sqrt(P[0])

    def _moved(self, t_s: float) -> tuple[float, float, tuple[float, float, float]]:
        """State and covariance at a later moment."""
        dt, tau, variance = t_s - self._t_s, TUNING.memory_s, self._rate_variance
        # Covariance of an Ornstein-Uhlenbeck process and its integral (Uhlenbeck & Ornstein, Phys. Rev. 36, 1930).
        d = -expm1(-dt / tau)
        Q11 = variance * tau * tau * (2.0 * (dt / tau - d) - d * d)
        Q12, Q22 = variance * tau * d * d, variance * d * (2.0 - d)
        # From reading to reading the rate stays: dying all the time, it would always be some percent too slow.
        e, a = 1.0, dt
        if dt > TUNING.steady_s:
            e = exp((TUNING.steady_s - dt) / tau)
            a = TUNING.steady_s + tau * (1.0 - e)
        P11, P12, P22 = self._P
        P = (P11 + 2.0 * a * P12 + a * a * P22 + Q11, e * (P12 + a * P22) + Q12, e * e * P22 + Q22)
        return self._q + a * self._w, e * self._w, P

    def _begin(self, t_s: float, value: float) -> None:
        self._t_s = self.seen_s = self._since_s = t_s
        self._q, self._w, self._value = value, 0.0, value
        self._P = (self._R, 0.0, self._rate_variance)
        self._refused.clear()

    def _is_repeated(self, t_s: float, value: float) -> bool:
        """Whether it is an earlier reading once more, as there usually are before the next one: it tells of then, not
        of now. One that stays for longer tells that the joint does.
        """
        since_s = t_s - self._since_s
        if value == self._value:
            return since_s <= TUNING.usual_holds * self._hold_s
        if since_s <= TUNING.longest_hold_s:
            self._hold_s += TUNING.hold_memory * (since_s - self._hold_s)
        self._value, self._since_s = value, t_s
        return False

    def _refuse(self, t_s: float, value: float) -> None:
        """Keep a reading out, unless it is one of several that agree: then begin anew with it."""
        if self._refused:
            last_s, last = self._refused[-1]
            reach = self._fastest * (t_s - last_s) + TUNING.gate * sqrt(2.0 * self._R)
            if abs(self._apart(value, last)) > reach:
                self._refused.clear()
        self._refused.append((t_s, value))
        if len(self._refused) >= TUNING.believed:
            self.jumps += 1
            self._begin(t_s, value)
        else:
            self.spikes += 1

    def _apart(self, value: float, from_value: float) -> float:
        """The difference, of an angle the way that is shorter."""
        difference = value - from_value
        return (difference + pi) % TURN - pi if self._turns else difference

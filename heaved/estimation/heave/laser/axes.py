"""What a laser shows of the axes of the accelerometers: a linear layer before the observer, guarded.

An IMU that stands askew, whose axes leak into each other or whose scale bends puts attitude and horizontal acceleration
into the vertical one (:mod:`heaved.estimation.imu.leaks`): linearly, by a handful of unknowns that no sea changes. They
are found by kinematics alone. Over a piece of half a minute, whatever the observer thinks,

    reading = double integral of (acceleration - sum w_k leak_k) + cubic in time + nuisances,

for what the integral begins with, and what the bias does meanwhile, is a cubic. Nuisances are what a laser shows beside
(gain, lag and spread of the sensor; where the gauge really is), so that a lever arm is not taken for a leak, nor a leak
for a lever arm: on a sea of more than one period they are not alike, a tilt a reads as a lever arm of g a / omega^2.

A ridge regression (Hoerl and Kennard 1970), each unknown with the size that such things have as its prior, is fitted
with few columns and with more. Each piece is held out in turn: what some columns take off its sum of squares, over the
variance that they leave, is twice a likelihood ratio. It is summed over the pieces, so that a thing which shows only
when waves are high is found as well; each column has its price, no piece decides alone, and few may speak against it.
Those are taken that are worth most beyond their price. What is in use stays until the newest pieces speak against it as
surely. Found, it is taken out of the acceleration, the past included, so that observer, forecasts and delayed heave
have right physics; and it stays through an outage and a change of the sea, for it is a property of the sensor.

Without roll and pitch nothing of this is known: nothing is learned, and nothing taken out.
"""

from __future__ import annotations

from collections import deque
from math import inf, isfinite, isnan, nan, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.heave.laser.placement import heaves_m
from heaved.estimation.imu.attitude_error import Amendment
from heaved.estimation.imu.leaks import Leak

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.estimation.heave.laser.geometry import Geometry
    from heaved.estimation.heave.laser.tilts import Tilt
    from heaved.estimation.imu.vertical import VerticalAcceleration

Array = NDArray[np.float64]

COUNT: Final = len(Leak)
NUISANCES: Final = 5
"""Gain, lag, spread, and the lever arm forward and to port."""
SIZE: Final = COUNT + NUISANCES + 1
"""Columns of a piece."""


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """How pieces are made, and what counts as shown."""

    piece_s: float = 30.0
    """A few waves; over longer ones the noise of the accelerometer, integrated twice, is more than that of a laser."""
    least_seen: float = 0.5
    """Share of a piece in which there are readings."""
    order: int = 3
    """Of the polynomial in time."""
    every_s: float = 0.2
    """Readings closer together than this are left out."""
    gap_s: float = 0.3
    """Between accelerations further apart the vessel may have done anything."""
    kept: int = 40
    """Pieces: twenty minutes of laser."""
    least: int = 3
    """Pieces before anything is concluded."""
    price: float = 20.0
    """Of an unknown, in twice a log likelihood: e^10 times as likely. At e^5, of 36 records of IMUs without such
    errors, 5 show one: what an attitude leaves is not white; a bend of 1 % shows with that on half of the swells."""
    loudest: float = 40.0
    """A piece says no more than that for or against: one with something else in it is not to decide."""
    against: float = 0.4
    """Nor may those that speak against it say more than that share of what the others do."""
    newest: int = 6
    """Pieces which let go what is in use, when they say more against it than one may."""
    independent_s: float = 2.0
    """Residuals so far apart count as independent."""
    nuisances: tuple[float, float, float, float, float] = (0.1, 0.3, 0.1, 5.0, 5.0)
    """Standard deviations of the nuisances before anything is known: gain, s, s2, m, m."""
    turned: float = 0.05
    """The same of triads that are askew, rad: three degrees,"""
    leaking: float = 0.02
    """of the leak of an axis into another: one per cent is in data sheets,"""
    bent: float = 0.01
    """and of what an axis shows more for each g."""
    most: float = 0.15
    """Nothing is believed of an IMU that is worse than that: eight degrees askew."""
    past_s: float = 600.0
    """What is found is taken out of so much of the past: the sea is fitted to it."""
    past_every_s: float = 0.2
    """Which is kept in steps of that: no wave moves within it."""
    remembered_s: float = 7.0 * 86400.0
    """What an earlier run has found is not taken out when nothing has borne it out for longer: an IMU may have been
    mounted anew. A younger one the next three pieces judge."""
    rounds: int = 3
    """For what is left to weigh the rows by, which depends on the solution."""


TUNING: Final = Tuning()


class SavedAxes(msgspec.Struct, frozen=True, kw_only=True):
    """What a restart remembers of the axes."""

    weights: tuple[float, ...]
    """As :attr:`AxisErrors.weights`."""
    unconfirmed_s: float = 0.0
    """Since a laser last bore them out."""


class Columns(msgspec.Struct, frozen=True, eq=False):
    """A hypothesis: which combinations of the unknowns there are, and how large they may be."""

    mixes: Array
    """(COUNT, k)."""
    std: Array
    """(k,)."""


class _Sums(msgspec.Struct, frozen=True, eq=False):
    """Of the rows of m pieces, or of m sets of pieces."""

    grams: Array
    """(m, SIZE, SIZE): products of the columns and, last, of what they are to explain."""
    rows: Array
    """(m,)"""


def _hypotheses() -> tuple[Columns, ...]:
    """From the plainest to all that there may be."""
    one = np.eye(COUNT)
    forward_up, port_up, up_forward, up_port = one[:, : Leak.ACROSS].T
    turned = np.column_stack((forward_up - up_forward, port_up - up_port))
    leaking = np.column_stack((turned, forward_up + up_forward, port_up + up_port))
    t = TUNING
    of_turned, of_leaking = np.full(2, t.turned), np.array((t.turned, t.turned, t.leaking, t.leaking))
    bent = one[:, [Leak.BEND]], np.array((t.bent,))
    crossed = np.hstack((leaking, one[:, [Leak.ACROSS]])), np.append(of_leaking, t.leaking)
    return (
        Columns(turned, of_turned),
        Columns(*bent),
        Columns(leaking, of_leaking),
        Columns(*crossed),
        Columns(np.hstack((crossed[0], bent[0])), np.concatenate((crossed[1], bent[1]))),
    )


HYPOTHESES: Final = _hypotheses()
LEAST_M2: Final = 1e-12
"""Mean square of what is left, to divide by."""
NOTHING: Final = Columns(np.zeros((COUNT, 0)), np.zeros(0))


class AxisErrors:
    """Step it with every vertical acceleration, push it every reading of the target; it gives the acceleration without
    what the axes put into it.

    Attributes:
        weights: (COUNT,) what has been found of each unknown; 0: nothing.
        is_in_use: whether anything has been found.
        changes: how often what is taken out has changed,
        moved_m: RMS by which that has moved the heave, and
        begun: how often something was, and nothing before.
        amendment: what has been found of the past; take it away.
    """

    def __init__(self, max_rate_hz: float, noise_std_m: float, *, enabled: bool) -> None:
        """``max_rate_hz``: of the IMU; a faster one is not looked at. ``noise_std_m``: of one reading."""
        self._enabled = enabled
        self._noise_std_m = noise_std_m
        rows = int((TUNING.piece_s + 5.0) * max_rate_hz) if enabled else 1
        self._forces = RingBuffer(rows, 2 + COUNT)
        """Time, acceleration as measured, leaks."""
        self._past = RingBuffer(max(1, round(TUNING.past_s / TUNING.past_every_s)) if enabled else 1, 1 + COUNT)
        self._since_s = inf
        """Accelerations have no gap since then."""
        self._t_s = self._past_s = -inf
        self._readings: list[tuple[float, float, float, float]] = []
        """Time, reading, roll, pitch, of the piece that has begun."""
        self._pieces: deque[tuple[Array, int]] = deque(maxlen=TUNING.kept)
        """Products of the columns of each, and its rows."""
        self.weights: Array = np.zeros(COUNT)
        self._weights: list[float] = [0.0] * COUNT
        self.is_in_use = self.is_applied = False
        self.changes = self.begun = 0
        self.moved_m = 0.0
        self.amendment: Amendment | None = None
        self._unconfirmed_s, self._first_s = 0.0, nan
        """What is in use had not been borne out for so long when this run began; and its first moment."""
        self._confirmed_s = nan
        """When it last was, in this run."""

    # --- memory ------------------------------------------------------------------------------------------------------

    def saved(self) -> SavedAxes | None:
        """What a restart shall remember; None: nothing has been found."""
        if not self.is_in_use:
            return None
        before_s = self._unconfirmed_s if isnan(self._confirmed_s) else 0.0
        last_s = self._first_s if isnan(self._confirmed_s) else self._confirmed_s
        since_s = self._t_s - last_s if isfinite(self._t_s - last_s) else 0.0
        return SavedAxes(weights=tuple(self._weights), unconfirmed_s=before_s + since_s)

    def restore(self, saved: SavedAxes, age_s: float) -> None:
        """Begin with what an earlier run has found ``age_s`` ago (nan: not known); call before the first sample."""
        unconfirmed_s = saved.unconfirmed_s + (age_s if isfinite(age_s) else 0.0)
        if not self._enabled or unconfirmed_s > TUNING.remembered_s or len(saved.weights) != COUNT:
            return
        self._unconfirmed_s = unconfirmed_s
        self.weights, self._weights = np.array(saved.weights), list(saved.weights)
        self.is_in_use = any(saved.weights)

    @property
    def taken(self) -> Sequence[float]:
        """(COUNT,) shares of the leaks that are taken out of the acceleration; empty: none is."""
        return self._weights if self.is_in_use else ()

    # --- input -------------------------------------------------------------------------------------------------------

    def step(self, up: VerticalAcceleration) -> float:
        """The vertical acceleration without what has been found of the axes."""
        leaks, t_s = up.leaks_mps2, up.t_s
        if not self._enabled:
            return up.up_mps2
        if leaks is None or not isfinite(up.up_mps2 + sum(leaks)):
            self.cut()
            self.is_applied = False
            return up.up_mps2
        if not t_s > self._t_s:
            return up.up_mps2
        if not t_s - self._t_s <= TUNING.gap_s:
            self._since_s = t_s
            self._readings.clear()
        self._t_s = t_s
        if isnan(self._first_s):
            self._first_s = t_s
        if up.amendment is not None:
            self._forces.add(1, up.amendment.t_s, up.amendment.more_mps2)
        self._forces.push((t_s, up.up_mps2, *leaks))
        if t_s - self._past_s >= TUNING.past_every_s - 1e-3:
            self._past_s = t_s
            self._past.push((t_s, *leaks))
        self.is_applied = self.is_in_use
        if not self.is_in_use:
            return up.up_mps2
        return up.up_mps2 - sum([w * leak for w, leak in zip(self._weights, leaks, strict=True)])

    def cut(self) -> None:
        """What comes does not go on from what was: another target, or no attitude."""
        self._since_s = inf
        self._t_s = -inf
        self._readings.clear()

    def retarget(self) -> None:
        """The readings are of another target."""
        self._readings.clear()

    def push(self, t_s: float, reading_m: float, tilt: Tilt | None, configured: Geometry) -> bool:
        """Take a reading of the target, with the attitude of its time, by a gauge that is held to be where it is
        configured. True: the heave is another one from now on, by more than a laser's noise.
        """
        if not self._enabled or tilt is None or not self._since_s <= t_s <= self._t_s:
            return False
        readings = self._readings
        if readings and t_s - readings[-1][0] < TUNING.every_s - 1e-3:
            return False
        is_full = bool(readings) and t_s - readings[0][0] > TUNING.piece_s - 1e-3
        is_new = is_full and self._end_piece(configured)
        readings.append((t_s, reading_m, *tilt))
        return is_new

    def _end_piece(self, configured: Geometry) -> bool:
        """A piece is over: take it, and look at all there are. True: what is taken out has changed by much."""
        readings = np.array(self._readings)
        self._readings.clear()
        if len(readings) * TUNING.every_s < TUNING.least_seen * TUNING.piece_s:
            return False
        piece = self._piece(readings, configured)
        if piece is None:
            return False
        self._pieces.append(piece)
        return len(self._pieces) >= TUNING.least and self._look()

    def _piece(self, readings: Array, configured: Geometry) -> tuple[Array, int] | None:
        """The sums of a piece; None: it has nothing to say."""
        at_s = readings[:, 0]
        rows = self._forces.since(at_s[0] - TUNING.gap_s)
        rows = rows[rows[:, 0] <= at_s[-1] + TUNING.gap_s]
        if len(rows) < 2 or rows[0, 0] > at_s[0] or rows[-1, 0] < at_s[-1]:
            return None
        t_s, up = rows[:, 0], rows[:, 1:2]
        once = _integral(t_s, rows[:, 1:])
        twice = _integral(t_s, once)
        # Leaks, gain, lag and spread at the readings, lever arms; and what the acceleration makes more of the heave.
        moved = np.hstack((twice[:, 1:], twice[:, :1], once[:, :1], up))
        moved = np.column_stack([np.interp(at_s, t_s, column) for column in moved.T])
        reading_m, roll, pitch = readings[:, 1:].T
        ahead, across = np.sin(pitch), np.sin(roll) * np.cos(pitch)
        rest_m = moved[:, COUNT] - heaves_m(configured, reading_m, roll, pitch)
        table = np.column_stack((moved, ahead, across, rest_m))
        if not np.isfinite(table).all():
            return None
        along = 2.0 * (at_s - at_s[0]) / (at_s[-1] - at_s[0]) - 1.0
        smooth, _ = np.linalg.qr(np.polynomial.legendre.legvander(along, TUNING.order))
        table -= smooth @ (smooth.T @ table)
        return table.T @ table, len(table)

    # --- what the pieces say -----------------------------------------------------------------------------------------

    def _look(self) -> bool:
        grams, rows = np.array([gram for gram, _ in self._pieces]), np.array([float(n) for _, n in self._pieces])
        pieces, everything = _Sums(grams, rows), _Sums(np.sum(grams, axis=0)[None], np.sum(rows)[None])
        others = _Sums(everything.grams - grams, everything.rows - rows)

        def left(hypothesis: Columns, given: Array | None = None) -> Array:
            """What each piece keeps of its mean square when it is held out."""
            return _left(pieces, _fitted(others, hypothesis, given))

        nothing = left(NOTHING)
        if self.is_in_use:
            said = _said(nothing, left(NOTHING, self.weights), rows)[-TUNING.newest :]
            if _worth(said, 0) > TUNING.loudest:
                # It is another IMU, or stands otherwise: what the older pieces say is of before.
                while len(self._pieces) > TUNING.least:
                    self._pieces.popleft()
                return self._take(np.zeros(COUNT))
        best = _best([left(each) for each in HYPOTHESES], nothing, rows)
        if best is not None:
            found = _fitted(everything, best)[0, :COUNT]
            if float(np.max(np.abs(found))) <= TUNING.most:
                self._confirmed_s = self._t_s
                return self._take(found)
        if self.is_in_use:
            self._confirmed_s = self._t_s
        return False

    def _take(self, weights: Array) -> bool:
        if np.array_equal(weights, self.weights):
            return False
        more = weights - self.weights
        self.moved_m = sqrt(
            max(float(np.mean([more @ gram[:COUNT, :COUNT] @ more / n for gram, n in self._pieces])), 0.0)
        )
        was_in_use = self.is_in_use
        self.weights, self._weights = weights, weights.tolist()
        self.is_in_use = bool(np.any(weights != 0.0))
        self.changes += 1
        self.begun += self.is_in_use and not was_in_use
        past = self._past.last(len(self._past))
        self.amendment = Amendment(past[:, 0].copy(), -past[:, 1:] @ more)
        return self.moved_m > self._noise_std_m or self.is_in_use is not was_in_use


def _integral(t_s: Array, rates: Array) -> Array:
    """Of (n, k) over time (n,), by trapezoids, from nothing."""
    areas = 0.5 * (rates[1:] + rates[:-1]) * np.diff(t_s)[:, None]
    return np.vstack((np.zeros((1, rates.shape[1])), np.cumsum(areas, axis=0)))


def _said(more: Array, plain: Array, rows: Array) -> Array:
    """(m,) what each piece says for that which leaves ``more`` of it, against what leaves ``plain``: twice the
    logarithm of how much more likely it is.
    """
    variance = max(float(more @ rows) / float(np.sum(rows)), LEAST_M2)
    said = (plain - more) * rows * TUNING.every_s / (TUNING.independent_s * variance)
    return np.clip(said, -TUNING.loudest, TUNING.loudest)


def _worth(said: Array, columns: int) -> float:
    """What so many columns more are worth beyond their price; nothing where too many pieces speak against them."""
    against = -float(np.sum(said[said < 0.0]))
    if against > TUNING.against * float(np.sum(said[said > 0.0])):
        return 0.0
    return float(np.sum(said)) - TUNING.price * columns


def _best(lefts: Sequence[Array], nothing: Array, rows: Array) -> Columns | None:
    """The hypothesis that is worth most, given what each leaves of the pieces: first against nothing, where all may
    say as much as they can, then against the best so far. None: none is worth its price.
    """
    best, plain = NOTHING, nothing
    for _ in HYPOTHESES:
        worths = [
            _worth(_said(left, plain, rows), len(each.std) - len(best.std))
            for left, each in zip(lefts, HYPOTHESES, strict=True)
        ]
        at = int(np.argmax(worths))
        if not worths[at] > 0.0:
            break
        best, plain = HYPOTHESES[at], lefts[at]
    return None if best is NOTHING else best


def _fitted(known: _Sums, hypothesis: Columns, given: Array | None = None) -> Array:
    """(m, COUNT + NUISANCES) sizes of all columns: those of the hypothesis and the nuisances by ridge regression, what
    is ``given`` of the unknowns (COUNT,) as it is.
    """
    offset, free = np.zeros(COUNT + NUISANCES), len(hypothesis.std)
    if given is not None:
        offset[:COUNT] = given
    mixes = np.zeros((COUNT + NUISANCES, free + NUISANCES))
    mixes[:COUNT, :free] = hypothesis.mixes
    mixes[COUNT:, free:] = np.eye(NUISANCES)
    G, b = known.grams[:, :-1, :-1], known.grams[:, :-1, -1]
    normal, moments = mixes.T @ G @ mixes, (b - G @ offset) @ mixes
    prior = np.diag(1.0 / np.square(np.concatenate((hypothesis.std, TUNING.nuisances))))
    share = TUNING.every_s / TUNING.independent_s
    variance = _left(known, np.broadcast_to(offset, b.shape))
    solution = np.zeros(b.shape)
    for _ in range(TUNING.rounds):
        weight = share / np.maximum(variance, LEAST_M2)
        left = weight[:, None, None] * normal + prior
        solution = offset + np.linalg.solve(left, (weight[:, None] * moments)[:, :, None])[:, :, 0] @ mixes.T
        variance = _left(known, solution)
    return solution


def _left(pieces: _Sums, solutions: Array) -> Array:
    """(m,) mean squares of what the sizes of the columns (m, COUNT + NUISANCES) leave unexplained, m2."""
    v = np.hstack((solutions, np.full((len(solutions), 1), -1.0)))
    return np.asarray(np.maximum(np.einsum("mi,mij,mj->m", v, pieces.grams, v), 0.0) / pieces.rows)

"""What the own errors of an attitude sensor do to the vertical acceleration, found from the record and taken out.

An attitude sensor that nobody tells the vertical knows it from its accelerometers in the long run and from its
gyroscopes in the short, by a complementary filter of a time constant of some 5 to 20 s. So it leans into horizontal
acceleration; and its solution comes later than the accelerations, by some tens of milliseconds. Both errors are small
beside the angles, but gravity is removed with them, and angles that are wrong by d do to the vertical acceleration

    y d_roll + x d_pitch + (g + up) (d_roll^2 + d_pitch^2) / 2,

x forward, y to port, up: measured with those angles. The product of two waves has their difference frequency, far below
both, where a millimetre per second squared is decimetres of heave.

**Lean.** The sensor's filter is angle' = rate + k (apparent - angle), k one over its time constant, apparent: as the
specific force would have it. What the measured level still shows, x / (g + up) and y / (g + up), *is* apparent - angle.
So the lean is k times an integral of what is measured, whatever vessel and waves do, and takes no gyroscope. A level
bias makes that integral run away, in a straight line, which is taken out by least squares over the record. What is left
is slow, and an error of the axes that is slow does no harm.

**Lateness.** The angle is off by -late rate, and by -late k apparent: the sensor has compared what was of one moment.
It may be negative: accelerometers have low-passes.

k and lateness are found where they do harm. Below the waves there is no heave; what the vertical acceleration shows
there is noise, and the products through which the two come in. They are fitted to some minutes of it in the frequency
domain, each frequency weighed by what else is there (Gauss-Markov), so that waves, and the foot of a long swell, have
no say (:mod:`heaved.estimation.imu.attitude_fit`). Gyroscopes, where there are any, show both within half a minute.
Where nothing shows them they stay nothing, which they may well be; how far they are not known is
:attr:`AttitudeError.noise`. What is found later than it was needed is taken out of the past as well:
:attr:`AttitudeError.amendment`.
"""

from __future__ import annotations

from math import cos, exp, hypot, inf, isfinite, nan, sin, sqrt
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.ring import RingBuffer
from heaved.estimation.imu import attitude_fit
from heaved.estimation.imu.attitude_fit import MEANS, TUNING, UP, Noise, Run, Unsized
from heaved.estimation.imu.attitude_memory import TUNING as MEMORY
from heaved.estimation.imu.attitude_memory import Memory, SavedAttitudeError
from heaved.samples import GRAVITY_MPS2

Array = NDArray[np.float64]

LEAN: Final = slice(MEANS, MEANS + 2)
"""Columns of the record beside those of :func:`attitude_fit.runs`: the integrals as they stood,"""
ACROSS, ALONG = range(MEANS - 1, MEANS + 1)
"""Of these, among the means of a row,"""
ROLL_RATE, PITCH_RATE = 5, 6
"""and the rates,"""
TAKEN: Final = MEANS + 2
"""what has been taken out of the vertical acceleration,"""
TURNED: Final = MEANS + 3
"""and 1 where gyroscopes have measured all rates, else 0."""


class Amendment(msgspec.Struct, frozen=True, eq=False):
    """What vertical accelerations of the past were too little by."""

    t_s: Array
    """(n,) increasing,"""
    more_mps2: Array
    """(n,)"""


class Lean(msgspec.Struct, frozen=True, gc=False):
    """What measured angles are off by, and how well that is known, rad."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    roll_std_rad: float = 0.0
    pitch_std_rad: float = 0.0
    late_std_s: float = 0.0
    """How well it is known by how much the angles are late: off by as much of their own rates, both at once,"""
    late_roll_std_rad: float = 0.0
    """and what that comes to on average."""
    late_pitch_std_rad: float = 0.0


MEAN_S: Final = 60.0
"""The integrals are known but for what is slow in them. It is their mean of so long: of no vessel that stays at work is
the mean acceleration along or across another than nothing."""
OF_LEAN: Final = 0.12
"""What that leaves of a lean: a wave of 12 s is in it by a sixteenth, and what a level bias that is being learned
makes of the integrals is no straight line."""
SETTLED: Final = 7.0
"""So many times as long it takes to know that; before, it is known less by as much as is lacking."""
SHOWN: Final = 2.0
"""Standard deviations from which the record has shown a lean to whoever wants the angles themselves,"""
LATE_SHOWN: Final = 3.0
"""and a lateness, which moves the end of a long arm by centimetres: of a sensor that is not late, two are shown once in
a few records of ten minutes, for it is looked at every ten seconds."""
COHERENT: Final = 3.0
"""Radians of the waves over which they have lost most of what they have in common with now."""


class AttitudeError:
    """Feed it every acceleration in the level frame of the measured angles; it gives the vertical one corrected.

    Attributes:
        lean_per_s: k, 1/s; 0: the angles do not lean.
        late_s: by which the angles are later than the accelerations.
        covariance: (2, 2) of the two.
        angles_late_s: by which the angles are late; where it is less than nothing it is the accelerometers that are.
        noise: what not knowing them better leaves in the vertical acceleration, as of the last look; take it away.
        unsized: what it leaves in the row that has just ended, by the two; take it away.
        amendment: what has been found out that is worth amending the past for; take it away.
        record: means over the last minutes, a row every quarter of a second.
    """

    def __init__(self, late_s: float = 0.0) -> None:
        """``late_s``: as somebody has measured it; 0: nobody has."""
        self._belief = attitude_fit.told(late_s)
        self.lean_per_s, self.late_s = self._belief.null
        self.covariance: Array = 0.5 * np.diag(np.square(self._belief.spread))
        self._if_any: Array = np.hypot(self._belief.null, self._belief.spread)
        """Of the two, where they are not nothing: whoever wants the angles has one sensor, not the average of those
        that lean and those that do not."""
        self._know()
        self._memory: Memory | None = None
        """Of an earlier run, until the record has taken its place."""
        self._has_looked = False
        self.noise: Noise | None = None
        self.unsized: Unsized | None = None
        self.amendment: Amendment | None = None
        self.record = RingBuffer(round(TUNING.record_s / TUNING.row_s), TURNED + 1)
        self._t_s = self._off_x = self._off_y = nan
        self._along = self._across = 0.0
        """Integrals of the apparent vertical against the measured one, less a straight line, rad s,"""
        self._rise_x = self._rise_y = 0.0
        """and how that rises, rad."""
        self._row, self._until_s, self._look_s = nan, -inf, nan
        self._means = [0.0, 0.0, 0.0, 0.0]
        """Of the two integrals, and of these means,"""
        self._square_along = self._square_across = 0.0
        """and mean squares of what is left,"""
        self._square_roll_rate = self._square_pitch_rate = 0.0
        """and of the rates."""
        self._followed_s = 0.0
        self._samples: list[tuple[float, ...]] = []
        """Of the row that has begun."""
        self._are_rates_measured = True
        """In all of them."""

    def restore(self, saved: SavedAttitudeError, age_s: float) -> None:
        """Begin with what an earlier run has found ``age_s`` ago (nan: not known); call before the first
        sample. The lean is taken out from the first look on: before that nobody knows the integrals it is made of.
        """
        if age_s + saved.unconfirmed_s > MEMORY.serves_s:
            return
        memory = self._memory = Memory(saved, age_s)
        self.late_s = saved.late_s
        of_lean = float(self.covariance[0, 0])
        self.covariance = memory.covariance
        self.covariance[0, 0] = max(of_lean, float(memory.covariance[0, 0]) + saved.lean_per_s**2)
        self._if_any = np.sqrt(np.square(memory.mean) + np.diag(memory.covariance))
        self._know()

    def saved(self) -> SavedAttitudeError | None:
        """What a restart shall remember; None: nothing has been found."""
        if self._memory is not None and not self._memory.is_confirmed:
            return self._memory.unconfirmed
        if not self._has_looked or np.all(np.diag(self.covariance) > np.square(MEMORY.doubt)):
            return None
        of_lean, of_both, _, of_lateness = self.covariance.ravel().tolist()
        return SavedAttitudeError(
            lean_per_s=self.lean_per_s, late_s=self.late_s, covariance=(of_lean, of_both, of_lateness)
        )

    def step(
        self, t_s: float, x_mps2: float, y_mps2: float, up_mps2: float, roll_rad: float, pitch_rad: float,
        roll_radps: float, pitch_radps: float, *, are_rates_measured: bool,
    ) -> float:  # fmt: skip
        """The vertical acceleration at ``t_s`` without the two errors, from the level frame of the measured angles
        (forward, port, up), these angles, and their rates, which gyroscopes may have measured.
        """
        if t_s >= self._until_s:
            self._close(t_s)
        elapsed_s, self._t_s = t_s - self._t_s, t_s
        weight = GRAVITY_MPS2 + up_mps2
        x, y = x_mps2 / weight, y_mps2 / weight
        if elapsed_s <= TUNING.hole_s:
            self._along += elapsed_s * (0.5 * (x + self._off_x) - self._rise_x)
            self._across += elapsed_s * (0.5 * (y + self._off_y) - self._rise_y)
        else:
            self._along = self._across = 0.0
            self._means, self._followed_s = [0.0, 0.0, 0.0, 0.0], 0.0
        self._off_x, self._off_y = x, y
        k, late_s, along, across = self.lean_per_s, self.late_s, self._along, self._across
        # The sensor has compared angle and apparent vertical of one moment.
        roll = k * (across - late_s * (roll_rad + y)) - late_s * roll_radps
        pitch = k * (along - late_s * (pitch_rad + x)) - late_s * pitch_radps
        error = y_mps2 * roll + x_mps2 * pitch + 0.5 * weight * (roll * roll + pitch * pitch)
        self._samples.append(
            (up_mps2, y_mps2, x_mps2, roll_rad, pitch_rad, roll_radps, pitch_radps, across, along, error)
        )
        if not are_rates_measured:
            self._are_rates_measured = False
        return up_mps2 - error

    def amend(self, more: Amendment) -> None:
        """Vertical accelerations of the past were too little by something that is no error of the attitude."""
        self.record.add(UP, more.t_s / TUNING.row_s - 0.5, more.more_mps2)

    def _follow(self, along: float, across: float, roll_radps: float, pitch_radps: float) -> None:
        """Keep what is slow in the integrals, and the size of the rest, and of the rates, from their means over a row:
        nan, where those are not known. The mean of a
        while, and once more the mean of that, are behind a slope by as much each: twice the one less the other is not.
        """
        self._followed_s += TUNING.row_s
        share = TUNING.row_s / min(self._followed_s, MEAN_S)
        means = self._means
        means[0] += share * (along - means[0])
        means[1] += share * (across - means[1])
        means[2] += share * (means[0] - means[2])
        means[3] += share * (means[1] - means[3])
        along += means[2] - 2.0 * means[0]
        across += means[3] - 2.0 * means[1]
        self._square_along += share * (along * along - self._square_along)
        self._square_across += share * (across * across - self._square_across)
        if isfinite(roll_radps + pitch_radps):
            self._square_roll_rate += share * (roll_radps * roll_radps - self._square_roll_rate)
            self._square_pitch_rate += share * (pitch_radps * pitch_radps - self._square_pitch_rate)

    @property
    def _waves(self) -> tuple[float, float]:
        """The integrals without what is slow."""
        along, across, of_along, of_across = self._means
        return self._along - 2.0 * along + of_along, self._across - 2.0 * across + of_across

    def lean(self, t_s: float, omega_radps: float) -> Lean:
        """By how much roll and pitch, as they are measured at a moment at or after the last sample, lean.

        That is k times the integrals less their means: of waves that is the whole of it. ``omega_radps``: of the waves,
        by which the lean goes on to a later moment, as far as they have something in common with now.
        """
        since_s = t_s - self._t_s
        if not -TUNING.hole_s <= since_s:
            return Lean()
        std = self._lean_std
        k = self.lean_per_s if self.lean_per_s > SHOWN * std else 0.0
        late2 = self._late_square
        late = sqrt(late2), sqrt(late2 * self._square_roll_rate), sqrt(late2 * self._square_pitch_rate)
        if k == 0.0:
            k2 = self._lean_square
            return Lean(0.0, 0.0, sqrt(k2 * self._square_across), sqrt(k2 * self._square_along), *late)
        settling = max(SETTLED * MEAN_S / max(self._followed_s, MEAN_S), 1.0)
        doubt = hypot(std, OF_LEAN * k * settling)
        turned = omega_radps * max(since_s, 0.0)
        left = exp(-((turned / COHERENT) ** 2))
        c, s = left * cos(turned), left * (sin(turned) / omega_radps if omega_radps > 0.0 else since_s)
        along, across = self._waves
        along = c * along + s * (self._off_x - self._rise_x)
        across = c * across + s * (self._off_y - self._rise_y)
        lost2 = doubt**2 + k * k * (1.0 - left * left)
        return Lean(k * across, k * along, sqrt(lost2 * self._square_across), sqrt(lost2 * self._square_along), *late)

    def _know(self) -> None:
        """What is asked for with every sample, from what has been found: that changes once in ten seconds."""
        self._lean_std = sqrt(float(self.covariance[0, 0]))
        is_known = self._belief.null[1] > 0.0 or self.late_s > LATE_SHOWN * sqrt(float(self.covariance[1, 1]))
        self.angles_late_s = max(self.late_s, 0.0) if is_known else 0.0
        self._late_square = float(self.covariance[1, 1] if self.angles_late_s else self._if_any[1] ** 2)
        self._lean_square = float(self._if_any[0] ** 2)

    def _close(self, t_s: float) -> None:
        """Keep the row that has ended, and look at them all when it is time to."""
        if self._samples:
            means = [sum(column) / len(self._samples) for column in zip(*self._samples, strict=True)]
            self.record.push((self._row, *means, float(self._are_rates_measured)))
            now = self.record.last(1)[0]
            self.unsized = attitude_fit.unsized(now, (self.lean_per_s, self.late_s), self.covariance)
            self._samples, self._are_rates_measured = [], True
            self._follow(means[ALONG], means[ACROSS], *means[ROLL_RATE : PITCH_RATE + 1])
            if t_s >= self._look_s:
                self._look_s = t_s + TUNING.every_s
                self._look()
        else:
            self._look_s = t_s + TUNING.first_s
        self._row = t_s // TUNING.row_s
        self._until_s = TUNING.row_s * (self._row + 1.0)

    def _look(self) -> None:
        rows = self.record.last(len(self.record))
        runs = attitude_fit.runs(rows)
        if not runs or runs[-1].number[-1] != rows[-1, 0]:
            return
        last = runs[-1]
        across, along = (last.lean[-1] - rows[-1, LEAN]).tolist()
        self._across += across
        self._along += along
        shifts = (along, across, along, across)
        self._means = [mean + shift for mean, shift in zip(self._means, shifts, strict=True)]
        self._rise_y, self._rise_x = last.rise.tolist()
        turned = rows[:, TURNED] == 1.0
        solution = self._learn(runs, runs if turned.all() else attitude_fit.runs(rows[turned]))
        error = np.concatenate([attitude_fit.error(run.made, solution) for run in runs])
        error = np.interp(rows[:, 0], np.concatenate([run.number for run in runs]), error)
        more = rows[:, TAKEN] - error
        self.amendment = Amendment(TUNING.row_s * (rows[:, 0] + 0.5), more)
        self.record.add(TAKEN, rows[:, 0], -more)

    def _learn(self, record: list[Run], turned: list[Run]) -> Array:
        """The two, as the record shows them; ``turned``: that part of it whose rates gyroscopes have measured."""
        belief, told = attitude_fit.turned(turned, self._belief), (np.zeros((2, 2)), np.zeros(2))
        if (found := attitude_fit.spectra(record)) is not None:
            told = attitude_fit.below_waves(found, belief)
        joined = None if self._memory is None else self._memory.joined(self._t_s, belief, *told)
        if joined is not None:
            solution, self.covariance = joined
            self._if_any = np.sqrt(np.square(solution) + np.diag(self.covariance))
        else:
            self._memory = None
            solution, self.covariance, self._if_any = attitude_fit.averaged(belief, *told)
        self._has_looked = True
        solution[0] = max(solution[0], 0.0)
        self.lean_per_s, self.late_s = solution.tolist()
        self._know()
        self.noise = attitude_fit.noise(record, solution, self.covariance)
        return solution

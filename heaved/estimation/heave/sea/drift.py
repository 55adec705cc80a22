"""A bias that runs away, seen within seconds: while a sensor warms up, its level drifts as no wave does.

The filter follows a bias that wanders as far as its model says; one that leads the same way for minutes takes the heave
with it. A sum of the last samples with weights that hardly let any wave through shows the drift a hundred times finer
than its heave could, and what the model expects of that sum is known.
"""

from __future__ import annotations

from math import inf, pi, sqrt
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from heaved.estimation.heave.sea.model import SeaModel
    from heaved.estimation.heave.sea.record import SeaRecord

Array = NDArray[np.float64]


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """What counts as a drift."""

    drifts_s: tuple[float, float, float] = (30.0, 60.0, 120.0)
    """A drift is looked for in the last so many seconds."""
    looked_every_s: float = 1.0
    """So often; less is not worth a sum over two minutes."""
    too_far: float = 4.0
    """Standard deviations of a drift that is not expected."""
    seems_far: float = 1.5
    """The same, above one more of which errors are said to be as many times larger."""
    highest_hz: float = 1.0
    """Of what is left of a record by weights over half a minute and more, 1e-13 is faster."""
    all_there: float = 2.0
    """Samples by which the last ones may span more than they do when none is missing: elsewhere weights see the
    waves."""


TUNING: Final = Tuning()


def drift_weights(count: int) -> Array:
    """(n,) weights that leave of a record how far its level goes from its first half to its second, and hardly any
    waves.
    """
    x = (np.arange(count) + 0.5) / count
    weights = -(np.sin(pi * x) ** 4) * np.cos(pi * x)
    return np.asarray(2.0 * weights / np.sum(np.abs(weights)))


def drift_variances(weights: Array, dt_s: float, model: SeaModel) -> tuple[float, float]:
    """Variance (m/s2)2 of a sum of samples every ``dt_s``, so weighed, by ``model`` but for the walk of its bias, and
    what a walk of 1 (m/s2)2/s adds.
    """
    n = 4 * len(weights)
    f: Array = np.fft.rfftfreq(n, dt_s)[1:].astype(np.float64)
    passed = np.abs(np.fft.rfft(weights, n)[1:]) ** 2 * f[0]
    f, passed = f[f <= TUNING.highest_hz], passed[f <= TUNING.highest_hz]
    walk = 2.0 / (2.0 * pi * f) ** 2
    rest = model.acceleration_spectrum(f, dt_s) - model.bias_walk_psd * walk
    return float(passed @ rest), float(passed @ walk)


class DriftDetector:
    """Looks at the last samples now and then.

    Attributes:
        ratio: how far the level goes over what the model has for that, at the last look.
    """

    def __init__(self, model: SeaModel, dt_s: float) -> None:
        self._looked_s = -inf
        self.ratio = 0.0
        self._sums: list[tuple[float, Array, float]] = []
        for seconds in TUNING.drifts_s:
            weights = drift_weights(round(seconds / dt_s))
            rest, walk = drift_variances(weights, dt_s, model)
            self._sums.append((seconds, weights, rest + model.bias_walk_psd * walk))

    def step(self, t_s: float, record: SeaRecord) -> None:
        """See how far the level goes in the ``record`` up to ``t_s``, since its last cut, when it is time for that."""
        if t_s - self._looked_s < TUNING.looked_every_s:
            return
        self._looked_s = t_s
        cuts_s = record.cuts_s
        samples = record.since(max(t_s - max(TUNING.drifts_s) - 1.0, cuts_s[-1][1] if cuts_s else -inf))
        self.ratio = 0.0
        for seconds, weights, variance in self._sums:
            part = samples[-len(weights) :]
            is_whole = len(part) == len(weights) and part[-1, 0] - part[0, 0] < seconds * (
                1.0 + TUNING.all_there / len(part)
            )
            if is_whole:
                self.ratio = max(self.ratio, abs(float(weights @ part[:, 1])) / sqrt(variance))

    @property
    def is_drifting(self) -> bool:
        """Whether that is further than the model has it."""
        return self.ratio > TUNING.too_far

    @property
    def factor(self) -> float:
        """By which errors are larger than the model says, as far as it seems."""
        return max(1.0, self.ratio - TUNING.seems_far) if self.ratio > TUNING.seems_far + 1.0 else 1.0

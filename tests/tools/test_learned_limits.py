"""What it costs to learn a spectrum: nothing of an endless record of a sea that the family holds."""

from __future__ import annotations

from math import inf

import numpy as np
from evidence.learned_limits import learned_heave_limit
from evidence.limits import causal_heave_limit

from heaved.estimation.heave.sea.model import SeaModel

F = np.linspace(0.0, 5.0, 2**14 + 1)
NOISE = np.full(F.size, 1e-5)
MEMBER = SeaModel(
    stages=7, frequency_hz=(0.09, 0.13, 0.2), damping=(0.3, 0.3, 0.4), level_m2phz=(8.0, 3.0, 0.3), noise_psd=1e-5,
    bias_walk_psd=1e-12,
)  # fmt: skip
SEA = MEMBER.wave_spectrum(np.maximum(F, 1e-4))


def test_the_shorter_the_record_the_more_it_costs() -> None:
    limit_m = causal_heave_limit(F, SEA, NOISE)
    endless, long, short = (learned_heave_limit(F, SEA, NOISE, seconds) / limit_m for seconds in (inf, 3000.0, 150.0))
    assert 1.0 <= endless < 1.02
    assert endless < long < short < 1.5

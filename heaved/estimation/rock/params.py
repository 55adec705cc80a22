"""What a user sets of the predictions of roll, pitch and yaw, whichever method makes them."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

STEP_S = 0.05
"""One prediction step (Wei et al. 2019: the tracking radar's 20 Hz)."""
STANDARD_HORIZONS_S = (0.05, 0.10, 0.15)
"""Always predicted (Wei et al. 2019, algorithm 1)."""
DEFAULT_HORIZONS_S = (*STANDARD_HORIZONS_S, 0.5, 1.0, 2.0, 5.0)


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The table ``[rock]`` of the configuration."""

    predictor: Literal["direct", "ml"] = "direct"
    """Direct regression of each horizon (:mod:`heaved.estimation.rock.direct`), or
    :mod:`heaved.estimation.rock.maximum_likelihood`."""
    mode: Literal["zero", "endpoint"] = "endpoint"
    """How the filter starts: from zeros (the method as first used), or from a polynomial fit over the first 2 s."""
    points: Annotated[int, msgspec.Meta(ge=20, le=1000)] | None = None
    """Length of the regression in steps of 50 ms, at any sample rate; unset: 210 for "zero", 67 for "endpoint"."""
    degree: Annotated[int, msgspec.Meta(ge=1, le=6)] = 3
    """Degree of the fading-memory polynomial (4: the five-point filter)."""
    thetas: Annotated[tuple[Annotated[float, msgspec.Meta(ge=0.2, le=0.97)], ...], msgspec.Meta(min_length=1)] = (
        0.6,
        0.7,
        0.8,
    )
    """Discounts per 50 ms that run side by side, the best of them published; one value switches nothing."""
    horizons_s: tuple[Annotated[float, msgspec.Meta(ge=0.01, le=30.0)], ...] = DEFAULT_HORIZONS_S
    """Predicted besides 0.05, 0.10 and 0.15 s, which always are."""
    mean_memory_s: Annotated[float, msgspec.Meta(ge=5.0, le=600.0)] = 30.0
    """Memory of the mean (list, trim, heading) on which the regression is centred."""
    error_memory_s: Annotated[float, msgspec.Meta(ge=5.0, le=3600.0)] = 30.0
    """Memory of the realised errors, from which the standard deviations come."""
    memory_s: Annotated[float, msgspec.Meta(ge=60.0, le=1800.0)] = 300.0
    """Of the direct regression."""
    max_gap_s: Annotated[float, msgspec.Meta(ge=0.05, le=5.0)] | None = None
    """Longer gaps (and longer than 3.5 sample intervals) start an axis anew; unset: 2 s ("direct"), 0.25 s ("ml")."""

    @property
    def window_s(self) -> float:
        """Length of the past that the maximum-likelihood method looks at."""
        points = self.points if self.points is not None else (210 if self.mode == "zero" else 67)
        return points * STEP_S

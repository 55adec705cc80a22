"""What a user sets of the heave: ``[heave]``, with ``[heave.sea]`` and ``[heave.lead]`` in it."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from heaved.estimation.heave.laser import lead


class SeaParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[heave.sea]``: the sea observer."""

    stages: Annotated[int, msgspec.Meta(ge=4, le=12)] = 7
    """Resonators in a chain (M): the steeper the spectrum towards long waves, the more."""
    components: Annotated[int, msgspec.Meta(ge=1, le=4)] = 3
    """Chains (K)."""
    windows_s: tuple[Annotated[float, msgspec.Meta(ge=60, le=1800)], ...] = (120.0, 300.0, 600.0)
    """Lengths of the past that are fitted side by side."""
    first_fit_s: Annotated[float, msgspec.Meta(ge=30, le=300)] = 40.0
    """Seconds of samples before the first fit, and the first heave."""
    refresh_s: Annotated[float, msgspec.Meta(ge=5, le=300)] = 30.0
    """Interval of the fits."""
    bias_walk_mps2_rts: Annotated[float, msgspec.Meta(gt=0, le=1)] = 3e-5
    """Random walk of the accelerometer's bias, m/s2 per root second, where learning begins (data sheet: bias
    instability)."""
    delay_s: Annotated[float, msgspec.Meta(ge=10, le=300)] = 60.0
    """Age of the delayed heave."""
    channels: Literal["auto", "single"] = "auto"
    """"auto": roll and pitch beside the vertical acceleration, while they are shown to make the heave better; "single":
    the vertical acceleration alone."""
    max_gap_s: Annotated[float, msgspec.Meta(gt=0, le=600)] = 60.0
    """After a longer gap the past is forgotten; the model stays until there is a new one."""


class Params(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[heave]``: the observer."""

    observer: Literal["harmonic", "sea"] = "sea"
    """"harmonic": a few sinusoids, as the paper has it; "sea": the spectrum of the sea."""
    components: Annotated[int, msgspec.Meta(ge=1, le=8)] = 1
    """Sinusoids in the model (n)."""
    window_s: Annotated[float, msgspec.Meta(ge=15, le=120)] = 30.0
    """Record in which their frequencies are looked for (N)."""
    refresh_s: Annotated[float, msgspec.Meta(ge=1, le=60)] = 10.0
    """Interval of that search (delta t)."""
    band_hz: tuple[float, float] = (0.04, 0.6)
    """Wave band."""
    initial_period_s: Annotated[float, msgspec.Meta(ge=1, le=30)] = 8.0
    """Assumed until the first search."""
    highpass_period_s: Annotated[float, msgspec.Meta(ge=5, le=100)] = 16.0
    """Corner of the double integration. Shorter: less drift, more lead to undo."""
    process_noise: Annotated[float, msgspec.Meta(gt=0, le=1)] = 1e-3
    """Variance per 50 ms of each h (m2) and h' (m2/s2). The paper has 1e-5."""
    drift_process_noise_m2: Annotated[float, msgspec.Meta(gt=0, le=1)] = 1e-5
    """Variance per 50 ms of dh."""
    measurement_variance_m2: Annotated[float, msgspec.Meta(gt=0, le=10)] = 0.022
    """Of the inertial displacement, at 20 Hz (R)."""
    initial_variance: Annotated[float, msgspec.Meta(gt=0, le=100)] = 0.1
    """P0 on the diagonal."""
    max_gap_s: Annotated[float, msgspec.Meta(gt=0, le=30)] = 5.0
    """Longest gap in the samples that is bridged; a longer one restarts the observer."""
    forecast_horizons_s: tuple[Annotated[float, msgspec.Meta(gt=0, le=30)], ...] = (0.05, 0.1, 0.15, 0.5, 1.0, 2.0, 5.0)
    lead: lead.Params = lead.Params()
    sea: SeaParams = SeaParams()

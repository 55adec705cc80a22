"""What we set in the estimation of the hull's deformation; what a user sets is in ``estimate.Params``."""

from __future__ import annotations

from math import radians
from typing import Final

import msgspec

from heaved.estimation.common.rotations import ARCSEC


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Grouped by the file that uses them. Where no source is named, the value was chosen on simulated hulls."""

    # --- streams: two IMUs on one grid --------------------------------------------------------------------------------
    heard_s: float = 2.0
    """Streams are heard for so long before the grid takes their rate."""
    rate_from: int = 200
    """Readings that this is taken from at the most."""
    most_grid_hz: float = 25.0
    """The grid is no faster, unless it is configured so: what a hull does, and what shakes it, is well below."""
    averaged_reach: float = 3.0
    """Half width of the fit to a fast stream, grid steps."""
    averaged_below: float = 0.75
    """Grid steps between readings below which a stream is fast."""
    taper_power: int = 4
    """(1 - u^2) to this power weighs a fast stream: with the cubic, at least 60 dB down from the grid's rate on."""
    on_grid: float = 1e-3
    """Grid steps by which a reading may be off the grid and pass for one that is on it in a spectrum."""
    fewest_averaged: int = 6
    """Readings that an average is made of."""
    stream_gate_std: float = 8.0
    """A reading of a fast stream further than this from the middle of its neighbours, in its usual distances, is
    none."""
    usual_distance_from: int = 30
    """Readings that these distances are taken from at the least."""
    usual_distance_weight: float = 0.02
    """Of one reading in them."""
    shorter_period_weight: float = 0.1
    """Of an interval in the mean period when it is shorter ..."""
    longer_period_weight: float = 0.01
    """... and when it is longer: one with a lost reading in it is no period."""
    latest_handed: float = 0.75
    """Grid steps by which a reading may be older than the instant that takes it; half of one without jitter."""
    longest_join: float = 2.5
    """Readings further apart than so many grid steps are not averaged together."""
    wait_s: float = 1.0
    """How long a grid instant waits for the slower stream."""
    kept_s: float = 8.0
    """Record of a stream."""
    longest_jump_s: float = 10.0
    """A stream that is further ahead than this of the grid moves the grid."""
    stuck_s: float = 1.0
    """Repeated for so long, a gyro no longer measures."""
    share_weight: float = 0.03
    """Of one reading in the shares of missing and repeated ones."""
    missing_share: float = 0.2
    """Of readings from which on an IMU is called missing."""
    repeated_share: float = 0.3
    """Of readings from which on an IMU is called slow ..."""
    slow_period: float = 1.34
    """... and grid steps between its readings, likewise."""
    largest_radps: float = 10.0
    """No ship turns faster: the value is a bus error."""

    # --- band: what is slow in a gyro that shakes ---------------------------------------------------------------------
    ahead_s: float = 1.0
    """The window reaches so far ahead of its moment ..."""
    back_s: float = 3.0
    """... and so far back: a line is the better known the longer it has been heard."""
    shortest_window: int = 2
    """Readings ahead and back without which there is no window: at the ends of a record."""
    slow_hz: float = 2.5
    """Slow readings are made about so often: twice what passes the window under vibration, 0.9 Hz, and more."""
    motion_terms: int = 5
    """Of the polynomial: up to the fourth power of time."""
    motion_hz: float = 0.15
    """The slow motion's spectrum falls as a Gaussian of this width: by 35 dB at 0.6 Hz, by 97 dB at 1 Hz."""
    motion_std_radps: tuple[float, float] = (0.05, 1.0)
    """Its standard deviation, at least and at most: far above any vessel's, so that next to nothing of a motion is
    taken for noise, as far as the digits of a double allow."""
    motion_over_white: float = 1e12
    """That limit: variance of the motion over that of the white noise."""
    waves_end_hz: float = 1.0
    """What the record shows above it is no wave."""
    spectrum_lines: int = 129
    """Frequencies of a spectrum, from 0 to half of the sampling rate."""
    spectrum_segment: int = 256
    """Readings that a spectrum is taken from at a time."""
    spectrum_from: int = 24
    """Readings that one can be taken from."""
    coherent_s: float = 3.0
    """Standard deviation of the time over which a line keeps its phase: one that wanders by 5 % does for as long."""
    white_quantile: float = 0.1
    """Of the spectrum above the waves, taken for white."""
    lags_per_step: int = 8
    """Lags of a covariance that are worked out per step of the readings; between them it runs straight."""
    reading_gate_std: float = 8.0
    """A reading further than this from what the others expect is no reading of a gyro."""
    most_wrong: float = 0.25
    """Share of a window's readings that may be."""
    residual_weight: float = 0.1
    """Of one window in the size of the residuals."""
    longest_hole_s: float = 0.55
    """Neither a rigid hull nor its vibration is known across a longer one."""
    rounds: int = 4
    """Of identifying what vibrates: each takes most of what the missing readings added to a spectrum out again."""
    patterns_kept: int = 50
    """Patterns of holes that are remembered: 80 kB each at 25 Hz, and with jitter no two are alike."""

    # --- alignment, start, refit --------------------------------------------------------------------------------------
    correlated_s: float = 1.0
    """Flexure makes successive residuals of an alignment alike for so long: it counts for that many fewer."""
    fewest_aligned: int = 3
    """Slow readings that an alignment needs ..."""
    aligned_share: float = 0.3
    """... and share of the record that must be usable."""
    one_axis_motion: float = 0.02
    """Second over largest eigenvalue of the motion's mean square below which it is about one axis."""
    first_try_s: float = 1.0
    """From here on a provisional filter runs on whatever alignment there is."""
    retry_s: float = 5.0
    """Between two attempts to start."""
    longest_start_s: float = 30.0
    """An alignment looks at no more than this."""
    good_alignment_rad: float = radians(1.0)
    """Deviation of an alignment that a filter may start from."""
    longest_delay: float = 1.5
    """Sampling intervals that the alignment searches: the polynomial covers two."""
    worst_misfit: float = 0.2
    """Residual over motion above which the streams are not of one rigid hull: delays and flexure stay far below."""
    iterated_s: float = 30.0
    """Each update is iterated twice, and psi folded into C0, for so long."""
    identified_s: float = 26.0
    """Record that what vibrates is learned from, again and again."""
    longest_gap_s: float = 1.0
    """A longer gap ends the record: it is no longer evenly sampled."""
    ordinary_std: float = 3.0
    """A reading whose known deviation is more than so many times the median one is left out of a fit ..."""
    ordinary_share: float = 0.5
    """... of which so much of the record must be left."""

    # --- so3, euler: the filters --------------------------------------------------------------------------------------
    gate_nis: float = 60.0
    """A normalised innovation squared (3 degrees of freedom) beyond this is no reading of this hull."""
    fold_rad: float = 1e-4
    """psi is folded into C0 when it is longer than this: the square of it is what linearising costs."""

    # --- markov: the fit of the flexure -------------------------------------------------------------------------------
    aliases: int = 1
    """Images of the spectrum above the sampling rate that are folded back one by one, each side."""
    fine_hz: float = 1.0
    """Up to here the lines of a periodogram are fitted one by one ..."""
    averaged_lines: int = 12
    """... and so many together above it."""
    lowest_cycles: int = 3
    """Lines below this many cycles per record are the bias and its trend, not the flexure."""
    prior_log_std: tuple[float, float, float, float] = (1.5, 1.0, 0.7, 3.0)
    """How broad the prior of the fit is: natural logarithm of sigma, mu, lambda and noise."""
    fit_bounds: tuple[tuple[float, float], ...] = (
        (0.02 * ARCSEC, 600.0 * ARCSEC),
        (0.01, 2.0),
        (0.12, 10.0),
        (1e-10, 1e-1),
    )
    """Of sigma rad, mu 1/s, lambda rad/s, noise rad/s per sample."""

    # --- consistency --------------------------------------------------------------------------------------------------
    forecast_every_s: float = 10.0
    """Between two forecasts of the reachable accuracy."""
    forecast_window_s: float = 100.0
    """Motion that they are made from."""
    forecast_from: int = 15
    """Readings that one needs."""
    one_axis_information: float = 0.02
    """Least over second least eigenvalue of the information below which the motion is about one axis."""
    unexplained: int = 8
    """Successive readings that no state explains: start over."""
    nis_weight: float = 0.04
    """Of one reading in the mean normalised innovation squared."""
    worst_nis: float = 4.0
    """Mean normalised innovation squared per degree of freedom that is still taken for the model's."""
    drift_s: float = 60.0
    """Delays are compared over this time ..."""
    drift_ppm: float = 5.0
    """... and a difference per time below this is nothing."""
    drifting_walk_s_rts: float = 1e-4
    """Random walk of the delay once it is seen to drift: 50 ppm are then followed within half a millisecond."""
    gimbal_cos: float = 1e-3
    """Cosine of y below which x and z are no longer told apart: an arcsecond of one is a thousand of them."""
    holding_s: float = 2.0
    """Without an update for so long the last static deformation is held."""

    # --- remembered: what an earlier run has found -----------------------------------------------------------------
    remembered_s: float = 3600.0
    """What is older is not taken: in an hour a vessel is loaded, or somebody has been at the IMU."""
    away_walk_arcsec_rth: float = 20.0
    """Random walk of the static deformation while nobody looks, arcsec per root hour: ten times that of a vessel at
    work, for pauses are when loads come on board, tanks are filled and IMUs warm up."""
    away_scale_rth: float = 1e-5
    """The same of the scales of the gyros, which go with their temperature."""
    unlike_nis: float = 16.0
    """Normalised square (3 degrees of freedom) of the difference from a cold start from which it is another mounting:
    a thousandth by chance, and then nothing is lost but the remembered."""
    in_doubt: float = 0.5
    """Share of the cold start's deviations, and of what it differs by, in the published ones for as long as nothing is
    decided."""
    as_good: float = 2.0
    """It is decided when the cold start knows the deformation to so many of the other's deviations."""
    coherent_arcsec: float = 1.0
    """Flexure coherent with the waves, by which what two seas show differs."""


TUNING: Final = Tuning()

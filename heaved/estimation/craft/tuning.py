"""What we set in the estimation of a craft's heave and pitch; what a user sets is in ``fusion.Params``."""

from __future__ import annotations

from typing import Final

import msgspec


class Tuning(msgspec.Struct, frozen=True, kw_only=True):
    """Grouped by the file that uses them. Where no source is named, the value was chosen on simulated craft."""

    # --- stage --------------------------------------------------------------------------------------------------------
    own_step_s: float = 0.05
    """Our own heave is read this often: its errors linger, so more readings tell no more."""
    serves_s: float = 0.5
    """A reading of another sensor, and a speed or flap angle, is used for so long; then it is missing."""

    # --- inputs -------------------------------------------------------------------------------------------------------
    most_heave_m: float = 20.0
    most_pitch_rad: float = 0.8
    """Readings beyond are not of a craft that floats."""

    # --- fusion -------------------------------------------------------------------------------------------------------
    least_probability: float = 1e-4
    """Of a sea: a fifth of what flows back to it in one sample at 100 Hz with a mean stay of 10 s."""
    settled_s: float = 5.0
    """After a start the wave accelerations are not known for about two of their periods."""
    lost_times: int = 50
    """So many samples in a row that are older than the last one: time itself has been set back, so start again."""

    # --- model --------------------------------------------------------------------------------------------------------
    longest_step_s: float = 0.1
    """A longer interval is gone through in steps: half of what the integration of the craft allows."""
    same_step_s: float = 1e-5
    """Intervals this close share one transition: its noise is off by 0.3 % at most at 100 Hz."""
    start_std: tuple[float, float] = (1.0, 0.1)
    """Heave (m, and m/s) and pitch (rad, and rad/s) at the start, where not measured."""

    # --- dynamics -----------------------------------------------------------------------------------------------------
    flap_effect: float = 0.5
    """Incidence per flap angle: a flap of about a fifth of the chord (thin-aerofoil theory gives 0.55)."""
    slowest_mps: float = 0.5
    """Angles of attack are worked out at no less: below, the dynamic pressure is next to nothing anyway."""
    most_stiffening: float = 3.0
    """c z^2 (2.2 m) and c' theta^2 grow no further: a hull leaves the water, or is under it."""
    fastest: tuple[float, float] = (10.0, 2.0)
    """m/s and rad/s from which on quadratic damping grows on linearly. No craft gets there, but the points of a filter
    that is lost do, and neither term may then outrun the step of integration."""

    # --- sensor_noise -------------------------------------------------------------------------------------------------
    window_s: float = 2.0
    """Readings that one is split with ..."""
    window: tuple[int, int] = (12, 200)
    """... but no fewer and no more than these."""
    record_s: float = 26.0
    """Record that is learned from ..."""
    learn_every_s: float = 5.0
    """... again and again."""
    first_s: float = 9.0
    """Record from which on there is something to learn."""
    segment_s: float = 8.0
    """Of one periodogram; they overlap by half."""
    waves_end_hz: float = 2.0
    """A craft does not follow waves above: at 18 m/s they are met at this frequency when they are 12 m long."""
    motion_hz: float = 0.5
    """The slow motion's spectrum falls as a Gaussian of this width: by 35 dB at 2 Hz, by 78 dB at 3 Hz."""
    motion_std: tuple[float, float] = (2.0, 0.2)
    """Of heave (m) and pitch (rad), above any craft's."""
    stands_out: float = 5.0
    """Spectrum over its median above the waves from which on it is vibration: the mean of five overlapping periodograms
    is that by chance once in some ten thousand lines."""
    least_power: float = 0.1
    """Variance of what vibrates over that of the white noise below which it is not worth a word."""
    noisier: float = 1.5
    """Variance over the configured one from which on the learned one is used."""
    coherent_s: float = 2.0
    """Standard deviation of the time over which a line keeps its phase."""
    gate_std: float = 6.0
    """A reading further than this from what those before it expect is not learned from."""
    least_share: float = 0.5
    """Of readings that must be there to learn, and to split one."""
    most_completed: int = 540
    """Readings of a record of which the missing ones are put in as what is known expects them: 27 s at 20 Hz. Of more,
    which come faster, straight lines will do."""
    most_with_holes: int = 80
    """Readings that one is split with when some of them are missing: each pattern of holes is worked out by itself."""
    fewest: int = 8
    """Readings that one is split with at the least."""
    lost_s: float = 1.0
    """Without a reading for so long, what vibrates is no longer known."""
    spike_std: float = 8.0
    """A reading further than this from the middle of its neighbours, in usual distances, is not learned from either."""
    shortest_step_s: float = 0.004
    """No sensor of a craft is read more often."""
    step_weight: float = 0.02
    """Of an interval in the mean one."""


TUNING: Final = Tuning()

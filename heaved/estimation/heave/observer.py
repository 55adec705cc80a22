"""What every observer of the heave does, whatever it is made of: the harmonic one, the one of the sea, one of your own.

The heave chain steps an observer with the vertical acceleration and asks it for the heave of moments near the last
sample. What is fitted to the past is fitted beside the event loop: :meth:`HeaveObserver.due` hands the past out,
:meth:`HeaveObserver.accept` takes what came of it.
"""

from __future__ import annotations

from enum import StrEnum
from math import nan
from typing import TYPE_CHECKING, Final, Protocol

import msgspec
import numpy as np
from numpy.typing import NDArray

from heaved.estimation.common.bounds import HEAVE_M
from heaved.estimation.heave.sea.model import SeaModel
from heaved.samples import DelayedHeave, HeaveForecast, SeaState

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Sequence

    from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow

Array = NDArray[np.float64]


class Motion(msgspec.Struct, frozen=True, gc=False):
    """Heave at one moment."""

    heave_m: float
    velocity_mps: float


UNKNOWN: Final = Motion(nan, nan)


def foretold(horizon_s: float, heave_m: float, std_m: float) -> HeaveForecast:
    """A forecast, of which nothing is known where the heave is what no vessel does."""
    if abs(heave_m) > HEAVE_M:
        heave_m = std_m = nan
    return HeaveForecast(horizon_s=horizon_s, heave_m=heave_m, std_m=std_m)


def nothing_foretold(horizons_s: Sequence[float]) -> tuple[HeaveForecast, ...]:
    """Nothing is known for any of the horizons."""
    return tuple([HeaveForecast(horizon_s=h) for h in horizons_s])


class Verdict(StrEnum):
    """What became of something that was fitted or trained beside the event loop."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    """It came late, or at the wrong moment, or it is no better than what is in use."""
    FAILED = "failed"
    """There is none, or it is unusable."""


class SavedObserver(msgspec.Struct, frozen=True, kw_only=True):
    """What a restart remembers of an observer; each takes from it what is its own."""

    frequencies_hz: tuple[float, ...] = ()
    """Of the lines of a harmonic observer."""
    sea: SeaModel | None = None
    """Of a sea observer,"""
    bias_mps2: float | None = None
    """the bias of the accelerometer that it has found, and"""
    bias_std_mps2: float = 1.0
    """how well."""


class RollPitch(msgspec.Struct, frozen=True, gc=False):
    """What roll and pitch have to do with the heave."""

    coherence: float = nan
    """Squared, of both together with the heave; nan: not known."""
    weight: float = 0.0
    """How much of what they tell is in the heave, 0 to 1."""


class LaserAided(Protocol):
    """An observer, as one sees it that takes readings of the heave by a laser in as measurements."""

    def aid(self, t_s: float, laser_m: float, std_m: float) -> None:
        """Take a laser as a measurement of the heave at ``t_s``, its sign applied; what it is off by is found too."""

    def stop_aiding(self, t_s: float, why: str) -> None:
        """The readings are of another target from ``t_s`` on."""

    def aiding_remark(self, t_s: float) -> str:
        """Why a laser does not aid, for people; or nothing."""


class HeaveObserver(Protocol):
    """Feed it vertical acceleration in order of time; ask it for heave at any moment near the last one."""

    # --- input -------------------------------------------------------------------------------------------------------

    def step(
        self, t_s: float, a_up_mps2: float, roll_rad: float = nan, pitch_rad: float = nan, yaw_rad: float = nan, /
    ) -> None:
        """Take the vertical acceleration at ``t_s`` (later than the last one; nan: missing, nothing happens), with the
        angles of that moment (nan: not known).
        """

    def cut(self) -> None:
        """What comes is measured otherwise than what was, with the tilt removed, or without."""

    def amend(self, t_s: Array, more_mps2: Array) -> None:
        """The past at ``t_s`` (n,) was measured too little by ``more_mps2`` (n,)."""

    def disturb(self, f_hz: Array, psd: Array) -> None:
        """What comes, and what came, has noise that it does not show, of one-sided density ``psd`` (n,), (m/s2)2/Hz, at
        ``f_hz`` (n,), evenly spaced.
        """

    def mistake(self, t_s: float, shapes: tuple[float, float], covariance: Array) -> None:
        """The acceleration about ``t_s`` has two errors beside, that are ``shapes`` (2,) for each unit of their size,
        which is known as well as ``covariance`` (2, 2) says.
        """

    @property
    def laser_aided(self) -> LaserAided | None:
        """The same observer, if it is one that a laser can aid."""

    # --- fits --------------------------------------------------------------------------------------------------------

    def due(self) -> SeaWindow | None:
        """The past, when it is time to fit it; each is given out once."""

    def accept(self, fit: SeaFit) -> Verdict:
        """Change over to what was fitted, without a jump."""

    # --- output ------------------------------------------------------------------------------------------------------

    def at(self, shift_s: float, learned_lead_s: float = 0.0) -> Motion:
        """Heave ``shift_s`` after the last sample; nan while nothing is known.

        ``learned_lead_s``: how early the sensor is, by the laser, beyond :attr:`design_lead_s`.
        """

    def unshifted(self) -> Motion:
        """What the laser is compared with: nothing learned taken out."""

    def forecast(
        self, shift_s: float, learned_lead_s: float = 0.0, scale: float = 1.0, gain: float = 1.0
    ) -> tuple[HeaveForecast, ...]:
        """Heave and :meth:`error_std_m` for each of the configured horizons after a moment ``shift_s`` after the last
        sample, both times ``gain``: what the laser has shown of the sensor's scale.
        """

    def error_std_m(self, shift_s: float, scale: float = 1.0) -> float:
        """Standard deviation of the error of :meth:`at`, its modelled part times ``scale``: what the laser has shown;
        nan while nothing is known.
        """

    @property
    def t_s(self) -> float:
        """Time of the last sample; nan: there was none."""

    @property
    def acceleration_mps2(self) -> float:
        """The last vertical acceleration, without what is known of its bias."""

    @property
    def bias_mps2(self) -> float:
        """Of the accelerometer, as far as the observer has a name for it; else 0."""

    @property
    def delayed(self) -> DelayedHeave | None:
        """The newest delayed heave, if it has one."""

    # --- what it knows of the sea, and of itself ---------------------------------------------------------------------

    def heave_std_m(self) -> float:
        """Standard deviation of the heave itself; nan while it is not known."""

    @property
    def omega_radps(self) -> float:
        """Mean or dominant frequency of the heave."""

    @property
    def frequencies_hz(self) -> tuple[float, ...]:
        """Of the lines or chains that the heave is made of."""

    @property
    def sea(self) -> SeaState | None:
        """The newest sea state, if it has one."""

    @property
    def design_lead_s(self) -> float:
        """How early the heave is by design, which :meth:`at` takes out."""

    @property
    def has_true_gain(self) -> bool:
        """Whether the heave has the scale of the acceleration by design."""

    @property
    def settled_s(self) -> float:
        """Seconds of record since the start or the last reset; nan before the first sample."""

    @property
    def needed_s(self) -> float:
        """Seconds of record from which it counts as settled."""

    @property
    def doubts(self) -> tuple[str, ...]:
        """What is held against the output, for people."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What people should know, and no reason to trust the output less."""

    @property
    def refreshes(self) -> int:
        """How often the frequencies or the model have changed since the last reset."""

    @property
    def rejected(self) -> int:
        """Measurements that its own gate has kept out."""

    @property
    def steps(self) -> int:
        """Of the accelerometer's level that were found; the past stays."""

    @property
    def resets(self) -> Counter[str]:
        """By reason."""

    @property
    def roll_pitch(self) -> RollPitch:
        """What roll and pitch have to do with its heave."""

    # --- memory ------------------------------------------------------------------------------------------------------

    def saved(self) -> SavedObserver:
        """What a restart shall remember."""

    def restore(self, saved: SavedObserver, age_s: float = nan, /) -> None:
        """Start with what an earlier run has found ``age_s`` ago (nan: not known), if there is anything for this kind
        of observer; call before the first sample.

        Raises:
            ValueError: it does not fit the configuration; nothing was taken over.
        """

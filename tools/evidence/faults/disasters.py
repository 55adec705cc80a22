"""What goes wrong on a real vessel, as one table: holes and odd times, wrong values, lasers and states that mislead.

A disaster takes an honest record and spoils its readings; the truth beside it stays what it was, but for the few in
which the vessel itself does something. Each is a pure function of the record, of when it happens and of a seed, and is
made for every rate. ``faults.py`` runs them through the pipeline of the daemon and judges what it published.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, radians
from typing import Final, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from evidence.faults.moves import Move, Span, growing, listed, met_by_a_swell, turned_into_the_sea
from heaved.samples import GRAVITY_MPS2
from heaved.simulate.gauge import LASER_DISTANCE_M
from heaved.simulate.sensors import REGISTER_STEPS, Recording
from heaved.simulate.vessel import Motion

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Columns = dict[str, Array]

FORCES: Final = ("ax_mps2", "ay_mps2", "az_mps2")
ANGLES: Final = ("roll_rad", "pitch_rad", "yaw_rad")
RATES: Final = ("gx_radps", "gy_radps", "gz_radps")
IMU: Final = FORCES + ANGLES + RATES
"""In the order of the registers."""
LOWEST_REGISTER, HIGHEST_REGISTER = -(2**15), 2**15 - 1
EVERYTHING: Final = inf
"""Lasts until the end of the record."""


Deed = Callable[[Recording, Span, np.random.Generator], Recording]


class Asked(msgspec.Struct, frozen=True, kw_only=True):
    """What is asked once it is over, beside no lie and nothing beyond physics; None: nothing."""

    back: Literal["valid", "usable"] = "valid"
    within_s: float | None = 60.0
    """Until it is so again. Of what is there from the first sample: beyond the time that the honest record takes."""
    heave_ratio: float | None = 1.1
    """Error of the heave in the last minute over that of the honest record; where it lasts from the start, in all of
    the record."""
    rock_ratio: float | None = 1.1
    """The same of roll and pitch half a second ahead."""


class Disaster(msgspec.Struct, frozen=True, kw_only=True):
    """One row of the table."""

    what: str
    deed: Deed | None = None
    move: Move | None = None
    """What the vessel itself does: the truth moves, and honest sensors with it."""
    unforeseen_s: float = 0.0
    """So long after it begins nobody knows from waves what the angles are going to be: no prediction of them is a lie,
    but one that is made later."""
    lasts_s: float = EVERYTHING
    from_start: bool = False
    """From the first sample on, not from the time that the campaign says."""
    is_step: bool = False
    """It stays, and the estimators are to be back with it there: times count from its beginning."""
    laser: Literal["off", "reference", "aiding"] = "off"
    memory: Literal["none", "calmer sea", "same sea", "zeros", "huge"] = "none"
    """State of an earlier run that is restored before the first sample."""
    asked: Asked = Asked()

    def span(self, at_s: float) -> Span:
        """When it happens in a campaign whose disasters begin at ``at_s``."""
        start_s = 0.0 if self.from_start else at_s
        return Span(start_s, start_s + self.lasts_s)

    def over_s(self, at_s: float) -> float:
        """From when on the estimators are expected back."""
        span = self.span(at_s)
        return span.start_s if self.is_step or span.end_s == inf else span.end_s


# --- what is done to the readings ------------------------------------------------------------------------------------


def columns_of(recording: Recording) -> Columns:
    """The readings by name, the laser's too, without times and truth."""
    return {name: getattr(recording, name) for name in (*IMU, "laser_m")}


def changed(recording: Recording, new: Columns) -> Recording:
    """The same record with other readings."""
    return msgspec.structs.replace(recording, **new)


def rows(recording: Recording, kept: Mask | NDArray[np.intp]) -> Recording:
    """Some of its rows, by mask or by number."""
    truth = {name: getattr(recording.truth, name)[kept] for name in recording.truth.__struct_fields__}
    columns = {name: values[kept] for name, values in columns_of(recording).items()}
    return Recording(t_s=recording.t_s[kept], **columns, truth=Motion(**truth))


def mapped(names: tuple[str, ...], function: Callable[[Array], Array]) -> Deed:
    """These columns, put through a function while it lasts."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        inside = span.holds(recording.t_s)
        old = {name: getattr(recording, name) for name in names}
        return changed(recording, {name: np.where(inside, function(values), values) for name, values in old.items()})

    return deed


def noisy(names: tuple[str, ...], std: float) -> Deed:
    """White noise on these columns."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        inside = span.holds(recording.t_s)
        old = {name: getattr(recording, name) for name in names}
        return changed(
            recording,
            {name: values + std * inside * rng.standard_normal(values.size) for name, values in old.items()},
        )

    return deed


def blank(names: tuple[str, ...], share: float) -> Deed:
    """Their cells are empty in this share of the rows, at random; all of them together."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        gone = span.holds(recording.t_s) & (rng.random(recording.t_s.size) < share)
        return changed(recording, {name: np.where(gone, np.nan, getattr(recording, name)) for name in names})

    return deed


def blank_in_bursts(names: tuple[str, ...], hole_s: float, stretch_s: float) -> Deed:
    """Holes and stretches of random length, exponentially distributed about these means."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        t = recording.t_s
        lengths = rng.exponential((stretch_s, hole_s), (int(t[-1] / (hole_s + stretch_s)) + 50, 2))
        borders = t[0] + np.cumsum(lengths.ravel())
        gone = span.holds(t) & (np.searchsorted(borders, t, side="right") % 2 == 1)
        return changed(recording, {name: np.where(gone, np.nan, getattr(recording, name)) for name in names})

    return deed


def only_every(names: tuple[str, ...], nth: int) -> Deed:
    """Their cells are filled in every n-th row only."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        gone = span.holds(recording.t_s) & (np.arange(recording.t_s.size) % nth != 0)
        return changed(recording, {name: np.where(gone, np.nan, getattr(recording, name)) for name in names})

    return deed


def restarted(hole_s: float, by_mps2: float) -> Deed:
    """No rows for so long, and then az is off by so much for good: the sensor has found another zero."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        back = recording.t_s >= span.start_s + hole_s
        moved = changed(recording, {"az_mps2": recording.az_mps2 + by_mps2 * back})
        return rows(moved, back | (recording.t_s < span.start_s))

    return deed


def exchanged(one: str, other: str) -> Deed:
    """Each is read in the place of the other."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        inside = span.holds(recording.t_s)
        a, b = getattr(recording, one), getattr(recording, other)
        return changed(recording, {one: np.where(inside, b, a), other: np.where(inside, a, b)})

    return deed


def scattered(name: str, std: float, share: float, far: float) -> Deed:
    """Noise, and that share of the readings anywhere within ``far`` of what it should be."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        values = getattr(recording, name)
        inside, n = span.holds(recording.t_s), values.size
        off = np.where(rng.random(n) < share, rng.uniform(-far, far, n), std * rng.standard_normal(n))
        return changed(recording, {name: values + inside * off})

    return deed


def hole(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
    """No rows at all."""
    return rows(recording, ~span.holds(recording.t_s))


def holes_again(hole_s: float, every_s: float) -> Deed:
    """No rows for so long, again and again."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        t = recording.t_s
        return rows(recording, ~(span.holds(t) & (t % every_s >= every_s - hole_s)))

    return deed


def rows_lost(share: float) -> Deed:
    """Whole rows, at random."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        lost = span.holds(recording.t_s) & (rng.random(recording.t_s.size) < share)
        return rows(recording, ~lost)

    return deed


def slower_rows(rate_hz: float) -> Deed:
    """Rows come at a lower rate."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        t = recording.t_s
        is_due = np.diff(np.floor(t * rate_hz + 1e-6), prepend=-1.0) > 0
        return rows(recording, is_due | ~span.holds(t))

    return deed


def in_bursts(together: int, every_s: float) -> Deed:
    """A gateway that hands on several readings at once, a microsecond apart by their stamps; each has its own noise."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        due = np.flatnonzero(np.diff(np.floor(recording.t_s / every_s + 1e-6), prepend=-1.0) > 0)
        burst = rows(recording, np.repeat(due, together))
        stamps = burst.t_s + 1e-6 * np.tile(np.arange(together), due.size)
        own = {
            name: values + (1e-3 if name in FORCES else 1e-5) * rng.standard_normal(values.size)
            for name, values in columns_of(burst).items()
        }
        return msgspec.structs.replace(changed(burst, own), t_s=stamps)

    return deed


def measured_slowly(share: float, names: tuple[str, ...] = IMU) -> Deed:
    """The sensor measures at this share of the polls, and repeats itself exactly to the others.

    A reading is of the tick of its own clock, which lies between two polls where the share is not one in so many.
    """

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        row = np.arange(recording.t_s.size)
        tick = np.floor(row * share + 1e-6) / share
        inside = span.holds(recording.t_s)
        return changed(
            recording,
            {name: np.where(inside, np.interp(tick, row, col), col) for name in names
             for col in [getattr(recording, name)]},
        )  # fmt: skip

    return deed


def in_registers(change: Callable[[NDArray[np.int64], np.random.Generator], NDArray[np.int64]]) -> Deed:
    """Something done to the 16-bit registers (9, k) of the IMU, by which the readings are then read."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        inside = span.holds(recording.t_s)
        honest = np.array([getattr(recording, name) for name in IMU])
        registers = np.round(honest[:, inside] / REGISTER_STEPS[:, None]).astype(np.int64)
        honest[:, inside] = change(registers, rng) * REGISTER_STEPS[:, None]
        return changed(recording, dict(zip(IMU, honest, strict=True)))

    return deed


def _random(registers: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    return rng.integers(LOWEST_REGISTER, HIGHEST_REGISTER, registers.shape, endpoint=True)


def _bytes_swapped(registers: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    return registers.astype(np.int16).byteswap().astype(np.int64)


def _three_further(registers: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
    return np.roll(registers, 3, axis=0)


def _all(value: int) -> Callable[[NDArray[np.int64], np.random.Generator], NDArray[np.int64]]:
    return lambda registers, rng: np.full_like(registers, value)


def _one_in(nth: int) -> Callable[[NDArray[np.int64], np.random.Generator], NDArray[np.int64]]:
    def change(registers: NDArray[np.int64], rng: np.random.Generator) -> NDArray[np.int64]:
        return np.where(rng.random(registers.shape[1]) < 1.0 / nth, _random(registers, rng), registers)

    return change


def frozen(names: tuple[str, ...]) -> Deed:
    """They repeat the last reading from before."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        inside = span.holds(recording.t_s)
        last = max(int(np.argmax(inside)) - 1, 0)
        return changed(recording, {
            name: np.where(inside, values[last], values) for name in names for values in [getattr(recording, name)]
        })  # fmt: skip

    return deed


def old_readings(share: float, each_s: float, of_s: float) -> Deed:
    """For ``each_s`` of every ``of_s`` that share of the rows are an old one: a gateway serves its memory."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        inside = span.holds(recording.t_s)
        begun_s = np.floor(recording.t_s / of_s) * of_s
        is_old = inside & (recording.t_s - begun_s < each_s) & (rng.random(len(inside)) < share)
        old = np.searchsorted(recording.t_s, begun_s)
        return changed(recording, {
            name: np.where(is_old, values[old], values) for name in IMU for values in [getattr(recording, name)]
        })  # fmt: skip

    return deed


def wild(value: float, nth: int) -> Deed:
    """All readings of one row in so many are this one."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        hit = span.holds(recording.t_s) & (rng.random(recording.t_s.size) < 1.0 / nth)
        return changed(recording, {name: np.where(hit, value, getattr(recording, name)) for name in IMU})

    return deed


def creeping(name: str, per_s: float) -> Deed:
    """A straight line on top, from the beginning on."""

    def deed(recording: Recording, span: Span, rng: np.random.Generator) -> Recording:
        along_s = np.clip(recording.t_s - span.start_s, 0.0, span.end_s - span.start_s)
        return changed(recording, {name: getattr(recording, name) + per_s * along_s})

    return deed


def negated(*names: str) -> Deed:
    return mapped(names, np.negative)


def raised(name: str, by: float) -> Deed:
    return mapped((name,), lambda values: values + by)


# --- the table -------------------------------------------------------------------------------------------------------

HONEST: Final = Asked(within_s=None, heave_ratio=None, rock_ratio=None)
"""Nothing to compare with: no lie, nothing beyond physics."""
USABLE: Final = Asked(back="usable", within_s=20.0, heave_ratio=None, rock_ratio=None)
BY_RATE: Final = HONEST
"""At 20 polls a second it measures once in a second, and shows nothing above half a hertz, where there are waves: that
is to be said. At 100 polls it is a sensor of 5 Hz, like others."""
STAYS_WRONG: Final = HONEST
"""What nobody can make right: to be said, not to be guessed."""
AS_WHOLE: Final = Asked(within_s=20.0)
AS_A_START: Final = Asked(within_s=100.0, heave_ratio=1.45)
"""The past is lost: no worse than a record that begins there. On S6 at 20 Hz those of three records, begun at 490 s,
are `valid` after 60 to 90 s, and err from 640 s on by up to 1.3 of what the whole record does: a spectrum of three
minutes."""
FEWER: Final = Asked(back="usable", within_s=60.0, heave_ratio=None, rock_ratio=None)
"""There is less to know from now on: usable, and as right as it says."""

DISASTERS: Final[dict[str, Disaster]] = {
    "clean": Disaster(what="nothing", from_start=True, asked=HONEST),
    # Holes and odd times.
    **{
        f"attitude_lost_{percent}": Disaster(
            what=f"{percent} % of the angles missing for 60 s", deed=blank(ANGLES, percent / 100.0), lasts_s=60.0
        )
        for percent in (30, 60, 85)
    },
    "attitude_lost_60_always": Disaster(
        what="60 % of the angles missing", deed=blank(ANGLES, 0.6), from_start=True,
        asked=Asked(within_s=20.0, heave_ratio=1.25, rock_ratio=None),
    ),
    "attitude_bursts": Disaster(
        what="angles in bursts: there 0.5 s, gone 0.7 s, for 60 s", deed=blank_in_bursts(ANGLES, 0.7, 0.5), lasts_s=60.0
    ),
    "attitude_fifth": Disaster(
        what="angles in every 5th row", deed=only_every(ANGLES, 5), from_start=True,
        asked=Asked(within_s=20.0, heave_ratio=1.25, rock_ratio=None),
    ),
    "attitude_tenth": Disaster(
        what="angles in every 10th row", deed=only_every(ANGLES, 10), from_start=True,
        asked=Asked(back="usable", within_s=20.0, heave_ratio=None, rock_ratio=None),
    ),
    "holes_again": Disaster(
        what="0.4 s missing every 20 s", deed=holes_again(0.4, 20.0), from_start=True, asked=AS_WHOLE
    ),
    **{
        f"gap_{length_s:g}": Disaster(
            what=f"a gap of {length_s:g} s", deed=hole, lasts_s=length_s, asked=Asked(within_s=within_s)
        )
        for length_s, within_s in ((0.3, 5.0), (1.0, 5.0), (3.0, 20.0), (10.0, 20.0))
    },
    "gap_90": Disaster(what="a gap of 90 s", deed=hole, lasts_s=90.0, asked=AS_A_START),
    **{
        f"rows_lost_{percent}": Disaster(
            what=f"{percent} % of the rows lost from then on", deed=rows_lost(percent / 100.0), is_step=True,
            asked=FEWER,
        )
        for percent in (30, 60, 75, 88)
    },
    "rows_lost_75_always": Disaster(
        what="75 % of the rows lost from the start", deed=rows_lost(0.75), from_start=True, asked=FEWER
    ),
    "polls_fail_60": Disaster(
        what="60 % of the polls fail for 60 s", deed=blank(IMU, 0.6), lasts_s=60.0
    ),
    "polls_fail_10": Disaster(
        what="all polls fail for 10 s", deed=blank(IMU, 1.0), lasts_s=10.0, asked=Asked(within_s=20.0)
    ),
    "attitude_gone": Disaster(what="no angles for 60 s", deed=blank(ANGLES, 1.0), lasts_s=60.0),
    "attitude_gone_150": Disaster(
        what="no angles for 150 s", deed=blank(ANGLES, 1.0), lasts_s=150.0, asked=AS_A_START
    ),
    "attitude_never": Disaster(what="no angles at all", deed=blank(ANGLES, 1.0), from_start=True, asked=HONEST),
    "az_alone": Disaster(
        what="nothing but the vertical acceleration",
        deed=blank(tuple(name for name in IMU if name != "az_mps2"), 1.0), from_start=True, asked=HONEST,
    ),
    "az_lost_30": Disaster(what="30 % of az missing for 60 s", deed=blank(("az_mps2",), 0.3), lasts_s=60.0),
    "every_2s": Disaster(
        what="a row every 2 s", deed=slower_rows(0.5), from_start=True, asked=HONEST
    ),
    "to_2hz": Disaster(what="2 Hz from then on", deed=slower_rows(2.0), is_step=True, asked=FEWER),
    "bursts": Disaster(
        what="four rows within 3 us every 0.1 s", deed=in_bursts(4, 0.1), from_start=True,
        asked=Asked(back="usable", within_s=20.0, heave_ratio=None, rock_ratio=None),
    ),
    **{
        f"slow_sensor_{name}": Disaster(
            what=f"measures at {name} % of the polls", deed=measured_slowly(share), from_start=True,
            asked=asked,
        )
        for name, share, asked in (
            ("80", 0.8, USABLE), ("30", 0.3, USABLE), ("20", 0.2, USABLE), ("10", 0.1, USABLE), ("5", 0.05, BY_RATE)
        )
    },
    "slow_attitude": Disaster(
        what="angles and rates measured at every 5th poll", deed=measured_slowly(0.2, ANGLES + RATES), from_start=True,
        asked=Asked(back="usable", within_s=20.0, heave_ratio=None, rock_ratio=None),
    ),
    "slow_acceleration": Disaster(
        what="accelerations measured at every 5th poll", deed=measured_slowly(0.2, FORCES), from_start=True,
        asked=Asked(back="usable", within_s=20.0, heave_ratio=None, rock_ratio=None),
    ),
    # Values.
    "angles_0_360": Disaster(
        what="roll and pitch counted 0..360 degrees", from_start=True,
        deed=mapped(("roll_rad", "pitch_rad"), lambda angle: angle % (2.0 * np.pi)), asked=AS_WHOLE,
    ),
    "random_registers": Disaster(what="random registers for 20 s", deed=in_registers(_random), lasts_s=20.0),
    "bytes_swapped": Disaster(what="bytes swapped for 20 s", deed=in_registers(_bytes_swapped), lasts_s=20.0),
    "registers_shifted": Disaster(
        what="read three registers off for 20 s", deed=in_registers(_three_further), lasts_s=20.0
    ),
    "wild_1_in_200": Disaster(
        what="one row in 200 is random", deed=in_registers(_one_in(200)), from_start=True, asked=AS_WHOLE
    ),
    "wild_1e308": Disaster(
        what="one row in 200 is 1e308", deed=wild(1e308, 200), from_start=True, asked=AS_WHOLE
    ),
    "registers_ffff": Disaster(what="all registers 0xFFFF for 1 s", deed=in_registers(_all(-1)), lasts_s=1.0),
    "registers_8000": Disaster(
        what="all registers 0x8000 for 1 s", deed=in_registers(_all(LOWEST_REGISTER)), lasts_s=1.0
    ),
    "attitude_frozen": Disaster(what="angles frozen for 30 s", deed=frozen(ANGLES), lasts_s=30.0),
    "roll_frozen": Disaster(what="roll alone frozen for 30 s", deed=frozen(("roll_rad",)), lasts_s=30.0),
    "acceleration_frozen": Disaster(what="accelerations frozen for 30 s", deed=frozen(FORCES), lasts_s=30.0),
    "old_readings": Disaster(
        what="for 60 s half of the rows an old one, 1.5 s of every 5", deed=old_readings(0.5, 1.5, 5.0), lasts_s=60.0
    ),
    "az_step_0.05": Disaster(what="az + 0.05 m/s2 from then on", deed=raised("az_mps2", 0.05), is_step=True),
    "az_step_0.5": Disaster(what="az + 0.5 m/s2 from then on", deed=raised("az_mps2", 0.5), is_step=True),
    "az_pulse_1": Disaster(what="az + 1 m/s2 for 3 s", deed=raised("az_mps2", 1.0), lasts_s=3.0),
    "az_noise": Disaster(what="az with 1 m/s2 RMS of noise for 20 s", deed=noisy(("az_mps2",), 1.0), lasts_s=20.0),
    "roll_sign": Disaster(
        what="sign of roll wrong", deed=negated("roll_rad"), from_start=True, asked=STAYS_WRONG
    ),
    "pitch_sign": Disaster(
        what="sign of pitch wrong", deed=negated("pitch_rad"), from_start=True, asked=STAYS_WRONG
    ),
    "attitude_signs": Disaster(
        what="signs of roll and pitch wrong", deed=negated("roll_rad", "pitch_rad"), from_start=True, asked=STAYS_WRONG
    ),
    "az_sign": Disaster(what="sign of az wrong", deed=negated("az_mps2"), from_start=True, asked=STAYS_WRONG),
    "az_in_g": Disaster(
        what="accelerations in g", from_start=True, asked=STAYS_WRONG,
        deed=mapped(FORCES, lambda values: values / GRAVITY_MPS2),
    ),
    "gravity_removed": Disaster(
        what="gravity removed from az", deed=raised("az_mps2", -GRAVITY_MPS2), from_start=True, asked=STAYS_WRONG
    ),
    "list_3": Disaster(
        what="a real list of 3 degrees within 5 s", move=listed(radians(3.0), 5.0), is_step=True, unforeseen_s=6.0
    ),
    # The vessel and its sensors, at once or by themselves.
    "list_and_bursts": Disaster(
        what="a list of 3 degrees within 5 s while angles come in bursts for 60 s", move=listed(radians(3.0), 5.0),
        deed=blank_in_bursts(ANGLES, 0.7, 0.5), lasts_s=60.0, unforeseen_s=6.0,
    ),
    "list_slow": Disaster(
        what="a list of 3 degrees within 60 s", move=listed(radians(3.0), 60.0), is_step=True, unforeseen_s=60.0
    ),
    "turn_into_sea": Disaster(
        what="waves are met 1.25 times as fast within 40 s", move=turned_into_the_sea(0.8, 40.0), is_step=True,
        asked=Asked(heave_ratio=None, rock_ratio=None),
    ),
    "swell_arrives": Disaster(
        what="a swell of 16 s, 0.1 m each of three lines, within 240 s", move=met_by_a_swell(0.1, 240.0), is_step=True,
        asked=Asked(within_s=300.0, heave_ratio=None, rock_ratio=None),
    ),
    "sea_grows": Disaster(
        what="the sea grows from a tenth of its height within 5 min", move=growing(0.1, 300.0), from_start=True,
        asked=HONEST,
    ),
    "sensor_restarts": Disaster(
        what="no rows for 15 s, then az + 0.1 m/s2", deed=restarted(15.0, 0.1), is_step=True
    ),
    "angles_exchanged": Disaster(
        what="roll and pitch exchanged for 10 s", deed=exchanged("roll_rad", "pitch_rad"), lasts_s=10.0
    ),
    "az_gain_105": Disaster(
        what="az 5 % too large from then on", deed=mapped(("az_mps2",), lambda values: 1.05 * values), is_step=True,
        asked=STAYS_WRONG,
    ),
    "polls_7hz": Disaster(
        what="7 polls a second", deed=slower_rows(7.0), from_start=True,
        asked=Asked(back="usable", within_s=20.0, heave_ratio=None, rock_ratio=None),
    ),
    "clock_200ppm": Disaster(
        what="measures 200 ppm slower than it is polled", deed=measured_slowly(1.0 - 2e-4), from_start=True,
        asked=AS_WHOLE,
    ),
    # A laser as aid.
    "clean_aiding": Disaster(what="nothing", laser="aiding", from_start=True, asked=HONEST),
    "aiding_jump": Disaster(
        what="laser + 1 m from then on", laser="aiding", deed=raised("laser_m", 1.0), is_step=True
    ),
    "aiding_zero": Disaster(
        what="laser reads 0 for 30 s", laser="aiding", deed=mapped(("laser_m",), lambda m: 0.0 * m), lasts_s=30.0
    ),
    "aiding_sign": Disaster(
        what="laser counts backwards for 30 s", laser="aiding", lasts_s=30.0,
        deed=mapped(("laser_m",), lambda m: 2.0 * LASER_DISTANCE_M - m),
    ),
    "aiding_boat": Disaster(
        what="a boat under the laser: 9 m less for 20 s", laser="aiding", deed=raised("laser_m", -9.0), lasts_s=20.0
    ),
    "aiding_creep": Disaster(
        what="laser creeps 1 cm a minute", laser="aiding", deed=creeping("laser_m", 0.01 / 60.0), is_step=True,
        asked=Asked(heave_ratio=None),
    ),
    "aiding_lost": Disaster(
        what="half of the laser's readings missing for 60 s", laser="aiding", deed=blank(("laser_m",), 0.5),
        lasts_s=60.0,
    ),
    "aiding_gone": Disaster(
        what="no laser for 60 s", laser="aiding", deed=blank(("laser_m",), 1.0), lasts_s=60.0
    ),
    # A laser as reference.
    "clean_reference": Disaster(what="nothing", laser="reference", from_start=True, asked=HONEST),
    "reference_jump": Disaster(
        what="laser + 1 m from then on", laser="reference", deed=raised("laser_m", 1.0), is_step=True
    ),
    "reference_mm": Disaster(
        what="laser in mm", laser="reference", from_start=True, asked=Asked(back="usable", within_s=20.0),
        deed=mapped(("laser_m",), lambda m: 1000.0 * m),
    ),
    "reference_flat_ends": Disaster(
        what="laser ends at +-0.5 m", laser="reference", from_start=True, asked=Asked(back="usable", within_s=20.0),
        deed=mapped(("laser_m",), lambda m: np.clip(m, LASER_DISTANCE_M - 0.5, LASER_DISTANCE_M + 0.5)),
    ),
    "reference_sign": Disaster(
        what="laser counts backwards", laser="reference", from_start=True, asked=Asked(back="usable", within_s=20.0),
        deed=mapped(("laser_m",), lambda m: 2.0 * LASER_DISTANCE_M - m),
    ),
    "reference_gone": Disaster(
        what="no laser for 60 s", laser="reference", deed=blank(("laser_m",), 1.0), lasts_s=60.0
    ),
    "reference_scattered": Disaster(
        what="laser with 5 cm of noise, one reading in 10 off by up to 3 m", laser="reference", from_start=True,
        deed=scattered("laser_m", 0.05, 0.1, 3.0), asked=Asked(back="usable", within_s=20.0),
    ),
    # What a restart remembers.
    "memory_calmer": Disaster(
        what="state of a calmer sea", memory="calmer sea", from_start=True, is_step=True, asked=AS_WHOLE
    ),
    "memory_same": Disaster(
        what="state of the same sea", memory="same sea", from_start=True, is_step=True, asked=AS_WHOLE
    ),
    "memory_zeros": Disaster(
        what="state with 0 for every number", memory="zeros", from_start=True, is_step=True, asked=AS_WHOLE
    ),
    "memory_huge": Disaster(
        what="state with 1e300 for every number", memory="huge", from_start=True, is_step=True, asked=AS_WHOLE
    ),
}  # fmt: skip
"""By name. A fault that ends is to leave nothing behind; one that stays is to be lived with, or to be said."""

HONEST_OF: Final = {"off": "clean", "aiding": "clean_aiding", "reference": "clean_reference"}
"""The honest record that a disaster is compared with, by its laser."""


def spoiled(recording: Recording, disaster: Disaster, span: Span, seed: int) -> Recording:
    """What the devices deliver of an honest record. ``seed`` draws what is random about it."""
    if disaster.deed is None:
        return recording
    return disaster.deed(recording, span, np.random.default_rng([seed, 4000]))

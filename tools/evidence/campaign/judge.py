"""What the daemon has published, against what was true; and what it has recorded, against what the slaves were asked.

Everything is read as any client would: lines of the stream, decoded here, and the files of the recording.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter, defaultdict
from contextlib import suppress
from datetime import datetime
from math import inf, isfinite, nan
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.recorder.found import RecordedError
from heaved.recorder.read import open_recorded, rows_of
from heaved.samples import CraneSample, Fault, HeaveState

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from evidence.campaign.process import Clock
    from evidence.campaign.truth import Truth
    from heaved.recorder.layout import Header

MOST_STDS: Final = 4.0
CLOCK_STEP_S: Final = 2e-3
"""Of what the slaves' clocks say, and of the stamps in the recording."""
BEYOND_M: Final = 30.0
"""No vessel heaves so far."""
ANGLE_LIMIT_DEG: Final = 1.0
"""Roll and pitch now have no published standard deviation: that of an honest reading is 0.02 degrees here."""
STEP_SEEN_S: Final = 3.0
"""The clock is looked at once a second, and lines wait."""
TIME_OFF_S: Final = 0.55
"""A smaller step is followed slowly."""
GOES_ON_S: Final = 15.0
"""What is wrong again within this has not been well between."""
_NO_SAMPLES: Final = frozenset({"no samples"} | {fault.value for fault in Fault})
"""What the daemon says of an IMU that has given nothing for a second."""
_PREFIX: Final = b'{"class":"MOTION"'


class _Quality(msgspec.Struct):
    heave: str
    laser: str = ""
    reasons: tuple[str, ...] = ()


class Line(msgspec.Struct):
    """What is needed of a MOTION line; nan: left out by the daemon."""

    seq: int
    mono_s: float
    quality: _Quality
    time: str = ""
    """UTC."""
    heave_m: float = nan
    heave_std_m: float = nan
    roll_deg: float = nan
    pitch_deg: float = nan
    dropped: int = 0

    @property
    def is_of_a_sample(self) -> bool:
        """Whether fresh readings of the IMU are behind it."""
        return not any(
            reason.startswith("imu: ") and (reason.endswith(", extrapolated") or reason[5:] in _NO_SAMPLES)
            for reason in self.quality.reasons
        )

    @property
    def is_valid(self) -> bool:
        return self.quality.heave == HeaveState.VALID.value


class Score:
    """What was seen of one fault."""

    def __init__(self) -> None:
        self.events = 0
        self.episodes = 0
        self.not_survived: list[str] = []
        self.recovery_s = 0.0
        self.valid_again_s = 0.0
        self.records_s = 0.0
        """Until the recording went on."""
        self.worst_stds = 0.0
        self.worst_m = 0.0
        self.worst_angle_deg = 0.0
        self.valid = self.lines = 0
        self.wrong: list[str] = []


class Judge:
    """A client of the stream that knows the truth. One that is connected again whenever the stream ends.

    Attributes:
        scores: by the name of the fault.
        now: name of the fault to which lines count.
        last: the newest line.
    """

    def __init__(self, truth: Truth, trace: Callable[[str], None] = lambda _text: None) -> None:
        """``trace``: told of each change of state and reasons."""
        self._truth, self.trace = truth, trace
        self._said: tuple[object, ...] = ()
        self.clock: Clock | None = None
        """By how much the daemon's UTC is off that of the machine; None: nobody asks."""
        self._stepped_s = -inf
        self._offset_s = 0.0
        self.scores: defaultdict[str, Score] = defaultdict(Score)
        self.now = "none"
        self.last: Line | None = None
        self.last_good_s = -inf
        """Moment of validity of the newest line with fresh readings behind it,"""
        self.last_valid_s = -inf
        """and of the newest valid one."""
        self.dropped = 0
        self._wrong = "none", -inf
        """Fault and moment of the last that was wrong."""
        self.connections = 0
        self._changed = asyncio.Event()
        self._decoder = msgspec.json.Decoder(Line)

    async def run(self, port: int) -> None:
        """Follow the stream for ever."""
        while True:
            with suppress(OSError):
                reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1 << 20)
                self.connections += 1
                try:
                    while text := await reader.readline():
                        if text.startswith(_PREFIX) and text.endswith(b"\n"):
                            self._take(self._decoder.decode(text))
                finally:
                    writer.transport.abort()
            await asyncio.sleep(0.02)

    def _take(self, line: Line) -> None:
        score = self.scores[self.now]
        before = len(score.wrong)
        self.dropped += line.dropped
        score.lines += 1
        self.last = line
        if line.is_of_a_sample:
            self.last_good_s = max(self.last_good_s, line.mono_s)
        if (said := (line.quality.heave, line.quality.laser, line.quality.reasons)) != self._said:
            self._said = said
            self.trace(f"  {line.mono_s:.3f} {line.quality.heave}: {'; '.join(line.quality.reasons)}")
        self._check_time(line, score)
        true = self._truth.at(line.mono_s)
        heave_m = abs(line.heave_m - true.heave_m)
        if isfinite(line.heave_m) and abs(line.heave_m) > BEYOND_M:
            score.wrong.append(f"heave {line.heave_m:.1f} m at {line.mono_s:.2f} s")
        if line.is_valid:
            score.valid += 1
            self.last_valid_s = max(self.last_valid_s, line.mono_s)
            stds = heave_m / line.heave_std_m if line.heave_std_m > 0.0 else inf
            if not stds <= MOST_STDS:
                score.wrong.append(
                    f"heave {line.heave_m:.3f} m, {line.heave_std_m:.3f} m, where {true.heave_m:.3f} m was true, at "
                    f"{line.mono_s:.2f} s"
                )
            angle_deg = max(abs(line.roll_deg - true.roll_deg), abs(line.pitch_deg - true.pitch_deg))
            if angle_deg > ANGLE_LIMIT_DEG:
                score.wrong.append(
                    f"roll and pitch {line.roll_deg:.2f} and {line.pitch_deg:.2f} degrees, where {true.roll_deg:.2f} "
                    f"and {true.pitch_deg:.2f} were true, at {line.mono_s:.2f} s"
                )
            if stds <= MOST_STDS or line.mono_s - self._wrong[1] > GOES_ON_S:
                score.worst_stds = max(score.worst_stds, stds)
                score.worst_m = max(score.worst_m, heave_m)
            else:
                begun = self.scores[self._wrong[0]]
                begun.worst_stds = max(begun.worst_stds, stds)
                begun.worst_m = max(begun.worst_m, heave_m)
            if isfinite(angle_deg):
                score.worst_angle_deg = max(score.worst_angle_deg, angle_deg)
        if len(score.wrong) > before:
            self._blame(score, line.mono_s, score.wrong[before:])
        self._changed.set()

    def _check_time(self, line: Line, score: Score) -> None:
        """A published time is that of its moment on the clock that was there then."""
        if self.clock is None or not line.time:
            return
        now_s = time.monotonic()
        if self.clock.offset_s != self._offset_s:
            self._offset_s, self._stepped_s = self.clock.offset_s, now_s
        true_s = time.time() - now_s + line.mono_s + self._offset_s
        off_s = datetime.fromisoformat(line.time).timestamp() - true_s
        if now_s - self._stepped_s > STEP_SEEN_S and abs(off_s) > TIME_OFF_S:
            score.wrong.append(f"a time that is {off_s:.1f} s off, {now_s - self._stepped_s:.1f} s after a step")

    def _blame(self, score: Score, mono_s: float, wrong: Sequence[str]) -> None:
        """What goes on being wrong is of the fault with which it began."""
        name, last_s = self._wrong
        self._wrong = (name if mono_s - last_s < GOES_ON_S else self.now), mono_s
        if self._wrong[0] != self.now:
            del score.wrong[-len(wrong) :]
            self.scores[self._wrong[0]].wrong += wrong

    async def good_after(self, since_s: float, patience_s: float) -> float:
        """Seconds from ``since_s`` until a line told of fresh readings of after that; inf: none within the patience."""
        return await self._until(since_s, patience_s, lambda: self.last_good_s)

    async def valid_after(self, since_s: float, patience_s: float) -> float:
        """The same of valid heave."""
        return await self._until(since_s, patience_s, lambda: self.last_valid_s)

    async def _until(self, since_s: float, patience_s: float, newest_s: Callable[[], float]) -> float:
        with suppress(TimeoutError):
            async with asyncio.timeout(patience_s):
                while newest_s() <= since_s:
                    self._changed.clear()
                    await self._changed.wait()
                return time.monotonic() - since_s
        return inf


# ---- the recording ---------------------------------------------------------------------------------------------------


class Kept(msgspec.Struct, frozen=True):
    """What a recording holds of one run of the daemon."""

    run: str
    rows: int
    missing: int
    """Calls between the first and the last that are not there."""
    longest_gap_s: float
    """Between two polls where some are missing between; 0: none are."""
    first_s: float
    last_s: float
    """Moments of the first and the last poll, monotonic."""
    polls: dict[str, int]
    """Rows by device."""
    clock_readings: int
    """Readings of the devices that tell their own clock,"""
    wrong_readings: int
    """and those which are not of their moment, or put together from two."""
    latest_ms: float
    """Greatest distance between a clock reading and the moment that it was recorded for."""
    example: str = ""


def recorded(directory: Path, begin_s: float, slack_s: float) -> tuple[list[Kept], list[str]]:
    """Each run in ``directory``, and what the reader has to remark.

    ``begin_s``: when the clocks of the slaves were at zero; ``slack_s``: a reading may be so much younger than its
    moment, never older.
    """
    try:
        found = open_recorded(directory, "samples")
    except RecordedError as error:
        return [], [str(error)]
    runs = []
    for hours in found.runs:
        counts: Counter[str] = Counter()
        readings = wrong = rows = 0
        latest_s, first_s, last_s, example = 0.0, inf, -inf, ""
        seqs: list[int] = []
        gap_s, before_s = 0.0, inf
        for hour in hours:
            for row in rows_of(hour):
                rows += 1
                is_gap = bool(seqs) and row.seq != seqs[-1] + 1
                seqs.append(row.seq)
                sample = row.sample
                if sample is None:
                    continue
                gap_s = max(gap_s, sample.t_s - before_s) if is_gap else gap_s
                before_s = sample.t_s
                counts[type(sample).__name__] += 1
                first_s, last_s = min(first_s, sample.t_s), max(last_s, sample.t_s)
                if isinstance(sample, CraneSample) and sample.fault is Fault.NONE and isfinite(sample.line_out_m):
                    readings += 1
                    told_s = begin_s + 0.1 * sample.line_out_m  # 1 cm is 1 ms.
                    off_s = told_s - sample.t_s
                    latest_s = max(latest_s, abs(off_s))
                    if not -CLOCK_STEP_S <= off_s <= slack_s:  # Never of before it was asked for.
                        wrong += 1
                        example = f"{off_s * 1e3:.0f} ms off at {sample.t_s:.3f} s"
        missing = max(seqs) - min(seqs) + 1 - len(set(seqs)) if seqs else 0
        header: Header = hours[0].header
        runs.append(
            Kept(
                run=header.run,
                rows=rows,
                missing=missing,
                longest_gap_s=gap_s,
                first_s=first_s,
                last_s=last_s,
                polls=dict(counts),
                clock_readings=readings,
                wrong_readings=wrong,
                latest_ms=latest_s * 1e3,
                example=example,
            )
        )
    return runs, list(found.remarks)

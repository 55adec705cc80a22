"""A campaign: lives of the daemon, each with its faults, and the table of what came of them."""

from __future__ import annotations

import asyncio
import json
import random
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from math import inf, isnan, nan
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

from evidence.campaign import deviations, episodes
from evidence.campaign.episodes import Episode
from evidence.campaign.hours import laser_lost
from evidence.campaign.judge import Judge, Kept, Score, recorded
from evidence.campaign.rig import QUICK, Rig, can_mount, new_truth

if TYPE_CHECKING:
    from collections.abc import Sequence

RECOVERS_S: Final = 1.0
"""Fresh readings are published so soon after their device is back."""
LASER_AWAY: Final = "laser lost for an hour"
LASER_FOUND_S: Final = 60.0
"""Its target is elsewhere by then, and how far it is away has to be found anew: the constant_time_s of [laser]."""
PATIENCE_S: Final = 15.0
"""Waited for, for a recovery that is late."""
VALID_PATIENCE_S: Final = 6.0
"""Waited for valid heave before the next episode."""
BREAKING: Final = ("craft", "heave_sensor")
"""Of the slaves that only answer: those whose connections break, and break."""
PROMPT: Final = ("reference_mru", "pitch_sensor")
"""And those which always answer at once, so that the daemon has as many bad answers as it can take."""
LOADED_S: Final = 0.5
"""Granted beside all times, to a machine that has other things to do."""
STOPS_S: Final = 2.0
"""Whatever hangs."""
DISK_GAP_S: Final = 15.0
"""An episode, the recorder started again, and a busy machine."""
RECORDER_STARTS_S: Final = 30.0
SECOND_S: Final = 1.0 + 2.0 * LOADED_S
"""The last second before an end may be missing from a recording."""
SLAVE_HELD_UP_S: Final = 0.1
"""So much later than it was asked may a reading be, since the slaves share that machine."""


class Settings(msgspec.Struct, frozen=True):
    """What to do."""

    seed: int = 1
    minutes: float = 20.0
    sea: str = "S4"
    only: tuple[str, ...] = ()
    """Words; only episodes and lives that have one of them in their names."""
    quick: tuple[str, ...] = tuple(QUICK)
    with_page: bool = True
    own_disk: bool = True
    laser_away_s: float = 3600.0
    """Of time that is data; 0: it stays."""
    settles_s: float = 180.0
    """A daemon that has learned nothing yet is valid within this; 0: valid heave is not waited for."""


class Life(msgspec.Struct, frozen=True):
    """One part of a campaign."""

    name: str
    share: float
    """Of the time."""
    serial: bool
    offered: Callable[[Rig], list[Episode]]
    kills: bool = False
    """The daemon, again and again, once it records,"""
    stops: bool = False
    """or it is told to stop as soon as it listens, its recorder not begun."""
    needs_valid: bool = True
    """Begins once the heave is valid."""
    most_gap_s: float = 0.0
    """May be missing at a time within the recording."""


LIVES: Final = (
    Life("IMU on TCP", 0.42, False, episodes.usual),
    Life("IMU on a serial line", 0.3, True, episodes.usual),
    Life("recorder and descriptors", 0.08, False, episodes.starved, needs_valid=False, most_gap_s=SECOND_S),
    Life("disk", 0.1, False, episodes.unwritable, needs_valid=False, most_gap_s=DISK_GAP_S),
    Life("no file may grow", 0.05, False, episodes.limited, needs_valid=False, most_gap_s=inf),
    Life("daemon killed", 0.1, False, episodes.usual, kills=True, needs_valid=False),
    Life("daemon stopped early", 0.06, False, episodes.usual, stops=True, needs_valid=False),
    Life("old readings in between", 0.05, False, episodes.old_readings),
)


class LifeResult(msgspec.Struct, frozen=True, kw_only=True):
    """What one part of a campaign has shown of the daemon as a whole."""

    name: str
    took_s: float
    settled_s: float
    exit_code: int
    uses: list[tuple[float, float, int, int]]
    """Seconds, MB, descriptors, threads."""
    kept: list[Kept]
    tail_s: float
    """The most that is not in a recording of what was before the daemon's end."""
    remarks: list[str]
    lines: int
    dropped: int


class Found(msgspec.Struct, frozen=True, kw_only=True):
    """What a campaign has found."""

    scores: dict[str, Score]
    lives: list[LifeResult]
    failures: list[str]
    took_s: float
    events: int
    bad_answers: int


class Campaign:
    """Runs lives of the daemon one after the other in one folder."""

    def __init__(self, settings: Settings, folder: Path, say: Callable[[str], None] = lambda _text: None) -> None:
        self._settings, self._folder, self._say = settings, folder, say
        self._chance = random.Random(settings.seed)  # noqa: S311  # Seeded.
        truth, self._begin_s = new_truth(settings.sea, settings.seed, 600.0 + 60.0 * settings.minutes)
        self.truth = truth
        self._trace = (folder / "trace").open("w", encoding="utf-8", buffering=1)
        self.judge = Judge(truth, lambda text: print(text, file=self._trace))
        self.failures: list[str] = []
        self._bad_answers = 0

    async def run(self, lives: Sequence[Life] = LIVES) -> Found:
        """All of them."""
        only = self._settings.only
        chosen = [life for life in lives if not only or any(word in life.name for word in only)] or list(lives)
        with self._trace:
            return await self._lives(chosen)

    async def _lives(self, chosen: Sequence[Life]) -> Found:
        started_s, whole = time.monotonic(), sum(life.share for life in chosen)
        done = [await self._life(life, 60.0 * self._settings.minutes * life.share / whole) for life in chosen]
        if self._settings.laser_away_s and self._is_wanted(LASER_AWAY):
            await asyncio.to_thread(self._laser_away)
        scores = {name: score for name, score in sorted(self.judge.scores.items()) if name != "none" or score.wrong}
        for name, score in scores.items():
            self.failures += [f"{name}: {what}" for what in (*score.not_survived[:3], *score.wrong[:3])]
        return Found(
            scores=scores, lives=done, failures=self.failures, took_s=time.monotonic() - started_s,
            events=sum(score.events for score in scores.values()), bad_answers=self._bad_answers,
        )  # fmt: skip

    def _is_wanted(self, name: str) -> bool:
        return not self._settings.only or any(word in name for word in self._settings.only)

    def _laser_away(self) -> None:
        """For hours, in minutes: no process, but the daemon's pipeline on samples."""
        found = laser_lost(self._settings.sea, self._settings.seed, self._settings.laser_away_s, self._say)
        for name, score in ((LASER_AWAY, found.score), (f"{LASER_AWAY}, afterwards", found.afterwards)):
            score.events = score.episodes = 1
            score.recovery_s = found.back_s
            if found.back_s > LASER_FOUND_S:
                score.not_survived.append(f"the laser is taken again {found.back_s:.1f} s after it is back")
            self.judge.scores[name] = score

    async def _life(self, life: Life, seconds: float) -> LifeResult:
        own_disk = self._settings.own_disk and can_mount() and life.offered is episodes.unwritable
        rig = Rig(
            self._folder, self.truth, self.judge, self._chance, self._begin_s, serial=life.serial,
            quick=self._settings.quick, with_page=self._settings.with_page, own_disk=own_disk,
        )  # fmt: skip
        try:
            return await self._lived(rig, life, seconds)
        finally:
            rig.release()
            self._put_away(rig)

    async def _lived(self, rig: Rig, life: Life, seconds: float) -> LifeResult:
        self.judge.now = "none"
        ends_s: list[float] = []
        started_s, lines, dropped = time.monotonic(), self._lines(), self.judge.dropped
        try:
            await rig.open()
            began_s = time.time()
            settled_s = await self._settled(life) if life.needs_valid else nan
            await rig.records(began_s - RECORDER_STARTS_S, RECORDER_STARTS_S)
            for slave in rig.quick:
                # Of one of them all readings are held against its clock; another breaks its connection again and again.
                values = () if slave.name == "crane" else deviations.VALUES
                kinds = [
                    one
                    for one in deviations.BYTES
                    if (slave.name in BREAKING or one not in deviations.BREAK_TCP)
                    and (slave.name not in PROMPT or one not in deviations.LET_WAIT)
                ]
                slave.behave(*kinds, *values, share=0.95, most=4)
            if life.kills:
                await self._kill(rig, time.monotonic() + seconds, ends_s)
            elif life.stops:
                await self._stop(rig, time.monotonic() + seconds, ends_s)
            else:
                await self._episodes(rig, life, time.monotonic() + seconds)
            for slave in rig.quick:
                slave.behave()
            rig.daemon.measure()
            uses = [(use.t_s - started_s, use.rss_mb, use.descriptors, use.threads) for use in rig.daemon.uses]
        finally:
            ends_s.append(time.monotonic())
            code = await rig.close()
            self._bad_answers += sum(slave.bad_answers for slave in rig.slaves.values())
        if code != 0:
            self.failures.append(f"{life.name}: the daemon ended with exit code {code}")
        self.failures += [f"{life.name}: {what}" for what in rig.daemon.ended]
        kept, remarks = await asyncio.to_thread(recorded, rig.disk / "recordings", self._begin_s, SLAVE_HELD_UP_S)
        tail_s = max((_tail_s(run, ends_s) for run in kept), default=nan)
        self._check(life, kept, remarks, tail_s)
        return LifeResult(
            name=life.name, took_s=time.monotonic() - started_s, settled_s=settled_s, exit_code=code, uses=uses,
            kept=kept, tail_s=tail_s, remarks=remarks, lines=self._lines() - lines,
            dropped=self.judge.dropped - dropped,
        )  # fmt: skip

    async def _settled(self, life: Life) -> float:
        patience_s = self._settings.settles_s
        if not patience_s:
            return nan
        settled_s = await self.judge.valid_after(time.monotonic(), patience_s)
        self._say(f"{life.name}: valid after {settled_s:.1f} s")
        if settled_s == inf:
            self.failures.append(f"{life.name}: the heave was not valid within {patience_s:g} s")
        return settled_s

    def _put_away(self, rig: Rig) -> None:
        """Each life has a recording of its own; the state stays, so that the next one starts warm."""
        if (rig.disk / "recordings").is_dir():
            (rig.disk / "recordings").rename(self._folder / f"recordings-{time.monotonic_ns()}")

    def _lines(self) -> int:
        return sum(score.lines for score in self.judge.scores.values())

    def _check(self, life: Life, kept: Sequence[Kept], remarks: Sequence[str], tail_s: float) -> None:
        if not kept:
            self.failures.append(f"{life.name}: nothing is recorded: {'; '.join(remarks)}")
        if tail_s > max(SECOND_S, life.most_gap_s):
            self.failures.append(f"{life.name}: the last {tail_s:.1f} s before an end are not in the recording")
        for run in kept:
            if run.missing and run.longest_gap_s > life.most_gap_s:
                self.failures.append(
                    f"{life.name}: {run.missing} rows are missing beside {run.rows} in the recording, for "
                    f"{run.longest_gap_s:.1f} s at a time"
                )
            if run.wrong_readings:
                self.failures.append(
                    f"{life.name}: {run.wrong_readings} of {run.clock_readings} readings are not of their moment "
                    f"({run.example})"
                )

    # ---- episodes ----------------------------------------------------------------------------------------------------

    async def _episodes(self, rig: Rig, life: Life, until_s: float) -> None:
        offered, only = life.offered(rig), self._settings.only
        chosen = [one for one in offered if not only or any(word in one.name for word in only)] or offered
        todo: list[Episode] = []
        measured_s = 0.0
        while time.monotonic() < until_s:
            # Each as often as the others, in an order of chance.
            todo = todo or self._chance.sample(chosen, len(chosen))
            await self._episode(rig, todo.pop())
            if rig.daemon.note_death(self.judge.now):
                self.judge.scores[self.judge.now].not_survived.append("the daemon has ended")
                await rig.daemon.start()
            if time.monotonic() - measured_s > 5.0:
                rig.daemon.measure()
                measured_s = time.monotonic()

    async def _episode(self, rig: Rig, episode: Episode) -> None:
        judge = self.judge
        judge.now = episode.name
        score = judge.scores[episode.name]
        score.episodes += 1
        judge.trace(f"{time.monotonic():.3f} {episode.name}")
        score.events += await episode.run(rig)
        judge.trace(f"{time.monotonic():.3f} is over")
        back_s = time.monotonic()
        recovery_s = await judge.good_after(back_s, PATIENCE_S)
        score.recovery_s = max(score.recovery_s, recovery_s)
        if recovery_s > RECOVERS_S + LOADED_S:
            last = judge.last
            said = "; ".join(last.quality.reasons) if last is not None else "nothing"
            score.not_survived.append(f"no fresh readings for {recovery_s:.2f} s after it was over ({said})")
        if episode.records_again_s:
            patience_s = episode.records_again_s + LOADED_S
            if not await rig.records(time.time(), patience_s):
                score.not_survived.append(f"the recording does not go on within {patience_s:g} s")
            score.records_s = max(score.records_s, time.monotonic() - back_s)
        if rig.page_has_ended:
            score.not_survived.append("the page has ended")
        if self._settings.settles_s:
            score.valid_again_s = max(score.valid_again_s, await judge.valid_after(back_s, VALID_PATIENCE_S))
        await asyncio.sleep(self._chance.uniform(0.0, 0.3))

    # ---- kills -------------------------------------------------------------------------------------------------------

    async def _kill(self, rig: Rig, until_s: float, ends_s: list[float]) -> None:
        judge = self.judge
        judge.now = name = "daemon killed"
        score = judge.scores[name]
        while time.monotonic() < until_s:
            # The state is saved once a second and the recording written all the time: kills fall into both.
            await asyncio.sleep(self._chance.uniform(0.0, 3.0))
            await rig.daemon.kill()
            ends_s.append(time.monotonic())
            score.events += 1
            score.episodes += 1
            killed_s, killed_utc_s = time.monotonic(), time.time()
            self._look_at_state(rig, score)
            await rig.daemon.start()
            listens_s = time.monotonic()
            recovery_s = await judge.good_after(listens_s, PATIENCE_S)
            score.recovery_s = max(score.recovery_s, recovery_s)
            if recovery_s > RECOVERS_S + LOADED_S:
                score.not_survived.append(f"no fresh readings for {recovery_s:.2f} s after it listened")
            self._say(f"killed: listening after {listens_s - killed_s:.1f} s, readings {recovery_s:.2f} s later")
            await rig.records(killed_utc_s + 0.5, RECORDER_STARTS_S)
            if self._chance.random() < 0.2:
                score.valid_again_s = max(score.valid_again_s, await judge.valid_after(killed_s, 30.0))

    async def _stop(self, rig: Rig, until_s: float, ends_s: list[float]) -> None:
        judge = self.judge
        judge.now = name = "daemon stopped early"
        score = judge.scores[name]
        while time.monotonic() < until_s:
            await asyncio.sleep(self._chance.uniform(0.0, 1.5))
            told_s = time.monotonic()
            code = await rig.daemon.stop()
            ends_s.append(time.monotonic())
            score.events += 1
            score.episodes += 1
            took_s = ends_s[-1] - told_s
            if took_s > STOPS_S + LOADED_S or code not in (0, 1):
                score.not_survived.append(f"it ended after {took_s:.1f} s, exit code {code}")
            self._look_at_state(rig, score)
            started_utc_s = time.time()
            await rig.daemon.start()
            recovery_s = await judge.good_after(time.monotonic(), PATIENCE_S)
            score.recovery_s = max(score.recovery_s, recovery_s)
            if recovery_s > RECOVERS_S + LOADED_S:
                score.not_survived.append(f"no fresh readings for {recovery_s:.2f} s after it listened")
        await rig.records(started_utc_s, RECORDER_STARTS_S)

    def _look_at_state(self, rig: Rig, score: Score) -> None:
        """Whatever the moment: an old state or a new one, whole."""
        path = rig.disk / "state" / "state.json"
        with suppress(FileNotFoundError):
            try:
                json.loads(path.read_bytes())
            except ValueError as error:
                score.not_survived.append(f"the state is torn: {error}")


def _tail_s(run: Kept, ends_s: Sequence[float]) -> float:
    """How much is missing at the end of a run."""
    return min((end_s - run.last_s for end_s in ends_s if end_s > run.last_s), default=0.0)


# ---- what came of it -------------------------------------------------------------------------------------------------


def table(found: Found) -> str:
    """As Markdown."""
    rows = [
        "| fault | events | episodes | survived | worst recovery, s | valid again, s | worst heave error, std | m | "
        "roll, pitch, deg | valid lines |",
        "|---|--:|--:|---|--:|--:|--:|--:|--:|--:|",
    ]
    for name, s in found.scores.items():
        survived = "yes" if not s.not_survived and not s.wrong else f"**no** ({len(s.not_survived)}, {len(s.wrong)})"
        figures = [f"{s.recovery_s:.2f}", _seconds(s.valid_again_s)] if s.episodes else ["", ""]
        figures += [f"{s.worst_stds:.2f}", f"{s.worst_m:.3f}", f"{s.worst_angle_deg:.2f}"] if s.valid else [""] * 3
        rows.append(
            f"| {name} | {s.events} | {s.episodes} | {survived} | {' | '.join(figures)} | {s.valid}/{s.lines} |"
        )
    lines = [
        f"{found.events} fault events in {found.took_s / 60.0:.1f} minutes "
        f"({found.events / max(found.took_s, 1e-9):.0f} a second), of which {found.bad_answers} answers that deviated "
        "in one way or in several.",
        "",
        *rows,
        "",
    ]
    for life in found.lives:
        valid = "" if isnan(life.settled_s) else f", valid after {life.settled_s:.0f} s"
        lines.append(f"* {life.name}: {life.took_s:.0f} s, {life.lines} lines{valid}. {_growth(life)}")
        for run in life.kept:
            polls = ", ".join(f"{name} {count}" for name, count in sorted(run.polls.items()))
            lines.append(
                f"  * recording: {run.rows} rows in {run.last_s - run.first_s:.0f} s, {run.missing} missing, "
                f"{run.longest_gap_s:.1f} s at a time ({polls}); "
                f"the last {life.tail_s:.2f} s before the end are not in it; "
                f"{run.clock_readings} clock readings, {run.wrong_readings} wrong, at most {run.latest_ms:.1f} ms off"
            ) if len(life.kept) < 4 else None
        if len(life.kept) >= 4:
            lines.append(
                f"  * {len(life.kept)} recordings, {sum(run.rows for run in life.kept)} rows, "
                f"{sum(run.missing for run in life.kept)} missing within them, at most the last {life.tail_s:.2f} s "
                "before an end; "
                f"{sum(run.wrong_readings for run in life.kept)} of "
                f"{sum(run.clock_readings for run in life.kept)} clock readings wrong"
            )
    lines += [
        f"* {name}: the recording went on after {score.records_s:.2f} s at the most."
        for name, score in found.scores.items()
        if score.records_s
    ]
    lines += ["", *(f"* **failed**: {what}" for what in found.failures)]
    return "\n".join(lines)


def _seconds(value: float) -> str:
    return f"> {VALID_PATIENCE_S:g}" if value == inf else f"{value:.2f}"


def _growth(life: LifeResult) -> str:
    """Memory, descriptors and threads from the first third to the last."""
    uses = life.uses
    if len(uses) < 6:
        return ""
    third = len(uses) // 3
    early, late = uses[third], uses[-1]
    highest = max(use[1] for use in uses)
    return (
        f"Memory {early[1]:.1f} MB after {early[0]:.0f} s, {late[1]:.1f} MB at the end (highest {highest:.1f}); "
        f"descriptors {early[2]}, {late[2]}; threads {early[3]}, {late[3]}."
    )


def campaign(settings: Settings, say: Callable[[str], None], folder: Path | None = None) -> Found:
    """Run one, in a folder of its own unless one is given."""
    if folder is not None:
        return asyncio.run(Campaign(settings, folder, say).run())
    with tempfile.TemporaryDirectory(prefix="heaved-campaign-") as made:
        return asyncio.run(Campaign(settings, Path(made), say).run())

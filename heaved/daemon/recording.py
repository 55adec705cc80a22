"""The hand-over to the process that records: every call into the pipeline, and every frame, in order.

The loop packs and appends, which takes it some ten microseconds a frame; a task of its own carries what has gathered to
the process, five times a second, and is kept until that has it on the disk: what a process had not written when it was
killed, the next one gets. While none runs, or the disk hangs, a few minutes are kept; what is beyond is lost, and
counted. Nothing here ever waits for a disk.
"""

from __future__ import annotations

import asyncio
import importlib.util
import os
import socket
import sys
import time
import uuid
from asyncio.subprocess import PIPE, Process
from collections import deque
from contextlib import suppress
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec
import structlog

from heaved import __version__
from heaved.daemon.recorded import FramePacker, PollPacker, layout_of
from heaved.daemon.state import state_directory
from heaved.outputs.output import OutputHealth
from heaved.recorder import messages
from heaved.recorder.calls import Restored, pack_fit
from heaved.recorder.layout import CALLS, HANDOVER, Call, Header, Layout, Report, Settings
from heaved.recorder.messages import Kind, packed

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.config import Config
    from heaved.devices.station import PollResult
    from heaved.estimation.heave.saved_state import SavedState
    from heaved.estimation.heave.sea.refit import SeaFit
    from heaved.samples import MotionFrame, TrainedNetwork

EXTRA: Final = "pip install 'heaved[recording]'"
CARRIED_S: Final = 0.2
"""What has gathered is carried to the process so often."""
LARGEST_CHUNK: Final = 1 << 16
MOST_KEPT_BYTES: Final = 32 << 20
"""Five minutes at 100 Hz."""
FIRST_PAUSE_S: Final = 1.0
LONGEST_PAUSE_S: Final = 60.0
GRACE_S: Final = 0.6
"""What the process may take to write the rest, once the daemon stops."""
HANGS_AFTER_S: Final = 10.0
"""A disk that takes nothing for so long is said to hang."""
MOST_ENDS: Final = 3
"""Processes that ended one after the other before they had written anything of what they were given: it is not given to
another."""
_HOUR_S: Final = 3600.0
_WORDS_BYTES: Final = 2000

_log = structlog.get_logger(__name__)


def has_extra() -> bool:
    """Whether what it takes is installed; it is not loaded, which is for the process that records."""
    return importlib.util.find_spec("pyarrow") is not None


def recording_directory(config: Config) -> Path:
    """Where recordings are kept."""
    given = config.recording.directory
    return Path(given).expanduser() if given else state_directory(config.state.directory) / "recordings"


class Journal:
    """What the daemon tells of each call into the pipeline, recorded or not: calls are counted from the start, so that
    a recording shows whether it has all of them.

    Attributes:
        calls: so far.
    """

    def __init__(self, offset_s: Callable[[], float], learned: Callable[[], SavedState]) -> None:
        """``offset_s``: UTC minus the monotonic clock. ``learned``: what a restart would remember now."""
        self.calls = 0
        self.run = uuid.uuid4().hex
        self.offset_s, self.learned = offset_s, learned
        self._output: RecordingOutput | None = None
        self._restored: bytes | None = None

    def output_of(self, config: Config) -> RecordingOutput:
        """The output that records from now on."""
        self._output = RecordingOutput(config, self)
        if self._restored is not None and self.calls == 1:
            # It was the first of all, and came before there was anybody to tell.
            self._output.call(Call.RESTORED, 0, nan, self._restored)
        return self._output

    def ended(self, output: RecordingOutput) -> None:
        """That output records no more."""
        if self._output is output:
            self._output = None

    def polled(self, result: PollResult) -> None:
        """The pipeline takes the sample of a poll."""
        seq = self._count()
        if self._output is not None:
            self._output.poll(result, seq)

    def coasted(self, t_s: float) -> None:
        """The pipeline makes a frame without a sample."""
        self._call(Call.COAST, t_s)

    def restored(self, state: SavedState, age_s: float) -> None:
        """The pipeline took over what an earlier run had learned."""
        self._restored = msgspec.msgpack.encode(Restored(state=state, age_s=age_s))
        self._call(Call.RESTORED, nan, self._restored)

    def network(self, network: TrainedNetwork) -> None:
        """The pipeline is given a network."""
        self._call(Call.NETWORK, nan, network)

    def fit(self, fit: SeaFit) -> None:
        """The pipeline is given a fit of the sea."""
        self._call(Call.FIT, nan, pack_fit(fit) if self._output is not None else b"")

    def refit(self, *, is_made: bool) -> None:
        """The hull's stage is given a refit, or told that it came to nothing."""
        self._call(Call.REFIT if is_made else Call.REFIT_FAILED, nan)

    def relieved(self, *, is_relieved: bool) -> None:
        """The pipeline does without what it can do without, or no longer."""
        self._call(Call.RELIEVED if is_relieved else Call.RESUMED, nan)

    def configured(self, call: Call, config: Config) -> None:
        """The pipeline, or a stage, begins anew with this configuration."""
        self._call(call, nan, msgspec.json.encode(config))

    def renewed(self, config: Config) -> None:
        """This configuration is in force now: what follows may have other columns."""
        if self._output is not None and config != self._output.config:
            self._output.renew(config)

    def _count(self) -> int:
        self.calls += 1
        return self.calls - 1

    def _call(self, call: Call, t_s: float, record: msgspec.Struct | bytes = b"") -> None:
        seq = self._count()
        if self._output is not None:
            body = record if isinstance(record, bytes) else msgspec.msgpack.encode(record)
            self._output.call(call, seq, t_s, body)


class _Chunk(msgspec.Struct, frozen=True, gc=False):
    """Messages that gathered, and the header that they are under."""

    header: bytes
    body: bytes
    rows: int


class RecordingOutput:
    """Carries what is recorded to its process, and has that running.

    Attributes:
        health: how it fares.
    """

    def __init__(
        self,
        config: Config,
        journal: Journal,
        *,
        command: tuple[str, ...] = (sys.executable, "-m", "heaved.recorder.serve"),
        retry_s: float = 60.0,
    ) -> None:
        params = config.recording
        self.health = OutputHealth("recording", "recording", str(recording_directory(config)))
        self._journal = journal
        self._command = command
        self._vessel = params.vessel or socket.gethostname()
        self._settings = Settings(
            directory=str(recording_directory(config).absolute()),
            max_bytes=round(1e9 * params.max_gb),
            max_age_s=86400.0 * params.max_days,
            retry_s=retry_s,
        )
        self._what = params.what
        self._header = self._sent_header = b""
        self.config: Config
        """Whose columns are recorded."""
        self._hour = -1
        self._polls: dict[str, PollPacker] = {}
        self._frames: FramePacker
        self._layout: Layout
        self._gathered: list[bytes] = []
        self._gathered_bytes = self._rows = 0
        self._kept: deque[_Chunk] = deque()
        self._given: deque[tuple[int, _Chunk]] = deque()
        """What the process has been given and has not settled, each with the rows that it will then have settled."""
        self._given_rows = 0
        self._kept_bytes = 0
        """Of all that is kept, given or not."""
        self._sent_before = self._lost_before = 0
        """Rows of the processes before this one that were written, and that were lost."""
        self._ends = 0
        """Processes that ended, one after the other, without having settled anything."""
        self._pause_s = FIRST_PAUSE_S
        self._has_begun = asyncio.Event()
        """The process reads what it is given."""
        self.renew(config)

    # ---- on the loop: pack and append --------------------------------------------------------------------------------

    def poll(self, result: PollResult, seq: int) -> None:
        """A poll."""
        packer = self._polls.get(result.device)
        if packer is not None:
            self._gather(packer.pack(result, seq))

    def call(self, call: Call, seq: int, t_s: float, record: bytes) -> None:
        """Any other call into the pipeline."""
        self._gather(packed(Kind.CALL, messages.CALL.pack(seq, CALLS.index(call), t_s) + record))

    def publish(self, frame: MotionFrame) -> None:
        """A frame."""
        if self._what != "samples":
            self._gather(self._frames.pack(frame))

    def renew(self, config: Config) -> None:
        """What follows has the columns of this configuration, and stands in files of its own."""
        self._cut()
        self.config = config
        self._frames = FramePacker(config)
        self._layout = layout_of(config, self._frames)
        self._polls = {device.name: PollPacker(i, device) for i, device in enumerate(self._layout.devices)}
        self._begin_file()

    def _begin_file(self) -> None:
        offset_s = self._journal.offset_s()
        now_utc_s = time.monotonic() + offset_s
        self._hour = int(now_utc_s // _HOUR_S)
        header = Header(
            vessel=self._vessel,
            run=self._journal.run,
            release=__version__,
            began_utc_s=now_utc_s,
            layout=self._layout,
            config=msgspec.Raw(msgspec.json.encode(self.config)),
            learned=msgspec.Raw(msgspec.json.encode(self._journal.learned())),
        )
        self._header = packed(Kind.HEADER, msgspec.json.encode(header))
        self._begin_chunk()

    def _gather(self, message: bytes) -> None:
        self._gathered.append(message)
        self._gathered_bytes += len(message)
        self._rows += 1
        if self._gathered_bytes >= LARGEST_CHUNK:
            self._cut()

    def _begin_chunk(self) -> None:
        self._gathered = [packed(Kind.OFFSET, messages.OFFSET.pack(self._journal.offset_s()))]
        self._gathered_bytes, self._rows = len(self._gathered[0]), 0
        # Chunks may be lost: what holds until it changes is told anew in each.
        self._frames.begin()

    def _cut(self) -> None:
        """What has gathered is ready to be carried."""
        if not self._rows:
            return
        chunk = _Chunk(self._header, b"".join(self._gathered), self._rows)
        if self._kept_bytes + len(chunk.body) > MOST_KEPT_BYTES:
            self.health.lost["full"] += chunk.rows
        else:
            self._kept.append(chunk)
            self._kept_bytes += len(chunk.body)
        self._begin_chunk()

    # ---- the task that carries ---------------------------------------------------------------------------------------

    async def run(self) -> None:
        """Keep the process running, and carry to it, until cancelled; then it gets the rest."""
        try:
            while not has_extra():
                self.health.down(f"what it takes is not installed: {EXTRA}")
                self._drop()
                await asyncio.sleep(LONGEST_PAUSE_S)
            while True:
                reason = await self._one_life()
                self.health.down(f"the recorder has ended: {reason}; it is started again")
                await asyncio.sleep(self._pause_s)
                self._pause_s = min(LONGEST_PAUSE_S, 2.0 * self._pause_s)
        finally:
            self._journal.ended(self)
            self._cut()
            self._take_back()
            if self._kept and has_extra():
                await asyncio.to_thread(self._hand_over)

    async def _one_life(self) -> str:
        """Run one process until it ends; why, with its last words."""
        try:
            process = await asyncio.create_subprocess_exec(
                *self._command, stdin=PIPE, stdout=PIPE, stderr=PIPE, env=_environment()
            )
        except OSError as error:
            return f"cannot start {self._command[0]}: {error}"
        self._has_begun.clear()
        tasks = [
            asyncio.create_task(self._carry(process), name="carry"),
            asyncio.create_task(self._listen(process), name="listen"),
        ]
        words = asyncio.create_task(_tail(process), name="words")
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        except asyncio.CancelledError:
            await self._finish(process, tasks)
            raise
        finally:
            for task in tasks:
                task.cancel()
            await _end(process)
            await asyncio.wait(tasks)
            said = (await words).decode("utf-8", "replace").strip()
        self._lost_before, self._sent_before = self.health.lost["disk"], self.health.sent
        self._ends += bool(self._given)
        self._take_back()
        self._settings = msgspec.structs.replace(self._settings, is_again=True)
        for task in tasks:
            if not task.cancelled() and task.exception() is not None and not isinstance(task.exception(), OSError):
                task.result()  # A bug, for whoever supervises this.
        return f"exit code {process.returncode}" + (f": {said}" if said else "")

    async def _carry(self, process: Process) -> None:
        assert process.stdin is not None
        # What is under way comes again if the process is killed: as little as can be, the rest waits here.
        process.stdin.transport.set_write_buffer_limits(high=0)
        process.stdin.write(packed(Kind.SETTINGS, msgspec.json.encode(self._settings)))
        self._sent_header = b""
        # What has left us before it reads would be lost with us: until then all is kept here.
        with suppress(TimeoutError):
            await asyncio.wait_for(self._has_begun.wait(), HANGS_AFTER_S)
        while True:
            self._roll_over()
            self._cut()
            while self._kept:
                self._send_first(process)
                await self._drain(process)
            await asyncio.sleep(CARRIED_S)

    def _send_first(self, process: Process) -> None:
        assert process.stdin is not None
        chunk = self._kept.popleft()
        self._given_rows += chunk.rows
        self._given.append((self._given_rows, chunk))
        if chunk.header is not self._sent_header:
            self._sent_header = chunk.header
            process.stdin.write(chunk.header)
        process.stdin.write(chunk.body)

    def _settle(self, rows: int) -> None:
        """The process is done with that many rows of what it was given."""
        while self._given and self._given[0][0] <= rows:
            _, chunk = self._given.popleft()
            self._kept_bytes -= len(chunk.body)
            self._ends = 0

    def _take_back(self) -> None:
        """The process has ended: what it has not settled is kept for the next, unless it may be what ends them."""
        given = [chunk for _, chunk in self._given]
        self._given.clear()
        self._given_rows = 0
        if self._ends < MOST_ENDS:
            self._kept.extendleft(reversed(given))
        else:
            self._ends = 0
            self._kept_bytes -= sum(len(chunk.body) for chunk in given)
            self.health.lost["given_up"] += sum(chunk.rows for chunk in given)

    async def _drain(self, process: Process) -> None:
        assert process.stdin is not None
        draining = asyncio.create_task(process.stdin.drain())
        try:
            done, _ = await asyncio.wait((draining,), timeout=HANGS_AFTER_S)
            if not done:
                self.health.down(
                    f"the disk of {self.health.where} has taken nothing for {HANGS_AFTER_S:g} s: look at it"
                )
            await draining
        finally:
            draining.cancel()

    def _roll_over(self) -> None:
        """Each hour of UTC has files of its own."""
        if int((time.monotonic() + self._journal.offset_s()) // _HOUR_S) != self._hour:
            self._cut()
            self._begin_file()

    async def _listen(self, process: Process) -> None:
        assert process.stdout is not None
        while line := await process.stdout.readline():
            report = msgspec.json.decode(line, type=Report)
            if report.has_begun:
                self._has_begun.set()
                continue
            if report.is_up:
                self.health.up()
                self._pause_s = FIRST_PAUSE_S
            else:
                self.health.down(report.detail)
            self._settle(report.settled)
            self.health.sent = self._sent_before + report.rows
            self.health.lost["disk"] = self._lost_before + report.lost
            if report.note:
                _log.info("recording", detail=report.note)

    async def _finish(self, process: Process, tasks: list[asyncio.Task[None]]) -> None:
        """The daemon stops: hand over the rest, as far as it is taken in time."""
        assert process.stdin is not None
        tasks[0].cancel()
        await asyncio.wait(tasks[:1])
        self._cut()
        if not self._has_begun.is_set():
            return  # It will not have read anything in time.
        with suppress(OSError, TimeoutError):
            while self._kept:
                self._send_first(process)
            process.stdin.close()
            await asyncio.wait_for(process.wait(), GRACE_S)
            if process.returncode == 0:  # It has settled all, whether we have read so by now or not.
                self._settle(self._given_rows)

    def _hand_over(self) -> None:
        """Keep what no process has settled in a file of its own: it loads, is too slow, or is to be started again."""
        held, data, rows = b"", [], 0
        for chunk in self._kept:
            data += [chunk.body] if chunk.header is held else [chunk.header, chunk.body]
            held, rows = chunk.header, rows + chunk.rows
        self._kept.clear()
        directory = Path(self.health.where)
        path = directory / f"heaved-{self._journal.run}-{self._journal.calls}{HANDOVER}"
        try:
            with suppress(FileExistsError):
                directory.mkdir(mode=0o750)
            unfinished = path.with_suffix(".tmp")
            with open(unfinished, "xb", opener=_private) as file:
                file.write(b"".join(data))
                file.flush()
                os.fsync(file.fileno())
            unfinished.rename(path)
        except OSError as error:
            _log.warning("the end of the recording is lost: the recorder did not run", rows=rows, reason=str(error))

    def _drop(self) -> None:
        self._cut()
        self.health.lost["off"] += sum(chunk.rows for chunk in self._kept)
        self._kept.clear()
        self._kept_bytes = 0


def _private(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NOFOLLOW, 0o640)


def _environment() -> dict[str, str]:
    return os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "ARROW_NUM_THREADS": "1"}


async def _tail(process: Process) -> bytes:
    assert process.stderr is not None
    tail = b""
    while chunk := await process.stderr.read(4096):
        tail = (tail + chunk)[-_WORDS_BYTES:]
    return tail


async def _end(process: Process) -> None:
    """Surely, whatever it does: our own child only."""
    assert process.stdin is not None
    process.stdin.close()
    if process.returncode is None:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()

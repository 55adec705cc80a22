"""The daemon's side of a worker process: training, and fitting the sea. No torch here: importing it stalls a loop.

``Worker`` serves the running daemon and never blocks it; ``BlockingTrainer`` serves replay, which waits for results.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import tempfile
from asyncio.subprocess import PIPE, Process
from collections.abc import Callable, Sequence
from contextlib import suppress
from threading import Timer
from types import TracebackType
from typing import Generic, Protocol, TypeVar, cast

import msgspec

from heaved.samples import TrainedNetwork, TrainingWindow
from heaved.workers import protocol

TRAINER = (sys.executable, "-m", "heaved.workers.train_correction")
FITTER = (sys.executable, "-m", "heaved.workers.fit_sea")
HULL_FITTER = (sys.executable, "-m", "heaved.workers.refit_hull")
LONGEST_JOB_S = 60.0
LONGEST_BACKOFF_S = 60.0
GRACE_S = 0.5
"""How long a process may take to end by itself once its stdin is closed."""
STDERR_KEPT_BYTES = 2000


class WorkerFailed(Exception):
    """The worker process died, hung or talked nonsense; the message says which."""


class Job(Protocol):
    """What is sent to a worker, and what comes back: both carry the number of the job."""

    @property
    def number(self) -> int: ...


Result = TypeVar("Result", bound=msgspec.Struct)


class Worker(Generic[Result]):
    """One worker process, started again with back-off (1, 2, 4 .. 60 s) whenever it fails.

    At most one job is under way and one waits; a newer job replaces the waiting one. The job under way when the process
    fails is dropped: the next one is seconds away, and the failure may be its fault.
    """

    def __init__(
        self,
        name: str,
        kind: type[Result],
        on_result: Callable[[Result], None],
        on_failure: Callable[[str], None],
        *,
        command: Sequence[str],
        longest_s: float = LONGEST_JOB_S,
        first_backoff_s: float = 1.0,
    ) -> None:
        """``kind``: the record of an answer. Both callbacks run on the loop; on_failure gets the reason and the last
        words of the process."""
        self._name = name
        self._kind = kind
        self._on_result = on_result
        self._on_failure = on_failure
        self._command = command
        self._longest_s = longest_s
        self._first_backoff_s = first_backoff_s
        self._backoff_s = first_backoff_s
        self._waiting: asyncio.Queue[tuple[int, bytes]] = asyncio.Queue(maxsize=1)
        """Number of a job, and its frame."""
        self._task: asyncio.Task[None] | None = None
        self.failures = 0
        """Times the process died, hung or talked nonsense."""
        self.replaced = 0
        """Jobs that a newer one replaced before they were begun."""

    async def start(self) -> None:
        """Start the process and its supervision."""
        self._task = asyncio.create_task(self._supervise(), name=self._name)

    def submit(self, job: Job) -> None:
        """Send this job as soon as the process is free. Never blocks.

        Raises:
            FrameError: the job is too large to be sent.
        """
        frame = protocol.encode(cast(msgspec.Struct, job))
        if self._waiting.full():
            self._waiting.get_nowait()
            self.replaced += 1
        self._waiting.put_nowait((job.number, frame))

    async def stop(self) -> None:
        """End the process within a second, whatever it is doing.

        Raises:
            Exception: a callback raised and ended the supervision: a bug, shown here rather than lost.
        """
        if self._task is None:
            return
        task, self._task = self._task, None
        task.cancel()
        await asyncio.wait((task,))
        if not task.cancelled():
            task.result()

    async def _supervise(self) -> None:
        while True:
            reason = await self._one_life()
            self.failures += 1
            self._on_failure(f"{self._name}: {reason}; starting it again in {self._backoff_s:g} s")
            await asyncio.sleep(self._backoff_s)
            self._backoff_s = min(LONGEST_BACKOFF_S, 2.0 * self._backoff_s)

    async def _one_life(self) -> str:
        """Run one process until it fails; the reason, with the last words it wrote to stderr."""
        try:
            process = await asyncio.create_subprocess_exec(
                *self._command, stdin=PIPE, stdout=PIPE, stderr=PIPE, env=_environment()
            )
        except OSError as error:
            return f"cannot start {self._command[0]}: {error}"
        last_words = asyncio.create_task(_tail(process))
        try:
            await self._serve(process)
        except WorkerFailed as error:
            reason = str(error)
        finally:
            try:
                await _end(process)
            finally:
                words = (await last_words).decode("utf-8", "replace").strip()
        return f"{reason} (exit code {process.returncode})" + (f": {words}" if words else "")

    async def _serve(self, process: Process) -> None:
        """Hand over jobs and deliver results until the process fails."""
        answer = asyncio.create_task(_answer(process, self._kind), name="answer")
        try:
            while True:
                submitted = asyncio.create_task(self._waiting.get())
                try:
                    await asyncio.wait((submitted, answer), return_when=asyncio.FIRST_COMPLETED)
                finally:
                    submitted.cancel()
                if answer.done():
                    answer.result()
                    raise WorkerFailed("it answered without being asked")
                self._on_result(await self._exchange(process, *submitted.result(), answer))
                self._backoff_s = self._first_backoff_s
                answer = asyncio.create_task(_answer(process, self._kind), name="answer")
        finally:
            answer.cancel()

    async def _exchange(self, process: Process, number: int, frame: bytes, answer: asyncio.Task[Result]) -> Result:
        assert process.stdin is not None
        try:
            async with asyncio.timeout(self._longest_s):
                process.stdin.write(frame)
                with suppress(ConnectionError):  # it died; the answer knows more
                    await process.stdin.drain()
                result = await answer
        except TimeoutError:
            raise WorkerFailed(f"a job took longer than {self._longest_s:g} s") from None
        answered = cast(Job, result).number
        if answered != number:
            raise WorkerFailed(f"it answered job {answered} instead of {number}")
        return result


class BlockingTrainer:
    """The same process, one window at a time, waiting for each: same input, same output. For replay.

    A context manager; the process starts with the first window, and again after a failure.
    """

    def __init__(self, *, command: Sequence[str] = TRAINER, longest_training_s: float = LONGEST_JOB_S) -> None:
        self._command = command
        self._longest_training_s = longest_training_s
        self._process: subprocess.Popen[bytes] | None = None
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 (lives as long as this object; close() ends it)

    def __enter__(self) -> BlockingTrainer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def fit(self, window: TrainingWindow) -> TrainedNetwork:
        """Train and wait. A failure of the process is the message of the result."""
        try:
            return self._exchange(window)
        except (OSError, WorkerFailed, protocol.FrameError) as error:
            self._end()
            self._stderr.seek(0)
            words = self._stderr.read()[-STDERR_KEPT_BYTES:].decode("utf-8", "replace").strip()
            return TrainedNetwork(number=window.number, message=f"trainer: {error}" + (f": {words}" if words else ""))

    def close(self) -> None:
        """End the process."""
        self._end()
        self._stderr.close()

    def _exchange(self, window: TrainingWindow) -> TrainedNetwork:
        if self._process is None:
            self._stderr.seek(0)
            self._stderr.truncate()
            self._process = subprocess.Popen(
                self._command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._stderr, env=_environment()
            )
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        watchdog = Timer(self._longest_training_s, process.kill)
        watchdog.start()
        try:
            process.stdin.write(protocol.encode(window))
            process.stdin.flush()
            result = protocol.read(process.stdout, TrainedNetwork)
        except OSError:
            result = None  # the same end, seen while writing
        finally:
            in_time = watchdog.is_alive()
            watchdog.cancel()
        if result is None and not in_time:
            raise WorkerFailed(f"a training took longer than {self._longest_training_s:g} s")
        if result is None:
            raise WorkerFailed("the process ended")
        if result.number != window.number:
            raise WorkerFailed(f"it answered window {result.number} instead of {window.number}")
        return result

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        process.communicate()


def _environment() -> dict[str, str]:
    """Ours, but one thread for every numerical library: the other core belongs to the tick."""
    return os.environ | {"OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


async def _answer(process: Process, kind: type[Result]) -> Result:
    assert process.stdout is not None
    try:
        header = await process.stdout.readexactly(protocol.HEADER.size)
        body = await process.stdout.readexactly(protocol.body_length(header))
        return protocol.decode(body, kind)
    except asyncio.IncompleteReadError:
        raise WorkerFailed("the process ended") from None
    except protocol.FrameError as error:
        raise WorkerFailed(str(error)) from error


async def _tail(process: Process) -> bytes:
    """The last bytes of stderr, read to its end so that a chatty process never blocks on a full pipe."""
    assert process.stderr is not None
    tail = b""
    while chunk := await process.stderr.read(4096):
        tail = (tail + chunk)[-STDERR_KEPT_BYTES:]
    return tail


async def _end(process: Process) -> None:
    """Close its stdin, then kill it: our own child only, and surely, even when cancelled while it takes its time."""
    assert process.stdin is not None
    process.stdin.close()
    try:
        async with asyncio.timeout(GRACE_S):
            await process.wait()
    except TimeoutError:
        pass
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()

"""Our side of a worker process (its own side: :mod:`heaved.workers.serve`). No torch here: importing it stalls a loop.

``Worker`` serves the running daemon and never blocks it; ``BlockingTrainer`` serves replay, which waits for results.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import tempfile
from asyncio.subprocess import PIPE, Process
from contextlib import suppress
from threading import Timer
from typing import TYPE_CHECKING, Final, Generic, cast

from heaved.samples import TrainedNetwork, TrainingWindow
from heaved.workers import protocol
from heaved.workers.jobs import TRAINING, Job, Numbered, Request, Result

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from types import TracebackType

LONGEST_JOB_S: Final = 60.0
LONGEST_BACKOFF_S: Final = 60.0
GRACE_S: Final = 0.5
"""How long a process may take to end by itself once its stdin is closed."""
STDERR_KEPT_BYTES: Final = 2000


class WorkerError(Exception):
    """The worker process died, hung or talked nonsense; the message says which."""


class Worker(Generic[Request, Result]):
    """One worker process, started again with back-off (1, 2, 4 .. 60 s) whenever it fails.

    At most one request is under way and one waits; a newer one replaces the waiting one. The request under way when the
    process fails is dropped: the next one is seconds away, and the failure may be its fault.
    """

    def __init__(
        self,
        job: Job[Request, Result],
        on_result: Callable[[Result], None],
        on_failure: Callable[[str], None],
        *,
        longest_s: float = LONGEST_JOB_S,
        first_backoff_s: float = 1.0,
    ) -> None:
        """Both callbacks run on the loop; on_failure gets the reason and the last words of the process."""
        self._job = job
        self._on_result = on_result
        self._on_failure = on_failure
        self._longest_s = longest_s
        self._first_backoff_s = first_backoff_s
        self._backoff_s = first_backoff_s
        self._waiting: asyncio.Queue[tuple[int, bytes]] = asyncio.Queue(maxsize=1)
        """Number of a request, and its frame."""
        self._asked = asyncio.Event()
        """There was a request."""
        self._task: asyncio.Task[None] | None = None
        self.failures = 0
        """Times the process died, hung or talked nonsense."""
        self.replaced = 0
        """Requests that a newer one replaced before they were begun."""

    async def start(self) -> None:
        """Start the supervision, and the process, unless that waits for work."""
        self._task = asyncio.create_task(self._supervise(), name=self._job.name)

    def submit(self, request: Request) -> None:
        """Send this as soon as the process is free. Never blocks.

        Raises:
            FrameError: it is too large to be sent.
        """
        frame = protocol.encode(request)
        if self._waiting.full():
            self._waiting.get_nowait()
            self.replaced += 1
        self._waiting.put_nowait((cast("Numbered", request).number, frame))
        self._asked.set()

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
        if self._job.waits_for_work:
            await self._asked.wait()
        while True:
            reason = await self._one_life()
            self.failures += 1
            self._on_failure(f"{self._job.name}: {reason}; starting it again in {self._backoff_s:g} s")
            await asyncio.sleep(self._backoff_s)
            self._backoff_s = min(LONGEST_BACKOFF_S, 2.0 * self._backoff_s)

    async def _one_life(self) -> str:
        """Run one process until it fails; the reason, with the last words it wrote to stderr."""
        try:
            process = await asyncio.create_subprocess_exec(
                *self._job.command, stdin=PIPE, stdout=PIPE, stderr=PIPE, env=_environment()
            )
        except OSError as error:
            return f"cannot start {self._job.command[0]}: {error}"
        last_words = asyncio.create_task(_tail(process))
        try:
            await self._serve(process)
        except WorkerError as error:
            reason = str(error)
        finally:
            try:
                await _end(process)
            finally:
                words = (await last_words).decode("utf-8", "replace").strip()
        return f"{reason} (exit code {process.returncode})" + (f": {words}" if words else "")

    async def _serve(self, process: Process) -> None:
        """Hand over requests and deliver results until the process fails."""
        answer = asyncio.create_task(_answer(process, self._job.result), name="answer")
        try:
            while True:
                submitted = asyncio.create_task(self._waiting.get())
                try:
                    await asyncio.wait((submitted, answer), return_when=asyncio.FIRST_COMPLETED)
                finally:
                    submitted.cancel()
                if answer.done():
                    answer.result()
                    raise WorkerError("it answered without being asked")
                self._on_result(await self._exchange(process, *submitted.result(), answer))
                self._backoff_s = self._first_backoff_s
                answer = asyncio.create_task(_answer(process, self._job.result), name="answer")
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
            raise WorkerError(f"a job took longer than {self._longest_s:g} s") from None
        answered = cast("Numbered", result).number
        if answered != number:
            raise WorkerError(f"it answered job {answered} instead of {number}")
        return result


class BlockingTrainer:
    """The same process, one window at a time, waiting for each: same input, same output. For replay.

    A context manager; the process starts with the first window, and again after a failure.
    """

    def __init__(self, *, command: Sequence[str] = TRAINING.command, longest_training_s: float = LONGEST_JOB_S) -> None:
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
        except (OSError, WorkerError, protocol.FrameError) as error:
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
            raise WorkerError(f"a training took longer than {self._longest_training_s:g} s")
        if result is None:
            raise WorkerError("the process ended")
        if result.number != window.number:
            raise WorkerError(f"it answered window {result.number} instead of {window.number}")
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
        raise WorkerError("the process ended") from None
    except protocol.FrameError as error:
        raise WorkerError(str(error)) from error


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

"""Supervision of the trainer process, against stand-ins that misbehave in one way each."""

from __future__ import annotations

import asyncio
import os
import sys
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import pytest
from training_windows import RAMP, window

from heaved.samples import TrainedNetwork, TrainingWindow
from heaved.workers.jobs import TRAINING, Job
from heaved.workers.process import BlockingTrainer, Worker
from heaved.workers.protocol import FrameError

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

PREAMBLE = """
import os, signal, sys
from heaved.samples import TrainedNetwork, TrainingWindow
from heaved.workers import protocol
def ask(): return protocol.read(sys.stdin.buffer, TrainingWindow) or sys.exit(0)
def say(number, message=""):
    sys.stdout.buffer.write(protocol.encode(TrainedNetwork(number=number, message=message)))
    sys.stdout.buffer.flush()
"""
ECHO = "while True: say(ask().number, message=os.environ['OMP_NUM_THREADS'])"
DIES = "sys.stderr.write('out of ' + 'cheese'); ask(); os._exit(3)"
HANGS = "ask(); signal.pause()"
BABBLES = "ask(); sys.stdout.write('Hello, world'); sys.stdout.flush(); signal.pause()"
WRONG_NUMBER = "say(ask().number + 1); signal.pause()"
UNASKED = "say(1); signal.pause()"
CHATTY = "sys.stderr.write('x' * 1_000_000); sys.stderr.flush()\n" + ECHO

MISBEHAVIOUR = {
    "dies": (DIES, "the process ended (exit code 3): out of cheese"),
    "hangs": (HANGS, "longer than 0.3 s"),
    "babbles": (BABBLES, "not a frame"),
    "wrong number": (WRONG_NUMBER, "instead of 1"),
}
every_misbehaviour = pytest.mark.parametrize(("script", "reason"), MISBEHAVIOUR.values(), ids=MISBEHAVIOUR.keys())


Training = Job[TrainingWindow, TrainedNetwork]


def job(script: str) -> Training:
    """A trainer that does as the script says, from the start."""
    return msgspec.structs.replace(TRAINING, command=command(script), waits_for_work=False)


def command(script: str) -> tuple[str, ...]:
    return (sys.executable, "-c", PREAMBLE + script)


def asking(number: int) -> TrainingWindow:
    return window(RAMP, RAMP[:, 0], number=number)


class Watcher:
    """Keeps what a trainer reports, and lets a test wait for it."""

    def __init__(self) -> None:
        self.results: asyncio.Queue[TrainedNetwork] = asyncio.Queue()
        self.failures: asyncio.Queue[str] = asyncio.Queue()


@asynccontextmanager
async def training(
    script: str, **options: float
) -> AsyncIterator[tuple[Worker[TrainingWindow, TrainedNetwork], Watcher]]:
    watcher = Watcher()
    trainer = Worker(
        job(script), watcher.results.put_nowait, watcher.failures.put_nowait, first_backoff_s=0.01, **options
    )
    await trainer.start()
    try:
        yield trainer, watcher
    finally:
        await trainer.stop()


async def test_results_come_back_one_by_one_from_a_single_threaded_process() -> None:
    async with training(ECHO) as (trainer, watcher):
        for number in (1, 2, 3):
            trainer.submit(asking(number))
            result = await watcher.results.get()
            assert (result.number, result.message) == (number, "1")
        assert (trainer.failures, trainer.replaced) == (0, 0)


async def test_a_newer_window_replaces_the_waiting_one() -> None:
    async with training(ECHO) as (trainer, watcher):
        for number in (1, 2, 3):  # nothing runs between these lines, so the first two never leave
            trainer.submit(asking(number))
        assert (await watcher.results.get()).number == 3
        assert trainer.replaced == 2


@every_misbehaviour
async def test_a_misbehaving_process_is_replaced_and_named(script: str, reason: str, tmp_path: Path) -> None:
    """The first life misbehaves, the second is well: the window that waits meanwhile is trained."""
    mark = tmp_path / "second"
    both = f"second = os.path.exists({str(mark)!r}); open({str(mark)!r}, 'w').close()\n"
    both += f"exec({ECHO!r}) if second else exec({script!r})"
    async with training(both, longest_s=0.3 if script is HANGS else 30.0) as (trainer, watcher):
        trainer.submit(asking(1))
        assert reason in await watcher.failures.get()
        trainer._longest_s = 30.0  # A busy machine takes long to start a process that is well.
        trainer.submit(asking(2))
        assert (await watcher.results.get()).number == 2
        assert trainer.failures == 1


async def test_an_idle_process_that_speaks_or_dies_is_noticed() -> None:
    async with training(UNASKED) as (_, watcher):
        assert "without being asked" in await watcher.failures.get()
    async with training("os._exit(4)") as (_, watcher):
        assert "exit code 4" in await watcher.failures.get()


async def test_a_process_that_waits_for_work_starts_with_it() -> None:
    waiting = msgspec.structs.replace(job(ECHO), waits_for_work=True)
    watcher = Watcher()
    trainer = Worker(waiting, watcher.results.put_nowait, watcher.failures.put_nowait)
    await trainer.start()
    for _ in range(20):
        await asyncio.sleep(0)
    assert child_pids() == set()
    trainer.submit(asking(1))
    assert (await watcher.results.get()).number == 1
    await trainer.stop()
    assert child_pids() == set()


async def test_the_back_off_doubles_while_nothing_succeeds() -> None:
    async with training("os._exit(4)") as (trainer, watcher):
        messages = [await watcher.failures.get() for _ in range(3)]
    assert [message.split(" in ")[-1] for message in messages] == ["0.01 s", "0.02 s", "0.04 s"]
    assert trainer.failures == 3


async def test_a_command_that_does_not_exist_is_a_message() -> None:
    failures: asyncio.Queue[str] = asyncio.Queue()
    absent = msgspec.structs.replace(job(ECHO), command=("/nonexistent/python",))
    trainer = Worker(absent, lambda _: None, failures.put_nowait)
    await trainer.start()
    assert "cannot start /nonexistent/python" in await failures.get()
    await trainer.stop()


async def test_a_megabyte_on_stderr_blocks_nothing() -> None:
    async with training(CHATTY) as (trainer, watcher):
        trainer.submit(asking(1))
        assert (await watcher.results.get()).number == 1


@pytest.mark.parametrize("script", [ECHO, "say(ask().number); signal.pause()"], ids=["idle", "deaf"])
async def test_stopping_ends_the_child(script: str) -> None:
    async with training(script) as (trainer, watcher):
        trainer.submit(asking(1))
        await watcher.results.get()
        children = child_pids()
        assert len(children) == 1
        await asyncio.wait_for(trainer.stop(), 5.0)
    assert child_pids() == set()


async def test_stopping_in_the_midst_of_a_training_ends_the_child() -> None:
    async with training("say(ask().number); ask(); os.close(1); signal.pause()") as (trainer, watcher):
        trainer.submit(asking(1))
        await watcher.results.get()
        trainer.submit(asking(2))
        await watcher.failures.get()
    assert child_pids() == set()


async def test_stopping_while_a_failed_child_takes_its_time_ends_it() -> None:
    async with training("sys.stdout.write('garbage'); sys.stdout.flush(); os.close(1); signal.pause()") as (_, watcher):
        while not (answers := tasks("answer")):  # noqa: ASYNC110 (a start has no event to wait for)
            await asyncio.sleep(0)
        await asyncio.wait(answers)
        for _ in range(5):  # from the answer to the closing of stdin, far from its timeout
            await asyncio.sleep(0)
    assert watcher.failures.empty()
    assert child_pids() == set()


async def test_stop_without_start_and_twice() -> None:
    trainer = Worker(job(ECHO), lambda _: None, lambda _: None)
    await trainer.stop()
    await trainer.start()
    await trainer.stop()
    await trainer.stop()
    assert child_pids() == set()


async def test_a_bug_in_a_callback_is_not_lost() -> None:
    def bug(_: TrainedNetwork) -> None:
        raise ZeroDivisionError

    trainer = Worker(job(ECHO), bug, lambda _: None)
    await trainer.start()
    trainer.submit(asking(1))
    await asyncio.wait(tasks("trainer"))
    with pytest.raises(ZeroDivisionError):
        await trainer.stop()
    assert child_pids() == set()


async def test_a_window_too_large_to_send_is_refused() -> None:
    trainer = Worker(job(ECHO), lambda _: None, lambda _: None)
    with pytest.raises(FrameError, match="shorten"):
        trainer.submit(window(RAMP, RAMP[:, 0], inputs=bytes(65 * 1024 * 1024)))


@every_misbehaviour
def test_replay_gets_a_message_and_a_new_process(script: str, reason: str, tmp_path: Path) -> None:
    mark = tmp_path / "second"
    both = f"second = os.path.exists({str(mark)!r}); open({str(mark)!r}, 'w').close()\n"
    both += f"exec({ECHO!r}) if second else exec({script!r})"
    with BlockingTrainer(command=command(both), longest_training_s=0.7 if script is HANGS else 30.0) as trainer:
        failed = trainer.fit(asking(1))
        assert failed.number == 1
        assert reason.replace("0.3", "0.7").replace(" (exit code 3)", "") in failed.message
        trainer._longest_training_s = 30.0
        assert trainer.fit(asking(2)).message == "1"
    assert child_pids() == set()


@pytest.fixture(autouse=True)
def _others() -> None:
    """Children that were there before the test are not of a worker: the resource tracker of multiprocessing, which a
    pool of another test has started, lives as long as we do.
    """
    _OTHERS.clear()
    _OTHERS.update(child_pids())


_OTHERS: set[int] = set()


def tasks(name: str) -> list[asyncio.Task[object]]:
    return [task for task in asyncio.all_tasks() if task.get_name() == name]


def child_pids() -> set[int]:
    """Our children since the test began, living or unburied, as the kernel lists them."""
    children = set()
    for path in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):  # it ended while we looked
            parent = path.read_text().rpartition(")")[2].split()[1]
            if int(parent) == os.getpid():
                children.add(int(path.parent.name))
    return children - _OTHERS

"""Tasks on Dask: processes of this machine, or the workers of a scheduler that is running somewhere.

A worker that dies (memory, power, a kill) takes its tasks with it; they are handed out again, so often and no more: a
file that kills whoever reads it ends as a failure of its own.
"""

from __future__ import annotations

import asyncio
import logging
import os
import signal
import socket
import tempfile
import uuid
from collections import deque
from contextlib import contextmanager, suppress
from importlib.metadata import version
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

import dask
from distributed import Client, LocalCluster, Security, as_completed
from distributed.comm.core import connect
from distributed.scheduler import KilledWorker

from heaved.backtest.task import Result, Task, failed
from heaved.backtest.units import UnreachableError

if TYPE_CHECKING:
    from collections.abc import Callable, Generator, Iterator, Sequence

MOST_ATTEMPTS: Final = 3
"""Of a task whose worker dies."""
ANSWERS_WITHIN_S: Final = 3.0
"""A scheduler, to a connection; and so long again to the first words, and to the client."""
CLOSES_WITHIN_S: Final = 10.0
"""A cluster whose workers have ended or were killed, and its client; what is left then ends with this process."""
LOCAL: Final = "127.0.0.1"


@contextmanager
def local_workers(count: int) -> Iterator[Client]:
    """Processes of this machine, of one thread each, that no other machine can reach.

    When the work is broken off, they are killed: what they are at is half done, and would be waited for.
    """
    with tempfile.TemporaryDirectory(prefix="heaved-backtest-", ignore_cleanup_errors=True) as scratch, _quiet():
        # A task whose worker died comes back at once: here, too, it is this module that counts how often.
        with _ctrl_c_waits(), dask.config.set({"distributed.scheduler.allowed-failures": 0}):
            cluster = LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                processes=True,
                host=LOCAL,
                dashboard_address=None,
                scheduler_kwargs={"dashboard_address": f"{LOCAL}:0"},  # Without a dashboard, too, it has a port.
                local_directory=scratch,
                silence_logs=logging.CRITICAL,
                env={"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
            client = Client(cluster, set_as_default=False)
        try:
            yield client
        except BaseException:
            for nanny in cluster.workers.values():
                nanny.auto_restart = False
                if nanny.pid is not None:
                    with suppress(ProcessLookupError):
                        os.kill(nanny.pid, signal.SIGKILL)
            raise
        finally:
            with _ctrl_c_waits():
                for close in (client.close, cluster.close):
                    with suppress(TimeoutError):
                        close(timeout=CLOSES_WITHIN_S)


@contextmanager
def _ctrl_c_waits() -> Iterator[None]:
    """Ctrl-C comes when this is over: a cluster that is half there, or half gone, leaves processes behind.

    Threads and processes that are started meanwhile never see it. So it is with the workers, to which a terminal sends
    it, too, and with those that replace them.
    """
    resource_tracker.ensure_running()  # When multiprocessing starts it by itself, it lets signals through again.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def remote_workers(address: str) -> Iterator[Client]:
    """Those of a scheduler.

    Raises:
        UnreachableError: it does not answer, or has no workers; within ten seconds.
    """
    start = f"start one with: dask scheduler --port {_port_of(address)}"
    host = urlsplit(address).hostname or ""
    try:
        socket.create_connection((host, _port_of(address)), ANSWERS_WITHIN_S).close()
    except OSError as error:
        reason = error.strerror or str(error)
        raise UnreachableError(f"{address}: no scheduler can be reached ({reason}): {start}") from error
    with _quiet():
        try:
            asyncio.run(asyncio.wait_for(_greeted(address), ANSWERS_WITHIN_S))
            client = Client(address, timeout=ANSWERS_WITHIN_S, set_as_default=False)
        except Exception as error:  # What a stranger says may be anything, and is read as if it were Dask's.
            raise UnreachableError(
                f"{address}: what listens there does not answer as a Dask scheduler of this version "
                f"({version('distributed')}): {start}"
            ) from error
        with client:
            if not client.nthreads():
                raise UnreachableError(
                    f"{address}: the scheduler has no workers: start some with: dask worker {address} --nthreads 1"
                )
            yield client


async def _greeted(address: str) -> None:
    """Exchange first words: a client would wait for these for ever."""
    connection = await connect(address, ANSWERS_WITHIN_S, **Security().get_connection_args("client"))
    await connection.close()


def _port_of(address: str) -> int:
    try:
        parts = urlsplit(address)
        port = parts.port
    except ValueError:
        parts, port = urlsplit(""), None
    if parts.scheme not in ("tcp", "tls") or not parts.hostname or port is None:
        raise UnreachableError(f"{address}: is no address of a scheduler: write it as tcp://host:8786")
    return port


@contextmanager
def _quiet() -> Iterator[None]:
    """What Dask logs of lost workers and connections is said by the results, once."""
    loggers = [logging.getLogger(name) for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    before = [logger.level for logger in loggers]  # Dask gives each its own.
    for logger in loggers:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def distributed(
    client: Client,
    tasks: Sequence[Task],
    perform: Callable[[Task], Result],
    again: Callable[[Task], None],
) -> Generator[tuple[Task, Result], None, None]:
    """Tasks, no two of one key, with their results, as these come. ``again`` is told of each that is handed out once
    more.

    Raises:
        UnreachableError: the scheduler has gone.
    """
    run = uuid.uuid4().hex
    waiting = deque((task, 1) for task in tasks)
    handed: dict[str, tuple[Task, int]] = {}
    going = as_completed(loop=client.loop, raise_errors=False)

    def hand_out() -> None:
        # No more than there are threads: what waits on a worker that dies would be blamed for it, too.
        threads: int = sum(client.nthreads().values())
        while waiting and len(handed) < max(threads, 1):
            task, attempt = waiting.popleft()
            # Under a key of this run and attempt: a scheduler remembers others, which have failed or write elsewhere.
            key = f"backtest-{run}-{task.key}-{attempt}"
            handed[key] = task, attempt
            going.add(client.submit(perform, task, key=key, pure=False))

    hand_out()
    for future in going:
        task, attempt = handed.pop(future.key)
        if future.cancelled():
            raise UnreachableError(
                "the scheduler has gone: what was done is kept, and the same command does the rest once it is back"
            )
        result: Result | None = None
        try:
            result = future.result()
        except KilledWorker:
            if attempt < MOST_ATTEMPTS:
                again(task)
                waiting.append((task, attempt + 1))
            else:
                result = failed(
                    f"{task.source}: {attempt} workers died of it: too little memory? With fewer --workers there is "
                    "more for each"
                )
        except Exception as error:  # Whatever a worker without this release says of the task.  # noqa: BLE001
            result = failed(
                f"{task.source}: a worker could not do it: {error!r}: is the same heaved installed on all of them?"
            )
        future.release()
        if result is not None:
            yield task, result
        hand_out()

"""The daemon's process, looked after as systemd would: started, started again, held up, limited, killed, measured."""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import signal
import struct
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from asyncio.subprocess import Process

STARTS_S: Final = 60.0
STOPS_S: Final = 20.0
_CHILDREN: Final = {
    "recorder": b"heaved.recorder.serve",
    "fitter": b"heaved.workers.fit_sea",
    "trainer": b"heaved.workers.train_correction",
}


_STEPPED: Final = Path(__file__).with_name("clock")


class Clock:
    """By how much the UTC of the daemon and of its processes is off that of the machine: a file that they look into."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.set(0.0)

    def set(self, offset_s: float) -> None:
        """Step it."""
        self.offset_s = offset_s
        with self.path.open("r+b" if self.path.exists() else "wb") as file:
            file.write(struct.pack("<d", offset_s))


class Use(NamedTuple):
    """What the daemon has at one moment; its children not included."""

    t_s: float
    rss_mb: float
    descriptors: int
    threads: int


class DaemonProcess:
    """``python -m heaved run``.

    Attributes:
        starts: so far.
        ended: ends that nobody had asked for, in words.
    """

    def __init__(self, config: Path, log: Path, clock: Path) -> None:
        """``clock``: holds by how much its UTC is off, see :class:`Clock`."""
        self._config, self._log, self._clock = config, log, clock
        self._process: Process | None = None
        self._drain: asyncio.Task[None] | None = None
        self.starts = 0
        self.ended: list[str] = []
        self.uses: list[Use] = []

    @property
    def pid(self) -> int:
        """Of the process that runs."""
        assert self._process is not None
        return self._process.pid

    @property
    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self._process is not None and self._process.returncode is None

    async def start(self) -> None:
        """Returns once it listens.

        Raises:
            RuntimeError: it does not start.
        """
        with self._log.open("ab") as errors:
            self._process = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "heaved", "run", "--config", str(self._config),
                stdout=asyncio.subprocess.PIPE, stderr=errors, env=self._environment(),
            )  # fmt: skip
        self.starts += 1
        stdout = self._process.stdout
        assert stdout is not None
        said = b""
        with contextlib.suppress(TimeoutError):
            said = await asyncio.wait_for(stdout.readline(), STARTS_S)
        if not said:
            raise RuntimeError(f"the daemon does not start; its log is {self._log}")
        self._drain = asyncio.create_task(_drain(stdout), name="stdout")
        self.uses.clear()

    def _environment(self) -> dict[str, str]:
        path = os.pathsep.join(filter(None, (str(_STEPPED), os.environ.get("PYTHONPATH", ""))))
        return {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": path, "CAMPAIGN_CLOCK": str(self._clock)}

    async def kill(self) -> None:
        """SIGKILL, at once."""
        assert self._process is not None
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        await self._process.wait()
        await self._drained()

    async def stop(self) -> int:
        """SIGTERM; the exit code."""
        assert self._process is not None
        with contextlib.suppress(ProcessLookupError):
            self._process.send_signal(signal.SIGCONT)
            self._process.send_signal(signal.SIGTERM)
        try:
            code = await asyncio.wait_for(self._process.wait(), STOPS_S)
        except TimeoutError:
            await self.kill()
            code = -signal.SIGKILL
        await self._drained()
        return code

    async def _drained(self) -> None:
        if self._drain is not None:
            await self._drain

    def note_death(self, during: str) -> bool:
        """Whether it has ended by itself; noted."""
        if self.is_running:
            return False
        assert self._process is not None
        self.ended.append(f"{during}: exit code {self._process.returncode}")
        return True

    # ---- what is done to it ------------------------------------------------------------------------------------------

    def signal(self, number: signal.Signals) -> None:
        """To the daemon alone."""
        os.kill(self.pid, number)

    def children(self) -> dict[int, str]:
        """Its children that are of the product, by process id: what they are."""
        found = {}
        with contextlib.suppress(OSError):
            for task in Path(f"/proc/{self.pid}/task").iterdir():
                for text in (task / "children").read_text().split():
                    with contextlib.suppress(OSError):
                        command = Path(f"/proc/{text}/cmdline").read_bytes()
                        for name, module in _CHILDREN.items():
                            if module in command:
                                found[int(text)] = name
        return found

    def kill_child(self, name: str) -> int:
        """SIGKILL to its children of that kind; how many there were."""
        killed = 0
        for pid, kind in self.children().items():
            if kind == name:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
                    killed += 1
        return killed

    def limit(self, kind: int, soft: int | None) -> None:
        """A soft limit of the daemon and of its recorder, None: as it was at the start."""
        for pid in (self.pid, *(pid for pid, name in self.children().items() if name == "recorder")):
            with contextlib.suppress(ProcessLookupError):
                hard = resource.prlimit(pid, kind)[1]
                resource.prlimit(pid, kind, (resource.getrlimit(kind)[0] if soft is None else soft, hard))

    def descriptors(self) -> int:
        """Open now."""
        return sum(1 for _ in Path(f"/proc/{self.pid}/fd").iterdir())

    # ---- what it uses ------------------------------------------------------------------------------------------------

    def measure(self) -> None:
        """Take note of what it uses now."""
        with contextlib.suppress(OSError):
            status = dict(
                line.split(":", 1) for line in Path(f"/proc/{self.pid}/status").read_text().splitlines() if ":" in line
            )
            rss_mb = int(status["VmRSS"].split()[0]) / 1024.0
            self.uses.append(Use(time.monotonic(), rss_mb, self.descriptors(), int(status["Threads"])))


async def _drain(stdout: asyncio.StreamReader) -> None:
    while await stdout.read(4096):
        pass

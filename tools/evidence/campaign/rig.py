"""All that a campaign has: slaves, the daemon and the page as processes, the client that judges, a disk of its own."""

from __future__ import annotations

import asyncio
import contextlib
import os
import shutil
import subprocess
import sys
import time
from math import inf
from typing import TYPE_CHECKING, Final

from evidence.campaign.far_ends import FarEnd
from evidence.campaign.process import Clock, DaemonProcess
from evidence.campaign.slaves import SerialSlave, Slave, TcpSlave
from evidence.campaign.truth import ClockRegisters, Truth
from evidence.processes import free_port

if TYPE_CHECKING:
    import random
    from asyncio.subprocess import Process
    from pathlib import Path

    from evidence.campaign.judge import Judge

IMU_TIMEOUT_S: Final = 0.05
QUICK_TIMEOUT_S: Final = 0.003
QUICK_HZ: Final = 1000.0
QUICK_SERIAL_HZ: Final = 100.0
DISK_MB: Final = 256
_CLOCK_PROFILE: Final = """[device.profile]
name = "clock"
[[device.profile.blocks]]
start = 100
fields = [{{ quantity = "{quantity}", offset = 0, type = "int32", unit = "{unit}" }}]
"""
QUICK: Final = {
    "crane": ("line_out_m", "cm", False),
    "reference_mru": ("heave_m", "cm", False),
    "heave_sensor": ("heave_m", "cm", False),
    "pitch_sensor": ("pitch_rad", "rad", False),
    "craft": ("speed_mps", "m/s", True),
}
"""Roles of devices that do nothing but answer, mostly wrongly, as fast as they are asked; what they measure and in what
unit; whether on a serial line. No reading of theirs touches the heave."""


class Rig:
    """One configuration, over as many lives of the daemon as it gets.

    Attributes:
        links: of the slaves, by the name of the device.
        has_disk: whether recordings and state are on a disk of their own, which can be filled.
    """

    def __init__(
        self, folder: Path, truth: Truth, judge: Judge, chance: random.Random, begin_s: float, *,
        serial: bool, quick: tuple[str, ...] = tuple(QUICK), with_page: bool = True, own_disk: bool = False,
    ) -> None:  # fmt: skip
        self.folder, self.truth, self.judge, self.chance = folder, truth, judge, chance
        self.serial, self.begin_s = serial, begin_s
        self.disk = folder / "disk"
        self.has_disk = own_disk
        self.ports = {name: free_port() for name in ("stream", "http", "registers", "telegram", "page")}
        self.slaves: dict[str, Slave] = {}
        self.links: dict[str, TcpSlave | SerialSlave] = {}
        self._with_page = with_page
        self._page: Process | None = None
        self._add("imu", truth.imu, 0x34, 0x50, IMU_TIMEOUT_S, serial=serial)
        self._add("laser", truth.laser, 0x34, 0x50, IMU_TIMEOUT_S, serial=False)
        clock = ClockRegisters(begin_s)
        for role in quick:
            self._add(role, clock.at, 100, 7, QUICK_TIMEOUT_S, serial=QUICK[role][2])
        self.clock = Clock(folder / "clock")
        judge.clock = self.clock
        self.far_ends = {name: FarEnd(free_port(), chance) for name in ("reader", "database", "broker", "plc")}
        self.daemon = DaemonProcess(folder / "heaved.toml", folder / "log", self.clock.path)
        self._following: asyncio.Task[None] | None = None

    def _add(self, name: str, registers: object, first: int, device_id: int, timeout_s: float, *, serial: bool) -> None:
        slave = Slave(name, registers, first, device_id, timeout_s, self.chance, self._count)  # type: ignore[arg-type]
        self.slaves[name] = slave
        self.links[name] = SerialSlave(slave, self.folder / f"tty-{name}") if serial else TcpSlave(slave)

    def _count(self, kind: str) -> None:
        self.judge.scores[f"answer: {kind}"].events += 1

    def trace(self, text: str) -> None:
        """For whoever looks into what went wrong."""
        self.judge.trace(text)

    @property
    def imu(self) -> TcpSlave | SerialSlave:
        """Its link."""
        return self.links["imu"]

    @property
    def quick(self) -> list[Slave]:
        """The slaves that only answer."""
        return [slave for name, slave in self.slaves.items() if name not in ("imu", "laser")]

    async def open(self) -> None:
        """Slaves, daemon and page run.

        Raises:
            RuntimeError, OSError: something does not start.
        """
        self.disk.mkdir(exist_ok=True)
        if self.has_disk:
            # What was learned so far goes with us, so that the daemon starts warm.
            state = self.disk / "state" / "state.json"
            learned = state.read_bytes() if state.exists() else b""
            self.has_disk = _mount("-t", "tmpfs", "-o", f"size={DISK_MB}m", "heaved-campaign", str(self.disk))
            state.parent.mkdir(exist_ok=True)
            if learned:
                state.write_bytes(learned)
        for link in self.links.values():
            await link.open()
        for far_end in self.far_ends.values():
            await far_end.open()
        self.configure()
        await self.daemon.start()
        if self._with_page:
            with (self.folder / "page.log").open("ab") as log:
                self._page = await asyncio.create_subprocess_exec(
                    *(sys.executable, "-m", "heaved", "page", "--port", str(self.ports["page"])),
                    *("--stream-port", str(self.ports["stream"])),
                    stdout=log,
                    stderr=log,
                )
        self._following = asyncio.create_task(self.judge.run(self.ports["stream"]), name="judge")

    async def close(self) -> int:
        """The daemon's exit code; -9: it had to be killed."""
        code = await self.daemon.stop()
        if self._following is not None:
            self._following.cancel()
            await asyncio.wait([self._following])
        if self._page is not None:
            with contextlib.suppress(ProcessLookupError):
                self._page.terminate()
            await self._page.wait()
        for link in self.links.values():
            link.close()
        for far_end in self.far_ends.values():
            await far_end.close()
        return code

    def release(self) -> None:
        """The disk is not wanted any more."""
        if self.has_disk:
            _run("umount", str(self.disk))

    async def records(self, since_s: float, patience_s: float) -> bool:
        """Wait until the daemon that runs has begun to record: a file of after ``since_s``, UTC."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(patience_s):
                while not any(  # noqa: ASYNC110  # Files have no event.
                    self._begun(path) >= since_s for path in (self.disk / "recordings").glob("*.arrows")
                ):
                    await asyncio.sleep(0.05)
                return True
        return False

    @staticmethod
    def _begun(path: Path) -> float:
        try:
            found = path.stat()
        except OSError:
            return -inf
        return found.st_mtime if found.st_size else -inf

    @property
    def page_has_ended(self) -> bool:
        """By itself."""
        return self._page is not None and self._page.returncode is not None

    def configure(self, further: str = "") -> None:
        """Write the daemon's configuration, with ``further`` behind it."""
        (self.folder / "heaved.toml").write_text(self._configuration() + further, encoding="utf-8")

    def _configuration(self) -> str:
        tables = [
            f'[[device]]\nname = "imu"\nrole = "imu"\nlink = "{self.links["imu"].link}"\ndevice_id = 80\n'
            'profile = "witmotion-wt901c485"\nrate_hz = 100.0\n',
            f'[[device]]\nname = "laser"\nrole = "laser"\nlink = "{self.links["laser"].link}"\ndevice_id = 80\n'
            'profile = "witmotion-wt53r-485"\nrate_hz = 20.0\n',
        ]
        for name in (one for one in self.links if one in QUICK):
            quantity, unit, is_serial = QUICK[name]
            rate_hz = QUICK_SERIAL_HZ if is_serial else QUICK_HZ
            tables.append(
                f'[[device]]\nname = "{name}"\nrole = "{name}"\nlink = "{self.links[name].link}"\ndevice_id = 7\n'
                f"rate_hz = {rate_hz}\ntimeout_ms = {QUICK_TIMEOUT_S * 1e3}\n"
                + _CLOCK_PROFILE.format(quantity=quantity, unit=unit)
            )
        p = self.ports
        tables.append(
            f"[stream]\nport = {p['stream']}\n[http]\nport = {p['http']}\n"
            + (
                # One table, and so one or the other: a PLC that asks, or one that is written to.
                f'[registers]\nenabled = true\nmode = "push"\nlink = "tcp://127.0.0.1:{self.far_ends["plc"].port}"\n'
                if self.serial
                else f'[registers]\nenabled = true\nlink = "tcp://127.0.0.1:{p["registers"]}"\n'
            )
            + f'[[output]]\nname = "winch"\ntelegram = "smc_hex"\nrate_hz = 50.0\n'
            f'link = "tcp://127.0.0.1:{self.far_ends["reader"].port}"\n'
            f'[influx]\nenabled = true\nlink = "http://127.0.0.1:{self.far_ends["database"].port}"\nrate_hz = 10.0\n'
            f'[mqtt]\nenabled = true\nlink = "mqtt://127.0.0.1:{self.far_ends["broker"].port}"\nrate_hz = 10.0\n'
            f'[[output]]\nname = "dp"\ntelegram = "tss1"\nlink = "tcp-listen://127.0.0.1:{p["telegram"]}"\n'
            'rate_hz = 20.0\nlead = "transmission"\n'
            f'[recording]\nenabled = true\nwhat = "samples"\ndirectory = "{self.disk / "recordings"}"\n'
            f'[state]\ndirectory = "{self.disk / "state"}"\nsave_period_s = 1.0\n'
        )
        return "".join(tables)

    def fill_disk(self) -> Path:
        """Write until nothing more goes in; the file that did it."""
        ballast = self.disk / "ballast"
        with contextlib.suppress(OSError), ballast.open("wb", buffering=0) as file:
            while True:
                file.write(b"\0" * (1 << 16))
        with contextlib.suppress(OSError), ballast.open("ab", buffering=0) as file:
            while True:
                file.write(b"\0")
        return ballast

    def remount(self, *, writable: bool) -> bool:
        """Whether the disk could be made so; a disk that is being written to may refuse."""
        return _mount("-o", "remount,rw" if writable else "remount,ro", str(self.disk))


def _mount(*words: str) -> bool:
    return _run("mount", *words)


def _run(program: str, *words: str) -> bool:
    """Whether a program of the system did it; a matter of milliseconds."""
    path = shutil.which(program)
    return path is not None and subprocess.run([path, *words], check=False, capture_output=True).returncode == 0


def can_mount() -> bool:
    """Whether a disk of our own can be had."""
    return os.geteuid() == 0


def new_truth(sea: str, seed: int, duration_s: float) -> tuple[Truth, float]:
    """The vessel, which begins to move now, and when that is."""
    begin_s = time.monotonic()
    return Truth(sea, seed, begin_s, duration_s), begin_s

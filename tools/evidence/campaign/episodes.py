"""What is done to the daemon, one episode after the other: each begins a fault, lasts, ends it, and counts its events.

When an episode returns, what it broke is well again: from then on the recovery is timed.
"""

from __future__ import annotations

import asyncio
import contextlib
import resource
import signal
from typing import TYPE_CHECKING, Final, NamedTuple

from evidence.campaign import deviations
from evidence.campaign.clients import CLIENTS, PAYLOADS
from evidence.campaign.far_ends import BEHAVIOURS
from evidence.campaign.slaves import SerialSlave, TcpSlave

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence

    from evidence.campaign.rig import Rig

SHARES: Final = (0.02, 0.1, 0.3, 1.0)
"""Of the answers that deviate; of a frozen sensor all do."""


DISK_S: Final = 4.0
"""It is looked at once a second, rows wait for half a second; and a recorder is nobody's first, on a busy machine."""
RECORDER_S: Final = 6.0
"""A recorder that was killed is back: started again after one or two seconds, and loaded."""


class Episode(NamedTuple):
    """A fault."""

    name: str
    run: Callable[[Rig], Awaitable[int]]
    """Returns how many events it was, beside those of answers, which count themselves."""
    group: str = ""
    records_again_s: float = 0.0
    """Within this after its end the recording goes on; 0: it is not asked."""


def lasts_s(rig: Rig, most_s: float = 1.5) -> float:
    """How long an episode lasts."""
    return rig.chance.uniform(0.1, most_s)


# ---- answers ---------------------------------------------------------------------------------------------------------


def answers(device: str, kinds: Sequence[str], number: int = 1) -> Callable[[Rig], Awaitable[int]]:
    """``number`` of these kinds at a time, of one device."""

    async def run(rig: Rig) -> int:
        slave = rig.slaves[device]
        chosen = rig.chance.sample(list(kinds), min(number, len(kinds)))
        share = 1.0 if chosen == ["frozen"] else rig.chance.choice(SHARES)
        slave.behave(*chosen, share=share, most=number)
        rig.trace(f"  {slave}")
        await asyncio.sleep(lasts_s(rig, 2.5))
        slave.behave()
        return 0

    return run


def mute(device: str, most_s: float) -> Callable[[Rig], Awaitable[int]]:
    """It says nothing at all."""

    async def run(rig: Rig) -> int:
        rig.slaves[device].is_mute = True
        await asyncio.sleep(lasts_s(rig, most_s))
        rig.slaves[device].is_mute = False
        return 1

    return run


# ---- TCP links -------------------------------------------------------------------------------------------------------


def _tcp(rig: Rig, device: str) -> TcpSlave:
    link = rig.links[device]
    assert isinstance(link, TcpSlave)
    return link


def resets(device: str) -> Callable[[Rig], Awaitable[int]]:
    """RST, many in a row."""

    async def run(rig: Rig) -> int:
        done = 0
        for _ in range(rig.chance.randint(1, 20)):
            done += _tcp(rig, device).reset()
            await asyncio.sleep(rig.chance.uniform(0.0, 0.05))
        return max(done, 1)

    return run


async def closes_after_each(rig: Rig) -> int:
    """As some gateways do."""
    link = _tcp(rig, "imu")
    before = link.slave.requests
    link.closes_after_each = True
    await asyncio.sleep(lasts_s(rig))
    link.closes_after_each = False
    return max(link.slave.requests - before, 1)


async def black_hole(rig: Rig) -> int:
    """What is sent is taken, and nothing ever comes."""
    link = _tcp(rig, "imu")
    link.swallows = True
    await asyncio.sleep(lasts_s(rig))
    link.swallows = False
    return 1


async def half_open(rig: Rig) -> int:
    """The other side is gone without a word: it resets what it no longer knows when it hears of it."""
    link = _tcp(rig, "imu")
    link.swallows = True
    await asyncio.sleep(lasts_s(rig, 0.5))
    link.reset()
    link.swallows = False
    return 1


async def restarts(rig: Rig) -> int:
    """Gone, the port closed, and back."""
    link = _tcp(rig, "imu")
    link.close()
    await asyncio.sleep(lasts_s(rig))
    await link.open()
    return 1


# ---- serial lines ----------------------------------------------------------------------------------------------------


async def unplugged(rig: Rig) -> int:
    """The adapter goes and comes again."""
    link = rig.imu
    assert isinstance(link, SerialSlave)
    link.close()
    await asyncio.sleep(lasts_s(rig))
    await link.open()
    return 1


async def babbling(rig: Rig) -> int:
    """The line carries what nobody asked for."""
    link = rig.imu
    assert isinstance(link, SerialSlave)
    pieces = rig.chance.randint(5, 60)
    for _ in range(pieces):
        link.babble(rig.chance.randbytes(rig.chance.randrange(1, 200)))
        await asyncio.sleep(rig.chance.uniform(0.0, 0.03))
    return pieces


# ---- the process -----------------------------------------------------------------------------------------------------


async def stopped(rig: Rig) -> int:
    """SIGSTOP, SIGCONT."""
    rig.daemon.signal(signal.SIGSTOP)
    await asyncio.sleep(lasts_s(rig, 2.0))
    rig.daemon.signal(signal.SIGCONT)
    return 1


def child_killed(*names: str) -> Callable[[Rig], Awaitable[int]]:
    """SIGKILL to whichever of these runs."""

    async def run(rig: Rig) -> int:
        return sum(rig.daemon.kill_child(name) for name in names)

    return run


async def out_of_descriptors(rig: Rig) -> int:
    """None can be opened any more, while the link to the IMU breaks and clients come."""
    rig.daemon.limit(resource.RLIMIT_NOFILE, rig.daemon.descriptors() + rig.chance.randint(0, 2))
    try:
        link = rig.imu
        if isinstance(link, TcpSlave):
            link.reset()
        for _ in range(10):
            with contextlib.suppress(OSError, TimeoutError):
                _, writer = await asyncio.wait_for(asyncio.open_connection("127.0.0.1", rig.ports["stream"]), 0.5)
                writer.transport.abort()
        await asyncio.sleep(lasts_s(rig))
    finally:
        rig.daemon.limit(resource.RLIMIT_NOFILE, None)
    return 1


async def file_size_limited(rig: Rig) -> int:
    """No file may grow: RLIMIT_FSIZE of the daemon and its recorder."""
    rig.daemon.limit(resource.RLIMIT_FSIZE, rig.chance.choice((0, 1, 4096)))
    try:
        await asyncio.sleep(lasts_s(rig, 3.0))
    finally:
        rig.daemon.limit(resource.RLIMIT_FSIZE, None)
    return 1


async def disk_full(rig: Rig) -> int:
    """Not a byte goes in."""
    ballast = await asyncio.to_thread(rig.fill_disk)
    await asyncio.sleep(lasts_s(rig, 3.0))
    ballast.unlink(missing_ok=True)
    return 1


async def disk_read_only(rig: Rig) -> int:
    """As a file system that has found an error makes itself. One with open files refuses: the recorder goes before."""
    rig.daemon.kill_child("recorder")
    done = False
    for _ in range(40):
        if done := await asyncio.to_thread(rig.remount, writable=False):
            break
        await asyncio.sleep(0.02)
    await asyncio.sleep(lasts_s(rig, 3.0))
    await asyncio.to_thread(rig.remount, writable=True)
    return int(done)


async def configured_wrongly(rig: Rig) -> int:
    """SIGHUP with a file that nobody can take, then again with the right one."""
    wrong = ("[heave", "[heave]\nobserver = 7\n", "[nothing]\n", "\0", "[stream]\nport = 99999\n")
    rig.configure(rig.chance.choice(wrong))
    rig.daemon.signal(signal.SIGHUP)
    await asyncio.sleep(lasts_s(rig, 0.5))
    rig.configure()
    rig.daemon.signal(signal.SIGHUP)
    return 1


STEPS_S: Final = (0.7, 60.0, 3600.0, 86_400.0, 1e8)


async def clock_stepped(rig: Rig) -> int:
    """UTC goes back or ahead, by a little or by years, as often as three times."""
    steps = rig.chance.randint(1, 3)
    for _ in range(steps):
        rig.clock.set(rig.clock.offset_s + rig.chance.choice((-1.0, 1.0)) * rig.chance.choice(STEPS_S))
        rig.trace(f"  UTC is off by {rig.clock.offset_s:g} s")
        await asyncio.sleep(lasts_s(rig, 2.5))
    if rig.chance.random() < 0.5:
        rig.clock.set(0.0)
    return steps


# ---- those to whom the daemon connects -------------------------------------------------------------------------------


def far_end(name: str) -> Callable[[Rig], Awaitable[int]]:
    """It breaks off, and whoever connects again finds one of the ways to go wrong."""

    async def run(rig: Rig) -> int:
        end = rig.far_ends[name]
        end.behaviour = rig.chance.choice(list(BEHAVIOURS))
        before = end.connections
        end.part()
        if rig.chance.random() < 0.2:
            end.refuse()
        await asyncio.sleep(lasts_s(rig, 3.0))
        end.behaviour = ""
        await end.open()
        end.part()
        return max(end.connections - before, 1)

    return run


# ---- clients ---------------------------------------------------------------------------------------------------------


def clients(place: str) -> Callable[[Rig], Awaitable[int]]:
    """One to three kinds of bad clients at once."""

    async def run(rig: Rig) -> int:
        kinds = rig.chance.sample(list(CLIENTS), rig.chance.randint(1, 3))
        seconds = lasts_s(rig)
        done = await asyncio.gather(
            *(CLIENTS[kind](rig.ports[place], PAYLOADS[place], rig.chance, seconds) for kind in kinds)
        )
        return sum(done)

    return run


# ---- all of them -----------------------------------------------------------------------------------------------------


async def combined(rig: Rig) -> int:
    """Two to four of the others at the same time."""
    offered = [one for one in usual(rig) if one.run is not combined]
    chosen = rig.chance.sample(offered, rig.chance.randint(2, 4))
    return sum(await asyncio.gather(*(one.run(rig) for one in chosen)))


def usual(rig: Rig) -> list[Episode]:
    """What is done to a daemon that lives through all of it, and loses nothing of its recording."""
    bytes_ = [kind for kind in deviations.BYTES if not (rig.serial and kind in deviations.FOR_TCP_ALONE)]
    found = [Episode(f"answer: {kind}", answers("imu", (kind,))) for kind in (*bytes_, *deviations.VALUES)]
    # What is frozen is so for all of an episode: it does not go with others, of a share of the answers.
    values = [kind for kind in deviations.VALUES if kind != "frozen"]
    found += [
        Episode("answers of the IMU, combined", answers("imu", (*bytes_, *values), 4)),
        Episode("answers of the laser, combined", answers("laser", (*deviations.BYTES, *values), 4)),
        Episode("IMU silent", mute("imu", 2.0)),
        Episode("laser lost", mute("laser", 3.0)),
        Episode("laser: TCP reset", resets("laser")),
        Episode("SIGSTOP, SIGCONT", stopped),
        Episode("fitter or trainer killed", child_killed("fitter", "trainer")),
        Episode("SIGHUP with a wrong configuration", configured_wrongly),
        Episode("UTC stepped", clock_stepped),
    ]
    if rig.serial:
        found += [Episode("serial line unplugged", unplugged), Episode("serial line babbles", babbling)]
    else:
        found += [
            Episode("TCP reset", resets("imu")),
            Episode("TCP closed after each answer", closes_after_each),
            Episode("TCP black hole", black_hole),
            Episode("TCP half-open", half_open),
            Episode("slave restarted", restarts),
        ]
    # Registers are served to a PLC, or pushed into one.
    served = [place for place in PAYLOADS if not (rig.serial and place == "registers")]
    found += [Episode(f"clients of {place}", clients(place)) for place in served]
    met = [name for name in rig.far_ends if rig.serial or name != "plc"]
    found += [Episode(f"far end: {name}", far_end(name)) for name in met]
    found.append(Episode("combined", combined))
    return found


def old_readings(_rig: Rig) -> list[Episode]:
    """A gateway that serves its memory now and then, and now and then asks the sensor."""

    async def run(rig: Rig) -> int:
        slave = rig.slaves["imu"]
        slave.behave("frozen", share=rig.chance.uniform(0.02, 0.7))
        rig.trace(f"  {slave}")
        await asyncio.sleep(lasts_s(rig, 2.5))
        slave.behave()
        return 0

    return [Episode("old readings in between", run)]


def starved(_rig: Rig) -> list[Episode]:
    """What the recorder may lose a second by."""
    return [Episode("out of descriptors", out_of_descriptors), Episode("recorder killed", child_killed("recorder"))]


def limited(_rig: Rig) -> list[Episode]:
    """What costs rows of the recording until the disk is tried again, which the daemon says."""
    return [Episode("no file may grow", file_size_limited)]


def unwritable(rig: Rig) -> list[Episode]:
    """What costs rows of the recording until the disk is well again: the second of the two kills the recorder, too."""
    if not rig.has_disk:
        return limited(rig)
    return [
        Episode("disk full", disk_full, records_again_s=DISK_S),
        Episode("disk read-only", disk_read_only, records_again_s=DISK_S + RECORDER_S),
    ]

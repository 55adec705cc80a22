"""Which sensor hangs on this line? Reads only, one request at a time, and compares what comes with known profiles.

The usual mistakes are tried too: addresses counted from one (shifted by one either way), holding for input registers,
and the other byte orders. What fits is judged by physics, over several reads: the accelerations of a sensor that lies
somewhere have the size of gravity, a ship does not lie on her side, a distance is within a laser's reach; what is
measured changes from read to read, and not by leaps. Registers that hold anything at all can look like a distance: only
gravity, or a clock that runs, proves a profile.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from math import inf, pi, sqrt
from typing import Final, Protocol, get_args

import msgspec

from heaved.devices.bandwidth import PASSES, folding, remedy
from heaved.devices.bus import Answer, OpenLink
from heaved.devices.frames import explain_exception
from heaved.devices.link import most_rate_hz
from heaved.devices.profile import Block, ByteOrder, Field, Profile, Quantity, block_registers, decode
from heaved.devices.timer import DeadlineTimer
from heaved.links import Link, SerialLink, TcpLink
from heaved.samples import GRAVITY_MPS2, Fault

MOST_SHOWN: Final = 4
"""Findings printed for one device."""
SHIFTS: Final = (0, 1, -1)
FITS: Final = 0.7
"""Score from which a profile is worth naming."""
GRAVITY_OFF_MPS2: Final = 2.5
"""By which the accelerations of a ship in a seaway are off gravity, at the most."""
READS: Final = 5
"""Of every profile that is worth naming."""
READ_PAUSE_S: Final = 0.1
"""Between them: long enough for any sensor to measure anew, short enough for a ship not to have gone far."""
LATEST_S: Final = 0.5
"""For so long after the last request late answers are listened for."""
SIMULATED: Final = "heaved-sim-"
"""Start of the names of the simulator's profiles, which are listed last."""
_ANYTHING: Final = Block(start=0, fields=(Field(quantity="signal", offset=0),))
"""One register: asked of an id to see whether there is anybody."""

FACTORY_IDS: Final = (80, 1)
"""Of the profiles that come with the program, as delivered: WitMotion; Baumer, Benewake and Riftek."""
FEW_IDS: Final = 2
"""So few that are named are looked for as thoroughly as those."""

_NOBODY: Final = (explain_exception(10), explain_exception(11))
"""A gateway's answer for an id behind which there is no device."""

Progress = Callable[[int], None]
"""Told the id that is being asked."""


class Reader(Protocol):
    """An open line; see :class:`heaved.devices.bus.OpenLink`."""

    async def read(self, device_id: int, block: Block, count: int, timeout_s: float) -> Answer:
        """Read ``count`` registers of a block."""


class Variant(msgspec.Struct, frozen=True, kw_only=True):
    """A profile as it stands, or with one of the usual mistakes undone."""

    profile: Profile
    shift: int = 0
    """Added to every address."""
    other_function: bool = False
    """Input registers for holding registers, and the other way round."""
    byte_order: ByteOrder | None = None
    """Of every field; None: the profile's own."""

    @property
    def changes(self) -> int:
        """Mistakes that are undone."""
        return (self.shift != 0) + self.other_function + (self.byte_order is not None)

    def describe(self) -> str:
        """Name of the profile, and what was changed."""
        notes = [f"addresses {self.shift:+d}"] if self.shift else []
        notes += ["the other function (input/holding)"] if self.other_function else []
        notes += [f"byte order {self.byte_order}"] if self.byte_order is not None else []
        return self.profile.name + (f" with {', '.join(notes)}" if notes else "")


class Finding(msgspec.Struct, frozen=True, kw_only=True):
    """What a variant makes of the registers of a device."""

    variant: Variant
    score: float
    """0..1; see :func:`plausibility`."""
    values: dict[Quantity, float]
    registers: list[int]
    read_s: float = 0.0
    """When they were asked for."""
    doubt: str = ""
    """Why the variant is a mere possibility; empty: proved."""


def plausibility(values: Mapping[Quantity, float], registers: Sequence[int]) -> float:
    """How far ``values`` look like those of a sensor on a ship: 0 not at all, 1 entirely. Gravity weighs most."""
    if len(set(registers)) == 1 and len(registers) > 1:
        return 0.0  # All alike: memory that nothing is written to.
    marks: list[tuple[float, bool]] = []
    forces = [values[axis] for axis in ("ax_mps2", "ay_mps2", "az_mps2") if axis in values]
    if len(forces) == 3:
        marks.append((4.0, abs(sqrt(sum(force**2 for force in forces)) - GRAVITY_MPS2) < GRAVITY_OFF_MPS2))
    elif forces:
        marks.append((2.0, any(abs(abs(force) - GRAVITY_MPS2) < 1.5 for force in forces)))
    marks += [(1.0, abs(values[angle]) < 0.8) for angle in ("roll_rad", "pitch_rad") if angle in values]
    marks += [(0.5, abs(values[rate]) < 1.0) for rate in ("gx_radps", "gy_radps", "gz_radps") if rate in values]
    if "laser_m" in values:
        marks.append((2.0, 0.02 < values["laser_m"] < 300.0))
    if "temperature_c" in values:
        marks.append((0.5, -40.0 < values["temperature_c"] < 90.0))
    total = sum(weight for weight, _ in marks)
    return sum(weight for weight, good in marks if good) / total if total else 0.0


def leaps(before: Finding, after: Finding) -> bool:
    """Whether a ship's sensor cannot have gone from the one reading to the other."""
    elapsed_s = max(after.read_s - before.read_s, READ_PAUSE_S)
    for quantity, value in after.values.items():
        step = abs(value - before.values[quantity])
        if quantity in ("roll_rad", "pitch_rad", "yaw_rad"):
            step = abs((step + pi) % (2.0 * pi) - pi)
        if step > _MOST_PER_S.get(quantity, inf) * elapsed_s + _MOST_AT_ONCE.get(quantity, 0.0):
            return True
    return False


_MOST_PER_S: Final[dict[Quantity, float]] = {
    **dict.fromkeys(("ax_mps2", "ay_mps2", "az_mps2"), 10.0),
    **dict.fromkeys(("roll_rad", "pitch_rad", "yaw_rad"), 0.5),
    **dict.fromkeys(("gx_radps", "gy_radps", "gz_radps"), 1.0),
    "laser_m": 5.0,
    "temperature_c": 1.0,
}
"""Change of a reading in a second: generous, random registers change by far more."""
_MOST_AT_ONCE: Final[dict[Quantity, float]] = {
    **dict.fromkeys(("ax_mps2", "ay_mps2", "az_mps2"), 0.5),
    **dict.fromkeys(("roll_rad", "pitch_rad", "yaw_rad", "gx_radps", "gy_radps", "gz_radps"), 0.02),
    "laser_m": 0.05,
    "temperature_c": 0.5,
}
"""Besides, a sensor's noise."""


def doubt(series: Sequence[Finding]) -> str:
    """Why readings that are plausible one by one do not prove the profile; empty when they do."""
    pairs = list(pairwise(series))
    steps = [
        (after.values["device_time_s"] - before.values["device_time_s"], after.read_s - before.read_s)
        for before, after in pairs
        if "device_time_s" in after.values
    ]
    ticks = [(step_s, passed_s) for step_s, passed_s in steps if 0.0 < step_s <= 2.0 * passed_s]
    # A clock may begin anew once, and a slow sensor's stands for a while; but it does not go at half the pace.
    if len(ticks) >= max(len(pairs) - 1, 2) and sum(step for step, _ in ticks) > 0.5 * sum(s for _, s in ticks):
        return ""
    if len({tuple(finding.registers) for finding in series}) == 1:
        return "nothing in it changes: memory, or a sensor that stands"
    if not {"ax_mps2", "ay_mps2", "az_mps2"} <= series[0].values.keys():
        return "such values alone prove nothing: see whether they follow when the sensor is moved"
    return ""


def parse_ids(text: str) -> tuple[int, ...]:
    """``1-16,80`` as ids, each once, in order.

    Raises:
        ValueError: says what is wrong.
    """
    found: dict[int, None] = {}
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise ValueError(f"ids {text!r}: write numbers and ranges, such as 1-16,80")
        low, high = int(first), int(last or first)
        if not 1 <= low <= high <= 247:
            raise ValueError(f"ids {text!r}: {part.strip()!r} is not within 1-247, from low to high")
        found |= dict.fromkeys(range(low, high + 1))
    return tuple(found)


class ReopenedLine:
    """A line that is opened again whenever the other side closes it, or says what cannot be read on from."""

    def __init__(self, link: Link, timer: DeadlineTimer) -> None:
        self._link, self._timer = link, timer
        self._open: OpenLink | None = None
        self.late_s: dict[int, float] = {}
        """By id, how long after its request an answer came that was too late."""

    async def read(self, device_id: int, block: Block, count: int, timeout_s: float) -> Answer:
        """Raises:
        ConnectionError: the line cannot be opened; says why and what to do.
        """
        answer = await self._read(device_id, block, count, timeout_s)
        if answer.fault is Fault.DISCONNECTED:
            answer = await self._read(device_id, block, count, timeout_s)
        return answer

    async def _read(self, device_id: int, block: Block, count: int, timeout_s: float) -> Answer:
        if self._open is None:
            await self.open()
        connection = self._open
        assert connection is not None  # It has been opened.
        answer = await connection.read(device_id, block, count, timeout_s)
        self.look_back()
        if answer.fault is Fault.DISCONNECTED or not connection.whole:
            self.close()
        return answer

    async def open(self) -> None:
        """Raises:
        ConnectionError: as :meth:`read`.
        """
        self._open = OpenLink(self._link, self._timer, time.monotonic, lambda: None)
        if failure := await self._open.open():
            self.close()
            raise ConnectionError(failure)

    def look_back(self) -> None:
        """Note what has come too late."""
        if self._open is not None:
            self._open.unasked()
            self.late_s |= self._open.late_s

    def close(self) -> None:
        """Give it back."""
        if self._open is not None:
            self._open.close()
            self._open = None


class Bandwidth(msgspec.Struct, frozen=True, kw_only=True):
    """To what a sensor's low-pass is set."""

    hertz: float
    is_read: bool
    """From the sensor's register; else it is as delivered."""
    source: str
    """The same in words."""


class Device(msgspec.Struct, frozen=True, kw_only=True):
    """Somebody who answers."""

    device_id: int
    link: Link
    findings: list[Finding]
    """What fits, best first."""
    bandwidth: Bandwidth | None = None

    @property
    def proved(self) -> list[Finding]:
        """Those of the findings that are beyond doubt."""
        return [finding for finding in self.findings if not finding.doubt]

    @property
    def verdict(self) -> str:
        """How well it is known."""
        if self.proved:
            return "fits"
        return "could be" if self.findings else "answers, but no known profile fits"


class Report(msgspec.Struct, frozen=True):
    """What there is to print."""

    devices: list[Device]
    hints: list[str]
    """Why there may be more than that, and how to find it."""

    @property
    def lines(self) -> list[str]:
        """Each device that answers, and what fits it; empty when nobody answers."""
        return [line for device in self.devices for line in device_lines(device)]


async def probe(
    link: Link, ids: Sequence[int], profiles: Sequence[Profile], timeout_s: float, progress: Progress
) -> Report:
    """Ask every id, and examine those that answer.

    Raises:
        ConnectionError: the line cannot be opened; says why and what to do.
    """
    devices: list[Device] = []
    hints: list[str] = []
    with DeadlineTimer() as timer:
        line = ReopenedLine(link, timer)
        try:
            await line.open()
            found, odd = await find_ids(line, ids, timeout_s, progress)
            if len(found) < len(ids):
                await asyncio.sleep(max(timeout_s, LATEST_S))
                line.look_back()
            hints += [
                f"id {device_id} answers, but only {late_s:.2g} s after its request: "
                f"ask again with --timeout {2.0 * late_s:.2g}"
                for device_id, late_s in sorted(line.late_s.items())
                if device_id not in found
            ]
            hints += _odd_hints(odd)
            if isinstance(link, SerialLink):
                silent = [i for i in ids if i not in found and i not in line.late_s and i not in dict(odd)]
                found += await _find_choosy(line, thorough_ids(silent, len(ids)), profiles, timeout_s)
            for device_id in found:
                findings = await examine(
                    line, device_id, profiles, timeout_s, rest_s=0.0 if isinstance(link, TcpLink) else timeout_s
                )
                device = Device(device_id=device_id, link=link, findings=findings)
                devices.append(device)
                if findings:
                    bandwidth = await _bandwidth(line, device_id, findings[0].variant, timeout_s)
                    devices[-1] = msgspec.structs.replace(device, bandwidth=bandwidth)
        except ConnectionError as error:
            if not devices and not hints:
                raise
            hints.append(f"the line was lost: {error}")
        finally:
            line.close()
    return Report(devices, hints)


def device_lines(device: Device) -> Iterator[str]:
    """What was found of it, for people."""
    yield f"id {device.device_id}: {device.verdict}"
    for finding in (device.proved or device.findings)[:MOST_SHOWN]:
        yield f"  {finding.score:4.0%}  {finding.variant.describe()}"
        yield "        " + ", ".join(f"{quantity} {value:.4g}" for quantity, value in finding.values.items())
        yield "        registers " + " ".join(f"{register:04X}" for register in finding.registers)
        if finding.doubt:
            yield f"        {finding.doubt}"
    if device.bandwidth is not None:
        yield from _bandwidth_lines(device.bandwidth, device.findings[0].variant.profile, device.link)


async def _bandwidth(line: Reader, device_id: int, variant: Variant, timeout_s: float) -> Bandwidth | None:
    """To what the sensor's low-pass is set; None: nobody knows."""
    profile = variant.profile
    register = profile.bandwidth_register
    if register is not None:
        field = Field(quantity="signal", offset=0, type="uint16", byte_order=profile.blocks[0].fields[0].byte_order)
        asked = changed(Block(start=register.address, fields=(field,)), variant)
        answer = await line.read(device_id, asked, 1, timeout_s)
        value = decode(asked, answer.registers).values.get("signal", inf) if answer.fault is Fault.NONE else inf
        if value < len(register.choices_hz):
            source = f"register 0x{register.address:02X} is {value:g}"
            return Bandwidth(hertz=register.choices_hz[int(value)], is_read=True, source=source)
    if not profile.bandwidth_hz:
        return None
    return Bandwidth(hertz=profile.bandwidth_hz, is_read=False, source="as delivered")


def _bandwidth_lines(bandwidth: Bandwidth, profile: Profile, link: Link) -> Iterator[str]:
    """How fast the sensor wants to be polled, and what to do if the line cannot."""
    hertz, most_hz = bandwidth.hertz, most_rate_hz(link, profile)
    yield f"        bandwidth {hertz:g} Hz ({bandwidth.source}): poll at {PASSES * hertz:g} Hz or more"
    if most_hz < PASSES * hertz:
        yield f"        the line carries {most_hz:g} polls a second: {folding(most_hz, hertz)}"
        yield f"        {remedy(most_hz, hertz, profile.bandwidth_register, most_hz)}"


def _odd_hints(odd: Sequence[tuple[int, str]]) -> Iterator[str]:
    ids: dict[str, list[int]] = {}
    for device_id, detail in odd:
        ids.setdefault(detail.replace("timeout_ms", "--timeout"), []).append(device_id)
    for detail, same in list(ids.items())[:MOST_SHOWN]:
        more = f" and {len(same) - MOST_SHOWN} more" if len(same) > MOST_SHOWN else ""
        yield f"heard of id {', '.join(map(str, same[:MOST_SHOWN]))}{more}: {detail}"


async def find_ids(
    line: Reader, ids: Sequence[int], timeout_s: float, progress: Progress
) -> tuple[list[int], list[tuple[int, str]]]:
    """The ids that answer at all, an exception is an answer too; and of the others, what came instead of an answer."""
    found: list[int] = []
    odd: list[tuple[int, str]] = []
    for device_id in ids:
        progress(device_id)
        answer = await line.read(device_id, _ANYTHING, 1, timeout_s)
        if (answer.answered or answer.fault is Fault.LENGTH) and answer.detail not in _NOBODY:
            found.append(device_id)
        if not answer.answered and (answer.fault is not Fault.TIMEOUT or "own request" in answer.detail):
            odd.append((device_id, answer.detail))
    return found, odd


def thorough_ids(ids: Sequence[int], asked: int) -> list[int]:
    """Those of ``ids`` that are worth more than one request each, where ``asked`` are asked in all."""
    return [device_id for device_id in ids if device_id in FACTORY_IDS or asked <= FEW_IDS]


def first_registers(profiles: Sequence[Profile]) -> list[Block]:
    """A block of one register for the first of each block of the profiles, each once, but for holding register 0, which
    everybody is asked for. Some devices do not refuse a register that they have not got, but ignore the request.
    """
    real = [profile for profile in profiles if not profile.name.startswith(SIMULATED)]
    places = {(block.function, block.start): None for profile in real for block in profile.blocks}
    places.pop((_ANYTHING.function, _ANYTHING.start), None)
    return [Block(function=function, start=start, fields=_ANYTHING.fields) for function, start in places]


async def _find_choosy(line: Reader, ids: Sequence[int], profiles: Sequence[Profile], timeout_s: float) -> list[int]:
    """Those that answer to a read of what they have, and to no other."""
    found: list[int] = []
    for device_id in ids:
        for place in first_registers(profiles):
            if (await line.read(device_id, place, 1, timeout_s)).answered:
                found.append(device_id)
                break
    return found


async def examine(
    line: Reader, device_id: int, profiles: Sequence[Profile], timeout_s: float, *, rest_s: float
) -> list[Finding]:
    """What fits the device, best first: what is proved, then the simulator's profiles after the others, the least
    changed profile before its variants, the richer before the poorer (in values, then in registers).

    ``rest_s``: after a lost answer, so that it is not taken for the next one (on a serial line).
    """
    cache: dict[tuple[str, int, int], Answer] = {}
    findings: dict[tuple[object, ...], list[Finding]] = {}
    for variant in _variants(profiles):
        finding = await _try(line, device_id, variant, timeout_s, rest_s, cache)
        if finding is not None and finding.score >= FITS:
            # Variants that read the same values from the same registers say nothing new.
            findings.setdefault((variant.profile.name, variant.shift, *finding.values.values()), [finding])
    kept = list(findings.values())
    for _ in range(READS - 1):
        await asyncio.sleep(READ_PAUSE_S)
        cache.clear()
        for series in kept.copy():
            finding = await _try(line, device_id, series[0].variant, timeout_s, rest_s, cache)
            if finding is None or finding.score < FITS or leaps(series[-1], finding):
                kept.remove(series)
            else:
                series.append(finding)
    return sorted(
        (
            msgspec.structs.replace(series[-1], score=min(finding.score for finding in series), doubt=doubt(series))
            for series in kept
        ),
        key=lambda finding: (
            bool(finding.doubt),
            finding.variant.profile.name.startswith(SIMULATED),
            -finding.score,
            finding.variant.changes,
            -len(finding.values),
            -len(finding.registers),
        ),
    )


def _variants(profiles: Sequence[Profile]) -> Iterator[Variant]:
    orders: tuple[ByteOrder, ...] = get_args(ByteOrder)
    for profile in profiles:
        own = {field.byte_order for block in profile.blocks for field in block.fields}
        for shift in SHIFTS:
            if any(not 0 <= block.start + shift <= 65536 - block_registers(block) for block in profile.blocks):
                continue
            for other_function in (False, True):
                for order in (None, *(order for order in orders if own != {order})):
                    yield Variant(profile=profile, shift=shift, other_function=other_function, byte_order=order)


async def _try(
    line: Reader,
    device_id: int,
    variant: Variant,
    timeout_s: float,
    rest_s: float,
    cache: dict[tuple[str, int, int], Answer],
) -> Finding | None:
    values: dict[Quantity, float] = {}
    registers: list[int] = []
    read_s = 0.0
    for block in variant.profile.blocks:
        asked = changed(block, variant)
        key = (asked.function, asked.start, block_registers(asked))
        if key not in cache:
            cache[key] = await line.read(device_id, asked, key[2], timeout_s)
            if not cache[key].answered:
                await asyncio.sleep(rest_s)
        if cache[key].fault is not Fault.NONE:
            return None
        decoded = decode(asked, cache[key].registers)
        if decoded.fault is not Fault.NONE:
            return None
        values |= decoded.values
        registers += cache[key].registers
        read_s = cache[key].sent_s
    score = plausibility(values, registers)
    return Finding(variant=variant, score=score, values=values, registers=registers, read_s=read_s)


def changed(block: Block, variant: Variant) -> Block:
    """A block of the profile as the variant reads it."""
    is_holding = (block.function == "holding") is not variant.other_function
    fields = block.fields
    if variant.byte_order is not None:
        fields = tuple(msgspec.structs.replace(field, byte_order=variant.byte_order) for field in fields)
    return Block(
        function="holding" if is_holding else "input",
        start=block.start + variant.shift,
        fields=fields,
    )

"""Baud rate, parity and ids of what hangs on a serial line of which nothing is known. Reads only, never writes.

The usual settings and ids are asked first; whatever comes back is looked at: an answer settles it, bytes that are no
frame say that something is there, and for whom it was asked is tried earlier with the other settings; the own request
is an echo. The time that all of it takes at the most is known beforehand.
"""

from __future__ import annotations

import asyncio
import re
import struct
from collections.abc import Callable, Iterator, Sequence
from enum import Enum
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.devices.frames import Request, crc16, find_rtu_answer, rtu_senders
from heaved.devices.probe import FACTORY_IDS, first_registers, thorough_ids
from heaved.links import Parity, SerialLink, character_s, explain_open_failure, silence_s
from heaved.serial_port import SerialPort
from heaved.setup.adapters import explain

if TYPE_CHECKING:
    from heaved.devices.profile import Profile

SETTINGS: Final[tuple[tuple[int, Parity], ...]] = (
    (9600, "N"),  # WitMotion as delivered; most of what is sold.
    (115200, "N"),  # Benewake as delivered, and what WitMotion is set to.
    (57600, "E"),  # Baumer as delivered.
    (19200, "E"),  # The default of the Modbus standard (over serial line V1.02, 2.5.1).
    (19200, "N"),
    (38400, "N"),
    (57600, "N"),
    (9600, "E"),  # Riftek as delivered.
    (230400, "N"),
    (115200, "E"),
    (38400, "E"),
    (4800, "N"),
    (460800, "N"),
    (921600, "N"),
    (9600, "O"),
    (19200, "O"),
    (2400, "N"),
)
"""Baud rates and parities, most usual first. Two stop bits are heard as one, and answered to as well."""
USUAL_IDS: Final = (*FACTORY_IDS, *range(2, 17), 32, 100, 247)
ALL_IDS: Final = (*USUAL_IDS, *(i for i in range(1, 248) if i not in USUAL_IDS))
LISTEN_S: Final = 0.06
"""Before anything is asked with new settings: whoever speaks by itself is heard."""
OPEN_S: Final = 0.03
"""An adapter takes about so long to be set."""
REQUEST_BYTES, ANSWER_BYTES = 8, 7
_FIRST: Final = (3, 0)
"""What everybody is asked for: holding register 0; who has not got it refuses, which is an answer."""
_READ: Final = struct.Struct(">BBHH")
_SENTENCE: Final = re.compile(rb"[$!:][A-Za-z][ -~]{4,}\r?\n")
_MOST_SHOWN: Final = 12
"""Bytes of garbage,"""
_MOST_NAMED: Final = 3
"""and settings at which it came."""

Progress = Callable[[int, int, str], None]
"""Told how many requests have been made, of how many at the most, and what is asked now."""


class Heard(Enum):
    """What came after a request."""

    NOTHING = "nothing"
    ANSWER = "answer"
    """A good frame, of whomever."""
    ECHO = "echo"
    """The own request alone."""
    SENTENCE = "sentence"
    """A line of text: somebody speaks by itself."""
    GARBAGE = "garbage"


def judge(heard: bytes, sent: bytes, request: Request) -> Heard:
    """What the bytes are that came after a request. ``sent``: its bytes."""
    if find_rtu_answer(heard, request) or rtu_senders(heard):
        return Heard.ANSWER
    rest = heard.removeprefix(sent)
    if not rest:
        return Heard.ECHO if heard else Heard.NOTHING
    return Heard.SENTENCE if _SENTENCE.search(rest) else Heard.GARBAGE


class Scan(msgspec.Struct, frozen=True):
    """What a line said."""

    link: SerialLink | None
    """With the settings at which somebody answers; None: nobody does."""
    ids: tuple[int, ...]
    """Who has answered."""
    notes: tuple[str, ...]
    """What else was heard, and what that means."""


class Plan(msgspec.Struct, frozen=True):
    """What is asked, in order: some ids with every setting, then others with every setting."""

    rounds: tuple[tuple[int, ...], ...]
    settings: tuple[tuple[int, Parity], ...]
    timeout_s: float
    places: tuple[tuple[int, int], ...] = ()
    """Functions and registers that ids which are likely are asked for besides, if they do not answer."""

    def thorough(self, ids: Sequence[int]) -> list[int]:
        """Those of the ids of a round that are."""
        return thorough_ids(ids, sum(map(len, self.rounds)))

    def requests_of(self, ids: Sequence[int]) -> int:
        """Most that are made of the ids of a round, with one setting."""
        return len(ids) + len(self.places) * len(self.thorough(ids))

    @property
    def requests(self) -> int:
        """Most that are made."""
        return len(self.settings) * sum(map(self.requests_of, self.rounds))

    def bound_s(self, rounds: int | None = None) -> float:
        """Longest time that it takes, or that its first ``rounds`` take."""
        total = 0.0
        for ids in self.rounds[:rounds]:
            for setting in self.settings:
                link = SerialLink("", *setting)
                total += OPEN_S + LISTEN_S
                total += self.requests_of(ids) * (wait_s(link, self.timeout_s) + silence_s(link))
        return total


def plan(ids: Sequence[int] | None, timeout_s: float, profiles: Sequence[Profile] = ()) -> Plan:
    """``ids``: whom to ask; None: the usual ones with every setting, then all others. ``profiles``: of what is likely
    to be there.
    """
    rounds = (tuple(ids),) if ids is not None else (USUAL_IDS, ALL_IDS[len(USUAL_IDS) :])
    places = tuple((3 if block.function == "holding" else 4, block.start) for block in first_registers(profiles))
    return Plan(rounds, SETTINGS, timeout_s, places)


def wait_s(link: SerialLink, timeout_s: float) -> float:
    """After a request: the time on the line is not the slave's."""
    return timeout_s + (REQUEST_BYTES + ANSWER_BYTES) * character_s(link)


class _Ear:
    """The port with one setting."""

    def __init__(self, link: SerialLink) -> None:
        self._link = link
        self._port = SerialPort(link, self._on_bytes, self._on_loss)
        self._heard = b""
        self._request: Request | None = None
        self._settled = asyncio.Event()
        self._loss = ""

    def open(self) -> None:
        """Raises:
        OSError: it cannot be opened, or not with that setting.
        """
        self._port.open()

    def close(self) -> None:
        self._port.close()

    async def listen(self, duration_s: float) -> bytes:
        """What comes unasked. Raises: ConnectionError: the port has gone."""
        self._heard = b""
        await self._wait(duration_s)
        return self._heard

    async def ask(self, device_id: int, place: tuple[int, int], timeout_s: float) -> tuple[Heard, bytes]:
        """Read one register, ``place``: its function and address. Raises: ConnectionError: the port has gone."""
        function, register = place
        request = self._request = Request(device_id, function, 1)
        body = _READ.pack(device_id, function, register, request.count)
        sent = body + crc16(body).to_bytes(2, "little")
        self._heard = b""
        if not self._port.write(sent) and not self._loss:
            raise ConnectionError(f"{self._link.path} takes no bytes: unplug the adapter and plug it in again")
        await self._wait(wait_s(self._link, timeout_s))
        self._request = None
        return judge(self._heard, sent, request), self._heard.removeprefix(sent)

    async def _wait(self, duration_s: float) -> None:
        self._settled.clear()
        if not self._loss:
            try:
                async with asyncio.timeout(duration_s):
                    await self._settled.wait()
            except TimeoutError:
                return
        if self._loss:
            raise ConnectionError(f"{self._link.path} has gone while it was asked ({self._loss}): plug the adapter in")

    def _on_bytes(self, data: bytes) -> None:
        self._heard = (self._heard + data)[-4096:]
        if self._request is not None and find_rtu_answer(self._heard, self._request):
            self._settled.set()

    def _on_loss(self, reason: str) -> None:
        self._loss = reason
        self._settled.set()


async def scan(path: str, asked: Plan, progress: Progress) -> Scan:
    """Look for the settings of a serial line, and for who is there: up to the first setting at which somebody answers.
    Cancelled, as by Ctrl-C, it tells what has been heard so far.

    Raises:
        ConnectionError: the port cannot be opened, has gone, or takes nothing; says why and what to do.
    """
    search = _Search(path, asked, progress)
    try:
        return await search.run()
    except asyncio.CancelledError:
        task = asyncio.current_task()
        if task is not None:
            task.uncancel()
        return search.cut_short()


class _Search:
    """One scan, and how far it has come."""

    def __init__(self, path: str, asked: Plan, progress: Progress) -> None:
        self._path, self._asked, self._progress = path, asked, progress
        self._notes = _Notes()
        self._heard_of: list[int] = []
        """Ids for which something came that was no answer."""
        self._done = 0
        self._answered: dict[SerialLink, list[int]] = {}
        """The one setting at which somebody did, and who."""

    async def run(self) -> Scan:
        for ids in self._asked.rounds:
            for setting in self._asked.settings:
                link = SerialLink(self._path, *setting)
                if found := await self._try(link, ids):
                    self._progress(self._asked.requests, self._asked.requests, str(link))
                    return Scan(link, tuple(dict.fromkeys(found)), self._notes.told(found=True))
        return Scan(None, (), self._notes.told(found=False))

    def cut_short(self) -> Scan:
        for link, found in self._answered.items():
            return Scan(link, tuple(dict.fromkeys(found)), self._notes.told(found=True))
        cut = f"cut short after {self._done} of {self._asked.requests} requests: the others may be right"
        return Scan(None, (), (*self._notes.told(found=False), cut))

    async def _try(self, link: SerialLink, ids: Sequence[int]) -> list[int]:
        """Those who answer with one setting."""
        # First of all, whoever has made a noise with other settings.
        queue = [*(i for i in self._heard_of if i in ids), *(i for i in ids if i not in self._heard_of)]
        ear = _Ear(link)
        try:
            ear.open()
        except OSError as error:
            if error.errno is not None or not self._notes.refused(link):
                raise ConnectionError(explain(link, explain_open_failure(link, error))) from error
            self._done += self._asked.requests_of(queue)
            return []
        found: list[int] = []
        try:
            self._notes.hears_unasked(link, await ear.listen(LISTEN_S))
            # Who shares the line has the same settings: they are asked to the end, whoever has answered.
            for device_id in queue:
                await self._ask(ear, link, device_id, _FIRST, found)
            for device_id in self._asked.thorough(queue):
                for place in self._asked.places:
                    if device_id not in found:
                        await self._ask(ear, link, device_id, place, found)
        finally:
            ear.close()
        return found

    async def _ask(self, ear: _Ear, link: SerialLink, device_id: int, place: tuple[int, int], found: list[int]) -> None:
        self._progress(self._done, self._asked.requests, f"{_setting(link)} id {device_id}")
        self._done += 1
        what, heard = await ear.ask(device_id, place, self._asked.timeout_s)
        if what is Heard.ANSWER:
            found += [device_id, *(sender.device_id for sender in rtu_senders(heard))]
            self._answered[link] = found
        elif what is Heard.GARBAGE and device_id not in self._heard_of:
            self._heard_of.append(device_id)
        self._notes.hears(link, device_id, what, heard)
        await asyncio.sleep(silence_s(link))


class _Notes:
    """What was heard that is no answer: by setting, the first of each kind."""

    def __init__(self) -> None:
        self._echo = False
        self._refused: set[str] = set()
        self._sentences: list[str] = []
        self._unasked: dict[str, str] = {}
        self._garbage: dict[str, str] = {}

    def refused(self, link: SerialLink) -> bool:
        """The port takes other settings, not this one. False: it takes none."""
        self._refused.add(_setting(link))
        return len(self._refused) < len(SETTINGS)

    def hears_unasked(self, link: SerialLink, heard: bytes) -> None:
        if _SENTENCE.search(heard):
            self._sentences.append(f"{_setting(link)} ({_shown(heard)})")
        elif heard:
            self._unasked.setdefault(_setting(link), _shown(heard))

    def hears(self, link: SerialLink, device_id: int, what: Heard, heard: bytes) -> None:
        self._echo |= what is Heard.ECHO
        if what is Heard.GARBAGE:
            self._garbage.setdefault(_setting(link), f"id {device_id} was asked at {_setting(link)} ({_shown(heard)})")
        elif what is Heard.SENTENCE:
            self.hears_unasked(link, heard)

    def told(self, *, found: bool) -> tuple[str, ...]:
        return tuple(self._told(found=found))

    def _told(self, *, found: bool) -> Iterator[str]:
        if self._echo:
            yield (
                "the adapter hears its own requests: harmless with a two-wire RS-485 adapter that echoes; if nobody "
                "answers, its wires may be shorted, or A and B not connected"
            )
        if self._refused:
            yield f"the adapter does not take {', '.join(sorted(self._refused))}: not tried"
        if self._sentences:
            yield (
                f"something speaks by itself at {self._sentences[0]}, which is no Modbus: give it a profile with "
                "[[device.profile.sentences]] and a serial:// link (see the end of heaved.toml)"
            )
        elif self._unasked and not found:
            places = ", ".join(f"{setting} ({shown})" for setting, shown in list(self._unasked.items())[:_MOST_NAMED])
            yield (
                f"bytes come unasked at {places}: another master uses the line (stop it), or a device speaks by itself "
                "(set it to Modbus)"
            )
        if self._garbage and not found:
            first = "; ".join(list(self._garbage.values())[:_MOST_NAMED])
            yield (
                f"bytes that are no frame came when {first}: something is there, and either none of the settings tried "
                "is its own, or two masters use the line, or wiring (A and B swapped) and termination are bad"
            )


def _setting(link: SerialLink) -> str:
    return f"{link.baudrate} 8{link.parity}{link.stopbits}"


def _shown(heard: bytes) -> str:
    if found := _SENTENCE.search(heard):
        return '"' + found[0][:40].decode("ascii").strip() + '"'
    more = " …" if len(heard) > _MOST_SHOWN else ""
    return heard[:_MOST_SHOWN].hex(" ") + more

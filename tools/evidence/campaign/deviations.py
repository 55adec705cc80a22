"""What can be wrong with one answer of a Modbus slave, as bytes. Pure: chance is an argument.

Written from the Modbus documents, sharing nothing with the code that is tried.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    import random
    from collections.abc import Sequence


def _crc_table() -> list[int]:
    table = []
    for byte in range(256):
        register = byte
        for _ in range(8):
            register = (register >> 1) ^ (0xA001 if register & 1 else 0)
        table.append(register)
    return table


_TABLE: Final = _crc_table()


def crc(data: bytes) -> bytes:
    """CRC-16/MODBUS, low byte first as on the line."""
    register = 0xFFFF
    for byte in data:
        register = (register >> 8) ^ _TABLE[(register ^ byte) & 0xFF]
    return register.to_bytes(2, "little")


class Asked(NamedTuple):
    """A read request, as it came."""

    raw: bytes
    is_tcp: bool
    transaction: int
    device_id: int
    function: int
    start: int
    number: int
    """Of registers."""

    def frame(self, pdu: bytes, *, device_id: int = -1, transaction: int = -1) -> bytes:
        """``pdu`` as a frame of the same link, by default that of the answer to this request."""
        unit = bytes((self.device_id if device_id < 0 else device_id,))
        if not self.is_tcp:
            return unit + pdu + crc(unit + pdu)
        number = self.transaction if transaction < 0 else transaction
        return number.to_bytes(2) + b"\0\0" + (len(pdu) + 1).to_bytes(2) + unit + pdu

    def read(self, registers: Sequence[int]) -> bytes:
        """The PDU that a read is answered with."""
        return bytes((self.function, 2 * len(registers))) + b"".join(word.to_bytes(2) for word in registers)


Sent = list[tuple[float, bytes]]
"""What goes out: seconds after the request, and the bytes."""
Deviation = "Callable[[Asked, list[int], Sent, random.Random, float], Sent]"
"""(request, registers of the honest answer, what would go out, chance, timeout of the master in s) to what goes out."""


def _whole(sent: Sent) -> bytes:
    return b"".join(data for _, data in sent)


def _after_s(sent: Sent) -> float:
    return sent[0][0] if sent else 0.0


def silent(_asked: Asked, _registers: list[int], _sent: Sent, _chance: random.Random, _timeout_s: float) -> Sent:
    return []


def late(_asked: Asked, _registers: list[int], sent: Sent, chance: random.Random, timeout_s: float) -> Sent:
    """Up to three timeouts late, and never beyond what the manual demands (0.5 s)."""
    after_s = min(timeout_s * chance.uniform(1.0, 3.0), 0.45)
    return [(after_s + at_s, data) for at_s, data in sent]


def truncated(_asked: Asked, _registers: list[int], sent: Sent, chance: random.Random, _timeout_s: float) -> Sent:
    whole = _whole(sent)
    return [(_after_s(sent), whole[: chance.randrange(1, len(whole))])] if len(whole) > 1 else sent


def in_pieces(_asked: Asked, _registers: list[int], sent: Sent, chance: random.Random, timeout_s: float) -> Sent:
    whole, pieces, at_s = _whole(sent), [], _after_s(sent)
    while whole:
        size = chance.randrange(1, len(whole) + 1)
        pieces.append((at_s, whole[:size]))
        whole, at_s = whole[size:], at_s + chance.uniform(0.0, 0.2) * timeout_s
    return pieces


def duplicated(_asked: Asked, _registers: list[int], sent: Sent, _chance: random.Random, _timeout_s: float) -> Sent:
    return [(_after_s(sent), 2 * _whole(sent))]


def wrong_id(asked: Asked, registers: list[int], sent: Sent, chance: random.Random, _timeout_s: float) -> Sent:
    other = (asked.device_id + chance.randrange(1, 240)) % 248
    return [(_after_s(sent), asked.frame(asked.read(registers), device_id=other))]


def wrong_function(asked: Asked, registers: list[int], sent: Sent, chance: random.Random, _timeout_s: float) -> Sent:
    function = chance.choice([one for one in (1, 2, 3, 4, 6, 16, 0x2B) if one != asked.function])
    return [(_after_s(sent), asked.frame(bytes((function,)) + asked.read(registers)[1:]))]


def wrong_transaction(asked: Asked, registers: list[int], sent: Sent, chance: random.Random, _timeout_s: float) -> Sent:
    """Never one that is still to come: where the slave is behind, that would be the right one."""
    number = (asked.transaction + -chance.choice((1, 2, 7, 4711))) % 65536
    return [(_after_s(sent), asked.frame(asked.read(registers), transaction=number))]


def wrong_count(asked: Asked, registers: list[int], sent: Sent, chance: random.Random, _timeout_s: float) -> Sent:
    fewer = registers[: chance.randrange(len(registers))] if chance.random() < 0.5 else [*registers, 0x5A5A]
    return [(_after_s(sent), asked.frame(asked.read(fewer)))]


def broken_crc(asked: Asked, _registers: list[int], sent: Sent, chance: random.Random, _timeout_s: float) -> Sent:
    """A bit or two of a serial frame; of a TCP frame, which has no checksum of its own, of protocol and length."""
    whole = bytearray(_whole(sent))
    if whole:
        bits = range(16, 48) if asked.is_tcp else range(8 * len(whole))
        for bit in chance.sample(bits, chance.choice((1, 2))):
            whole[bit // 8] ^= 1 << bit % 8
    return [(_after_s(sent), bytes(whole))]


def exception(asked: Asked, _registers: list[int], sent: Sent, chance: random.Random, _timeout_s: float) -> Sent:
    code = chance.choice((1, 2, 3, 4, 5, 6, 8, 10, 11, 0x7F))
    return [(_after_s(sent), asked.frame(bytes((asked.function | 0x80, code))))]


def echo(asked: Asked, _registers: list[int], sent: Sent, _chance: random.Random, _timeout_s: float) -> Sent:
    return [(0.0, asked.raw), *sent]


def noise(_asked: Asked, _registers: list[int], sent: Sent, chance: random.Random, _timeout_s: float) -> Sent:
    """Before the answer, after it, or in place of it."""
    babble = chance.randbytes(chance.randrange(1, 40))
    where = chance.randrange(3)
    whole = _whole(sent)
    return [(_after_s(sent), babble + whole if where == 0 else whole + babble if where == 1 else babble)]


BYTES: Final = {
    "exception": exception,
    "wrong id": wrong_id,
    "wrong function": wrong_function,
    "wrong transaction": wrong_transaction,
    "wrong count": wrong_count,
    "CRC or header broken": broken_crc,
    "duplicated": duplicated,
    "echo": echo,
    "noise": noise,
    "truncated": truncated,
    "in pieces": in_pieces,
    "late": late,
    "silent": silent,
}
"""Of the bytes, in the order in which they are put upon each other: what is cut off stands at the end, so that nothing
is put into the readings of a TCP frame, which has no checksum."""
_FRAMES: Final = ("exception", "wrong id", "wrong function", "wrong transaction", "wrong count")
"""Another frame in place of the answer: one at a time."""
FOR_TCP_ALONE: Final = ("wrong transaction",)
BREAK_TCP: Final = ("CRC or header broken", "noise", "truncated", "in pieces", "silent")
"""After which a TCP connection is made anew, which takes a quarter of a second."""

LET_WAIT: Final = ("wrong id", "wrong function", "wrong transaction", "late")
"""After which the master waits in vain."""


def together(kinds: Sequence[str]) -> list[str]:
    """Those of ``kinds`` that can be seen in one answer, in order."""
    if "silent" in kinds:
        return ["silent"]
    frames = [kind for kind in kinds if kind in _FRAMES][:1]
    values = [] if "exception" in frames else [kind for kind in kinds if kind in VALUES]
    return values + [kind for kind in BYTES if kind in frames or (kind in kinds and kind not in _FRAMES)]


# ---- of the values ---------------------------------------------------------------------------------------------------


class Values:
    """Registers that lie. It remembers the last honest ones, which a frozen sensor goes on showing."""

    def __init__(self) -> None:
        self._frozen: list[int] | None = None

    def thawed(self) -> None:
        """The sensor measures again."""
        self._frozen = None

    def turned(self, kind: str, registers: list[int], chance: random.Random) -> list[int]:
        """What the registers hold instead."""
        if kind == "frozen":
            if self._frozen is None or len(self._frozen) < len(registers):
                self._frozen = registers
            return self._frozen[: len(registers)]
        made = list(registers)
        place = chance.randrange(len(made))
        if kind == "spiking":
            size = round(2.0 ** chance.uniform(4.0, 15.0)) * chance.choice((-1, 1))
            made[place] = (made[place] + size) & 0xFFFF
        elif kind == "FFFFh":
            made = [0xFFFF] * len(made)
        elif kind == "8000h or 0":
            made = [chance.choice((0x8000, 0))] * len(made)
        elif kind == "bytes swapped":
            made = [(word >> 8) | (word & 0xFF) << 8 for word in made]
        elif kind == "one register torn":
            made[place] = chance.randrange(0x10000)
        return made


VALUES: Final = ("frozen", "spiking", "FFFFh", "8000h or 0", "bytes swapped", "one register torn")

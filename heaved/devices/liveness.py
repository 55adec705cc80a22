"""Judging a device by its answers over time: frozen values, a frozen clock, a slave that has fallen silent. Pure."""

from __future__ import annotations

from enum import Enum
from math import inf, nan
from typing import TYPE_CHECKING, Final

from heaved.devices.profile import MAX_REGISTERS, DeviceSpec, Quantity, role_quantities, si_step, told_together
from heaved.samples import Fault
from heaved.unchanged import Unchanged

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

STALE_AFTER_S = 0.5
"""A device clock that stands for longer than this is a fault, unless its resolution or the poll rate is coarser."""

SILENT_AFTER_POLLS = 3
SILENT_AFTER_S = 0.5
"""A slave is silent when it has missed that many polls and not answered for that long."""

PROBE_S = 0.5
"""A silent slave is asked at most this often; no answer comes later than this after its request."""

MOST_LONGER = 8
"""Registers more than wanted that a read asks for at most, so that its answer has a length of its own."""


class LivenessCheck:
    """Whether what a device says is alive.

    Measurements that stay identical to the last bit for longer than ``stuck_after_s`` are stuck (0: never judged): a
    living sensor has noise. The encoders of a crane have none and stand still with it, and an MRU in a harbour may tell
    the same centimetre for long: they are not judged. A device that sends its own clock is stale when that clock
    stands. Neither is forgotten over a lost connection: a gateway that serves its memory is found out at once.
    """

    def __init__(self, device: DeviceSpec) -> None:
        wanted = role_quantities(device.role)
        blocks = device.profile.blocks
        measured = [tuple(name for name in names if name in wanted) for names in told_together(device.profile)]
        self._blocks = [(names, Unchanged()) for names in measured if names]
        is_coarse = device.role in ("crane", "reference_mru")
        self._stuck_after_s = inf if is_coarse else device.stuck_after_s or inf
        steps_s = [si_step(field) for block in blocks for field in block.fields if field.quantity == "device_time_s"]
        self._clock = Unchanged()
        # Two steps and a half: a clock that ticks as coarsely as it is read may show the same time twice.
        self._stale_after_s = max(STALE_AFTER_S, 2.5 / device.rate_hz, 2.5 * max(steps_s, default=0.0))

    def judge(self, values: Mapping[Quantity, float], t_s: float) -> tuple[Fault, str]:
        """``values``: of all blocks of one poll, SI units. Returns the fault and what to say about it."""
        time_s = values.get("device_time_s")
        if time_s is not None and (stood_s := self._clock.push(t_s, time_s)) > self._stale_after_s:
            return Fault.STALE, f"the device's clock has stood at {time_s:.6g} s for {stood_s:.1f} s: restart it"
        for names, content in self._blocks:
            if values.keys().isdisjoint(names):
                continue  # They stand in another sentence.
            if (stood_s := content.push(t_s, tuple(values.get(name, nan) for name in names))) > self._stuck_after_s:
                hint = "restart the sensor, or raise stuck_after_s if it may stand still"
                return Fault.STUCK, f"{', '.join(names)} have not changed for {stood_s:.1f} s: {hint}"
        return Fault.NONE, ""


_REFUSES_LENGTH: Final = (2, 3)
"""Exceptions that speak of the registers asked for: illegal data address, illegal data value."""


class _Way(Enum):
    """How a block is read."""

    PLAIN = 1
    LONGER = 2
    """With some registers more than are wanted, which are thrown away."""
    PARTS = 3
    """In several reads."""


def _divided(count: int, cuts: Sequence[int], taken: Collection[int]) -> tuple[int, ...]:
    """Lengths of the parts of a block, none of them taken, as long as they can be from the start on: what belongs
    together is then mostly read at one moment. Empty: there are none.
    """
    rest: dict[int, tuple[int, ...]] = {count: ()}
    for start in (*reversed(cuts), 0):
        for end in sorted(rest, reverse=True):
            if end - start not in taken:
                rest[start] = (end - start, *rest[end])
                break
    return rest.get(0, ())


class Contact:
    """Whether an answer of this slave can be told from a late one, and whether asking it is worth the line's time.

    On a serial line nothing but id, function and length ties an answer to its request. After a request that was not
    answered an answer may still be under way; it would be taken for that of the next request of the same length. So no
    length is asked for again while an answer of that length may come: a block is meanwhile read with a few registers
    more, or, from a slave that refuses those, in parts. No order of the answers is assumed. On a line just opened,
    where somebody else may have asked, the first read is such a one. When no length is left, the slave is left alone.

    What a slave must keep to: one answer to a request, with the number of registers asked for, within ``quiet_s`` or
    before those to later requests, or never.

    A silent slave would take the time of its neighbours with its timeouts, so it is asked rarely until it answers.

    Args:
        numbered: answers carry the number of their request (TCP).
        lengths: numbers of registers that are asked for regularly.
        alone: no other slave on the bus.
        timeout_s: of one read.
        opened_s: when the line was opened.
    """

    def __init__(
        self, *, numbered: bool, lengths: Collection[int], alone: bool, timeout_s: float, opened_s: float
    ) -> None:
        self._lengths = tuple(lengths)
        self._numbered = numbered
        self._rests = not (numbered and alone)
        self.quiet_s = max(PROBE_S, 2.0 * timeout_s)
        self._pending: dict[int, float] = {}
        """Lengths of which an answer may be under way, with the time of the request."""
        self._way = _Way.PLAIN
        self._refused: set[_Way] = set()
        self._failed: _Way | None = None
        """The way that got no answer last, until a plain read has one."""
        self._misses = 0
        self._answered_s = opened_s
        self.reopened(opened_s)

    @property
    def is_plain(self) -> bool:
        """Whether the last plan asks for exactly what is wanted: a refusal is then the device's, not our making."""
        return self._way is _Way.PLAIN

    def plan(self, now_s: float, count: int, cuts: Sequence[int] = (), most: int = MAX_REGISTERS) -> tuple[int, ...]:
        """Lengths of the reads, one after the other, that give ``count`` registers now; empty: leave the slave alone.

        ``cuts``: where the block may be divided, in order. ``most``: registers that may be read from its start.
        """
        self._way = _Way.PLAIN
        is_quiet = now_s - self._asked_s >= self.quiet_s
        if self._rests and not is_quiet and self.silent(now_s):
            return ()
        if self._pending:
            self._forget_what_cannot_come(now_s, is_quiet)
        if count not in self._pending:
            return (count,)
        # Some devices do not answer at all what they would have to refuse: then the other way comes first.
        for way in sorted((_Way.LONGER, _Way.PARTS), key=lambda way: way is self._failed):
            if way in self._refused:
                continue
            if lengths := self._longer(count, most) if way is _Way.LONGER else _divided(count, cuts, self._pending):
                self._way = way
                return lengths
        return ()

    def _longer(self, count: int, most: int) -> tuple[int, ...]:
        lengths = range(count + 1, min(count + MOST_LONGER, most, MAX_REGISTERS) + 1)
        return tuple(length for length in lengths if length not in self._pending)[:1]

    def _forget_what_cannot_come(self, now_s: float, is_quiet: bool) -> None:
        """An answer that is overdue and has been overtaken by later ones, or for which everything has waited."""
        self._pending = {
            length: asked_s
            for length, asked_s in self._pending.items()
            if not (is_quiet or (self._served_s > asked_s and now_s - asked_s >= self.quiet_s))
        }

    def silent(self, now_s: float) -> bool:
        """Whether it has missed enough requests, for long enough."""
        return self._misses >= SILENT_AFTER_POLLS and now_s - self._answered_s >= SILENT_AFTER_S

    def answered(self, now_s: float) -> None:
        """The registers came that were asked for last."""
        self._misses = 0
        if self._way is _Way.PLAIN:
            self._failed = None
        self._answered_s = self._served_s = now_s

    def refused(self, now_s: float, count: int, code: int) -> None:
        """An exception came. It carries no length: it may answer any request under way, so it proves nothing."""
        self._misses = 0
        if code in _REFUSES_LENGTH:
            self._refused.add(self._way)
        if self._pending:
            self._expect(now_s, count)
        self._answered_s = now_s

    def missed(self, now_s: float, count: int) -> None:
        """It was asked for ``count`` registers, and no valid answer came in time."""
        self._misses += 1
        self._failed = self._way
        self._expect(now_s, count)

    def heard(self, now_s: float, count: int) -> None:
        """It sent ``count`` registers that nobody waited for: what was under way, or something that it sends unasked,
        and then may send again.
        """
        if self._pending.pop(count, None) is None:
            self._expect(now_s, count)

    def _expect(self, now_s: float, count: int) -> None:
        self._asked_s = now_s
        if not self._numbered:
            self._pending[count] = now_s

    def reopened(self, now_s: float) -> None:
        """The line is new, and has been silent for ``quiet_s``: only what is held back till the next request may come,
        and comes before its answer.
        """
        self._misses = 0
        self._refused.clear()
        self._pending.clear()
        for count in self._lengths:
            self._expect(now_s - self.quiet_s, count)
        self._asked_s, self._served_s = now_s, -inf

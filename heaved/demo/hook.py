"""The hook under a simulated winch that is driven by a daemon's stream, in the sea whose truth the simulator knows."""

from __future__ import annotations

import time
from collections import deque
from math import sqrt
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.client.stream_client import SILENCE_S, StreamConnection, Trouble, UnreachableError
from heaved.outputs.records import MotionRecord
from heaved.simulate.compensator import Compensator, CompensatorParams, Source, Update
from heaved.simulate.winch import Winch, WinchParams, WinchState

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.simulate.seaway import Seaway

_CONNECT_S: Final = 1.0
_RETRY_S: Final = 0.5
_SAY_EVERY_S: Final = 5.0


class Lift:
    """A winch and its compensator: lines of the stream in, the rope's motion out. Pure."""

    def __init__(
        self,
        source: Source = Source.FORECAST,
        *,
        winch: WinchParams = WinchParams(),  # noqa: B008  (frozen)
        params: CompensatorParams = CompensatorParams(),  # noqa: B008
        t_s: float = 0.0,
    ) -> None:
        self.winch = Winch(winch, t_s=t_s)
        self.compensator = Compensator(winch, params, source)

    def tick(self, now_s: float) -> WinchState:
        """Run the winch until ``now_s`` and give it its next set-point."""
        state = self.winch.advance(now_s)
        self.winch.command(now_s, self.compensator.set_point(now_s))
        return state


class HookMotion:
    """What the compensation is worth: heave and hook over the last minute of compensation in full. Pure."""

    WINDOW_S: Final = 60.0
    BEGIN_S: Final = 10.0
    """At first the rope is still brought to where it belongs; and less than so many seconds of record say nothing."""

    def __init__(self) -> None:
        self._record: deque[tuple[float, float, float]] = deque()
        self._full_since_s: float | None = None
        self._has_begun = False
        self._said = ""

    def note(self, now_s: float, heave_m: float, hook_m: float, authority: float) -> None:
        """One moment: true heave, hook, and how far the compensator is in charge (0 to 1)."""
        if authority < 1.0:
            self._record.clear()
            self._full_since_s = None
            return
        self._has_begun = True
        if self._full_since_s is None:
            self._full_since_s = now_s
        if now_s - self._full_since_s < self.BEGIN_S:
            return
        self._record.append((now_s, heave_m, hook_m))
        while now_s - self._record[0][0] > self.WINDOW_S:
            self._record.popleft()

    def news(self) -> str | None:
        """A line for the terminal; None: it would be the same words again."""
        line = self._line()
        is_new = line != self._said
        self._said = line
        return line if is_new else None

    def _line(self) -> str:
        if not self._record or (length_s := self._record[-1][0] - self._record[0][0]) < self.BEGIN_S:
            if self._has_begun and self._full_since_s is None:
                return "hook motion: the heave cannot be used, the winch holds"
            return "hook motion: settling"
        heave, hook = (sqrt(sum(moment[i] ** 2 for moment in self._record) / len(self._record)) for i in (1, 2))
        decimals = 2 if heave >= 0.2 else 4
        share = f" ({100.0 * hook / heave:.1f} %)" if heave > 1e-3 else ""
        return (
            f"hook motion, last {length_s:.0f} s: {heave:.{decimals}f} m uncompensated, "
            f"{hook:.{decimals}f} m compensated{share}"
        )


def follow(
    host: str, port: int, sea: Seaway, epoch_s: float, say: Callable[[str], None], ended: Callable[[], bool]
) -> None:
    """Compensate from the stream at ``host:port``, in real time, until ``ended``; ``say`` is given a line now and then.

    The sea's time 0 was at ``epoch_s`` of this machine's monotonic clock. Daemons may come and go meanwhile.
    """
    client = _Client(sea, epoch_s, say)
    while not ended():
        try:
            with StreamConnection(host, port, deadline_s=time.monotonic() + _CONNECT_S) as connection:
                client.listen(connection, ended)
        except UnreachableError:
            client.wait(ended)


class _Client:
    """The lift on the clock of this machine: ticks at absolute deadlines, between which it listens."""

    def __init__(self, sea: Seaway, epoch_s: float, say: Callable[[str], None]) -> None:
        self._sea, self._epoch_s, self._say = sea, epoch_s, say
        now_s = time.monotonic()
        self._params = CompensatorParams()
        self._lift = Lift(params=self._params, t_s=now_s)
        self._motion = HookMotion()
        self._due_s = self._said_s = now_s

    def listen(self, connection: StreamConnection, ended: Callable[[], bool]) -> None:
        """Take lines and tick.

        Raises:
            UnreachableError: the connection is lost.
        """
        compensator = self._lift.compensator
        compensator.connected()
        heard_s = time.monotonic()
        while not ended():
            record = connection.read(self._due_s)
            now_s = time.monotonic()
            if isinstance(record, MotionRecord):
                heard_s = now_s
                compensator.take(msgspec.convert(record, Update, from_attributes=True), now_s)
            elif now_s - heard_s > SILENCE_S:
                raise UnreachableError(Trouble.SILENT, f"nothing said for {SILENCE_S:g} s")
            if now_s >= self._due_s:
                self._tick(now_s)

    def wait(self, ended: Callable[[], bool]) -> None:
        """Tick without a connection: at least until the rope rests, for trying to connect may take its time."""
        until_s = time.monotonic() + _RETRY_S
        while not ended() and (time.monotonic() < until_s or self._lift.compensator.authority > 0.0):
            time.sleep(max(0.0, self._due_s - time.monotonic()))
            self._tick(time.monotonic())

    def _tick(self, now_s: float) -> None:
        state = self._lift.tick(now_s)
        heave_m = self._sea.at(now_s - self._epoch_s).heave_m
        self._motion.note(now_s, heave_m, heave_m + state.position_m, self._lift.compensator.authority)
        self._due_s += self._params.period_s
        if self._due_s <= now_s:  # What was missed is not made up for in a burst.
            self._due_s = now_s + self._params.period_s
        if now_s - self._said_s >= _SAY_EVERY_S:
            self._said_s = now_s
            if (line := self._motion.news()) is not None:
                self._say(line)

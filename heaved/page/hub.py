"""What the page knows, and what waits for each browser that shows it.

Both are bounded: the hub keeps ten minutes of what is plotted and the newest record of each slower class; for a browser
wait the frames of two seconds and, of everything else, the newest. What a slow browser loses is counted and told.

It says server-sent events. Each carries JSON in which ``at_s``, ``read_s`` and ``sent_s`` are on the monotonic clock of
this process (``/clock`` tells a browser what that says now), and in which a record of the stream stands as it came.
"""

from __future__ import annotations

import asyncio
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING, Final

import msgspec

from heaved.outputs.records import DelayedRecord, MotionRecord
from heaved.page.divergence import DivergenceMeter
from heaved.page.follower import RATE_HZ
from heaved.samples import HeaveState

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.page.follower import Known, Link

HISTORY_S: Final = 600.0
HISTORY_HZ: Final = 5.0
"""Of what is kept: a wave of 2 s has ten points."""
_MOST_ROWS: Final = round(HISTORY_S * HISTORY_HZ)
_MOST_FRAMES: Final = round(2.0 * RATE_HZ)
"""That wait for a browser. Older ones are in the history, if it comes again."""
_SLOWER_S: Final = 1.0
"""DIVERGENCE is told so often, and ..."""
_DELAYED_S: Final = 0.9 / HISTORY_HZ
"""... DELAYED, which may come with every frame."""
_COLUMNS: Final = ("at_s", "lead_s", "heave_m", "heave_std_m", "reference_m", "roll_deg", "pitch_deg")

_encode: Final = msgspec.json.Encoder().encode
_Row = tuple[float, float, float | None, float | None, float | None, float | None, float | None]


class Viewer:
    """One browser: what it has not been sent yet."""

    def __init__(self) -> None:
        self._frames: deque[bytes] = deque()
        self._newest: dict[str, bytes] = {}
        self._lost = 0
        self._news = asyncio.Event()

    def frame(self, text: bytes) -> None:
        """One frame; the oldest gives way if too many wait."""
        self._frames.append(text)
        if len(self._frames) > _MOST_FRAMES:
            self._frames.popleft()
            self._lost += 1
        self._news.set()

    def put(self, event: str, text: bytes) -> None:
        """What replaces whatever waits of its kind."""
        self._newest[event] = text
        self._news.set()

    async def wait(self, timeout_s: float) -> None:
        """Until there is something to send, or in any case for so long."""
        with suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                await self._news.wait()

    def take(self, now_s: float) -> bytes:
        """All that waits, as events, and at first the time."""
        self._news.clear()
        events = [_event("clock", b'{"sent_s":%.6f}' % now_s)]
        events += [_event(name, text) for name, text in self._newest.items()]
        self._newest.clear()
        if self._frames:
            frames = b'{"lost":%d,"frames":[%b]}' % (self._lost, b",".join(self._frames))
            events.append(_event("motion", frames))
            self._frames.clear()
            self._lost = 0
        return b"".join(events)


class Hub:
    """Hears what the stream says and tells it to the viewers.

    Attributes:
        viewers: those that are told.
    """

    def __init__(self, page_id: str, clock: Callable[[], float]) -> None:
        """``page_id``: changes when the files of the page do, so that a browser can load them anew."""
        self.viewers: set[Viewer] = set()
        self._page_id = page_id
        self._clock = clock
        self._link = b""
        self._rows: deque[_Row] = deque(maxlen=_MOST_ROWS)
        self._newest: dict[str, bytes] = {}
        self._divergence = DivergenceMeter()
        self._divergence_due_s = self._delayed_due_s = 0.0

    def join(self) -> Viewer:
        """A browser that is told from now on; what is known waits for it already."""
        viewer = Viewer()
        if self._link:
            viewer.put("link", self._link)
        viewer.put("history", self._history())
        for event, text in self._newest.items():
            viewer.put(event, text)
        self.viewers.add(viewer)
        return viewer

    def leave(self, viewer: Viewer) -> None:
        """It is told no more."""
        self.viewers.discard(viewer)

    def link(self, link: Link) -> None:
        """The connection has come up or is lost: nothing that was said before counts as known."""
        self._newest.clear()
        self._divergence = DivergenceMeter()
        self._link = _encode({"page": self._page_id, **msgspec.to_builtins(link)})
        for viewer in self.viewers:
            viewer.put("link", self._link)

    def hear(self, record: Known, line: bytes, at_s: float) -> None:
        """One record of the stream."""
        now_s = self._clock()
        if isinstance(record, MotionRecord):
            self._hear_motion(record, line, at_s)
        elif isinstance(record, DelayedRecord):
            self._divergence.delayed(at_s, record.heave_m, record.std_m)
            if now_s >= self._delayed_due_s:
                self._delayed_due_s = now_s + _DELAYED_S
                self._tell("delayed", b'{"at_s":%.6f,"record":%b}' % (at_s, line))
            if now_s >= self._divergence_due_s and (found := self._divergence.result()) is not None:
                self._divergence_due_s = now_s + _SLOWER_S
                self._tell("divergence", _encode(found))
        else:
            name = str(record.__struct_config__.tag).lower()
            self._tell(name, b'{"read_s":%.6f,"record":%b}' % (at_s, line))

    def _hear_motion(self, motion: MotionRecord, line: bytes, at_s: float) -> None:
        lead_s = motion.compensation_lead_s or 0.0
        heave_m = None if motion.quality.heave is HeaveState.INVALID else motion.heave_m
        if not self._rows or at_s - self._rows[-1][0] >= 0.9 / HISTORY_HZ:
            self._rows.append((
                round(at_s, 3), lead_s, heave_m, motion.heave_std_m, motion.reference_m,
                motion.roll_deg, motion.pitch_deg,
            ))  # fmt: skip
        is_usable = motion.quality.heave in (HeaveState.VALID, HeaveState.DEGRADED)
        if is_usable and motion.heave_m is not None and motion.heave_std_m is not None:
            self._divergence.said(at_s + lead_s, motion.heave_m, motion.heave_std_m)
        text = b'{"at_s":%.6f,"record":%b}' % (at_s, line)
        for viewer in self.viewers:
            viewer.frame(text)

    def _tell(self, event: str, text: bytes) -> None:
        self._newest[event] = text
        for viewer in self.viewers:
            viewer.put(event, text)

    def _history(self) -> bytes:
        columns = zip(*self._rows, strict=True) if self._rows else ((),) * len(_COLUMNS)
        return _encode(dict(zip(_COLUMNS, columns, strict=True)))


def _event(name: str, text: bytes) -> bytes:
    return b"event: %b\ndata: %b\n\n" % (name.encode(), text)

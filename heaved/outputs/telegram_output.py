"""One ``[[output]]``: of the frames that come, those that are due, as telegrams of its format, over its link."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from heaved.links import AnyLink, SerialLink, TcpLink, TcpListenLink, UdpLink, parse_any_link
from heaved.outputs.due_times import DueTimes
from heaved.outputs.motion import motion_at
from heaved.outputs.output import OutputHealth
from heaved.outputs.senders.sender import DOWN
from heaved.outputs.senders.serial_line import SerialSender
from heaved.outputs.senders.tcp import TcpSender
from heaved.outputs.senders.tcp_listen import TcpListenSender
from heaved.outputs.senders.udp import UdpSender
from heaved.outputs.telegrams.spec import Format, OutputSpec, as_read

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.outputs.senders.sender import Sender
    from heaved.samples import MotionFrame

SCHEMES: Final = ("udp", "tcp", "tcp-listen", "serial")
"""Of the links of an output."""
NOT_KNOWN: Final = "not known"
"""Why a message is lost: its format has no way to say that the motion is not known."""


class TelegramOutput:
    """See :class:`heaved.outputs.output.Output`.

    Attributes:
        health: how it fares.
    """

    def __init__(
        self, spec: OutputSpec, form: Format, utc_s: Callable[[float], float], clock: Callable[[], float]
    ) -> None:
        """``form``: of ``spec.telegram``. ``utc_s``: UTC, seconds since 1970, of a time on ``clock``, the monotonic
        clock of the frames.

        Raises:
            ValueError: the link cannot be read, or a network of ``spec.allow`` is none.
        """
        link = parse_any_link(spec.link, SCHEMES)
        self.health = OutputHealth(spec.name, form.title, str(link))
        self._spec, self._form, self._utc_s, self._clock = spec, form, utc_s, clock
        self._lead = spec.lead or form.lead
        self._due = DueTimes(spec.rate_hz)
        self._sender = _sender(link, spec, self.health)

    def publish(self, frame: MotionFrame) -> None:
        """Send a telegram, if one is due and somebody may read it."""
        if not self._due.is_due(frame.t_s):
            return
        if not self._sender.has_reader:
            if not self.health.is_up:
                self.health.lost[DOWN] += 1
            return
        motion = motion_at(frame, self._spec.point, self._lead, self._clock(), self._utc_s)
        telegram = self._form.encode(as_read(motion, self._spec, self._form.signs), self._spec)
        if telegram:
            self._sender.send(telegram)
        else:
            self.health.lost[NOT_KNOWN] += 1

    async def run(self) -> None:
        """Keep its link open."""
        await self._sender.run()


def _sender(link: AnyLink, spec: OutputSpec, health: OutputHealth) -> Sender:
    if isinstance(link, SerialLink):
        return SerialSender(link, health)
    if isinstance(link, TcpLink):
        return TcpSender(link, health)
    if isinstance(link, TcpListenLink):
        return TcpListenSender(link, health, spec.allow)
    assert isinstance(link, UdpLink)  # The scheme of nothing else.
    return UdpSender(link, health)

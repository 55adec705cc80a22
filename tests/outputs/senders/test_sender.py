"""Why nothing goes out, in words that say what to do."""

from __future__ import annotations

import errno
import os
import socket
from itertools import accumulate, repeat

import pytest

from heaved.links import AnyLink, SerialLink, TcpLink, TcpListenLink, UdpLink
from heaved.outputs.senders.sender import FIRST_PAUSE_S, LONGEST_PAUSE_S, explain, longer

TCP, UDP, TTY = TcpLink("10.0.0.9", 5000), UdpLink("plc.ship", 5000), SerialLink("/dev/ttyUSB2")


def error_of(number: int) -> OSError:
    return OSError(number, os.strerror(number))


CAUSES: list[tuple[AnyLink, BaseException, str]] = [
    (TCP, error_of(errno.ECONNREFUSED), "nobody reads tcp://10.0.0.9:5000, the machine is there: start the program"),
    (TCP, error_of(errno.ECONNRESET), "tcp://10.0.0.9:5000 has ended the connection (Connection reset by peer)"),
    (TCP, error_of(errno.EPIPE), "tcp://10.0.0.9:5000 has ended the connection (Broken pipe)"),
    (TCP, TimeoutError(), "nobody answers at tcp://10.0.0.9:5000: check power, cable, address"),
    (TCP, error_of(errno.ETIMEDOUT), "nobody answers at tcp://10.0.0.9:5000: check power, cable, address"),
    (UDP, error_of(errno.EPERM), "does not let us send to udp://plc.ship:5000: allow its network"),
    (UDP, error_of(errno.ENETUNREACH), "(udp://plc.ship:5000)"),
    (UDP, socket.gaierror(socket.EAI_NONAME, "unknown"), "host name plc.ship is unknown"),
    (UDP, socket.gaierror(socket.EAI_AGAIN, "away"), "no name server answers"),
    (TcpListenLink("10.0.0.1", 5000), error_of(errno.ETIMEDOUT), "nobody answers at tcp-listen://10.0.0.1:5000"),
    (TCP, error_of(errno.EMFILE), "no file descriptor is left"),
    (TTY, error_of(errno.ENOENT), "/dev/ttyUSB2 is not there: plug the adapter in"),
    (TTY, error_of(errno.EACCES), "add the daemon's user to the port's group"),
    (TTY, error_of(errno.EAGAIN), "in use by another program"),
    (TTY, ValueError("Invalid baud rate"), "cannot be opened (Invalid baud rate): check the link's settings"),
]


@pytest.mark.parametrize(("link", "error", "said"), CAUSES)
def test_every_cause_has_its_words(link: AnyLink, error: BaseException, said: str) -> None:
    assert said in explain(link, error)


def test_it_is_tried_for_ever_and_at_least_every_two_seconds() -> None:
    pauses_s = list(accumulate(repeat(None, 100), lambda pause_s, _: longer(pause_s), initial=FIRST_PAUSE_S))
    assert pauses_s == sorted(pauses_s)
    assert pauses_s[-1] == LONGEST_PAUSE_S <= 2.0

"""A TCP connection whose far end has gone without a word is noticed although nothing is sent."""

from __future__ import annotations

import socket


def keep_alive(connection: socket.socket, *, idle_s: int, probe_s: int, probes: int = 3) -> None:
    """Ask the far end after ``idle_s`` of silence whether it is there, each ``probe_s``; that many times unheard, the
    connection fails.
    """
    for option, value in ((socket.TCP_KEEPIDLE, idle_s), (socket.TCP_KEEPINTVL, probe_s), (socket.TCP_KEEPCNT, probes)):
        connection.setsockopt(socket.IPPROTO_TCP, option, value)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)

"""What the system is told of a connection, asked of the system."""

from __future__ import annotations

import socket

from heaved.keep_alive import keep_alive


def test_the_system_asks_whether_the_far_end_is_there() -> None:
    with socket.socket() as connection:
        assert not connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        keep_alive(connection, idle_s=17, probe_s=4, probes=2)
        assert connection.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE)
        of_tcp = (socket.TCP_KEEPIDLE, socket.TCP_KEEPINTVL, socket.TCP_KEEPCNT)
        assert [connection.getsockopt(socket.IPPROTO_TCP, option) for option in of_tcp] == [17, 4, 2]

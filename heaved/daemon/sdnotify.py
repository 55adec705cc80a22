"""The service manager's notification socket, after sd_notify(3): newline-separated assignments in one datagram."""

from __future__ import annotations

import os
import socket
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


class Notifier:
    """Tells systemd how the service is. Without a socket (started by hand) every call does nothing.

    Attributes:
        watchdog_s: within this time ``WATCHDOG=1`` is expected again and again; None when nobody watches.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        # A leading @ stands for the NUL byte of Linux's abstract name space.
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) if address else None
        if self._socket is not None:
            self._socket.setblocking(False)  # A hung service manager must not hang the loop.
        watched = environment.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())
        usec = environment.get("WATCHDOG_USEC", "")
        self.watchdog_s = int(usec) / 1e6 if self._socket and watched and usec.isdigit() and int(usec) else None

    def notify(self, *assignments: str) -> bool:
        """Send e.g. ``"READY=1", "STATUS=polling"``; False when there is no one to take it."""
        if self._socket is None:
            return False
        try:
            self._socket.sendto("\n".join(assignments).encode(), self._address)
        except OSError:
            return False  # Nobody listens (any more): there is no better place to say so, and nothing to do about it.
        return True

    def close(self) -> None:
        """Nothing more is told."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

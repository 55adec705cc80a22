"""A serial port on the event loop: what comes is handed on, what cannot go out at once is thrown away."""

from __future__ import annotations

import asyncio
import os
import termios
from contextlib import suppress
from typing import TYPE_CHECKING, Final

import serial

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.links import SerialLink

_READ_BYTES: Final = 512
"""Taken at a time: whoever floods the line has the loop for no longer than that."""


def open_serial(link: SerialLink) -> serial.Serial:
    """The port, held exclusively; its descriptor does not block. Keeps the caller for a moment.

    Raises:
        OSError: it is not there, in use, or refuses its settings.
    """
    try:
        port = serial.Serial(
            link.path,
            baudrate=link.baudrate,
            bytesize=link.bytesize,
            parity=link.parity,
            stopbits=link.stopbits,
            timeout=0,
            write_timeout=0,
            exclusive=True,
        )
    except (termios.error, ValueError) as error:  # Neither is an OSError: the port refuses its settings.
        raise OSError(f"{error}") from error
    os.set_blocking(port.fileno(), False)
    with suppress(ValueError, OSError):  # What pyserial raises where the port has no such mode: a pty.
        # USB adapters otherwise hold bytes back for up to 16 ms.
        port.set_low_latency_mode(True)
    return port


def close_serial(port: serial.Serial) -> None:
    """Give it back; what has not gone out is thrown away, since ``close`` would wait for it up to half a minute."""
    with suppress(OSError, termios.error):  # It may be gone.
        termios.tcflush(port.fileno(), termios.TCOFLUSH)
    port.close()


class SerialPort:
    """One port, held exclusively while it is open."""

    def __init__(self, link: SerialLink, heard: Callable[[bytes], None], lost: Callable[[str], None]) -> None:
        """``heard``: takes what comes. ``lost``: told once, with the reason, when the port has gone and is closed."""
        self._link, self._heard, self._lost = link, heard, lost
        self._port: serial.Serial | None = None
        self._fd = -1

    def open(self) -> None:
        """Take it, which keeps the loop for a moment.

        Raises:
            OSError: it is not there, in use, or refuses its settings.
        """
        self._port = open_serial(self._link)
        self._fd = self._port.fileno()
        asyncio.get_running_loop().add_reader(self._fd, self._readable)

    def write(self, data: bytes) -> bool:
        """Whether all of it went out: a line does not wait, and half a frame is none."""
        try:
            return self._fd >= 0 and os.write(self._fd, data) == len(data)
        except BlockingIOError:
            return False
        except OSError as error:
            self._gone(error.strerror or str(error))
            return False

    def close(self) -> None:
        """Give it back."""
        if self._port is not None:
            asyncio.get_running_loop().remove_reader(self._fd)
            self._fd = -1
            close_serial(self._port)
            self._port = None

    def _readable(self) -> None:
        try:
            data = os.read(self._fd, _READ_BYTES)
        except BlockingIOError:
            return
        except OSError as error:
            self._gone(error.strerror or str(error))
            return
        if data:
            self._heard(data)
        else:
            self._gone("it was hung up")

    def _gone(self, reason: str) -> None:
        self.close()
        self._lost(reason)

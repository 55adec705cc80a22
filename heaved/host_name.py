"""Host names of links to addresses, without holding anything up: a name server that is away takes the C library up to
half a minute, and each look-up a thread. So they have threads of their own: files and servers need those of the event
loop.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Final

MOST_ADDRESSES: Final = 4
"""Tried for one name."""

_THREADS: Final = ThreadPoolExecutor(16, "look up")


class HostName:
    """A host, looked up once at a time however often it is asked for."""

    def __init__(self, host: str) -> None:
        self._host = host
        self._looking: asyncio.Task[list[str]] | None = None

    async def addresses(self, timeout_s: float) -> list[str]:
        """IP addresses, the best first. The host may be one itself.

        Raises:
            socket.gaierror: it has none, or no name server has said so in time (EAI_AGAIN).
        """
        try:
            ipaddress.ip_address(self._host)
        except ValueError:
            pass
        else:
            return [self._host]
        if self._looking is None:
            self._looking = asyncio.create_task(_look_up(self._host), name=f"look up {self._host}")
        done, _ = await asyncio.wait([self._looking], timeout=timeout_s)
        if not done:
            raise socket.gaierror(socket.EAI_AGAIN, f"no answer within {timeout_s:g} s")
        found, self._looking = self._looking, None
        return found.result()


async def _look_up(host: str) -> list[str]:
    ask = partial(socket.getaddrinfo, host, None, type=socket.SOCK_STREAM)
    found = await asyncio.get_running_loop().run_in_executor(_THREADS, ask)
    return list(dict.fromkeys(str(entry[4][0]) for entry in found))[:MOST_ADDRESSES]

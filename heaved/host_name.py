"""Host names of links to addresses, without holding anything up: a name server that is away takes the C library up to
half a minute, and each look-up a thread. So each has one of its own: files and servers need those of the event loop,
and the end of the process waits for those.
"""

from __future__ import annotations

import asyncio
import ipaddress
import socket
import threading
from contextlib import suppress
from typing import Final

MOST_ADDRESSES: Final = 4
"""Tried for one name."""


class HostName:
    """A host, looked up once at a time however often it is asked for."""

    def __init__(self, host: str) -> None:
        self._host = host
        self._looking: asyncio.Task[list[str] | OSError] | None = None

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
        found, self._looking = self._looking.result(), None
        if isinstance(found, OSError):
            raise found
        return found


async def _look_up(host: str) -> list[str] | OSError:
    loop = asyncio.get_running_loop()
    answer: asyncio.Future[list[str] | OSError] = loop.create_future()

    def tell(found: list[str] | OSError) -> None:
        if not answer.done():
            answer.set_result(found)

    def ask() -> None:
        found = _addresses(host)
        with suppress(RuntimeError):  # The loop has ended.
            loop.call_soon_threadsafe(tell, found)

    threading.Thread(target=ask, name=f"look up {host}", daemon=True).start()
    return await answer


def _addresses(host: str) -> list[str] | OSError:
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except OSError as error:
        return error
    except UnicodeError as error:  # What no host can be called.
        return socket.gaierror(socket.EAI_NONAME, str(error))
    return list(dict.fromkeys(str(entry[4][0]) for entry in found))[:MOST_ADDRESSES]

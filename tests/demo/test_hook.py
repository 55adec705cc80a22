"""The client that drives the simulated winch, without a daemon."""

from __future__ import annotations

import socket
import time
from itertools import count
from typing import TYPE_CHECKING

from heaved.demo.hook import follow
from heaved.simulate.seaway import seaway

if TYPE_CHECKING:
    from collections.abc import Callable


def ends_after(times: int) -> Callable[[], bool]:
    calls = count()
    return lambda: next(calls) >= times


def test_without_a_daemon_it_waits_until_it_is_told_to_end() -> None:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
    said: list[str] = []
    follow("127.0.0.1", port, seaway("T3"), time.monotonic(), said.append, ends_after(30))
    assert said == []


def test_what_is_no_daemon_is_left_alone() -> None:
    """It accepts connections and says nothing of a stream."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        said: list[str] = []
        host, port = listener.getsockname()
        follow(host, port, seaway("T3"), time.monotonic(), said.append, ends_after(5))
    assert said == []

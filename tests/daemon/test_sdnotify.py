"""The notification protocol, against a socket of the test's own in the place of systemd's."""

from __future__ import annotations

import os
import socket
from contextlib import closing
from typing import TYPE_CHECKING

import pytest

from heaved.daemon.sdnotify import Notifier

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

Manager = tuple[str, socket.socket]
"""What NOTIFY_SOCKET says, and the socket of the service manager."""


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Manager]:
    """(what NOTIFY_SOCKET says, the socket of the service manager)."""
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as receiver:
        if request.param == "path":
            name = bound = str(tmp_path / "notify")
        else:
            name, bound = f"@heaved-test-{os.getpid()}", f"\0heaved-test-{os.getpid()}"
        receiver.bind(bound)
        receiver.settimeout(5.0)
        yield name, receiver


def test_one_datagram_with_a_line_for_each_assignment(manager: Manager) -> None:
    name, receiver = manager
    with closing(Notifier({"NOTIFY_SOCKET": name})) as notifier:
        assert notifier.notify("READY=1", "STATUS=heave valid ± 0.1 m")
        assert receiver.recv(1000) == "READY=1\nSTATUS=heave valid ± 0.1 m".encode()
        assert notifier.notify("STOPPING=1")
        assert receiver.recv(1000) == b"STOPPING=1"


def test_started_by_hand_nothing_happens() -> None:
    with closing(Notifier({})) as notifier:
        assert notifier.watchdog_s is None
        assert not notifier.notify("READY=1")


def test_a_service_manager_that_does_not_read_hangs_nobody(manager: Manager) -> None:
    name, _ = manager
    with closing(Notifier({"NOTIFY_SOCKET": name})) as notifier:
        sent = [notifier.notify("STATUS=" + "x" * 1000) for _ in range(5000)]
    assert sent[0]
    assert not sent[-1]


def test_a_service_manager_that_is_gone_is_no_error(tmp_path: Path) -> None:
    with closing(Notifier({"NOTIFY_SOCKET": str(tmp_path / "gone")})) as notifier:
        assert not notifier.notify("WATCHDOG=1")


@pytest.mark.parametrize(
    ("environment", "seconds"),
    [
        ({"WATCHDOG_USEC": "5000000"}, 5.0),
        ({"WATCHDOG_USEC": "5000000", "WATCHDOG_PID": str(os.getpid())}, 5.0),
        ({"WATCHDOG_USEC": "5000000", "WATCHDOG_PID": str(os.getppid())}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "soon"}, None),
        ({}, None),
    ],
)
def test_watchdog_of_this_process_alone(environment: dict[str, str], seconds: float | None) -> None:
    with closing(Notifier({"NOTIFY_SOCKET": "/nowhere", **environment})) as notifier:
        assert notifier.watchdog_s == seconds

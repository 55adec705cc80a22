"""Before numpy is loaded: one BLAS thread, as the daemon runs. And which tests may run side by side, with ``-n 3``."""

from __future__ import annotations

import logging
import os
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import pytest
import structlog
from hypothesis import settings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from xdist.scheduler import LoadScopeScheduling

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

settings.register_profile("heaved", deadline=None, derandomize=True)  # No clock decides, and no luck.
settings.load_profile("heaved")

pytest_plugins = ("served",)


@pytest.fixture(autouse=True)
def events_where_they_were() -> Iterator[None]:
    """A command that a test ran in this process has sent events to a standard error that is gone afterwards."""
    root = logging.getLogger()
    before = root.level
    yield
    for handler in [one for one in root.handlers if type(one).__module__ == "heaved.daemon.logs"]:
        root.removeHandler(handler)
        root.setLevel(before)
        structlog.reset_defaults()


LIVE = {
    "sensors": ("daemon", "devices", "workers", "demo", "simulate/test_plant.py", "test_cli.py"),
    "readers": ("outputs", "client", "page", "recorder"),
}
"""Ports, serial lines, processes that answer in time: those of a room one after another. They wait more than they
compute, so that there may be two rooms on two cores.
"""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadScopeScheduling:
    """Live tests by their rooms, of the others each file in one process, because its tests share what is expensive."""
    from xdist.scheduler import LoadScopeScheduling

    class OneRoomEach(LoadScopeScheduling):  # type: ignore[misc]  # xdist comes without types
        def _split_scope(self, nodeid: str) -> str:
            file = PurePath(nodeid.split("::", maxsplit=1)[0])
            tests = PurePath("tests")
            rooms = [room for room, parts in LIVE.items() if any(file.is_relative_to(tests / part) for part in parts)]
            return rooms[0] if rooms else str(file)

    return OneRoomEach(config, log)

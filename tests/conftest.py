"""Before numpy is loaded: one BLAS thread, as the daemon runs. And which tests may run side by side, with ``-n 2``."""

from __future__ import annotations

import os
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from xdist.scheduler import LoadScopeScheduling

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

settings.register_profile("heaved", deadline=None, derandomize=True)  # No clock decides, and no luck.
settings.load_profile("heaved")

pytest_plugins = ("served",)

LIVE = (
    "daemon",
    "devices",
    "outputs",
    "client",
    "page",
    "workers",
    "demo",
    "simulate/test_plant.py",
    "test_cli.py",
)
"""Ports, serial lines, processes that answer in time: one after another, as on a machine of their own."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> LoadScopeScheduling:
    """All live tests in one process; of the others each file in one, because its tests share what is expensive."""
    from xdist.scheduler import LoadScopeScheduling

    class OneRoomEach(LoadScopeScheduling):  # type: ignore[misc]  # xdist comes without types
        def _split_scope(self, nodeid: str) -> str:
            file = PurePath(nodeid.split("::", maxsplit=1)[0])
            return "live" if any(file.is_relative_to(PurePath("tests", part)) for part in LIVE) else str(file)

    return OneRoomEach(config, log)

"""What is worked out beside the daemon, and where: one row for each kind of work."""

from __future__ import annotations

import sys
from typing import Final, Generic, Protocol, TypeVar

import msgspec

from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow
from heaved.samples import TrainedNetwork, TrainingWindow
from heaved.workers.refit_hull import HullFit, HullJob


class Numbered(Protocol):
    """What is sent to a worker, and what comes back: both carry the number of the request."""

    @property
    def number(self) -> int:
        """Of the request."""


Request = TypeVar("Request", bound=msgspec.Struct)
Result = TypeVar("Result", bound=msgspec.Struct)


class Job(msgspec.Struct, Generic[Request, Result], frozen=True, kw_only=True):
    """A kind of work, which a process of its own does."""

    name: str
    """Of its worker, for people."""
    command: tuple[str, ...]
    request: type[Request]
    """Records that are sent; each has a number."""
    result: type[Result]
    """Records that come back, with the number of their request."""
    waits_for_work: bool = False
    """The process starts with its first request: it takes much memory, and there may never be one."""


def _module(name: str) -> tuple[str, ...]:
    return (sys.executable, "-m", f"heaved.workers.{name}")


TRAINING: Final = Job(
    name="trainer",
    command=_module("train_correction"),
    request=TrainingWindow,
    result=TrainedNetwork,
    waits_for_work=True,
)
SEA_FIT: Final = Job(name="fitter", command=_module("fit_sea"), request=SeaWindow, result=SeaFit)
HULL_REFIT: Final = Job(name="hull fitter", command=_module("refit_hull"), request=HullJob, result=HullFit)

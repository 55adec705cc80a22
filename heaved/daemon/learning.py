"""The processes that learn for the daemon: which of them run, what they are given, what becomes of their answers."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any, Final

import structlog

from heaved.config import Config
from heaved.daemon.acquisition import Acquisition
from heaved.daemon.metrics import Metrics
from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow
from heaved.estimation.hull.refit import RefitJob
from heaved.samples import TrainedNetwork, TrainingWindow
from heaved.workers import refit_hull as hull_fitter
from heaved.workers.process import FITTER, HULL_FITTER, TRAINER, Worker
from heaved.workers.refit_hull import HullFit

TRAINING: Final = "trainer"
FITTING: Final = "fitter"
HULL_FITTING: Final = "hull fitter"

_log = structlog.get_logger(__name__)


class Workers:
    """A trainer runs when there is something to learn, a fitter when there is a sea to fit, one more when there is a
    hull, and only then: they take memory. A job for one that does not run is let go.

    Attributes:
        running: by name.
    """

    def __init__(self, acquisition: Callable[[], Acquisition], metrics: Metrics) -> None:
        """``acquisition``: what takes the answers, asked for when there is one."""
        self.running: dict[str, Worker[Any]] = {}
        self._acquisition = acquisition
        self._metrics = metrics
        self._hull_jobs = 0
        self._troubles: dict[str, str] = {}

    async def have(self, config: Config) -> None:
        """Start and stop what ``config`` asks for."""
        for name, is_wanted in (
            (TRAINING, config.correction.enabled and config.has_laser),
            (FITTING, config.heave.observer == "sea"),
            (HULL_FITTING, config.hull.enabled and config.hull.refit_after_s > 0.0),
        ):
            if is_wanted and name not in self.running:
                self.running[name] = self._made(name)
                await self.running[name].start()
            elif not is_wanted and name in self.running:
                await self.running.pop(name).stop()

    def stopping(self) -> dict[str, Awaitable[object]]:
        """The end of each, to be awaited, by name."""
        return {name: worker.stop() for name, worker in self.running.items()}

    def train(self, window: TrainingWindow) -> None:
        self._submit(TRAINING, window)

    def fit(self, window: SeaWindow) -> None:
        self._submit(FITTING, window)

    def refit(self, job: RefitJob) -> None:
        if HULL_FITTING in self.running:
            self._hull_jobs += 1
            self._submit(HULL_FITTING, hull_fitter.pack(self._hull_jobs, job))

    def _submit(self, name: str, job: TrainingWindow | SeaWindow | hull_fitter.HullJob) -> None:
        if (worker := self.running.get(name)) is not None:
            worker.submit(job)

    def _made(self, name: str) -> Worker[Any]:
        failed = partial(self._failed, name)
        if name == TRAINING:
            return Worker(name, TrainedNetwork, self._trained, failed, command=TRAINER)
        if name == FITTING:
            return Worker(name, SeaFit, self._fitted, failed, command=FITTER)
        return Worker(name, HullFit, self._refitted, failed, command=HULL_FITTER)

    def _trained(self, network: TrainedNetwork) -> None:
        self._works_again(TRAINING)
        self._acquisition().accept(network)

    def _fitted(self, fit: SeaFit) -> None:
        self._works_again(FITTING)
        self._acquisition().accept_fit(fit)

    def _refitted(self, fit: HullFit) -> None:
        self._works_again(HULL_FITTING)
        if fit.number == self._hull_jobs:  # Else it is the answer to a job of an earlier configuration.
            self._acquisition().accept_refit(hull_fitter.unpack(fit))

    def _works_again(self, name: str) -> None:
        if self._troubles.pop(name, ""):
            _log.info(f"the {name} works again")

    def _failed(self, name: str, reason: str) -> None:
        if name == HULL_FITTING:
            self._acquisition().accept_refit(None)
        else:
            runs = self._metrics.training_runs if name == TRAINING else self._metrics.sea_fits
            runs.labels("failed").inc()
        trouble = reason.split(";")[0]  # Without the growing pause before the next start.
        if trouble != self._troubles.get(name):
            self._troubles[name] = trouble
            _log.warning(f"the {name} has failed: the stream goes on with what was learned", reason=reason)

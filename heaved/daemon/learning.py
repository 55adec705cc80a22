"""The processes that learn for the daemon: which of them run, what they are given, what becomes of their answers."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import structlog

from heaved.estimation.heave.observer import Verdict
from heaved.workers import refit_hull as hull_fitter
from heaved.workers.jobs import HULL_REFIT, SEA_FIT, TRAINING, Job, Request
from heaved.workers.process import Worker

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from heaved.config import Config
    from heaved.daemon.acquisition import Acquisition
    from heaved.daemon.metrics import Metrics
    from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow
    from heaved.estimation.hull.refit import RefitJob
    from heaved.samples import TrainedNetwork, TrainingWindow
    from heaved.workers.refit_hull import HullFit

_log = structlog.get_logger(__name__)


class Workers:
    """A trainer serves when there is a laser, and starts with the first window that is worth it; a fitter runs when
    there is a sea to fit, one more when there is a hull, and only then: they take memory. What is for one that does not
    run is let go.

    Attributes:
        running: by name.
    """

    def __init__(self, acquisition: Callable[[], Acquisition], metrics: Metrics) -> None:
        """``acquisition``: what takes the answers, asked for when there is one."""
        self.running: dict[str, Worker[Any, Any]] = {}
        self._acquisition = acquisition
        self._metrics = metrics
        self._hull_jobs = 0
        self._troubles: dict[str, str] = {}

    async def have(self, config: Config) -> None:
        """Start and stop what ``config`` asks for."""
        jobs: tuple[tuple[Job[Any, Any], Callable[[Any], None], bool], ...] = (
            (TRAINING, self._trained, config.correction.enabled and config.has_laser),
            (SEA_FIT, self._fitted, config.heave.observer == "sea"),
            (HULL_REFIT, self._refitted, config.hull.enabled and config.hull.refit_after_s > 0.0),
        )
        for job, on_result, is_wanted in jobs:
            if is_wanted and job.name not in self.running:
                self.running[job.name] = Worker(job, on_result, partial(self._failed, job))
                await self.running[job.name].start()
            elif not is_wanted and job.name in self.running:
                await self.running.pop(job.name).stop()

    def stopping(self) -> dict[str, Awaitable[object]]:
        """The end of each, to be awaited, by name."""
        return {name: worker.stop() for name, worker in self.running.items()}

    def train(self, window: TrainingWindow) -> None:
        """Hand a window to the trainer."""
        self._submit(TRAINING, window)

    def fit(self, window: SeaWindow) -> None:
        """Hand the past to the fitter of the sea."""
        self._submit(SEA_FIT, window)

    def refit(self, job: RefitJob) -> None:
        """Hand a job to the fitter of the hull's flexure."""
        if HULL_REFIT.name in self.running:
            self._hull_jobs += 1
            self._submit(HULL_REFIT, hull_fitter.pack(self._hull_jobs, job))

    def _submit(self, job: Job[Request, Any], request: Request) -> None:
        if (worker := self.running.get(job.name)) is not None:
            worker.submit(request)

    def _trained(self, network: TrainedNetwork) -> None:
        self._works_again(TRAINING)
        self._acquisition().accept(network)

    def _fitted(self, fit: SeaFit) -> None:
        self._works_again(SEA_FIT)
        self._acquisition().accept_fit(fit)

    def _refitted(self, fit: HullFit) -> None:
        self._works_again(HULL_REFIT)
        if fit.number == self._hull_jobs:  # Else it is the answer to a job of an earlier configuration.
            self._acquisition().accept_refit(hull_fitter.unpack(fit))

    def _works_again(self, job: Job[Any, Any]) -> None:
        if self._troubles.pop(job.name, ""):
            _log.info(f"the {job.name} works again")

    def _failed(self, job: Job[Any, Any], reason: str) -> None:
        if job is HULL_REFIT:
            self._acquisition().accept_refit(None)
        else:
            runs = self._metrics.training_runs if job is TRAINING else self._metrics.sea_fits
            runs.labels(Verdict.FAILED).inc()
        trouble = reason.partition(";")[0]  # Without the growing pause before the next start.
        if trouble != self._troubles.get(job.name):
            self._troubles[job.name] = trouble
            _log.warning(f"the {job.name} has failed: the stream goes on with what was learned", reason=reason)

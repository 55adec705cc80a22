"""From a poll to a published frame, on the event loop: the daemon's hot path, and its heartbeat when no poll comes."""

from __future__ import annotations

import time
from math import inf, isfinite, nan
from typing import TYPE_CHECKING

import structlog

from heaved.daemon.device_health import DeviceHealth, RateMeter
from heaved.estimation.heave.observer import Verdict
from heaved.samples import Fault, ImuSample, MotionFrame, RockScore, Sample, TrainedNetwork, TrainingWindow

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.daemon.metrics import DeviceMetrics, Metrics
    from heaved.daemon.recording import Journal
    from heaved.devices.bus import PollResult
    from heaved.devices.profile import DeviceSpec
    from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow
    from heaved.estimation.hull.refit import RefitJob, RefitResult
    from heaved.pipeline import Pipeline

IDLE_RATE_HZ = 10.0
"""Frames a second without any IMU: a consumer then still sees that the daemon is alive and the heave is not."""
_MISSING_PERIODS = 1.5
"""A frame that is so late is replaced by an extrapolated one; ordinary jitter stays far below half a period."""
_HELD_UP_PERIODS = 0.5
"""A heartbeat that is so late itself shows that the loop was held up, and the poll with it: its sample follows."""
_EXCUSED_PERIODS = 10.0
"""Silence for which that is an excuse, and no longer: the stream runs on a machine that is always late, too."""

_log = structlog.get_logger(__name__)


class Acquisition:
    """Steps the pipeline with every poll and publishes what comes of it. Nothing here waits, nothing raises.

    The stream runs at the IMU's rate whatever happens: :meth:`heartbeat`, called once a period while no sample comes,
    fills in. Its times of validity increase strictly; a frame that comes after its replacement was published is not
    published again.

    Attributes:
        pipeline: may be replaced at any time.
        health: of each device, by name.
        last_frame: the last one published, or None.
        frames: published since the start.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        *,
        metrics: Metrics,
        publish: Callable[[MotionFrame], None],
        train: Callable[[TrainingWindow], None],
        fit: Callable[[SeaWindow], None],
        refit: Callable[[RefitJob], None] = lambda _job: None,
        publish_stages: Callable[[], None] = lambda: None,
        alive: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
        journal: Journal | None = None,
    ) -> None:
        """``publish``, ``train``, ``fit`` and ``refit`` must only hand over, ``publish_stages`` looks after each poll
        for what the stages have to say, ``alive`` is told of each that shows the IMU alive; ``clock`` is that of the
        samples. ``journal`` is told each call into the pipeline, in order.
        """
        self.pipeline = pipeline
        self.health: dict[str, DeviceHealth] = {}
        self.last_frame: MotionFrame | None = None
        self.frames = 0
        self.period_s = 1.0 / IDLE_RATE_HZ
        self.trainings = 0
        """Finished since the start, with any result and any pipeline."""
        self.last_training = ""
        self.accepted_s = nan
        """When the network in use was accepted."""
        self.last_fit = ""
        self.fitted_s = nan
        """When the sea model in use was accepted."""
        self._metrics = metrics
        self._device_metrics: dict[str, DeviceMetrics] = {}
        self._publish = publish
        self._train = train
        self._fit = fit
        self._refit = refit
        self._publish_stages = publish_stages
        self._alive = alive
        self._refit_job: RefitJob | None = None
        """Of the hull, under way."""
        self._clock = clock
        self._journal = journal
        self._rate = RateMeter()
        self._published_s = -inf
        """Validity of the last frame."""
        self._live_s = -inf
        """When the IMU last gave a sample."""
        self._held_up_s = -inf
        """When a heartbeat was last late itself."""
        self._lag_s = 0.0
        """From the validity of an IMU sample to its arrival, so that replacements fall where the frames would."""
        self._bugs: set[str] = set()

    def set_devices(self, devices: tuple[DeviceSpec, ...]) -> None:
        """The devices that will be polled; what is known of those that stay is kept."""
        names = {device.name for device in devices}
        for name in self.health.keys() - names:
            del self.health[name]
            self._device_metrics.pop(name).set_up(False)
        for name in names - self.health.keys():
            self.health[name] = DeviceHealth(name)
            self._device_metrics[name] = self._metrics.device(name)
        self.period_s = 1.0 / next((device.rate_hz for device in devices if device.role == "imu"), IDLE_RATE_HZ)

    def rate_hz(self, now_s: float) -> float:
        """Frames a second, measured."""
        return self._rate.per_s(now_s)

    def rock_scores(self) -> tuple[RockScore, ...]:
        """How the attitude predictions have fared, of those axes and horizons that the last frame has."""
        made = {
            (axis, rock.horizon_s)
            for rock in (self.last_frame.rock if self.last_frame is not None else ())
            for axis, angle in (("roll", rock.roll_rad), ("pitch", rock.pitch_rad), ("yaw", rock.yaw_rad))
            if isfinite(angle)
        }
        return tuple(score for score in self.pipeline.rock_scores() if (score.axis, score.horizon_s) in made)

    def on_poll(self, result: PollResult) -> None:
        """What the buses call, once for each deadline of each device."""
        sample = result.sample
        started_s = self._clock()
        frame = self._step(sample)
        now_s = self._clock()
        if frame is not None:
            published = self._emit(frame, now_s, now_s - started_s)
            if result.fault is Fault.NONE:
                self._lag_s = now_s - sample.t_s
            # A timeout arrives long after its deadline, when its replacements are out already: it is no sign of life.
            if published or result.fault is Fault.NONE:
                self._live_s = now_s
                self._alive()
        # The frame is out: what nobody waits for.
        if self._journal is not None:
            self._journal.polled(result)
        self._publish_stages()
        self._account(result)
        self._offer_work()

    def heartbeat(self, lateness_s: float = 0.0) -> bool:
        """Called once a period: publish an extrapolated frame if the IMU's is missing. Returns whether it did.

        ``lateness_s``: of this call. Within a period of a late one nothing is missing: its sample would follow at once,
        and two frames for one period are no help to a machine that is busy.
        """
        started_s = self._clock()
        silent_periods = (started_s - self._live_s) / self.period_s
        if lateness_s > _HELD_UP_PERIODS * self.period_s:
            self._held_up_s = started_s
        is_excused = started_s - self._held_up_s < self.period_s and silent_periods < _EXCUSED_PERIODS
        if silent_periods < _MISSING_PERIODS or is_excused:
            return False
        t_s = started_s - self._lag_s
        frame = self._coast(t_s)
        if self._journal is not None:
            self._journal.coasted(t_s)
        now_s = self._clock()
        return frame is not None and self._emit(frame, now_s, now_s - started_s)

    def accept(self, network: TrainedNetwork) -> None:
        """Hand a training's result to the pipeline, which decides whether it is used."""
        if self._journal is not None:
            self._journal.network(network)
        try:
            result = self.pipeline.accept(network)
        except Exception as error:  # A bug in an estimator must not take the stream down.  # noqa: BLE001
            self._bug("accept", error)
            result = Verdict.FAILED
        self.trainings += 1
        self._metrics.training_runs.labels(result).inc()
        if result == Verdict.ACCEPTED:
            self.accepted_s = self._clock()
        if result != self.last_training:
            self.last_training = result
            detail = {"detail": network.message} if network.message else {}
            _log.info("training of the correction", result=result, seconds=network.seconds, **detail)

    def accept_fit(self, fit: SeaFit) -> None:
        """Hand a fit of the sea to the pipeline."""
        if self._journal is not None:
            self._journal.fit(fit)
        try:
            result = self.pipeline.accept_fit(fit)
        except Exception as error:  # Likewise.  # noqa: BLE001
            self._bug("accept_fit", error)
            result = Verdict.FAILED
        self._metrics.sea_fits.labels(result).inc()
        if result == Verdict.ACCEPTED:
            self.fitted_s = self._clock()
        if result != self.last_fit:
            self.last_fit = result
            _log.info("fit of the sea", result=result, **({"detail": fit.message} if fit.message else {}))

    def accept_refit(self, result: RefitResult | None) -> None:
        """Hand a refit of the hull's flexure to its stage, if that still waits for it; None: it came to nothing."""
        job, self._refit_job = self._refit_job, None
        if job is not None and self.pipeline.stages.due_refit is job:
            if self._journal is not None:
                self._journal.refit(is_made=result is not None)
            used = self.pipeline.stages.accept(result)
            _log.info("refit of the hull's flexure", result="accepted" if used else "of no use")

    # ---- within one poll ---------------------------------------------------------------------------------------------

    def _account(self, result: PollResult) -> None:
        health, metrics = self.health[result.device], self._device_metrics[result.device]
        metrics.record_poll(result.fault, result.duration_s)
        self._metrics.tick_lateness.observe(result.lateness_s)
        if result.reconnected:
            metrics.count_reconnect()
        was_up = health.up
        event = health.observe(self._clock(), result.fault, result.detail)
        if health.up is not was_up:
            metrics.set_up(health.up)
        if event is not None:
            log = _log.warning if event.level == "warning" else _log.info
            log(event.text, **event.fields)

    def _step(self, sample: Sample) -> MotionFrame | None:
        try:
            return self.pipeline.step(sample)
        except Exception as error:  # Likewise.  # noqa: BLE001
            self._bug("step", error)
        return self._coast(sample.t_s) if isinstance(sample, ImuSample) else None

    def _coast(self, t_s: float) -> MotionFrame | None:
        try:
            return self.pipeline.coast(t_s)
        except Exception as error:  # Likewise.  # noqa: BLE001
            self._bug("coast", error)
            return None

    def _emit(self, frame: MotionFrame, now_s: float, step_s: float) -> bool:
        if frame.t_s <= self._published_s:
            return False
        self._published_s = frame.t_s
        self._publish(frame)
        self.last_frame = frame
        self.frames += 1
        self._rate.count(now_s)
        self._metrics.record_frame(frame, age_s=now_s - frame.t_s, step_s=step_s)
        return True

    def _offer_work(self) -> None:
        """Hand out what is to be computed beside the event loop."""
        try:
            if (window := self.pipeline.training_due()) is not None:
                self._train(window)
            if (past := self.pipeline.fit_due()) is not None:
                self._fit(past)
            job = self.pipeline.stages.due_refit
            if job is not None and job is not self._refit_job:
                self._refit_job = job
                self._refit(job)
        except Exception as error:  # Likewise.  # noqa: BLE001
            self._bug("work", error)
        if (failure := self.pipeline.stages.failure) is not None:
            self.pipeline.stages.failure = None
            self._tell("stage", failure)

    def _bug(self, where: str, error: Exception) -> None:
        """Count it, and say it, with its traceback, once for each kind."""
        self._metrics.filter_resets.labels("pipeline", f"{where}: {type(error).__name__}").inc()
        self._tell(where, error)

    def _tell(self, where: str, error: Exception) -> None:
        kind = f"{where}: {type(error).__name__}"
        if kind not in self._bugs:
            self._bugs.add(kind)
            _log.error(
                "error in the pipeline: please report it; the stream goes on, if need be with extrapolated frames",
                where=where,
                exc_info=error,
            )

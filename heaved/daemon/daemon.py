"""The daemon: which parts there are, in which order they start and stop, what a signal does.

Start: listen, restore the state, poll, train, then READY once frames flow (with or without sensors).
Stop (SIGTERM, SIGINT): no more polls, clients get what is queued, the state is saved; within two seconds.
SIGHUP: the configuration file is read again; ``[[device]]``, the tables of the estimators and of the outputs beside the
stream take effect at once, the others (``[stream]``, ``[http]``, ``[state]``, ``[runtime]``) with the next start. A
file with faults changes nothing. The certificates of ``[tls]`` are read again, too, for connections to come.
"""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections import Counter
from contextlib import suppress
from functools import partial
from math import nan
from typing import TYPE_CHECKING, Final

import msgspec
import structlog

from heaved import __version__
from heaved.config.read import ConfigError, load_to_run
from heaved.config.rules import rate_faults
from heaved.daemon.acquisition import Acquisition
from heaved.daemon.learning import Workers
from heaved.daemon.load import TUNING as LOAD
from heaved.daemon.load import Load, Relief
from heaved.daemon.logs import configure_logging
from heaved.daemon.metrics import RENEWED_S, Metrics
from heaved.daemon.outputs import TABLES, Outputs
from heaved.daemon.realtime import freeze_memory, set_real_time
from heaved.daemon.recording import Journal
from heaved.daemon.sdnotify import Notifier
from heaved.daemon.signals import Signals
from heaved.daemon.state import Memory, StateFile, state_directory
from heaved.daemon.status import status_line, status_record
from heaved.daemon.supervise import cancelled, in_time, supervise
from heaved.daemon.utc_clock import UtcClock
from heaved.devices.bus import Bus
from heaved.devices.link import buses
from heaved.devices.listening import Listening
from heaved.devices.timer import Heartbeat
from heaved.estimation.heave import saved_state
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.stages import Stages
from heaved.outputs.http import HttpServer, liveness, readiness
from heaved.outputs.listen import ListenError
from heaved.outputs.stream import Publisher
from heaved.outputs.tls import Certificates, TlsParams
from heaved.pipeline import Pipeline, assemble
from heaved.recorder.layout import Call

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from pathlib import Path

    from heaved.config import Config
    from heaved.devices.profile import DeviceSpec
    from heaved.outputs.records import StatusRecord
    from heaved.samples import MotionFrame

__all__ = ["Daemon", "configure_logging", "run"]

_AT_ONCE: Final = ("heave", "laser", "correction", "rock", "point", "compensation", "quiet")
_AT_RESTART: Final = ("stream", "http", "state", "runtime")
_CANCEL_S: Final = 0.4
"""What a task may take to be cancelled."""
_OUTPUTS_S: Final = 0.85
"""And an output, which may have something to say at its end: within the time that all parts have."""
_STOP_S: Final = 0.95
"""What each part may take to stop; they stop side by side."""
_EXIT_S: Final = 1.8
"""After a signal to stop the process is gone by then, whatever hangs."""
_STDOUT: Final = 1

_log = structlog.get_logger(__name__)


class Daemon:
    """All parts of one daemon on the running event loop.

    Attributes:
        addresses: where it listens, by ``stream`` and ``http``, once started.
        config: in force.
        workers: the processes that learn.
    """

    def __init__(
        self,
        config: Config,
        config_path: Path | None = None,
        *,
        notifier: Notifier | None = None,
        clock: Callable[[], float] = time.monotonic,
        realtime: Callable[[], float] = time.time,
    ) -> None:
        """``config_path``: what :meth:`reload` reads. ``clock`` and ``realtime``: UTC is derived from the two.

        Raises:
            ValueError: a server would listen beyond this machine without networks that may connect.
            ListenError: the certificates that a server needs cannot be used.
        """
        self.config = config
        self._certificates = _certificates_of(config)
        self.addresses: dict[str, tuple[str, int]] = {}
        self.metrics = Metrics(__version__)
        self.utc = UtcClock(clock, realtime)
        self.workers = Workers(lambda: self.acquisition, self.metrics)
        self._journal = Journal(lambda: self.utc.offset_s, self._learned)
        self.acquisition: Acquisition = Acquisition(
            make_pipeline(config),
            metrics=self.metrics,
            publish=self._publish,
            train=self.workers.train,
            fit=self.workers.fit,
            refit=self.workers.refit,
            publish_stages=self._publish_stages,
            alive=self._is_alive,
            clock=clock,
            journal=self._journal,
        )
        self._heartbeat = Heartbeat(self._beat)
        self._load = Load()
        self.memory = Memory(
            StateFile(state_directory(config.state.directory), SavedState, saved_state.check),
            self._learned,
            count_save=lambda result: self.metrics.state_saves.labels(result).inc(),
            count_load=lambda result: self.metrics.state_loads.labels(result).inc(),
            realtime=realtime,
        )
        self._config_path = config_path
        self._notifier = notifier or Notifier({})
        self._clock = clock
        self._started_s = clock()
        self._is_ready = self._is_restored = False
        self._tasks: dict[str, asyncio.Task[None]] = {}
        self._buses: dict[str, tuple[DeviceSpec, ...]] = {}
        self._resets_seen: Counter[tuple[str, str]] = Counter()
        self._seen_s = self._started_s
        """When there was a new frame last, as seen once a second."""
        self._seen_frames = 0
        self._fed_s = -1.0
        self._fed_frames = 0
        self._publisher = self._make_publisher()
        self._outputs = Outputs(self.utc.utc_s, clock, self.status, self._journal.output_of)
        self.metrics.have_outputs(lambda: self._outputs.health)
        self._http = self._make_http() if config.http.enabled else None

    # ---- start and stop ----------------------------------------------------------------------------------------------

    async def start(self) -> None:
        """Returns when everything runs, soon whatever hangs; READY is told with the first frame, which needs no sensor.

        Raises:
            ListenError: a port is in use or may not be had; then nothing runs, and there is nothing to stop.
        """
        try:
            self.addresses["stream"] = await self._publisher.start()
            if self._http is not None:
                self.addresses["http"] = await self._http.start()
        except ListenError:
            await self._publisher.close(0.0)
            self.memory.close()
            raise
        await self.memory.restore(self._take_up)
        self._is_restored = True
        await self._outputs.have(self.config, _OUTPUTS_S)  # Before the first poll: a recording has all of them.
        await self._poll_devices()
        await self.workers.have(self.config)
        self._heartbeat.start(self.acquisition.period_s)
        self._supervise("housekeeping", self._keep_house)
        if self._certificates is not None:
            self.metrics.show_certificates(self._certificates.spans)
            self._supervise("certificates", self._certificates.keep_warning)
        self._supervise("load", self._watch_load)
        self._supervise("state", partial(self.memory.keep_saving, self.config.state.save_period_s))
        devices = [device.name for device in self.config.device]
        where = {name: f"{host}:{port}" for name, (host, port) in self.addresses.items()}
        _log.info("started", release=__version__, devices=",".join(devices) or "none", **where)

    async def stop(self) -> bool:
        """Stop everything and save the state, within a second or so; returns whether all parts stopped in time."""
        self._notifier.notify("STOPPING=1", "STATUS=stopping")
        self._heartbeat.stop()
        tasks = list(self._tasks.values())
        self._tasks.clear()
        is_clean = await cancelled(tasks, _CANCEL_S)
        parts: dict[str, Awaitable[object]] = {
            "stream": self._publisher.close(_CANCEL_S),
            **({"state": self.memory.save()} if self._is_restored else {}),  # Else there is nothing new to save.
            **self.workers.stopping(),
            "outputs": self._outputs.stop(_OUTPUTS_S),
        }
        if self._http is not None:
            parts["http"] = self._http.close()
        is_clean &= all(await asyncio.gather(*(in_time(name, part, _STOP_S) for name, part in parts.items())))
        self.memory.close()
        _log.info("stopped", frames=self.acquisition.frames)
        self._notifier.close()
        return is_clean

    async def _poll_devices(self) -> None:
        """Have the configured devices polled, and none else; a bus whose devices are as before is left alone."""
        wanted = buses(self.config.device) | {
            f"{device.name} {device.link}": (device,) for device in self.config.device if not device.is_asked
        }
        changed = [key for key in self._buses if self._buses[key] != wanted.get(key)]
        await cancelled([self._tasks.pop(f"bus {key}") for key in changed], _CANCEL_S)
        self.acquisition.set_devices(self.config.device)
        self._journal.renewed(self.config)
        for fault in rate_faults(self.config):
            _log.warning("the line cannot carry the poll rates", detail=fault)
        for key in wanted.keys() - (self._buses.keys() - set(changed)):
            self._supervise(f"bus {key}", partial(self._poll, wanted[key]))
        self._buses = wanted

    async def _poll(self, devices: tuple[DeviceSpec, ...]) -> None:
        line = Bus if devices[0].is_asked else Listening
        await line(devices, self.acquisition.on_poll, self._clock).run()

    def _supervise(self, name: str, run: Callable[[], Awaitable[None]]) -> None:
        self._tasks[name] = asyncio.create_task(supervise(name, run), name=name)

    # ---- configuration -----------------------------------------------------------------------------------------------

    async def reload(self) -> None:
        """Read the configuration file again and apply what has changed; a file with faults changes nothing."""
        if self._config_path is None:
            _log.warning("no configuration file was given: there is nothing to read again")
            return
        self._notifier.notify("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")
        try:
            await self._apply(await asyncio.to_thread(load_to_run, self._config_path))
            self.metrics.config_reloads.labels("applied").inc()
        except ConfigError as error:
            self.metrics.config_reloads.labels("refused").inc()
            for fault in error.faults:
                _log.error("new configuration refused, the old one stays", file=error.file, fault=fault)
        finally:
            self._notifier.notify("READY=1")

    async def _apply(self, new: Config) -> None:
        old = self.config
        later = {table: getattr(old, table) for table in _AT_RESTART if getattr(new, table) != getattr(old, table)}
        self.config = msgspec.structs.replace(new, **later)
        for table in later:
            _log.warning(f"[{table}] has changed: restart the daemon to bring it into force")
        if self._certificates is not None and new.wants_tls:
            await self._renew_certificates(self._certificates, new.tls)
        # The devices are those of before until they are polled otherwise.
        self._journal.renewed(msgspec.structs.replace(self.config, device=old.device))
        at_once = (*_AT_ONCE, "has_laser", "mounting")
        if any(getattr(new, name) != getattr(old, name) for name in at_once):
            self._replace_pipeline()
            await self.workers.have(self.config)
        if new.hull != old.hull:
            self.acquisition.pipeline.stages.configure_hull(new.hull)
            self._journal.configured(Call.HULL, self.config)
            await self.workers.have(self.config)
        if new.attitude != old.attitude:
            self.acquisition.pipeline.stages.configure_attitude(new.attitude)
            self._journal.configured(Call.ATTITUDE, self.config)
        if new.crane != old.crane:
            self.acquisition.pipeline.stages.configure_crane(new.crane)
            self._journal.configured(Call.CRANE, self.config)
        if new.reference_mru != old.reference_mru:
            self.acquisition.pipeline.stages.configure_reference_mru(new.reference_mru)
            self._journal.configured(Call.REFERENCE_MRU, self.config)
        if any(getattr(new, table) != getattr(old, table) for table in TABLES):
            await self._outputs.have(self.config, _OUTPUTS_S)
        if new.device != old.device:
            await self._poll_devices()
            self._heartbeat.start(self.acquisition.period_s)
        _log.info("configuration read again", devices=",".join(device.name for device in new.device) or "none")

    async def _renew_certificates(self, certificates: Certificates, files: TlsParams) -> None:
        try:
            await asyncio.to_thread(certificates.renew, files)
        except ValueError as error:  # They were well when the configuration was read, a moment ago.
            _log.error("new certificates refused, the old ones stay", fault=str(error))
            return
        certificates.warn(self.utc.utc_s(self._clock()))
        self.metrics.show_certificates(certificates.spans)

    def _take_up(self, state: SavedState, age_s: float) -> None:
        """Start from a saved state.

        Raises:
            ValueError: that cannot be done, and the pipeline is a new one.
        """
        try:
            self.acquisition.pipeline.restore(state, age_s)
        except Exception as error:  # Whatever is in a file must not keep the daemon from starting.
            self.acquisition.pipeline = make_pipeline(self.config, self.acquisition.pipeline.stages)
            raise error if isinstance(error, ValueError) else ValueError(repr(error)) from error
        self._journal.restored(state, age_s)

    def _learned(self) -> SavedState:
        """What a restart shall remember."""
        return self.acquisition.pipeline.state()

    def _replace_pipeline(self) -> None:
        pipeline = make_pipeline(self.config, self.acquisition.pipeline.stages)
        try:
            pipeline.restore(self._learned())
        except ValueError as error:
            _log.warning("what was learned does not fit the new parameters: estimators start cold", reason=str(error))
            self.acquisition.accepted_s = self.acquisition.fitted_s = nan
        self.acquisition.pipeline = pipeline
        self._journal.configured(Call.PIPELINE, self.config)
        if self._load.relief is Relief.LEFT_OUT:
            self._relieve_pipeline(is_relieved=True)
        self._resets_seen.clear()

    # ---- periodic work -----------------------------------------------------------------------------------------------

    def _is_alive(self) -> None:
        """A sample came: while they do, there is nothing to fill in."""
        self._heartbeat.put_off()
        self._feed_watchdog()

    def _beat(self, lateness_s: float) -> None:
        self.acquisition.heartbeat(lateness_s)
        self._feed_watchdog()

    def _feed_watchdog(self) -> None:
        """Fed by the loop that acquires and estimates: only if it has made frames since the last time."""
        watchdog_s, now_s = self._notifier.watchdog_s, self._clock()
        if watchdog_s is None or now_s - self._fed_s < 0.25 * watchdog_s or self.acquisition.frames == self._fed_frames:
            return
        self._fed_s, self._fed_frames = now_s, self.acquisition.frames
        self._notifier.notify("WATCHDOG=1")

    async def _keep_house(self) -> None:
        while True:
            await asyncio.sleep(1.0)
            self.keep_house()

    def keep_house(self) -> None:
        """What is looked after once a second."""
        step_s = self.utc.update()
        if step_s:
            self.metrics.clock_steps.inc()
            _log.warning("the system's UTC was stepped: published times follow, estimates do not care", step_s=step_s)
        resets = self.acquisition.pipeline.resets
        for (name, reason), count in (resets - self._resets_seen).items():
            self.metrics.filter_resets.labels(name, reason).inc(count)
            if reason != "spike":  # One held back is no reset, and a bad sensor gives many.
                _log.warning("estimator reset", filter=name, reason=reason, count=count)
        self._resets_seen = Counter(resets)
        status = self.status()
        self._publisher.publish_record(status)
        frame = self.acquisition.last_frame
        if frame is not None:
            self._publisher.publish_slow(frame)
        self._keep_gauges(frame)
        if self._load.relief is not Relief.NONE:
            self.metrics.overloaded.labels(self._load.relief.name.lower()).inc()
        self._notifier.notify(f"STATUS={status_line(status)}")

    def _keep_gauges(self, frame: MotionFrame | None) -> None:
        now_s, metrics = self._clock(), self.metrics
        if self.acquisition.frames != self._seen_frames:
            self._seen_frames, self._seen_s = self.acquisition.frames, now_s
        if frame is None or now_s - self._seen_s > RENEWED_S:
            metrics.record_no_frame()
            return
        metrics.record_sea(frame)
        metrics.record_stages(frame)
        metrics.record_quiet(frame.quiet)
        metrics.record_training(frame, now_s - self.acquisition.accepted_s)
        metrics.record_rock(self.acquisition.rock_scores())

    # ---- what the machine cannot do all of ---------------------------------------------------------------------------

    async def _watch_load(self) -> None:
        loop = asyncio.get_running_loop()
        while True:
            due_s = loop.time() + LOAD.probe_s
            await asyncio.sleep(LOAD.probe_s)
            now_s, before = loop.time(), self._load.relief
            if self._load.step(now_s, now_s - due_s, self.acquisition.period_s):
                self._relieve(before, self._load.relief)

    def _relieve(self, before: Relief, now: Relief) -> None:
        self._publisher.together = now.value
        if (now is Relief.LEFT_OUT) is not (before is Relief.LEFT_OUT):
            self._relieve_pipeline(is_relieved=now is Relief.LEFT_OUT)
        self.metrics.show_relief(now.value)
        if now.value > before.value:
            hint = "fewer clients or a lower rate_hz; [runtime] fifo_priority where other programs take the time"
            _log.warning("the machine does not keep up: less is done", frames_at_once=now.value, hint=hint)
        else:
            _log.info("the machine keeps up: more is done again", frames_at_once=now.value)

    def _relieve_pipeline(self, *, is_relieved: bool) -> None:
        self.acquisition.pipeline.relieve(is_relieved=is_relieved)
        self._journal.relieved(is_relieved=is_relieved)

    # ---- for the parts -----------------------------------------------------------------------------------------------

    def status(self) -> StatusRecord:
        """The answer to ``?STATUS``."""
        return status_record(
            self.acquisition,
            self.config,
            now_s=self._clock(),
            started_s=self._started_s,
            utc=self.utc,
            outputs=self._outputs.health,
            clients=self._publisher.clients,
            dropped=self._publisher.dropped,
            config_file=str(self._config_path) if self._config_path else None,
            state_file=str(self.memory.file.path),
        )

    def _publish(self, frame: MotionFrame) -> None:
        self._publisher.publish(frame)
        self._outputs.publish(frame)
        if not self._is_ready:
            self._is_ready = True
            self._notifier.notify("READY=1", "STATUS=running")

    def _publish_stages(self) -> None:
        stages = self.acquisition.pipeline.stages
        self._publisher.publish_stages(stages.angles, stages.motion, stages.reference_mru)

    def _make_publisher(self) -> Publisher:
        stream = self.config.stream
        return Publisher(
            host=stream.host,
            port=stream.port,
            max_clients=stream.max_clients,
            queue_frames=stream.queue_frames,
            stuck_s=stream.stuck_s,
            allow=stream.allow,
            version=__version__,
            status=self.status,
            metrics=self.metrics,
            utc_s=self.utc.utc_s,
            clock=self._clock,
            certificates=self._certificates if stream.tls else None,
        )

    def _make_http(self) -> HttpServer:
        http = self.config.http
        return HttpServer(
            host=http.host,
            port=http.port,
            allow=http.allow,
            metrics=self.metrics.render,
            alive=lambda: liveness(self.acquisition.last_frame, now_s=self._clock(), started_s=self._started_s),
            ready=lambda: readiness(self.acquisition.last_frame, now_s=self._clock()),
            count_client_error=self.metrics.count_client_error,
            certificates=self._certificates if http.tls else None,
        )


def _certificates_of(config: Config) -> Certificates | None:
    try:
        return Certificates(config.tls) if config.wants_tls else None
    except ValueError as error:
        raise ListenError(f"[tls] {error}") from error


def make_pipeline(config: Config, stages: Stages | None = None) -> Pipeline:
    """``stages``: to be gone on with; new ones by default."""
    return assemble(
        heave=config.heave,
        laser=config.laser,
        correction=config.correction,
        rock=config.rock,
        has_laser=config.has_laser,
        point=config.point,
        lead_s=config.compensation.lead_s,
        stages=stages or Stages(config.hull, config.attitude, config.crane, config.reference_mru, refit_inline=False),
        quiet=config.quiet,
        attitude_late_s=config.attitude_late_s,
    )


# ---- the process -----------------------------------------------------------------------------------------------------


def run(config: Config, config_path: Path | None, *, log_format: str) -> int:
    """Run the daemon until SIGTERM or SIGINT; returns the exit code. Standard output says where it listens.

    Raises:
        ValueError: ``log_format`` is unknown.
    """
    _have_standard_files()
    log = configure_logging(log_format)
    # Whatever hangs (a disk, a driver, who reads the log), the process ends in time.
    with log.in_background(), Signals(_EXIT_S) as signals:
        try:
            is_clean = asyncio.run(_serve(config, config_path, signals))
        except ListenError as error:
            _log.error(str(error))
            return 1
        if is_clean:
            signals.call_off()
    return 0


async def _serve(config: Config, config_path: Path | None, signals: Signals) -> bool:
    """Returns whether everything stopped as it should."""
    signals.tell(asyncio.get_running_loop())
    set_real_time(config.runtime.fifo_priority)
    daemon = Daemon(config, config_path, notifier=Notifier())
    stopping = asyncio.create_task(signals.stop.wait(), name="stop")
    starting = asyncio.create_task(daemon.start(), name="start")
    await asyncio.wait((starting, stopping), return_when=asyncio.FIRST_COMPLETED)
    tasks = [starting]
    if starting.done():
        starting.result()
        _announce(daemon.addresses)
        freeze_memory()

        async def reload_when_asked() -> None:
            while True:
                await signals.again.wait()
                signals.again.clear()
                await daemon.reload()

        tasks.append(asyncio.create_task(supervise("reload", reload_when_asked), name="reload"))
        await stopping
    is_clean = await cancelled(tasks, _CANCEL_S)
    return await daemon.stop() and is_clean


def _announce(addresses: dict[str, tuple[str, int]]) -> None:
    """Say on standard output where the servers listen; that nobody takes it, or not yet, is no reason to wait."""
    lines = "".join(f"{name} {host}:{port}\n" for name, (host, port) in addresses.items())

    def write() -> None:
        with suppress(OSError):
            os.write(_STDOUT, lines.encode())

    threading.Thread(target=write, name="announce", daemon=True).start()


def _have_standard_files() -> None:
    """Open what the process was started without: else the next socket would be standard error."""
    for fd in range(3):
        try:
            os.fstat(fd)
        except OSError:
            os.open(os.devnull, os.O_RDWR)

"""The outputs beside the stream: made of the configuration, each in a supervised task of its own, told every frame."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TYPE_CHECKING, Final

import msgspec
import structlog

from heaved.daemon.supervise import cancelled, supervise
from heaved.outputs.influx import InfluxOutput
from heaved.outputs.mqtt import MqttOutput
from heaved.outputs.output import Told
from heaved.outputs.registers import register_output
from heaved.outputs.telegram_output import TelegramOutput
from heaved.outputs.telegrams.formats import FORMATS

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.config import Config
    from heaved.outputs.output import Output, OutputHealth
    from heaved.outputs.records import StatusRecord
    from heaved.outputs.telegrams.spec import OutputSpec
    from heaved.samples import MotionFrame

TABLES: Final = ("output", "registers", "point", "mqtt", "influx", "recording")
"""Of the configuration, whose change makes outputs anew."""

_log = structlog.get_logger(__name__)


class Outputs:
    """All of them. One that fails, which is a bug, is counted and said once, and costs the others nothing."""

    def __init__(
        self,
        utc_s: Callable[[float], float],
        clock: Callable[[], float],
        status: Callable[[], StatusRecord],
        recording: Callable[[Config], Output] | None = None,
    ) -> None:
        """``utc_s``: UTC, seconds since 1970, of a time on ``clock``, the monotonic clock of the frames. ``status``:
        makes the STATUS of now. ``recording`` makes the output that records, which is told more than frames; None:
        nothing is recorded.
        """
        self._utc_s, self._clock, self._status, self._recording = utc_s, clock, status, recording
        self._running: dict[object, Output] = {}
        self._tasks: dict[object, asyncio.Task[None]] = {}
        self._bugs: set[str] = set()

    async def have(self, config: Config, stop_s: float) -> None:
        """Run those that are configured and none else; one whose table is as before is left alone."""
        wanted = self._wanted(config)
        gone = [table for table in self._running if table not in wanted]
        for table in gone:
            del self._running[table]
        await cancelled([self._tasks.pop(table) for table in gone], stop_s)
        running, self._running = self._running, {}
        for table, make in wanted.items():
            output = self._running[table] = running.get(table) or make()
            if table not in running:
                name = f"output {output.health.name}"
                self._tasks[table] = asyncio.create_task(supervise(name, output.run), name=name)

    async def stop(self, timeout_s: float) -> bool:
        """End all of them; returns whether they ended in time."""
        tasks = list(self._tasks.values())
        self._running.clear()
        self._tasks.clear()
        return await cancelled(tasks, timeout_s)

    def publish(self, frame: MotionFrame) -> None:
        """Tell each of them a frame."""
        for output in self._running.values():
            try:
                output.publish(frame)
            except Exception as error:  # A bug in one of them must not take the others down.  # noqa: BLE001
                self._bug(output.health, error)

    @property
    def health(self) -> list[OutputHealth]:
        """Of each, in the order of the configuration."""
        return [output.health for output in self._running.values()]

    def _wanted(self, config: Config) -> dict[object, Callable[[], Output]]:
        """By its table, how each output is made."""
        told = Told(self._status, self._utc_s, self._clock)
        wanted: dict[object, Callable[[], Output]] = {spec: self._telegrams(spec) for spec in config.output}
        registers, points = config.registers, tuple(point.name for point in config.point)
        if registers.enabled:
            wanted[registers, points] = partial(register_output, registers, points, self._utc_s, self._clock)
        if config.mqtt.enabled:
            wanted["mqtt", msgspec.json.encode(config.mqtt)] = partial(MqttOutput, config.mqtt, told)
        if config.influx.enabled:
            wanted["influx", msgspec.json.encode(config.influx)] = partial(InfluxOutput, config.influx, told)
        if config.recording.enabled and self._recording is not None:
            wanted[config.recording] = partial(self._recording, config)
        return wanted

    def _telegrams(self, spec: OutputSpec) -> Callable[[], Output]:
        return lambda: TelegramOutput(spec, FORMATS[spec.telegram], self._utc_s, self._clock)

    def _bug(self, health: OutputHealth, error: Exception) -> None:
        kind = f"{health.name}: {type(error).__name__}"
        health.lost["error"] += 1
        if kind not in self._bugs:
            self._bugs.add(kind)
            _log.error("error in an output: please report it; the others go on", output=health.name, exc_info=error)

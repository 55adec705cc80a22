"""What the product is for, measured: how much a hook still moves under a winch that is driven by the stream.

A simulated winch (:mod:`heaved.simulate.winch`) takes its set-points from a compensator that reads MOTION lines. The
true heave is known at every moment, so the hook is too. Two ways to the same table:

* live: simulated Modbus sensors, the daemon as a process, its TCP stream, winches and compensators in real time;
* replay: the same samples through the same pipeline and the same lines without sockets, each line a fixed time old.

Every row is one compensator. "perfect forecast" is given the truth for its forecasts, at the same moments: what the
winch and the period of its set-points leave, whatever the estimator.
"""

from __future__ import annotations

import asyncio
import tempfile
import time
from contextlib import AsyncExitStack
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from evidence.daemon import running_daemon
from evidence.learning import learn
from heaved.config.read import ConfigError, data_directory, load, parse
from heaved.demo.hook import Lift
from heaved.outputs.wire import encode_motion
from heaved.pipeline import Pipeline, assemble
from heaved.samples import HeaveState, ImuSample
from heaved.simulate.compensator import Ahead, CompensatorParams, Source, Trust, Update
from heaved.simulate.instruments import Instruments
from heaved.simulate.plant import SimulatedPlant
from heaved.simulate.seaway import Seaway, seaway
from heaved.simulate.sensors import LASER_NOISE_M, record
from heaved.simulate.shaking import NONE as NOT_SHAKEN
from heaved.simulate.winch import WinchParams

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

Array = NDArray[np.float64]

DEFAULT_SEAS: Final = ("S6", "T3")
SENSOR_SEEDS: Final = 1000
"""Added to the seed of the waves: sensor errors are drawn independently of them."""
PERIOD_S: Final = CompensatorParams().period_s
PERFECT_HORIZONS_S: Final = (0.05, 0.1, 0.15, 0.5, 1.0, 2.0)
NONE: Final = "none"
PERFECT: Final = "perfect forecast"
PAPER_OBSERVER: Final = "harmonic"
OURS: Final = "ours: forecasts of observer {}"
LIVE: Final = "live"
SCORED_FROM_S: Final = 300.0
"""As in all other tables."""
PATIENCE_S: Final = 10.0


class Setting(msgspec.Struct, frozen=True, kw_only=True):
    """How the loop is run."""

    observer: str
    """That of "ours"."""
    sensor: str = "A"
    laser: str = "50%"
    shake: str = NOT_SHAKEN
    """What shakes the sensors: one of :data:`heaved.simulate.shaking.SHAKES`, or nothing."""
    seed: int = 1
    warm_up_s: float = SCORED_FROM_S
    duration_s: float = 180.0
    """Scored, after the warm-up."""
    latency_s: float = 0.005
    """Of a replay: from the sensor's sampling to the line at the compensator. Live it is what it is."""
    winch: WinchParams = WinchParams()
    shifted: bool = False
    """A row more: a daemon with ``[compensation] lead_s``, its heave and velocity used as they come. Live only."""


class Stream(msgspec.Struct, frozen=True, kw_only=True):
    """One daemon."""

    observer: str
    lead_s: float = 0.0

    @property
    def settings(self) -> str:
        compensation = f"[compensation]\nlead_s = {self.lead_s}\n" if self.lead_s else ""
        return f'[heave]\nobserver = "{self.observer}"\n{compensation}'


class Row(msgspec.Struct, frozen=True, kw_only=True):
    """One compensator on one sea."""

    sea: str
    way: str
    """"live" or "replay"."""
    method: str
    setting: Setting
    heave_rms_m: float
    hook_rms_m: float
    share: float
    """Of the heave's RMS."""
    hook_peak_m: float
    forecast_share: float
    """RMS error of the heave that the winch was asked to cancel, over the heave's RMS; nan: nothing was asked."""
    held: float
    """Share of the scored time without full authority."""


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """One sea: moments of control and what every method made of them; arrays (n,)."""

    sea: str
    way: str
    setting: Setting
    t_s: Array
    """Since the controllers began."""
    heave_m: dict[str, Array]
    hook_m: dict[str, Array]
    asked_error_m: dict[str, Array]
    authority: dict[str, Array]
    ages_s: Array
    """Age of each line at the compensator, while scored."""

    @property
    def scored(self) -> NDArray[np.bool_]:
        return self.t_s >= self.setting.warm_up_s

    def rows(self) -> list[Row]:
        kept = self.scored
        rows = []
        for method, hook in self.hook_m.items():
            heave, asked = _rms(self.heave_m[method][kept]), self.asked_error_m[method][kept]
            rows.append(
                Row(
                    sea=self.sea,
                    way=self.way,
                    method=method,
                    setting=self.setting,
                    heave_rms_m=heave,
                    hook_rms_m=_rms(hook[kept]),
                    share=_rms(hook[kept]) / heave,
                    hook_peak_m=float(np.max(np.abs(hook[kept]))),
                    forecast_share=_rms(asked[np.isfinite(asked)]) / heave,
                    held=float(np.mean(self.authority[method][kept] < 1.0)),
                )
            )
        return rows


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else nan


class Controller:
    """A lift and its diary."""

    def __init__(self, method: str, source: Source, stream: Stream, setting: Setting) -> None:
        self.method, self.stream = method, stream
        self.lift = Lift(source, winch=setting.winch)
        self._diary: list[tuple[float, float, float, float]] = []

    def tick(self, now_s: float) -> None:
        state, compensator = self.lift.tick(now_s), self.lift.compensator
        asked = nan if compensator.aim is None else compensator.aim.heave_m
        self._diary.append((now_s, state.position_m, asked, compensator.authority))

    def columns(self) -> Array:
        """(n, 4): moment, rope position, heave to be cancelled when it takes effect, authority."""
        return np.array(self._diary)


def controllers(setting: Setting) -> list[Controller]:
    """One for each method of the table that reads a stream."""
    ours, paper = Stream(observer=setting.observer), Stream(observer=PAPER_OBSERVER)
    made = [
        Controller("present heave, no lead", Source.PRESENT, ours, setting),
        Controller("paper: harmonic observer, extrapolated", Source.FORECAST, paper, setting),
        Controller(OURS.format(setting.observer), Source.FORECAST, ours, setting),
    ]
    if setting.shifted:
        winch = setting.winch
        lead_s = setting.latency_s + winch.dead_time_s + winch.lag_s + PERIOD_S / 2.0
        shifted = Stream(observer=setting.observer, lead_s=lead_s)
        made.append(Controller(f"ours: stream shifted by {lead_s:g} s", Source.SHIFTED, shifted, setting))
    return made


# --- replay ----------------------------------------------------------------------------------------------------------


def replay(name: str, setting: Setting) -> Trial:
    """The loop without sockets: deterministic, as fast as the pipeline.

    Raises:
        ValueError: unknown sea, sensor, laser pattern, shake or observer.
    """
    if setting.shifted:
        raise ValueError("a stream shifted by [compensation] lead_s is compared live only")
    sea = seaway(name, setting.seed)
    recording = record(
        sea,
        setting.warm_up_s + setting.duration_s,
        imu_rate_hz=1.0 / PERIOD_S,
        sensor=setting.sensor,
        laser=setting.laser,
        shake=setting.shake,
        seed=SENSOR_SEEDS + setting.seed,
    )
    made = controllers(setting)
    pipelines = {stream: _pipeline(stream) for stream in dict.fromkeys(c.stream for c in made)}
    decoder, number = msgspec.json.Decoder(Update), 0
    for sample in recording.samples():
        now_s = sample.t_s + setting.latency_s
        for stream, pipeline in pipelines.items():
            frame = pipeline.step(sample)
            learn(pipeline)
            if frame is None:
                continue
            line = decoder.decode(encode_motion(frame, seq=number, utc_s=frame.t_s, sent_mono_s=now_s))
            for controller in made:
                if controller.stream == stream:
                    controller.lift.compensator.take(line, now_s)
        if isinstance(sample, ImuSample):
            number += 1
            for controller in made:
                controller.tick(now_s)
    epochs_s = dict.fromkeys(pipelines, 0.0)
    return _trial(name, "replay", setting, sea, made, epochs_s, np.array([setting.latency_s]))


def _pipeline(stream: Stream) -> Pipeline:
    document = {"heave": {"observer": stream.observer}}
    try:
        config = parse(document, file="closed loop", directory=data_directory())
    except ConfigError as error:
        raise ValueError(str(error)) from error
    return assemble(
        heave=config.heave, laser=config.laser, correction=config.correction, rock=config.rock, has_laser=True
    )


# --- live ------------------------------------------------------------------------------------------------------------


def live(name: str, setting: Setting) -> Trial:
    """The loop in real time; takes warm-up + duration.

    Raises:
        ValueError: unknown sea, sensor, laser pattern or shake.
        RuntimeError: a daemon does not start; says why.
        ConnectionError: a daemon is lost.
    """
    with tempfile.TemporaryDirectory(prefix="heaved-loop-") as folder:
        return asyncio.run(_live(name, setting, Path(folder)))


async def _live(name: str, setting: Setting, folder: Path) -> Trial:
    made = controllers(setting)
    epochs_s: dict[Stream, float] = {}
    ages_s: list[float] = []
    devices = load(data_directory() / "sensors.toml").device
    async with AsyncExitStack() as stack:
        ports: dict[Stream, int] = {}
        for number, stream in enumerate(dict.fromkeys(controller.stream for controller in made)):
            # Each daemon has sensors of its own, as noisy as the other's: a sensor is not polled by two.
            instruments = Instruments(
                seaway(name, setting.seed),
                sensor=setting.sensor,
                laser=setting.laser,
                shake=setting.shake,
                seed=SENSOR_SEEDS + setting.seed,
            )
            plant = SimulatedPlant(devices, instruments, any_port=True)
            await plant.start()
            stack.push_async_callback(plant.stop)
            epochs_s[stream] = time.monotonic() - plant.time_s()
            own = folder / str(number)
            own.mkdir()
            daemon = await stack.enter_async_context(running_daemon(plant.devices, own, stream.settings))
            _, ports[stream] = daemon.addresses["stream"]
        scored_from_s = time.monotonic() + setting.warm_up_s
        tasks = [asyncio.create_task(_control(made, setting.warm_up_s + setting.duration_s))]
        for stream, port in ports.items():
            lifts = [controller.lift for controller in made if controller.stream == stream]
            tasks.append(asyncio.create_task(_listen(port, lifts, ages_s, scored_from_s)))
        done, others = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in others:
            task.cancel()
        await asyncio.wait(tasks)
        for task in done:
            task.result()
    return _trial(name, LIVE, setting, seaway(name, setting.seed), made, epochs_s, np.array(ages_s))


async def _listen(port: int, lifts: Sequence[Lift], ages_s: list[float], scored_from_s: float) -> None:
    """Hand every MOTION line to the compensators, until cancelled; notes the ages of those that are scored."""
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    decoder = msgspec.json.Decoder(Update)
    try:
        while text := await asyncio.wait_for(reader.readline(), PATIENCE_S):
            if text.startswith(b'{"class":"MOTION"'):
                update, now_s = decoder.decode(text), time.monotonic()
                if now_s >= scored_from_s:
                    ages_s.append(now_s - update.mono_s)
                for lift in lifts:
                    lift.compensator.take(update, now_s)
        raise ConnectionError("the daemon closed the stream")
    finally:
        writer.close()


async def _control(made: Sequence[Controller], duration_s: float) -> None:
    """Every controller at absolute deadlines."""
    begun_s = time.monotonic()
    for number in range(round(duration_s / PERIOD_S)):
        await asyncio.sleep(begun_s + number * PERIOD_S - time.monotonic())
        for controller in made:
            controller.tick(time.monotonic())


# --- what came of it -------------------------------------------------------------------------------------------------


def _trial(
    name: str,
    way: str,
    setting: Setting,
    sea: Seaway,
    made: Sequence[Controller],
    epochs_s: dict[Stream, float],
    ages_s: Array,
) -> Trial:
    """Put the truth beside the diaries; and what a perfect forecast would have made of the same moments."""
    effect_s = setting.winch.dead_time_s + PERIOD_S / 2.0
    heave, hook, asked_error, authority = ({} for _ in range(4))
    ours = made[-1]
    moments = ours.columns()[:, 0]
    truth = sea.motion(moments - epochs_s[ours.stream]).heave_m
    heave[NONE] = hook[NONE] = truth
    asked_error[NONE], authority[NONE] = np.full(truth.size, nan), np.ones(truth.size)
    perfect = Controller(PERFECT, Source.FORECAST, ours.stream, setting)
    _drive_perfectly(perfect, sea, moments, epochs_s[ours.stream])
    for controller in (*made, perfect):
        t, position, asked, in_charge = controller.columns().T
        at = t - epochs_s[controller.stream]
        truth = sea.motion(at).heave_m
        heave[controller.method], hook[controller.method] = truth, truth + position
        asked_error[controller.method] = asked - sea.motion(at + effect_s).heave_m
        authority[controller.method] = in_charge
    return Trial(
        sea=name,
        way=way,
        setting=setting,
        t_s=moments - moments[0],
        heave_m=heave,
        hook_m=hook,
        asked_error_m=asked_error,
        authority=authority,
        ages_s=ages_s,
    )


def _drive_perfectly(controller: Controller, sea: Seaway, moments_s: Array, epoch_s: float) -> None:
    """Run it at the same moments on lines without age, whose forecasts are the truth."""
    ahead = np.array([sea.motion(moments_s - epoch_s + h).heave_m for h in (0.0, *PERFECT_HORIZONS_S)])
    for now_s, (heave, *row) in zip(moments_s.tolist(), ahead.T.tolist(), strict=True):
        forecast = tuple(Ahead(horizon_s=h, heave_m=m) for h, m in zip(PERFECT_HORIZONS_S, row, strict=True))
        update = Update(mono_s=now_s, quality=Trust(heave=HeaveState.VALID), heave_m=heave, forecast=forecast)
        controller.lift.compensator.take(update, now_s)
        controller.tick(now_s)


def report(trials: Sequence[Trial]) -> str:
    """A table per sea, as Markdown."""
    return "\n".join(line for trial in trials for line in (*_table(trial), ""))


def _table(trial: Trial) -> list[str]:
    setting, winch = trial.setting, trial.setting.winch
    age = f"{1e3 * np.median(trial.ages_s):.1f} ms"
    if trial.ages_s.size > 1:
        age = f"p50 {age}, p99 {1e3 * np.percentile(trial.ages_s, 99):.1f} ms"
    lines = [
        f"## Hook motion, {trial.way}: {trial.sea}, sensor {setting.sensor}, laser {setting.laser}"
        + (f", {setting.shake}" if setting.shake else ""),
        "",
        f"Scored for {setting.duration_s:g} s after {setting.warm_up_s:g} s; set-points every {1e3 * PERIOD_S:g} ms; "
        f"winch: dead time {winch.dead_time_s:g} s, lag {winch.lag_s:g} s, at most {winch.max_speed_mps:g} m/s and "
        f"{winch.max_acceleration_mps2:g} m/s2; age of a line at the controller {age}; "
        f"laser noise {1e3 * LASER_NOISE_M:g} mm.",
        "",
        "| compensation | hook RMS / m | % of heave RMS | hook peak / m | forecast error, % of heave | not in charge |",
        "|---|---|---|---|---|---|",
    ]
    for row in trial.rows():
        forecast = "–" if np.isnan(row.forecast_share) else f"{100 * row.forecast_share:.2f}"
        lines.append(
            f"| {row.method} | {row.hook_rms_m:.4g} | {100 * row.share:.2f} | {row.hook_peak_m:.3g} | {forecast} "
            f"| {100 * row.held:.1f} % |"
        )
    return lines


def run(names: Sequence[str], setting: Setting, offline: bool, watch: Callable[[Trial], None]) -> list[Trial]:
    """One sea after the other; ``watch`` is shown each. ``Raises`` as :func:`replay` and :func:`live`."""
    trials = []
    for name in names:
        trials.append((replay if offline else live)(name, setting))
        watch(trials[-1])
    return trials

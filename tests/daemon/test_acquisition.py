"""The hot path against a pipeline and a clock of the test's own."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, cast

import msgspec
import pytest
from structlog.testing import capture_logs

from heaved.config.read import data_directory, load
from heaved.daemon.acquisition import IDLE_RATE_HZ, Acquisition
from heaved.daemon.metrics import Metrics
from heaved.devices.bus import PollResult
from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow
from heaved.estimation.stages import Stages
from heaved.samples import (
    CorrectionState,
    Fault,
    HeaveState,
    ImuSample,
    LaserSample,
    LaserState,
    MotionFrame,
    Quality,
    Sample,
    TrainedNetwork,
    TrainingWindow,
)

if TYPE_CHECKING:
    from heaved.devices.profile import Role
    from heaved.pipeline import Pipeline

Answer = Callable[[int], tuple[float, Fault] | None]
"""Number of a poll -> seconds until its answer and its fault; None: no result at all."""

PERIOD_S = 0.01
DEVICES = load(data_directory() / "sensors.toml").device
QUALITY = Quality(heave=HeaveState.VALID, laser=LaserState.VALID, correction=CorrectionState.OFF)


class FakePipeline:
    """Frames that say where they come from: heave 1 of a sample, heave 0 extrapolated."""

    def __init__(self) -> None:
        self.error: dict[str, Exception] = {}
        self.windows: list[TrainingWindow] = []
        self.pasts: list[SeaWindow] = []
        self.resets: Counter[tuple[str, str]] = Counter()
        self.stages = Stages()
        self.steps = 0
        self.verdict = "accepted"

    def step(self, sample: Sample) -> MotionFrame | None:
        if "step" in self.error:
            raise self.error["step"]
        self.steps += 1
        return None if isinstance(sample, LaserSample) else MotionFrame(t_s=sample.t_s, quality=QUALITY, heave_m=1.0)

    def coast(self, t_s: float) -> MotionFrame:
        if "coast" in self.error:
            raise self.error["coast"]
        return MotionFrame(t_s=t_s, quality=QUALITY, heave_m=0.0)

    def training_due(self) -> TrainingWindow | None:
        return self.windows.pop() if self.windows else None

    def accept(self, network: TrainedNetwork) -> str:
        if "accept" in self.error:
            raise self.error["accept"]
        return self.verdict

    def fit_due(self) -> SeaWindow | None:
        return self.pasts.pop() if self.pasts else None

    def accept_fit(self, fit: SeaFit) -> str:
        if "accept_fit" in self.error:
            raise self.error["accept_fit"]
        return self.verdict


class Rig:
    def __init__(self) -> None:
        self.now_s = 100.0
        self.frames: list[MotionFrame] = []
        self.windows: list[TrainingWindow] = []
        self.pasts: list[SeaWindow] = []
        self.metrics = Metrics("test")
        self.pipeline = FakePipeline()
        self.acquisition = Acquisition(
            cast("Pipeline", self.pipeline),
            metrics=self.metrics,
            publish=self.frames.append,
            train=self.windows.append,
            fit=self.pasts.append,
            clock=lambda: self.now_s,
        )
        self.acquisition.set_devices(DEVICES)

    def poll(self, t_s: float, fault: Fault = Fault.NONE, role: Role = "imu", **changes: Any) -> None:
        kind = ImuSample if role == "imu" else LaserSample
        self.acquisition.on_poll(
            msgspec.structs.replace(
                PollResult(
                    device=role,
                    role=role,
                    due_s=t_s,
                    sent_s=t_s,
                    duration_s=self.now_s - t_s,
                    lateness_s=0.0,
                    skipped=0,
                    sample=kind(t_s=t_s, fault=fault),
                    fault=fault,
                    detail="" if fault is Fault.NONE else "as the test wants it",
                    extra={},
                    reconnected=False,
                ),
                **changes,
            )
        )

    def run(self, seconds: float, answer: Answer, tick_offset_s: float = 0.004, from_s: float | None = None) -> None:
        """Polls every period, as ``answer(number)`` says: seconds until the answer and its fault, or None for no
        result at all; heartbeats every period between them, in order of time.
        """
        start_s = self.now_s if from_s is None else from_s
        events: list[tuple[float, tuple[float, Fault] | None]] = []
        free_s = start_s
        for number in range(round(seconds / PERIOD_S)):
            due_s = start_s + number * PERIOD_S
            events.append((due_s + tick_offset_s, None))
            answered = answer(number)
            if answered is not None and due_s >= free_s - 1e-9:
                wait_s, fault = answered
                free_s = due_s + wait_s
                events.append((free_s, (due_s, fault)))
        for at_s, polled in sorted(events, key=lambda event: event[0]):
            self.now_s = at_s
            if polled is None:
                self.acquisition.heartbeat()
            else:
                self.poll(*polled)
        self.now_s = start_s + seconds

    def value(self, name: str) -> float:
        lines = self.metrics.render().decode().splitlines()
        return sum(float(line.split()[-1]) for line in lines if line.startswith(name))


@pytest.fixture
def rig() -> Rig:
    return Rig()


def well(number: int) -> tuple[float, Fault]:
    return 0.002, Fault.NONE


def jitter(number: int) -> tuple[float, Fault]:
    """Up to 8 ms late; the 2 ms steps are of no rhythm with the ticks."""
    return 0.001 + 0.002 * (number * 7 % 5), Fault.NONE


def times(frames: Sequence[MotionFrame]) -> list[float]:
    return [frame.t_s for frame in frames]


def check_increasing(frames: Sequence[MotionFrame]) -> None:
    assert all(after > before for before, after in itertools.pairwise(times(frames)))


# ---- the rate of the stream ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("answer", [well, jitter])
@pytest.mark.parametrize("tick_offset_s", [0.0, 0.0019, 0.0021, 0.005, 0.0099])
def test_ordinary_jitter_makes_no_double_frames(rig: Rig, answer: Answer, tick_offset_s: float) -> None:
    rig.poll(rig.now_s - PERIOD_S)
    rig.frames.clear()
    rig.run(2.0, answer, tick_offset_s)
    assert times(rig.frames) == pytest.approx([100.0 + PERIOD_S * number for number in range(200)])
    assert all(frame.heave_m == 1.0 for frame in rig.frames)


def test_a_loop_that_was_held_up_makes_no_double_frames(rig: Rig) -> None:
    """For 40 ms nothing ran: heartbeat and poll are both late, and the sample follows."""
    rig.run(1.0, well)
    rig.frames.clear()
    rig.now_s += 0.040
    assert not rig.acquisition.heartbeat(0.040)  # What was due at the beginning of the stall ...
    assert not rig.acquisition.heartbeat(0.004)  # ... and what was due at its end, at once after it.
    rig.now_s += 0.002
    rig.poll(rig.now_s - 0.002)
    assert [frame.heave_m for frame in rig.frames] == [1.0]
    # A sample that does not follow is missing.
    rig.now_s += 2.0 * PERIOD_S
    assert rig.acquisition.heartbeat(0.001)


def test_the_stream_runs_on_a_machine_that_is_always_late(rig: Rig) -> None:
    rig.run(1.0, well)
    rig.frames.clear()
    for _ in range(200):
        rig.now_s += PERIOD_S
        rig.acquisition.heartbeat(0.8 * PERIOD_S)
    assert len(rig.frames) >= 190
    check_increasing(rig.frames)


def test_without_any_imu_the_stream_runs_all_the_same(rig: Rig) -> None:
    rig.run(2.0, lambda number: None)
    assert len(rig.frames) == 200
    assert all(frame.heave_m == 0.0 for frame in rig.frames)
    check_increasing(rig.frames)


def test_idle_rate_without_an_imu_configured(rig: Rig) -> None:
    rig.acquisition.set_devices(())
    assert rig.acquisition.period_s == 1.0 / IDLE_RATE_HZ
    rig.acquisition.set_devices(DEVICES)
    assert rig.acquisition.period_s == PERIOD_S


@pytest.mark.parametrize(
    "outage",
    [
        lambda number: None,
        lambda number: (0.0, Fault.DISCONNECTED),
        lambda number: (0.05, Fault.TIMEOUT),
        lambda number: (0.002, Fault.NOT_FINITE),
    ],
    ids=["nothing", "disconnected", "timeouts of 50 ms", "nan"],
)
def test_the_rate_stays_through_an_outage_and_after_it(rig: Rig, outage: Answer) -> None:
    rig.run(1.0, well)
    rig.run(2.0, outage)
    rig.run(1.0, well)
    check_increasing(rig.frames)
    assert len(rig.frames) == pytest.approx(400, abs=4)
    gaps = [after - before for before, after in itertools.pairwise(times(rig.frames))]
    # Missed at one and a half periods, and seen at the next heartbeat.
    assert max(gaps) <= 2.5 * PERIOD_S + 1e-9
    assert all(frame.heave_m == 1.0 for frame in rig.frames[-95:])


@pytest.mark.parametrize("latency_s", [-0.2, -0.02, 0.0, 0.02])
def test_devices_that_answer_old_values_come_back_too(rig: Rig, latency_s: float) -> None:
    """Validity lags arrival by far more than a period: extrapolated frames must not shut the real ones out."""

    def poll_run(seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            rig.now_s += PERIOD_S
            rig.poll(rig.now_s + latency_s)
            rig.acquisition.heartbeat()

    poll_run(1.0)
    rig.run(1.0, lambda number: None)
    poll_run(1.0)
    check_increasing(rig.frames)
    assert sum(frame.heave_m == 1.0 for frame in rig.frames) >= 195
    assert len(rig.frames) == pytest.approx(300, abs=5)


def test_first_contact_after_extrapolation_without_known_lag(rig: Rig) -> None:
    """Frames of "now" were published before the first sample showed that validity is 0.5 s earlier."""
    rig.run(1.0, lambda number: None)
    for _ in range(100):
        rig.now_s += PERIOD_S
        rig.poll(rig.now_s - 0.5)
        rig.acquisition.heartbeat()
    check_increasing(rig.frames)
    assert sum(frame.heave_m == 1.0 for frame in rig.frames) >= 48


def test_a_slow_device_is_filled_up(rig: Rig) -> None:
    """33 Hz where 100 Hz were configured: no sample is lost for a replacement."""
    rig.run(3.0, lambda number: (0.024, Fault.NONE))
    check_increasing(rig.frames)
    assert len(rig.frames) >= 200 - 2
    assert sum(frame.heave_m == 1.0 for frame in rig.frames) >= 100 - 1  # Before the first, its lag is not known.


def test_laser_polls_make_no_frames(rig: Rig) -> None:
    rig.poll(100.0)
    for number in range(10):
        rig.poll(100.0 + number * 0.001, role="laser")
    assert len(rig.frames) == 1
    assert rig.pipeline.steps == 11


# ---- accounting ------------------------------------------------------------------------------------------------------


def test_metrics_of_polls_and_frames(rig: Rig) -> None:
    rig.run(1.0, well)
    rig.poll(rig.now_s, Fault.CRC)
    rig.now_s += PERIOD_S
    rig.poll(rig.now_s, reconnected=True)
    assert rig.value('heaved_polls_total{device="imu",result="none"}') == 101
    assert rig.value('heaved_polls_total{device="imu",result="crc"}') == 1
    assert rig.value('heaved_device_up{device="imu"}') == 1
    assert rig.value('heaved_reconnects_total{device="imu"}') == 1
    assert rig.value("heaved_step_duration_seconds_count") == rig.acquisition.frames == len(rig.frames)
    assert rig.value('heaved_quality{state="valid"}') == 1


def test_a_thousand_timeouts_are_one_line_and_one_when_it_is_back(rig: Rig) -> None:
    rig.run(1.0, well)
    with capture_logs() as logs:
        for _ in range(1000):
            rig.now_s += PERIOD_S
            rig.poll(rig.now_s, Fault.TIMEOUT)
        rig.run(2.0, well)
    assert [line["event"] for line in logs] == ["device down", "device back"]
    assert logs[0]["detail"] == "as the test wants it"
    assert logs[1]["timeout"] == 1000
    assert rig.value('heaved_device_up{device="imu"}') == 1


def test_devices_that_go_and_stay_over_a_reload(rig: Rig) -> None:
    rig.run(1.0, well)
    imu, laser = DEVICES
    rig.acquisition.set_devices((imu,))
    assert list(rig.acquisition.health) == ["imu"]
    assert rig.acquisition.health["imu"].results[Fault.NONE] == 100
    assert rig.value('heaved_device_up{device="laser"}') == 0
    rig.acquisition.set_devices((imu, laser))
    rig.poll(rig.now_s, role="laser")
    assert rig.acquisition.health["laser"].up


# ---- bugs in the pipeline --------------------------------------------------------------------------------------------


def test_a_bug_in_step_is_said_once_and_the_stream_goes_on(rig: Rig) -> None:
    rig.pipeline.error["step"] = ZeroDivisionError("float division by zero")
    with capture_logs() as logs:
        rig.run(1.0, well)
        rig.poll(rig.now_s, role="laser")
    assert len(rig.frames) == 100
    assert all(frame.heave_m == 0.0 for frame in rig.frames)
    errors = [line for line in logs if line["log_level"] == "error"]
    assert len(errors) == 1
    assert isinstance(errors[0]["exc_info"], ZeroDivisionError)
    assert rig.value('heaved_filter_resets_total{filter="pipeline",reason="step: ZeroDivisionError"}') == 101
    del rig.pipeline.error["step"]
    rig.frames.clear()
    rig.run(1.0, well, from_s=rig.now_s + PERIOD_S)
    assert sum(frame.heave_m == 1.0 for frame in rig.frames) >= 100 - 1  # Before the first, its lag is not known.


def test_two_kinds_of_bugs_are_two_lines(rig: Rig) -> None:
    with capture_logs() as logs:
        rig.pipeline.error["step"] = ZeroDivisionError()
        rig.run(0.1, well)
        rig.pipeline.error["step"] = IndexError()
        rig.run(0.1, well)
    assert sum(line["log_level"] == "error" for line in logs) == 2


def test_with_no_frame_at_all_nothing_is_raised(rig: Rig) -> None:
    rig.pipeline.error = {"step": ValueError(), "coast": ValueError()}
    rig.run(1.0, well)
    assert rig.frames == []
    assert rig.acquisition.frames == 0


# ---- training --------------------------------------------------------------------------------------------------------


def test_a_window_is_handed_on_once(rig: Rig) -> None:
    window = cast("TrainingWindow", SimpleNamespace(number=1))
    rig.pipeline.windows = [window]
    rig.run(0.1, well)
    assert rig.windows == [window]
    assert rig.pasts == []


def test_results_are_counted_and_said_when_they_change(rig: Rig) -> None:
    with capture_logs() as logs:
        for verdict in ["rejected", "accepted", "accepted", "accepted", "rejected"]:
            rig.pipeline.verdict = verdict
            rig.now_s += 10.0
            rig.acquisition.accept(TrainedNetwork(number=1, seconds=0.3))
        rig.pipeline.error["accept"] = ValueError("wrong size")
        rig.acquisition.accept(TrainedNetwork(number=1))
    assert [line["result"] for line in logs if "result" in line] == ["rejected", "accepted", "rejected", "failed"]
    assert rig.value('heaved_training_runs_total{result="accepted"}') == 3
    assert rig.value('heaved_training_runs_total{result="failed"}') == 1
    assert rig.acquisition.accepted_s == 140.0
    assert rig.acquisition.trainings == 6


# ---- fits of the sea -------------------------------------------------------------------------------------------------


def test_a_past_is_handed_on_once(rig: Rig) -> None:
    past = cast("SeaWindow", SimpleNamespace(number=1))
    rig.pipeline.pasts = [past]
    rig.run(0.1, well)
    assert rig.pasts == [past]
    assert rig.windows == []


def test_a_bug_in_handing_out_work_is_said_once_and_the_stream_goes_on(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken() -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(rig.pipeline, "fit_due", broken)
    with capture_logs() as logs:
        rig.run(1.0, well)
    assert [frame.heave_m for frame in rig.frames] == [1.0] * 100
    assert sum(line["log_level"] == "error" for line in logs) == 1
    assert rig.value('heaved_filter_resets_total{filter="pipeline",reason="work: ZeroDivisionError"}') == 100


def test_fits_are_counted_and_said_when_they_change(rig: Rig) -> None:
    with capture_logs() as logs:
        for verdict in ["failed", "accepted", "accepted", "rejected", "accepted"]:
            rig.pipeline.verdict = verdict
            rig.now_s += 10.0
            rig.acquisition.accept_fit(SeaFit(number=1, message="too short" if verdict == "failed" else ""))
        rig.pipeline.error["accept_fit"] = ValueError("wrong size")
        rig.acquisition.accept_fit(SeaFit(number=1))
    said = [(line["result"], line.get("detail", "")) for line in logs if "result" in line]
    assert said == [("failed", "too short"), ("accepted", ""), ("rejected", ""), ("accepted", ""), ("failed", "")]
    results = ("accepted", "rejected", "failed")
    assert [rig.value(f'heaved_sea_fits_total{{result="{result}"}}') for result in results] == [3, 1, 2]
    assert rig.acquisition.fitted_s == 150.0
    assert rig.acquisition.trainings == 0

"""Metrics: the names are a contract, the text is what Prometheus reads."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import msgspec
import pytest
from prometheus_client.parser import text_string_to_metric_families

from heaved.daemon.metrics import Metrics
from heaved.outputs.output import OutputHealth
from heaved.outputs.tls import Span
from heaved.samples import (
    CorrectionState,
    CraftMotion,
    DelayedHeave,
    Fault,
    HeaveState,
    HullAngles,
    LaserState,
    MotionFrame,
    MruAgreement,
    MruComparison,
    Quality,
    QuietForecast,
    QuietWindow,
    RockScore,
    SeaState,
    Vibration,
)

if TYPE_CHECKING:
    from prometheus_client import Metric

# As published: name, type, labels. Change one only with a line in the change log.
CONTRACT = {
    ("heaved_build_info", "gauge", ("version",)),
    ("heaved_device_up", "gauge", ("device",)),
    ("heaved_polls", "counter", ("device", "result")),
    ("heaved_poll_duration_seconds", "histogram", ("device",)),
    ("heaved_sample_age_seconds", "histogram", ()),
    ("heaved_reconnects", "counter", ("device",)),
    ("heaved_step_duration_seconds", "histogram", ()),
    ("heaved_heave_meters", "gauge", ()),
    ("heaved_heave_std_meters", "gauge", ()),
    ("heaved_reference_error_meters", "gauge", ()),
    ("heaved_lead_seconds", "gauge", ()),
    ("heaved_hull_angle_radians", "gauge", ("axis",)),
    ("heaved_hull_std_radians", "gauge", ("axis",)),
    ("heaved_reference_difference_meters", "gauge", ("kind",)),
    ("heaved_reference_difference_radians", "gauge", ("axis", "kind")),
    ("heaved_reference_correlation_ratio", "gauge", ()),
    ("heaved_reference_delay_seconds", "gauge", ()),
    ("heaved_reference_scale_ratio", "gauge", ()),
    ("heaved_attitude_heave_meters", "gauge", ()),
    ("heaved_attitude_heave_std_meters", "gauge", ()),
    ("heaved_attitude_pitch_radians", "gauge", ()),
    ("heaved_attitude_pitch_std_radians", "gauge", ()),
    ("heaved_quality", "gauge", ("state",)),
    ("heaved_training_runs", "counter", ("result",)),
    ("heaved_training_age_seconds", "gauge", ()),
    ("heaved_sea_fits", "counter", ("result",)),
    ("heaved_significant_heave_meters", "gauge", ()),
    ("heaved_peak_period_seconds", "gauge", ()),
    ("heaved_mean_period_seconds", "gauge", ()),
    ("heaved_delayed_heave_meters", "gauge", ()),
    ("heaved_clients", "gauge", ()),
    ("heaved_frames_sent", "counter", ()),
    ("heaved_frames_dropped", "counter", ("reason",)),
    ("heaved_filter_resets", "counter", ("filter", "reason")),
    ("heaved_rock_error_radians", "gauge", ("axis", "horizon")),
    ("heaved_rock_coverage_ratio", "gauge", ("axis", "horizon")),
    ("heaved_accelerometer_noise_mps2_rthz", "gauge", ()),
    ("heaved_accelerometer_bias_walk_mps2_rts", "gauge", ()),
    ("heaved_vibration_mps2", "gauge", ("rank",)),
    ("heaved_vibration_hertz", "gauge", ("rank",)),
    ("heaved_quiet_confidence_ratio", "gauge", ()),
    ("heaved_quiet_start_seconds", "gauge", ()),
    ("heaved_tick_lateness_seconds", "histogram", ()),
    ("heaved_certificate_end_timestamp_seconds", "gauge", ("file",)),
    ("heaved_clock_steps", "counter", ()),
    ("heaved_frames_at_once", "gauge", ()),
    ("heaved_overloaded_seconds", "counter", ("relief",)),
    ("heaved_state_saves", "counter", ("result",)),
    ("heaved_state_loads", "counter", ("result",)),
    ("heaved_client_errors", "counter", ("reason",)),
    ("heaved_config_reloads", "counter", ("result",)),
    ("heaved_output_up", "gauge", ("output",)),
    ("heaved_output_messages", "counter", ("output",)),
    ("heaved_output_lost", "counter", ("output", "reason")),
    ("heaved_output_connections", "counter", ("output",)),
}


def frame(heave: HeaveState, heave_m: float = math.nan, reference_m: float = math.nan) -> MotionFrame:
    quality = Quality(heave=heave, laser=LaserState.VALID, correction=CorrectionState.OFF)
    return MotionFrame(t_s=1.0, quality=quality, heave_m=heave_m, heave_std_m=0.02, lead_s=0.1, reference_m=reference_m)


def with_sea(plain: MotionFrame) -> MotionFrame:
    sea = SeaState(
        significant_height_m=2.5, peak_period_s=9.0, mean_period_s=7.5, systems=(), frequencies_hz=(), spectrum_m2phz=()
    )
    return msgspec.structs.replace(plain, sea=sea, delayed=DelayedHeave(t_s=-59.0, heave_m=-0.75, std_m=0.01))


def families(metrics: Metrics) -> dict[str, Metric]:
    return {family.name: family for family in text_string_to_metric_families(metrics.render().decode())}


def value(metrics: Metrics, name: str, **labels: str) -> float:
    found = [
        sample.value
        for family in families(metrics).values()
        for sample in family.samples
        if sample.name == name and sample.labels == labels
    ]
    assert len(found) == 1, f"{name} {labels} is there {len(found)} times"
    return found[0]


def exercise(metrics: Metrics) -> None:
    """Everything once, so that every label is there."""
    device = metrics.device("imu")
    device.record_poll(Fault.NONE, 0.002)
    device.record_poll(Fault.CRC, 0.05)
    device.set_up(True)
    device.count_reconnect()
    metrics.record_frame(frame(HeaveState.VALID, 1.5, 1.25), age_s=0.003, step_s=0.0002)
    metrics.tick_lateness.observe(0.0001)
    metrics.training_runs.labels("accepted").inc()
    metrics.sea_fits.labels("rejected").inc()
    metrics.record_sea(with_sea(frame(HeaveState.VALID, 1.5)))
    metrics.training_age.set(30.0)
    metrics.filter_resets.labels("heave", "not_finite").inc()
    metrics.record_rock((RockScore(axis="roll", horizon_s=0.15, error_rad=0.001, coverage=0.95),))
    metrics.set_clients(2)
    metrics.count_sent(2)
    metrics.count_dropped("slow_client")
    metrics.count_client_error("bad_request")
    metrics.show_certificates([Span("certificate_file", 1.7e9, 1.8e9), Span("certificate_file", 1.7e9, 1.75e9)])
    metrics.clock_steps.inc()
    metrics.state_saves.labels("saved").inc()
    metrics.state_loads.labels("restored").inc()
    metrics.config_reloads.labels("applied").inc()
    metrics.have_outputs(lambda: [OutputHealth("dp", "EM3000", "udp://10.0.0.9:5000")])


def own_labels(family: Metric) -> tuple[str, ...]:
    return tuple(sorted({label for sample in family.samples for label in sample.labels} - {"le"}))


def test_names_types_and_labels_are_the_contract() -> None:
    metrics = Metrics("1.2.3")
    exercise(metrics)
    found = {(family.name, family.type, own_labels(family)) for family in families(metrics).values()}
    assert found == CONTRACT
    assert all(family.documentation for family in families(metrics).values())
    assert value(metrics, "heaved_certificate_end_timestamp_seconds", file="certificate_file") == 1.75e9


def test_what_can_go_wrong_is_counted_from_zero() -> None:
    """A rate over a series that appears with its first event misses that event."""
    metrics = Metrics("1.2.3")
    for name, label, first in (
        ("heaved_training_runs_total", "result", "failed"),
        ("heaved_sea_fits_total", "result", "failed"),
        ("heaved_state_saves_total", "result", "failed"),
        ("heaved_state_loads_total", "result", "refused"),
        ("heaved_config_reloads_total", "result", "refused"),
        ("heaved_frames_dropped_total", "reason", "slow_client"),
        ("heaved_client_errors_total", "reason", "too_many_clients"),
        ("heaved_client_errors_total", "reason", "line_too_long"),
        ("heaved_client_errors_total", "reason", "stuck"),
    ):
        assert value(metrics, name, **{label: first}) == 0.0


def test_values() -> None:
    metrics = Metrics("1.2.3")
    exercise(metrics)
    assert value(metrics, "heaved_build_info", version="1.2.3") == 1.0
    assert value(metrics, "heaved_device_up", device="imu") == 1.0
    assert value(metrics, "heaved_polls_total", device="imu", result="none") == 1.0
    assert value(metrics, "heaved_polls_total", device="imu", result="crc") == 1.0
    assert value(metrics, "heaved_polls_total", device="imu", result="timeout") == 0.0
    assert value(metrics, "heaved_poll_duration_seconds_count", device="imu") == 2.0
    assert value(metrics, "heaved_poll_duration_seconds_sum", device="imu") == pytest.approx(0.052)
    assert value(metrics, "heaved_poll_duration_seconds_bucket", device="imu", le="0.01") == 1.0
    assert value(metrics, "heaved_sample_age_seconds_sum") == pytest.approx(0.003)
    assert value(metrics, "heaved_step_duration_seconds_sum") == pytest.approx(0.0002)
    assert value(metrics, "heaved_heave_meters") == 1.5
    assert value(metrics, "heaved_heave_std_meters") == 0.02
    assert value(metrics, "heaved_reference_error_meters") == 0.25
    assert value(metrics, "heaved_lead_seconds") == 0.1
    assert value(metrics, "heaved_sea_fits_total", result="rejected") == 1.0
    assert value(metrics, "heaved_sea_fits_total", result="accepted") == 0.0
    assert value(metrics, "heaved_significant_heave_meters") == 2.5
    assert value(metrics, "heaved_peak_period_seconds") == 9.0
    assert value(metrics, "heaved_mean_period_seconds") == 7.5
    assert value(metrics, "heaved_delayed_heave_meters") == -0.75
    assert value(metrics, "heaved_clients") == 2.0
    assert value(metrics, "heaved_frames_sent_total") == 2.0
    assert value(metrics, "heaved_frames_dropped_total", reason="slow_client") == 1.0


def test_what_is_not_known_is_nan() -> None:
    metrics = Metrics("1.2.3")
    names = ("heaved_heave_meters", "heaved_reference_error_meters", "heaved_training_age_seconds")
    assert all(math.isnan(value(metrics, name)) for name in names)
    metrics.record_frame(frame(HeaveState.VALID, 1.5, 1.25), age_s=0.003, step_s=0.0002)
    metrics.record_frame(frame(HeaveState.VALID, 1.5), age_s=0.003, step_s=0.0002)
    assert value(metrics, "heaved_heave_meters") == 1.5
    assert math.isnan(value(metrics, "heaved_reference_error_meters"))


SHAKES = tuple(Vibration(frequency_hz=3.1 * k, width_hz=0.1, rms_mps2=0.3 / k) for k in (1, 2, 3, 4))
WHOLE_SEA = SeaState(
    significant_height_m=2.5, peak_period_s=9.0, mean_period_s=7.5, systems=(), frequencies_hz=(),
    spectrum_m2phz=(), t_s=990.0, vibration=SHAKES, noise_mps2_rthz=1e-3, bias_walk_mps2_rts=3e-5,
)  # fmt: skip
WHOLE_HULL = HullAngles(t_s=999.8, state="converged", total_rad=(0.1, 0.2, 0.3), std_rad=(0.01, 0.02, 0.03))
WHOLE_CRAFT = CraftMotion(
    t_s=999.9, heave_m=0.4, heave_velocity_mps=0.0, pitch_rad=0.05, pitch_rate_radps=0.0, heave_std_m=0.01,
    heave_velocity_std_mps=0.1, pitch_std_rad=0.001, pitch_rate_std_radps=0.01,
)  # fmt: skip
AGREED = MruAgreement(
    reference=1.6, own=1.5, difference=0.1, mean_difference=0.02, std_difference=0.05, rms_difference=0.06,
    explained=0.07, correlation=0.99, delay_s=0.12, scale=0.97,
)  # fmt: skip
WHOLE_MRU = MruComparison(t_s=999.9, heave=AGREED, roll=AGREED, pitch=AGREED)
WHOLE = MotionFrame(
    t_s=1000.0,
    quality=Quality(heave=HeaveState.VALID, laser=LaserState.VALID, correction=CorrectionState.ACTIVE),
    heave_m=1.5,
    heave_std_m=0.02,
    lead_s=0.1,
    reference_m=1.25,
    sea=WHOLE_SEA,
    delayed=DelayedHeave(t_s=940.0, heave_m=-0.75, std_m=0.01),
    hull=WHOLE_HULL,
    attitude=WHOLE_CRAFT,
    reference_mru=WHOLE_MRU,
    quiet=QuietForecast(
        t_s=1000.0, window=QuietWindow(t_s=1000.0, start_s=12.0, length_s=15.0, confidence=0.85), best=0.9
    ),
)  # fmt: skip
"""All that a frame may have."""
SCORES = (RockScore(axis="roll", horizon_s=0.15, error_rad=0.001, coverage=0.95),)
NOW = {"heaved_heave_meters", "heaved_heave_std_meters", "heaved_reference_error_meters", "heaved_lead_seconds"}
SHAKING = {"heaved_vibration_mps2", "heaved_vibration_hertz"}
NOISE = {"heaved_accelerometer_noise_mps2_rthz", "heaved_accelerometer_bias_walk_mps2_rts"}
HEIGHTS = {"heaved_significant_heave_meters", "heaved_peak_period_seconds", "heaved_mean_period_seconds"}
SEA = HEIGHTS | NOISE | SHAKING
DELAYED = {"heaved_delayed_heave_meters"}
HULL = {"heaved_hull_angle_radians", "heaved_hull_std_radians"}
CRAFT = {f"heaved_attitude_{x}" for x in ("heave_meters", "heave_std_meters", "pitch_radians", "pitch_std_radians")}
ROCK = {"heaved_rock_error_radians", "heaved_rock_coverage_ratio"}
QUIET = {"heaved_quiet_confidence_ratio", "heaved_quiet_start_seconds"}
TRAINED = {"heaved_training_age_seconds"}
MRU = {
    f"heaved_reference_{x}"
    for x in ("difference_meters", "difference_radians", "correlation_ratio", "delay_seconds", "scale_ratio")
}
ALL = NOW | SEA | DELAYED | HULL | CRAFT | MRU | ROCK | QUIET | TRAINED


def changed(**changes: object) -> MotionFrame:
    return msgspec.structs.replace(WHOLE, **changes)


def judged(**changes: object) -> MotionFrame:
    return changed(quality=msgspec.structs.replace(WHOLE.quality, **changes))


def record(metrics: Metrics, frame: MotionFrame | None, scores: tuple[RockScore, ...] = SCORES) -> None:
    """What the daemon does with each frame, and once a second."""
    if frame is None:
        metrics.record_no_frame()
        return
    metrics.record_frame(frame, age_s=0.003, step_s=0.0002)
    metrics.record_sea(frame)
    metrics.record_stages(frame)
    metrics.record_quiet(frame.quiet)
    metrics.record_training(frame, 30.0)
    metrics.record_rock(scores)


def unknown(metrics: Metrics) -> set[str]:
    """Gauges of which any series is NaN."""
    return {
        family.name
        for family in families(metrics).values()
        for sample in family.samples
        if family.type == "gauge" and math.isnan(sample.value)
    }


GONE: dict[str, tuple[MotionFrame | None, set[str]]] = {
    "nothing": (WHOLE, set()),
    "frames": (None, ALL),
    "the heave": (judged(heave=HeaveState.INVALID), NOW | SEA | DELAYED),
    "the laser": (judged(laser=LaserState.STALE), {"heaved_reference_error_meters"}),
    "the laser's reading": (changed(reference_m=math.nan), {"heaved_reference_error_meters"}),
    "the sea": (changed(sea=None), SEA),
    "fits of the sea": (changed(sea=msgspec.structs.replace(WHOLE_SEA, t_s=399.0)), SEA),
    "what shakes": (changed(sea=msgspec.structs.replace(WHOLE_SEA, vibration=SHAKES[:2])), SHAKING),
    "what is known of the noise": (
        changed(sea=msgspec.structs.replace(WHOLE_SEA, noise_mps2_rthz=math.nan, bias_walk_mps2_rts=math.nan)),
        NOISE,
    ),
    "the delayed heave": (changed(delayed=None), DELAYED),
    "the smoother": (changed(t_s=1006.0, hull=None, attitude=None), DELAYED | HULL | CRAFT | MRU),
    "the reference MRU": (changed(reference_mru=msgspec.structs.replace(WHOLE_MRU, t_s=994.9)), MRU),
    "roll of the reference MRU": (
        changed(reference_mru=MruComparison(t_s=999.9, heave=AGREED, pitch=AGREED)),
        {"heaved_reference_difference_radians"},
    ),
    "the second IMU": (changed(hull=msgspec.structs.replace(WHOLE_HULL, t_s=994.9)), HULL),
    "the hull's stage": (changed(hull=None), HULL),
    "the craft's sensors": (changed(attitude=msgspec.structs.replace(WHOLE_CRAFT, t_s=994.9)), CRAFT),
    "the craft's stage": (changed(attitude=None), CRAFT),
    "the correction": (judged(correction=CorrectionState.OFF), TRAINED),
    "quiet windows": (changed(quiet=None), QUIET),
}


@pytest.mark.parametrize("gone", GONE)
def test_a_gauge_is_nan_when_what_it_describes_is_gone(gone: str) -> None:
    frame, void = GONE[gone]
    metrics = Metrics("1.2.3")
    record(metrics, WHOLE)
    assert unknown(metrics) == set()
    record(metrics, frame)
    assert unknown(metrics) == void
    record(metrics, changed(t_s=1000.01, delayed=DelayedHeave(t_s=941.0, heave_m=0.2, std_m=0.01)))
    assert unknown(metrics) == set()


def test_what_shakes_comes_strongest_first_and_no_more_than_three() -> None:
    metrics = Metrics("1.2.3")
    record(metrics, WHOLE)
    for rank, hertz, mps2 in (("1", 3.1, 0.3), ("2", 6.2, 0.15), ("3", 9.3, 0.1)):
        assert value(metrics, "heaved_vibration_hertz", rank=rank) == pytest.approx(hertz)
        assert value(metrics, "heaved_vibration_mps2", rank=rank) == pytest.approx(mps2)
    assert len(families(metrics)["heaved_vibration_mps2"].samples) == 3
    assert value(metrics, "heaved_accelerometer_noise_mps2_rthz") == 1e-3
    assert value(metrics, "heaved_accelerometer_bias_walk_mps2_rts") == 3e-5


def test_scores_of_predictions_that_are_not_made_are_nan() -> None:
    metrics = Metrics("1.2.3")
    record(metrics, WHOLE)
    record(metrics, WHOLE, scores=())
    assert unknown(metrics) == ROCK


def test_every_gauge_of_the_estimators_can_become_nan() -> None:
    """A new one must be in the table above."""
    kept = {
        "heaved_build_info", "heaved_device_up", "heaved_output_up", "heaved_quality", "heaved_clients",
        "heaved_certificate_end_timestamp_seconds", "heaved_frames_at_once",
    }  # fmt: skip
    assert {name for name, kind, _ in CONTRACT if kind == "gauge"} - kept == ALL


def test_without_frames_the_heave_is_invalid() -> None:
    metrics = Metrics("1.2.3")
    record(metrics, WHOLE)
    record(metrics, None)
    assert value(metrics, "heaved_quality", state="invalid") == 1.0
    assert value(metrics, "heaved_quality", state="valid") == 0.0


def test_quality_is_one_hot() -> None:
    metrics = Metrics("1.2.3")
    for heave in (*HeaveState, *HeaveState):
        metrics.record_frame(frame(heave), age_s=0.0, step_s=0.0)
        states = {state.value: value(metrics, "heaved_quality", state=state.value) for state in HeaveState}
        assert states == {state.value: float(state is heave) for state in HeaveState}


def test_two_daemons_in_one_process_do_not_share() -> None:
    first, second = Metrics("1"), Metrics("2")
    first.count_sent(5)
    assert value(first, "heaved_frames_sent_total") == 5.0
    assert value(second, "heaved_frames_sent_total") == 0.0


def test_attitude_predictions_and_quiet_windows() -> None:
    metrics = Metrics("1.0")
    assert math.isnan(value(metrics, "heaved_quiet_start_seconds"))
    metrics.record_rock((RockScore(axis="yaw", horizon_s=1.0, error_rad=0.002, coverage=0.94),))
    assert value(metrics, "heaved_rock_error_radians", axis="yaw", horizon="1") == 0.002
    assert value(metrics, "heaved_rock_coverage_ratio", axis="yaw", horizon="1") == 0.94
    window = QuietWindow(t_s=5.0, start_s=12.0, length_s=15.0, confidence=0.85)
    metrics.record_quiet(QuietForecast(t_s=5.0, window=window, best=0.9))
    assert value(metrics, "heaved_quiet_start_seconds") == 12.0
    assert value(metrics, "heaved_quiet_confidence_ratio") == 0.9
    metrics.record_quiet(QuietForecast(t_s=6.0, best=0.3))
    assert math.isnan(value(metrics, "heaved_quiet_start_seconds"))
    assert value(metrics, "heaved_quiet_confidence_ratio") == 0.3


def test_outputs_are_read_when_they_are_asked_for() -> None:
    metrics = Metrics("1.2.3")
    health = OutputHealth("dp", "EM3000", "udp://10.0.0.9:5000")
    outputs = [health]
    metrics.have_outputs(lambda: outputs)
    assert value(metrics, "heaved_output_up", output="dp") == 0
    for reason in ("down", "slow", "not known"):  # From the start: a rate would miss the first one.
        assert value(metrics, "heaved_output_lost_total", output="dp", reason=reason) == 0
    health.up()
    health.sent += 5
    health.lost["slow"] += 2
    health.lost["odd"] += 1
    assert value(metrics, "heaved_output_up", output="dp") == 1
    assert value(metrics, "heaved_output_connections_total", output="dp") == 1
    assert value(metrics, "heaved_output_messages_total", output="dp") == 5
    assert value(metrics, "heaved_output_lost_total", output="dp", reason="slow") == 2
    assert value(metrics, "heaved_output_lost_total", output="dp", reason="odd") == 1
    assert dict(health.lost) == {"slow": 2, "odd": 1}  # Reading has changed nothing.
    outputs.clear()
    assert not families(metrics)["heaved_output_up"].samples

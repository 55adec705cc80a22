"""Every Prometheus metric of the daemon, in one table. Costs: an increment under 1 µs, an observation 1.5 µs."""

from __future__ import annotations

from math import nan
from typing import Final

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    Info,
    disable_created_metrics,
    generate_latest,
)

from heaved.samples import Fault, HeaveState, MotionFrame, QuietForecast, RockScore

_SHORT_S: Final = (0.00005, 0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.1)
"""Work on the event loop: 50 µs is well, 10 ms is a whole sample period."""
_BUS_S: Final = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0)
"""A request and its answer: under 1 ms over Ethernet, 50 ms on a slow serial line."""


class DeviceMetrics:
    """The metrics of one device, bound to its name once: looking the labels up costs more than counting."""

    def __init__(self, up: Gauge, reconnects: Counter, poll_duration: Histogram, polls: dict[Fault, Counter]) -> None:
        self._up = up
        self._reconnects = reconnects
        self._poll_duration = poll_duration
        self._polls = polls

    def record_poll(self, fault: Fault, duration_s: float) -> None:
        """One request, however it ended. ``duration_s``: from the request to the answer or the giving up."""
        self._polls[fault].inc()
        self._poll_duration.observe(duration_s)

    def set_up(self, up: bool) -> None:
        self._up.set(up)

    def count_reconnect(self) -> None:
        self._reconnects.inc()


class Metrics:
    """One per daemon, with a registry of its own. What is not known yet is NaN, as Prometheus has it."""

    def __init__(self, release: str) -> None:
        disable_created_metrics()  # type: ignore[no-untyped-call]  # A time of creation beside every counter is noise.
        registry = CollectorRegistry()
        self._registry = registry

        Info("heaved_build", "Release of the daemon.", registry=registry).info({"version": release})
        self.device_up = Gauge(
            "heaved_device_up", "1 while the device gives good samples.", ["device"], registry=registry
        )
        self.polls = Counter(
            "heaved_polls_total", "Requests to a device by how they ended.", ["device", "result"], registry=registry
        )
        self.poll_duration = Histogram(
            "heaved_poll_duration_seconds",
            "From the request to the answer or the giving up.",
            ["device"],
            registry=registry,
            buckets=_BUS_S,
        )
        self.reconnects = Counter(
            "heaved_reconnects_total", "Connections to a device opened again.", ["device"], registry=registry
        )
        self.sample_age = Histogram(
            "heaved_sample_age_seconds",
            "From the validity of a frame to its publication.",
            registry=registry,
            buckets=_BUS_S,
        )
        self.step_duration = Histogram(
            "heaved_step_duration_seconds", "One step of the pipeline.", registry=registry, buckets=_SHORT_S
        )
        self.tick_lateness = Histogram(
            "heaved_tick_lateness_seconds", "Lateness of the polling timer.", registry=registry, buckets=_SHORT_S
        )
        self.heave = Gauge("heaved_heave_meters", "Published heave, positive up.", registry=registry)
        self.heave_std = Gauge("heaved_heave_std_meters", "Standard deviation of the heave.", registry=registry)
        self.reference_error = Gauge(
            "heaved_reference_error_meters", "Heave minus the laser's, while the laser is fresh.", registry=registry
        )
        self.lead = Gauge(
            "heaved_lead_seconds", "Lead of the inertial displacement over the truth.", registry=registry
        )
        self.quality = Gauge(
            "heaved_quality", "1 for the present state of the heave, 0 for the others.", ["state"], registry=registry
        )
        self.training_runs = Counter(
            "heaved_training_runs_total", "Trainings of the correction by result.", ["result"], registry=registry
        )
        self.training_age = Gauge(
            "heaved_training_age_seconds", "Since the correction in use was accepted.", registry=registry
        )
        self.sea_fits = Counter(
            "heaved_sea_fits_total", "Fits of the sea model by result.", ["result"], registry=registry
        )
        self.significant_height = Gauge(
            "heaved_significant_heave_meters", "Significant height of the heave: 4 standard deviations.",
            registry=registry,
        )  # fmt: skip
        self.peak_period = Gauge("heaved_peak_period_seconds", "Of the heave spectrum.", registry=registry)
        self.mean_period = Gauge("heaved_mean_period_seconds", "m0/m1 of the heave spectrum.", registry=registry)
        self.delayed_heave = Gauge(
            "heaved_delayed_heave_meters", "Delayed heave, valid at its own, earlier time.", registry=registry
        )
        self.hull_angle = Gauge(
            "heaved_hull_angle_radians", "Deformation between the IMUs, total.", ["axis"], registry=registry
        )
        self.hull_std = Gauge(
            "heaved_hull_std_radians", "Standard deviation of the deformation.", ["axis"], registry=registry
        )
        self.attitude_heave = Gauge("heaved_attitude_heave_meters", "Heave of the craft, fused.", registry=registry)
        self.attitude_heave_std = Gauge(
            "heaved_attitude_heave_std_meters", "Standard deviation of that heave.", registry=registry
        )
        self.attitude_pitch = Gauge("heaved_attitude_pitch_radians", "Pitch of the craft, fused.", registry=registry)
        self.attitude_pitch_std = Gauge(
            "heaved_attitude_pitch_std_radians", "Standard deviation of that pitch.", registry=registry
        )
        self.rock_error = Gauge(
            "heaved_rock_error_radians", "Rolling RMS error of the attitude predictions.", ["axis", "horizon"],
            registry=registry,
        )  # fmt: skip
        self.rock_coverage = Gauge(
            "heaved_rock_coverage_ratio", "Rolling share of angles within their 95 % interval.", ["axis", "horizon"],
            registry=registry,
        )  # fmt: skip
        self.quiet_confidence = Gauge(
            "heaved_quiet_confidence_ratio", "Of the surest quiet window within the look-ahead.", registry=registry
        )
        self.quiet_start = Gauge(
            "heaved_quiet_start_seconds", "From now to the next quiet window that is sure enough.", registry=registry
        )
        self.filter_resets = Counter(
            "heaved_filter_resets_total", "Estimators started afresh.", ["filter", "reason"], registry=registry
        )
        self.clients = Gauge("heaved_clients", "Connections to the stream.", registry=registry)
        self.frames_sent = Counter(
            "heaved_frames_sent_total", "Frames handed to a client's connection, all clients together.",
            registry=registry,
        )  # fmt: skip
        self.frames_dropped = Counter(
            "heaved_frames_dropped_total", "Lines dropped before they were sent.", ["reason"], registry=registry
        )
        self.client_errors = Counter(
            "heaved_client_errors_total", "Clients turned away or misunderstood.", ["reason"], registry=registry
        )
        self.clock_steps = Counter("heaved_clock_steps_total", "Steps of the system's UTC.", registry=registry)
        self.state_saves = Counter(
            "heaved_state_saves_total", "Saves of the state file by result.", ["result"], registry=registry
        )
        self.state_loads = Counter(
            "heaved_state_loads_total", "Restorings of the saved state by result.", ["result"], registry=registry
        )
        self.config_reloads = Counter(
            "heaved_config_reloads_total", "Reloads of the configuration by result.", ["result"], registry=registry
        )

        # Series that exist from the start: a rate over a counter that appears with its first event misses that event.
        for counter, values in (
            (self.training_runs, ("accepted", "rejected", "failed")),
            (self.sea_fits, ("accepted", "rejected", "failed")),
            (self.state_saves, ("saved", "failed")),
            (self.state_loads, ("restored", "absent", "refused")),
            (self.config_reloads, ("applied", "refused")),
            (self.frames_dropped, ("slow_client",)),
            (self.client_errors, ("bad_request", "line_too_long", "not_allowed", "stuck", "too_many_clients")),
        ):
            for value in values:
                counter.labels(value)

        self._quality_states = {state: self.quality.labels(state.value) for state in HeaveState}
        self._quality: HeaveState | None = None
        for gauge in (self.heave, self.heave_std, self.reference_error, self.lead, self.training_age):
            gauge.set(nan)
        for gauge in (self.quiet_confidence, self.quiet_start):
            gauge.set(nan)
        for gauge in (self.significant_height, self.peak_period, self.mean_period, self.delayed_heave):
            gauge.set(nan)
        self._attitude = (
            self.attitude_heave,
            self.attitude_heave_std,
            self.attitude_pitch,
            self.attitude_pitch_std,
        )
        self._hull = tuple((self.hull_angle.labels(axis), self.hull_std.labels(axis)) for axis in "xyz")
        for gauge in (*self._attitude, *(gauge for pair in self._hull for gauge in pair)):
            gauge.set(nan)

    def device(self, name: str) -> DeviceMetrics:
        """The metrics of one device; they appear, at zero, with this call."""
        return DeviceMetrics(
            up=self.device_up.labels(name),
            reconnects=self.reconnects.labels(name),
            poll_duration=self.poll_duration.labels(name),
            polls={fault: self.polls.labels(name, fault.value) for fault in Fault},
        )

    def record_frame(self, frame: MotionFrame, *, age_s: float, step_s: float) -> None:
        """One frame. ``age_s``: validity to publication; ``step_s``: what the pipeline took for it."""
        self.sample_age.observe(age_s)
        self.step_duration.observe(step_s)
        self.heave.set(frame.heave_m)
        self.heave_std.set(frame.heave_std_m)
        self.reference_error.set(frame.heave_m - frame.reference_m)
        self.lead.set(frame.lead_s)
        if frame.quality.heave is not self._quality:
            self._quality = frame.quality.heave
            for state, gauge in self._quality_states.items():
                gauge.set(state is self._quality)

    def record_sea(self, frame: MotionFrame) -> None:
        """What changes slowly: sea state and delayed heave."""
        if frame.sea is not None:
            self.significant_height.set(frame.sea.significant_height_m)
            self.peak_period.set(frame.sea.peak_period_s)
            self.mean_period.set(frame.sea.mean_period_s)
        self.delayed_heave.set(frame.delayed.heave_m if frame.delayed is not None else nan)

    def record_stages(self, frame: MotionFrame) -> None:
        """What the stages beside the heave have to say."""
        if (hull := frame.hull) is not None:
            for gauges, angle, std in zip(self._hull, hull.total_rad, hull.std_rad, strict=True):
                gauges[0].set(angle)
                gauges[1].set(std)
        if (motion := frame.attitude) is not None:
            values = (motion.heave_m, motion.heave_std_m, motion.pitch_rad, motion.pitch_std_rad)
            for gauge, value in zip(self._attitude, values, strict=True):
                gauge.set(value)

    def record_rock(self, scores: tuple[RockScore, ...]) -> None:
        """How the attitude predictions have fared."""
        for score in scores:
            horizon = f"{score.horizon_s:g}"
            self.rock_error.labels(score.axis, horizon).set(score.error_rad)
            self.rock_coverage.labels(score.axis, horizon).set(score.coverage)

    def record_quiet(self, quiet: QuietForecast | None) -> None:
        """What is foreseen of quiet windows; None: it is not asked for."""
        window = quiet.window if quiet is not None else None
        self.quiet_confidence.set(quiet.best if quiet is not None else nan)
        self.quiet_start.set(window.start_s if window is not None else nan)

    # What the stream's publisher counts.

    def set_clients(self, clients: int) -> None:
        self.clients.set(clients)

    def count_sent(self, frames: int) -> None:
        self.frames_sent.inc(frames)

    def count_dropped(self, reason: str) -> None:
        self.frames_dropped.labels(reason).inc()

    def count_client_error(self, reason: str) -> None:
        self.client_errors.labels(reason).inc()

    def render(self) -> bytes:
        """Everything, in the text format of Prometheus, version 0.0.4."""
        return generate_latest(self._registry)

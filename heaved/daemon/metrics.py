"""Every Prometheus metric of the daemon, in one table. Costs: an increment under 1 µs, an observation less.

A gauge describes something that is there now: when that is gone (no frame, no heave that means something, no laser, no
fit of the sea, an estimate that is not renewed), it is NaN.
"""

from __future__ import annotations

from bisect import bisect_left
from itertools import accumulate, zip_longest
from math import nan
from typing import TYPE_CHECKING, Final

from prometheus_client import (
    CollectorRegistry,
    Counter,
    Gauge,
    Info,
    disable_created_metrics,
    generate_latest,
)
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, HistogramMetricFamily, Metric
from prometheus_client.registry import Collector
from prometheus_client.utils import floatToGoString

from heaved.outputs.senders.sender import DOWN, SLOW
from heaved.outputs.telegram_output import NOT_KNOWN
from heaved.samples import (
    MOST_NAMED,
    CorrectionState,
    Fault,
    HeaveState,
    LaserState,
    MotionFrame,
    MruAgreement,
    MruComparison,
    QuietForecast,
    RockScore,
    SeaState,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

    from heaved.outputs.output import OutputHealth
    from heaved.outputs.tls import Span

_SHORT_S: Final = (0.00005, 0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.1)
"""Work on the event loop: 50 µs is well, 10 ms is a whole sample period."""
_BUS_S: Final = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1.0)
"""A request and its answer: under 1 ms over Ethernet, 50 ms on a slow serial line."""

RENEWED_S: Final = 5.0
"""What comes several times a second and is older than this is not being estimated any more."""
SEA_S: Final = 600.0
"""A fit of the sea is one of the present sea for so long: it is renewed at least every five minutes."""

LOST: Final = (DOWN, SLOW, NOT_KNOWN)
"""Reasons that have a series from the start."""


class Distribution:
    """How often values fell where, in a fifth of the time that the library's own histogram takes: there are hundreds of
    values a second.
    """

    def __init__(self, bounds: tuple[float, ...]) -> None:
        """``bounds``: upper ends of the buckets, increasing."""
        self._bounds = bounds
        self._counts = [0] * (len(bounds) + 1)
        self.total = 0.0
        """Sum of the values."""

    def observe(self, value: float) -> None:
        """One value."""
        self._counts[bisect_left(self._bounds, value)] += 1
        self.total += value

    def buckets(self) -> list[tuple[str, float]]:
        """Values up to each bound, as Prometheus counts."""
        ends = [*map(floatToGoString, self._bounds), "+Inf"]
        return [(end, float(count)) for end, count in zip(ends, accumulate(self._counts), strict=True)]


class Histogram(Collector):
    """The distributions of one metric, by their labels."""

    def __init__(self, name: str, what: str, bounds: tuple[float, ...], labels: tuple[str, ...]) -> None:
        self._name, self._what, self._bounds, self._labels = name, what, bounds, labels
        self._series: dict[tuple[str, ...], Distribution] = {}

    def labels(self, *values: str) -> Distribution:
        """The distribution with these labels; it appears with this call."""
        return self._series.setdefault(values, Distribution(self._bounds))

    def collect(self) -> Iterator[HistogramMetricFamily]:
        """What the registry asks for."""
        family = HistogramMetricFamily(self._name, self._what, labels=self._labels)
        for values, distribution in self._series.items():
            family.add_metric(values, distribution.buckets(), distribution.total)
        yield family


class OutputMetrics(Collector):
    """How the outputs beside the stream fare, read when it is asked for: a message costs nothing here."""

    def __init__(self, health: Callable[[], Iterable[OutputHealth]]) -> None:
        self._health = health

    def collect(self) -> Iterator[Metric]:
        """What the registry asks for."""
        up = GaugeMetricFamily("heaved_output_up", "1 while what it says goes out.", labels=["output"])
        sent = CounterMetricFamily("heaved_output_messages_total", "Messages that went out.", labels=["output"])
        lost = CounterMetricFamily(
            "heaved_output_lost_total", "Messages that did not go out, by reason.", labels=["output", "reason"]
        )
        connections = CounterMetricFamily(
            "heaved_output_connections_total", "Times that it came up, and readers that connected.", labels=["output"]
        )
        for health in self._health():
            up.add_metric([health.name], float(health.is_up))
            sent.add_metric([health.name], health.sent)
            for reason in dict.fromkeys((*LOST, *health.lost)):
                lost.add_metric([health.name, reason], health.lost[reason])
            connections.add_metric([health.name], health.connections)
        yield from (up, sent, lost, connections)


class DeviceMetrics:
    """The metrics of one device, bound to its name once: looking the labels up costs more than counting."""

    def __init__(
        self, up: Gauge, reconnects: Counter, poll_duration: Distribution, polls: dict[Fault, Counter]
    ) -> None:
        self._up = up
        self._reconnects = reconnects
        self._poll_duration = poll_duration
        self._polls = polls

    def record_poll(self, fault: Fault, duration_s: float) -> None:
        """One request, however it ended. ``duration_s``: from the request to the answer or the giving up."""
        self._polls[fault].inc()
        self._poll_duration.observe(duration_s)

    def set_up(self, up: bool) -> None:
        """Whether it gives good samples."""
        self._up.set(up)

    def count_reconnect(self) -> None:
        """Its connection was opened again."""
        self._reconnects.inc()


class _Table:
    """Makes the metrics of one registry. Series exist from the start where their labels are known: a rate over a
    counter that appears with its first event misses that event.
    """

    def __init__(self, registry: CollectorRegistry) -> None:
        self._registry = registry

    def gauge(self, name: str, what: str, *labels: str) -> Gauge:
        return Gauge(name, what, labels, registry=self._registry)

    def unknown(self, name: str, what: str) -> Gauge:
        """A gauge that is not known yet."""
        gauge = self.gauge(name, what)
        gauge.set(nan)
        return gauge

    def counter(self, name: str, what: str, *labels: str) -> Counter:
        return Counter(name, what, labels, registry=self._registry)

    def results(self, name: str, what: str, *values: str, label: str = "result") -> Counter:
        """A counter by one label, of which these values are known."""
        counter = self.counter(name, what, label)
        for value in values:
            counter.labels(value)
        return counter

    def histogram(self, name: str, what: str, buckets: tuple[float, ...], *labels: str) -> Histogram:
        made = Histogram(name, what, buckets, labels)
        self._registry.register(made)
        return made

    def distribution(self, name: str, what: str, buckets: tuple[float, ...]) -> Distribution:
        """A histogram without labels."""
        return self.histogram(name, what, buckets).labels()


class Metrics:
    """One per daemon, with a registry of its own. What is not known yet is NaN, as Prometheus has it."""

    def __init__(self, release: str) -> None:
        disable_created_metrics()  # type: ignore[no-untyped-call]  # A time of creation beside every counter is noise.
        self._registry = CollectorRegistry()
        Info("heaved_build", "Release of the daemon.", registry=self._registry).info({"version": release})
        table = _Table(self._registry)
        self._have_devices(table)
        self._have_heave(table)
        self._have_learning(table)
        self._have_sea(table)
        self._have_stages(table)
        self._have_rock(table)
        self._have_stream(table)
        self._have_daemon(table)

    def _have_devices(self, table: _Table) -> None:
        self.device_up = table.gauge("heaved_device_up", "1 while the device gives good samples.", "device")
        self.polls = table.counter("heaved_polls_total", "Requests to a device by how they ended.", "device", "result")
        self.poll_duration = table.histogram(
            "heaved_poll_duration_seconds", "From the request to the answer or the giving up.", _BUS_S, "device"
        )
        self.reconnects = table.counter("heaved_reconnects_total", "Connections to a device opened again.", "device")

    def _have_heave(self, table: _Table) -> None:
        self.sample_age = table.distribution(
            "heaved_sample_age_seconds", "From the validity of a frame to its publication.", _BUS_S
        )
        self.step_duration = table.distribution("heaved_step_duration_seconds", "One step of the pipeline.", _SHORT_S)
        self.tick_lateness = table.distribution(
            "heaved_tick_lateness_seconds", "Lateness of the polling timer.", _SHORT_S
        )
        self.heave = table.unknown("heaved_heave_meters", "Published heave, positive up.")
        self.heave_std = table.unknown("heaved_heave_std_meters", "Standard deviation of the heave.")
        self.reference_error = table.unknown(
            "heaved_reference_error_meters", "Heave minus the laser's, while the laser is fresh."
        )
        self.lead = table.unknown("heaved_lead_seconds", "Lead of the inertial displacement over the truth.")
        self.quality = table.gauge("heaved_quality", "1 for the present state of the heave, 0 for the others.", "state")
        self._quality_states = {state: self.quality.labels(state.value) for state in HeaveState}
        self._last_frame: MotionFrame | None = None
        self._now = (self.heave, self.heave_std, self.reference_error, self.lead)

    def _have_learning(self, table: _Table) -> None:
        results = ("accepted", "rejected", "failed")
        self.training_runs = table.results(
            "heaved_training_runs_total", "Trainings of the correction by result.", *results
        )
        self.training_age = table.unknown("heaved_training_age_seconds", "Since the correction in use was accepted.")
        self.sea_fits = table.results("heaved_sea_fits_total", "Fits of the sea model by result.", *results)

    def _have_sea(self, table: _Table) -> None:
        self.significant_height = table.unknown(
            "heaved_significant_heave_meters", "Significant height of the heave: 4 standard deviations."
        )
        self.peak_period = table.unknown("heaved_peak_period_seconds", "Of the heave spectrum.")
        self.mean_period = table.unknown("heaved_mean_period_seconds", "m0/m1 of the heave spectrum.")
        self.noise = table.unknown(
            "heaved_accelerometer_noise_mps2_rthz", "White noise of the accelerometer, one-sided density."
        )
        self.bias_walk = table.unknown(
            "heaved_accelerometer_bias_walk_mps2_rts", "Random walk of the accelerometer's bias."
        )
        self.vibration = table.gauge("heaved_vibration_mps2", "RMS of what shakes the hull, strongest first.", "rank")
        self.vibration_frequency = table.gauge("heaved_vibration_hertz", "Its frequency, as it is seen.", "rank")
        ranks = [str(rank) for rank in range(1, MOST_NAMED + 1)]
        self._vibration = [(self.vibration.labels(rank), self.vibration_frequency.labels(rank)) for rank in ranks]
        for pair in self._vibration:
            _set(pair, ())
        self._sea = (self.significant_height, self.peak_period, self.mean_period, self.noise, self.bias_walk)
        self.delayed_heave = table.unknown(
            "heaved_delayed_heave_meters", "Delayed heave, valid at its own, earlier time."
        )
        self._delayed_t_s = nan
        self._delayed_since_s = nan
        """When that one was there first."""

    def _have_stages(self, table: _Table) -> None:
        self.hull_angle = table.gauge("heaved_hull_angle_radians", "Deformation between the IMUs, total.", "axis")
        self.hull_std = table.gauge("heaved_hull_std_radians", "Standard deviation of the deformation.", "axis")
        self._hull = tuple((self.hull_angle.labels(axis), self.hull_std.labels(axis)) for axis in "xyz")
        for gauge in (gauge for pair in self._hull for gauge in pair):
            gauge.set(nan)
        self._attitude = (
            table.unknown("heaved_attitude_heave_meters", "Heave of the craft, fused."),
            table.unknown("heaved_attitude_heave_std_meters", "Standard deviation of that heave."),
            table.unknown("heaved_attitude_pitch_radians", "Pitch of the craft, fused."),
            table.unknown("heaved_attitude_pitch_std_radians", "Standard deviation of that pitch."),
        )
        self._have_reference(table)

    def _have_reference(self, table: _Table) -> None:
        """Of an existing MRU; heave in metres and angles in radians apart, since a metric has one unit."""
        names = ("latest", "mean", "std", "explained")
        self.reference_difference = table.gauge(
            "heaved_reference_difference_meters",
            "Heave of the reference MRU minus ours, and what both explain.",
            "kind",
        )
        self.reference_angle_difference = table.gauge(
            "heaved_reference_difference_radians", "Roll and pitch of the reference MRU minus ours.", "axis", "kind"
        )
        self._reference_heave = tuple(self.reference_difference.labels(name) for name in names)
        self._reference_angles = tuple(
            tuple(self.reference_angle_difference.labels(axis, name) for name in names) for axis in ("roll", "pitch")
        )
        self._reference_likeness = (
            table.unknown("heaved_reference_correlation_ratio", "Of the heave of the reference MRU with ours."),
            table.unknown("heaved_reference_delay_seconds", "By which the reference MRU is late."),
            table.unknown("heaved_reference_scale_ratio", "Heave of the reference MRU over ours."),
        )
        self._set_reference(None)

    def _have_rock(self, table: _Table) -> None:
        self.rock_error = table.gauge(
            "heaved_rock_error_radians", "Rolling RMS error of the attitude predictions.", "axis", "horizon"
        )
        self.rock_coverage = table.gauge(
            "heaved_rock_coverage_ratio", "Rolling share of angles within their 95 % interval.", "axis", "horizon"
        )
        self._scored: set[tuple[str, str]] = set()
        """Axes and horizons that have series."""
        self.quiet_confidence = table.unknown(
            "heaved_quiet_confidence_ratio", "Of the surest quiet window within the look-ahead."
        )
        self.quiet_start = table.unknown(
            "heaved_quiet_start_seconds", "From now to the next quiet window that is sure enough."
        )
        self.filter_resets = table.counter(
            "heaved_filter_resets_total", "Estimators started afresh.", "filter", "reason"
        )

    def _have_stream(self, table: _Table) -> None:
        self.clients = table.gauge("heaved_clients", "Connections to the stream.")
        self.frames_sent = table.counter(
            "heaved_frames_sent_total", "Frames handed to a client's connection, all clients together."
        )
        self.frames_dropped = table.results(
            "heaved_frames_dropped_total", "Lines dropped before they were sent.", "slow_client", label="reason"
        )
        reasons = (
            "bad_request", "line_too_long", "not_allowed", "request_too_slow", "stuck", "tls", "too_fast",
            "too_many_clients", "too_many_of_one_address",
        )  # fmt: skip
        self.client_errors = table.results(
            "heaved_client_errors_total", "Clients turned away or misunderstood.", *reasons, label="reason"
        )

        self.certificate_end = table.gauge(
            "heaved_certificate_end_timestamp_seconds", "When the first certificate of a file of [tls] ends.", "file"
        )

    def _have_daemon(self, table: _Table) -> None:
        self.clock_steps = table.counter("heaved_clock_steps_total", "Steps of the system's UTC.")
        self.frames_at_once = table.gauge(
            "heaved_frames_at_once", "That go to clients of the stream; more than 1: the machine does not keep up."
        )
        self.frames_at_once.set(1)
        self.overloaded = table.results(
            "heaved_overloaded_seconds_total",
            "For which the machine did not keep up, by what gave way: frames gathered, and predictions left out.",
            "gathered", "left_out", label="relief",
        )  # fmt: skip
        self.state_saves = table.results(
            "heaved_state_saves_total", "Saves of the state file by result.", "saved", "failed"
        )
        self.state_loads = table.results(
            "heaved_state_loads_total", "Restorings of the saved state by result.", "restored", "absent", "refused"
        )
        self.config_reloads = table.results(
            "heaved_config_reloads_total", "Reloads of the configuration by result.", "applied", "refused"
        )

    def have_outputs(self, health: Callable[[], Iterable[OutputHealth]]) -> None:
        """``health``: of the outputs that there are; to be called once."""
        self._registry.register(OutputMetrics(health))

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
        self._last_frame = frame

    def _show(self, frame: MotionFrame) -> None:
        """Set the gauges that describe the last frame, which nobody sees but when they are asked for."""
        is_known = frame.quality.heave is not HeaveState.INVALID
        error_m = frame.heave_m - frame.reference_m if frame.quality.laser is LaserState.VALID else nan
        _set(self._now, (frame.heave_m, frame.heave_std_m, error_m, frame.lead_s) if is_known else ())
        self._set_quality(frame.quality.heave)

    def record_no_frame(self) -> None:
        """There is none, or no new one: nothing that frames describe is known."""
        self._last_frame = None
        self._set_quality(HeaveState.INVALID)
        _set((*self._now, self.delayed_heave, *self._attitude, self.training_age), ())
        self._set_sea(None)
        _set([gauge for pair in self._hull for gauge in pair], ())
        self._set_reference(None)
        self.record_rock(())
        self.record_quiet(None)

    def _set_quality(self, quality: HeaveState) -> None:
        for state, gauge in self._quality_states.items():
            gauge.set(state is quality)

    def record_sea(self, frame: MotionFrame) -> None:
        """What changes slowly: sea state and delayed heave."""
        is_known = frame.quality.heave is not HeaveState.INVALID
        sea, delayed = frame.sea, frame.delayed
        self._set_sea(sea if is_known and sea is not None and not frame.t_s - sea.t_s > SEA_S else None)
        if delayed is not None and delayed.t_s != self._delayed_t_s:
            self._delayed_t_s, self._delayed_since_s = delayed.t_s, frame.t_s
        is_renewed = frame.t_s - self._delayed_since_s <= RENEWED_S
        self.delayed_heave.set(delayed.heave_m if is_known and delayed is not None and is_renewed else nan)

    def _set_sea(self, sea: SeaState | None) -> None:
        heights = (sea.significant_height_m, sea.peak_period_s, sea.mean_period_s) if sea is not None else ()
        noise = (sea.noise_mps2_rthz, sea.bias_walk_mps2_rts) if sea is not None else ()
        _set(self._sea, (*heights, *noise))
        shaken = [(one.rms_mps2, one.frequency_hz) for one in sea.vibration] if sea is not None else []
        for pair, values in zip_longest(self._vibration, shaken[: len(self._vibration)], fillvalue=()):
            _set(pair, values)

    def record_stages(self, frame: MotionFrame) -> None:
        """What the stages beside the heave have to say."""
        hull, motion = frame.hull, frame.attitude
        is_renewed = hull is not None and frame.t_s - hull.t_s <= RENEWED_S
        for i, pair in enumerate(self._hull):
            _set(pair, (hull.total_rad[i], hull.std_rad[i]) if hull is not None and is_renewed else ())
        if motion is not None and frame.t_s - motion.t_s <= RENEWED_S:
            _set(self._attitude, (motion.heave_m, motion.heave_std_m, motion.pitch_rad, motion.pitch_std_rad))
        else:
            _set(self._attitude, ())
        mru = frame.reference_mru
        self._set_reference(mru if mru is not None and frame.t_s - mru.t_s <= RENEWED_S else None)

    def _set_reference(self, mru: MruComparison | None) -> None:
        """How an existing MRU stands to ours; None: there is none, or it says nothing."""
        heave, *angles = (mru.heave, mru.roll, mru.pitch) if mru is not None else (None,) * 3
        _set(self._reference_heave, _differences(heave))
        for gauges, angle in zip(self._reference_angles, angles, strict=True):
            _set(gauges, _differences(angle))
        _set(self._reference_likeness, (heave.correlation, heave.delay_s, heave.scale) if heave is not None else ())

    def record_training(self, frame: MotionFrame, age_s: float) -> None:
        """``age_s``: since the network in use was accepted; nan: there is none."""
        self.training_age.set(age_s if frame.quality.correction is not CorrectionState.OFF else nan)

    def record_rock(self, scores: tuple[RockScore, ...]) -> None:
        """How the attitude predictions that are made have fared."""
        known = {(score.axis, f"{score.horizon_s:g}"): score for score in scores}
        self._scored.update(known)
        for labels in self._scored:
            score = known.get(labels)
            self.rock_error.labels(*labels).set(score.error_rad if score is not None else nan)
            self.rock_coverage.labels(*labels).set(score.coverage if score is not None else nan)

    def record_quiet(self, quiet: QuietForecast | None) -> None:
        """What is foreseen of quiet windows; None: it is not asked for."""
        window = quiet.window if quiet is not None else None
        self.quiet_confidence.set(quiet.best if quiet is not None else nan)
        self.quiet_start.set(window.start_s if window is not None else nan)

    def show_relief(self, frames_at_once: int) -> None:
        """What gives way is another now."""
        self.frames_at_once.set(frames_at_once)

    # What the stream's publisher counts.

    def set_clients(self, clients: int) -> None:
        """Connections to the stream now."""
        self.clients.set(clients)

    def count_sent(self, frames: int) -> None:
        """So many frames were handed to clients."""
        self.frames_sent.inc(frames)

    def count_dropped(self, reason: str) -> None:
        """A line was dropped."""
        self.frames_dropped.labels(reason).inc()

    def count_client_error(self, reason: str) -> None:
        """A client was turned away or misunderstood."""
        self.client_errors.labels(reason).inc()

    def show_certificates(self, spans: Collection[Span]) -> None:
        """Those of ``[tls]``; not called without."""
        for key in {span.key for span in spans}:
            self.certificate_end.labels(key).set(min(span.ends_s for span in spans if span.key == key))

    def render(self) -> bytes:
        """Everything, in the text format of Prometheus, version 0.0.4."""
        if self._last_frame is not None:
            self._show(self._last_frame)
        return generate_latest(self._registry)


def _differences(found: MruAgreement | None) -> tuple[float, ...]:
    if found is None:
        return ()
    return found.difference, found.mean_difference, found.std_difference, found.explained


def _set(gauges: Sequence[Gauge], values: Sequence[float]) -> None:
    """Each to its value; to NaN if there is none."""
    for gauge, value in zip_longest(gauges, values, fillvalue=nan):
        gauge.set(value)  # type: ignore[union-attr]  # There are no more values than gauges.

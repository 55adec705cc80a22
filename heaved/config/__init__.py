"""The configuration: which tables there are, their keys, units, ranges and defaults.

How a file becomes a :class:`Config` is in :mod:`heaved.config.read`; that every fault of it is named is the work of
:mod:`heaved.config.typed` (each key by itself) and :mod:`heaved.config.rules` (keys beside each other).
"""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec

from heaved.devices.profile import DeviceSpec
from heaved.estimation import quiescence
from heaved.estimation.craft import fusion
from heaved.estimation.crane import geometry as crane
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.hull import estimate as hull
from heaved.estimation.lever_arm import Point
from heaved.estimation.reference_mru import estimator as reference_mru
from heaved.estimation.rock import params as rock
from heaved.outputs.influx import InfluxParams
from heaved.outputs.mqtt import MqttParams
from heaved.outputs.register_map import RegistersParams
from heaved.outputs.telegrams.spec import OutputSpec
from heaved.outputs.tls import TlsParams

Port = Annotated[int, msgspec.Meta(ge=0, le=65535)]


class StreamParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[stream]``: the TCP stream of JSON lines."""

    host: str = "127.0.0.1"
    port: Port = 5570
    max_clients: Annotated[int, msgspec.Meta(ge=1, le=1024)] = 64
    queue_frames: Annotated[int, msgspec.Meta(ge=1, le=65536)] = 256
    stuck_s: Annotated[float, msgspec.Meta(gt=0, le=3600)] = 10.0
    """A client whose queue has been full without progress for this long is disconnected."""
    allow: tuple[str, ...] = ()
    """Networks (CIDR) from which clients may connect, besides loopback."""
    tls: bool = False
    """TLS alone is spoken, on loopback too, and only with clients that show a certificate: see ``[tls]``."""


class HttpParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[http]``: /metrics, /healthz, /readyz."""

    enabled: bool = True
    host: str = "127.0.0.1"
    port: Port = 9570
    allow: tuple[str, ...] = ()
    tls: bool = False


class StateParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[state]``: what a restart remembers."""

    directory: str = ""
    """Empty: $STATE_DIRECTORY (systemd), else ~/.local/state/heaved."""
    save_period_s: Annotated[float, msgspec.Meta(ge=1, le=86400)] = 60.0


class CompensationParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[compensation]``: what the consumer makes of the heave."""

    lead_s: Annotated[float, msgspec.Meta(ge=0, le=5)] = 0.0
    """Its own reaction time: heave, velocity and points are published for this long ahead."""


class RuntimeParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[runtime]``: how the process runs."""

    fifo_priority: Annotated[int, msgspec.Meta(ge=0, le=99)] = 0
    """SCHED_FIFO priority of the event loop; 0: ordinary scheduling."""


class RecordingParams(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """``[recording]``: what is kept on disk."""

    enabled: bool = False
    directory: str = ""
    """Empty: ``recordings`` in that of ``[state]``."""
    vessel: Annotated[str, msgspec.Meta(max_length=64)] = ""
    """Who it is of, so that nobody mixes them up ashore; empty: the name of this machine."""
    what: Literal["all", "samples"] = "all"
    """"samples": what was polled and learned, of which a replay makes all the rest again."""
    max_gb: Annotated[float, msgspec.Meta(ge=0.1, le=1e6)] = 20.0
    """The oldest hours are deleted so that all together stay below."""
    max_days: Annotated[float, msgspec.Meta(ge=0.1, le=36500)] = 90.0


class Config(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole configuration."""

    device: tuple[DeviceSpec, ...] = ()
    heave: heave.Params = heave.Params()
    laser: reference.Params = reference.Params()
    correction: correction.Params = correction.Params()
    rock: rock.Params = rock.Params()
    hull: hull.Params = hull.Params()
    attitude: fusion.Params = fusion.Params()
    crane: crane.Params = crane.Params()
    reference_mru: reference_mru.Params = reference_mru.Params()
    quiet: quiescence.Params = quiescence.Params()
    point: tuple[Point, ...] = ()
    compensation: CompensationParams = CompensationParams()
    output: tuple[OutputSpec, ...] = ()
    stream: StreamParams = StreamParams()
    http: HttpParams = HttpParams()
    tls: TlsParams = TlsParams()
    recording: RecordingParams = RecordingParams()
    registers: RegistersParams = RegistersParams()
    mqtt: MqttParams = MqttParams()
    influx: InfluxParams = InfluxParams()
    state: StateParams = StateParams()
    runtime: RuntimeParams = RuntimeParams()

    @property
    def wants_tls(self) -> bool:
        """Whether a server of the daemon speaks TLS."""
        return self.stream.tls or (self.http.enabled and self.http.tls)

    @property
    def has_laser(self) -> bool:
        """Whether there is a device to learn from."""
        return any(device.role == "laser" for device in self.device)

    @property
    def attitude_late_s(self) -> float:
        """By how much the IMU's angles are older than its accelerations."""
        return self.mounting[2] * 1e-3

    @property
    def mounting(self) -> tuple[tuple[float, ...], tuple[float, ...], float]:
        """How the IMU stands: ``rotation_deg``, ``bias_mps2`` and ``attitude_latency_ms`` of its device. What was
        measured with another one is not gone on with.
        """
        imu = next((device for device in self.device if device.role == "imu"), None)
        none = (0.0, 0.0, 0.0)
        return (imu.rotation_deg, imu.bias_mps2, imu.attitude_latency_ms) if imu is not None else (none, none, 0.0)

"""A ship with a crane, rigid, by scipy's rotations; and pipelines that are given its encoders."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from heaved.estimation.crane.geometry import Params
from heaved.simulate.crane import CraneAtWork, CraneBuild, CraneSensors

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from heaved.samples import CraneSample, Sample
    from heaved.simulate.sensors import Recording

Array = np.ndarray

BUILD = CraneBuild()
PARAMS = Params(
    pedestal_m=BUILD.pedestal_m,
    heel_outward_m=BUILD.heel_outward_m,
    heel_up_m=BUILD.heel_up_m,
    boom_length_m=BUILD.boom_length_m,
    jib_length_m=BUILD.jib_length_m,
    sheave_outward_m=BUILD.sheave_outward_m,
    sheave_up_m=BUILD.sheave_up_m,
    falls=BUILD.falls,
    hook_below_m=BUILD.hook_below_m,
)


def tip_on_ship(joints: Array) -> Array:
    """(3,) forward, port, up from the IMU, of slew, boom, jib against the deck, and line."""
    slew, boom, jib, _ = joints.tolist()
    on_turntable = (
        np.array([BUILD.heel_outward_m, 0.0, BUILD.heel_up_m])
        + Rotation.from_euler("y", -boom).apply([BUILD.boom_length_m, 0.0, 0.0])
        + Rotation.from_euler("y", -jib).apply([BUILD.jib_length_m, 0.0, 0.0])
        + Rotation.from_euler("y", -jib).apply([BUILD.sheave_outward_m, 0.0, BUILD.sheave_up_m])
    )
    found: Array = np.array(BUILD.pedestal_m) + Rotation.from_euler("z", -slew).apply(on_turntable)
    return found


def height(joints: Array, roll_rad: float, pitch_rad: float, *, hook: bool) -> float:
    """Over the IMU, metres, of the tip or of the hook plumb below it."""
    ship = Rotation.from_euler("xy", [roll_rad, -pitch_rad])  # about the ship's x, then about the level y: extrinsic
    hang = float(joints[3]) / BUILD.falls + BUILD.hook_below_m if hook else 0.0
    return float(ship.apply(tip_on_ship(joints))[2]) - hang


def heights(recording: Recording, crane: CraneAtWork, *, hook: bool) -> tuple[Array, Array]:
    """(n,) true heave of the place, and its true own height, at the recording's samples."""
    truth = recording.truth
    own, heave = [], []
    for t, z, roll, pitch in zip(
        *(column.tolist() for column in (truth.t_s, truth.heave_m, truth.roll_rad, truth.pitch_rad)), strict=True
    ):
        joints = crane.at(t).at
        level = height(joints, 0.0, 0.0, hook=hook)
        own.append(level)
        heave.append(z + height(joints, roll, pitch, hook=hook) - level)
    return np.array(heave), np.array(own)


def with_crane(
    samples: Sequence[Sample],
    crane: CraneAtWork,
    *,
    rate_hz: float = 10.0,
    seed: int = 1,
    as_read: Callable[[CraneSample], CraneSample | None] = lambda sample: sample,
) -> Iterator[Sample]:
    """The samples with those of the crane's encoders among them, by time; ``as_read``: what becomes of each."""
    sensors = CraneSensors(crane, seed=seed)
    next_s = samples[0].t_s + 0.013  # Not at the IMU's own times.
    for sample in samples:
        while next_s <= sample.t_s:
            if (read := as_read(sensors.read(next_s))) is not None:
                yield read
            next_s += 1.0 / rate_hz
        yield sample

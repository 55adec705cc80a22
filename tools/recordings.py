#!/usr/bin/env python
"""Make recordings (CSV) to replay and to score against: of simulated seas, and out of real measurements.

    tools/recordings.py sea S4 --sensor A --shake engines --duration 700 --out s4.csv
    tools/recordings.py hebrides BUOY.raw --rate 20 --sensor A --laser 50% --out hebrides.csv
    tools/recordings.py palmer SEAPATH.csv --out palmer.csv
    tools/recordings.py flume RUN.csv --froude 64 --out flume.csv
    tools/recordings.py microswift STATIC.dat --out still.csv

Beside ``x.csv`` it writes the truth to score against, ``x.truth.csv`` (``t_s, heave_m, ...``). Each command is a
function of the same name that returns the :class:`~heaved.simulate.sensors.Recording`.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.signal.windows import tukey

from heaved.samples import GRAVITY_MPS2
from heaved.simulate import directional
from heaved.simulate.play import write_recording, write_truth
from heaved.simulate.seaway import NAMES, seaway
from heaved.simulate.sensors import ImuModel, Recording, measure, record
from heaved.simulate.shaking import NONE, Shake
from heaved.simulate.vessel import Motion

if TYPE_CHECKING:
    from collections.abc import Mapping

Array = NDArray[np.float64]

BUOY_RATE_HZ = 1.28
BUOY_BAND_HZ = (0.033, 0.6)
"""What a wave-rider buoy's own filter lets through."""
SHIP_BAND_HZ = (0.02, 0.45)
"""Up to just below half of the ship's 1 Hz."""
FLUME_RATE_HZ = 200.0
FLUME_BAND_HZ = (0.2, 5.0)
"""Around the waves of 0.6 to 1.2 Hz and their harmonics, at model scale."""
FADE_S = 30.0
"""Real records are faded in from rest and out to rest over this long, so that they can be differentiated: score them
between the fades."""
FLUME_FADE_S = 4.0
"""The same for the truth of a flume run, at model scale."""


class Series(msgspec.Struct, frozen=True):
    """A quantity and its rates of change on a new grid; each (m,)."""

    value: Array
    rate: Array
    acceleration: Array


def sea(
    name: str,
    *,
    duration_s: float = 700.0,
    rate_hz: float = 20.0,
    sensor: str | ImuModel = "A",
    laser: str = "on",
    shake: str | Shake = NONE,
    seed: int = 1,
) -> Recording:
    """A simulated sea; waves, sensor errors and vibration all drawn from ``seed``.

    Raises:
        ValueError: unknown sea, sensor, laser pattern or shake.
    """
    return record(
        seaway(name, seed), duration_s, imu_rate_hz=rate_hz, sensor=sensor, laser=laser, shake=shake, seed=seed
    )


def hebrides(
    path: Path,
    *,
    rate_hz: float = 20.0,
    sensor: str | ImuModel = "A",
    laser: str = "on",
    shake: str | Shake = NONE,
    seed: int = 1,
) -> Recording:
    """A real sea: buoy displacement (status, heave, north, west in cm at 1.28 Hz), carried by a vessel that heads north
    and does not tilt.

    Raises:
        ValueError: the file has not these columns.
        OSError: the file cannot be read.
    """
    status, *displacement = _columns(path, 4)
    good = status == 0.0
    index = np.arange(status.size)
    heave, north, west = (
        resampled(np.interp(index, index[good], column[good]) / 100.0, BUOY_RATE_HZ, rate_hz, BUOY_BAND_HZ)
        for column in displacement
    )
    truth = _motion(rate_hz, heave, surge=north.acceleration, sway=west.acceleration)
    return measure(truth, imu_rate_hz=rate_hz, sensor=sensor, laser=laser, shake=shake, seed=seed)


def palmer(
    path: Path,
    *,
    rate_hz: float = 20.0,
    sensor: str | ImuModel = "A",
    laser: str = "on",
    shake: str | Shake = NONE,
    seed: int = 1,
) -> Recording:
    """A real ship under way: roll, pitch, heading and heave at 1 Hz.

    The file's heave moves against its GPS altitude, so it is positive down and turned here.

    Raises:
        ValueError: the file has not these columns.
        OSError: the file cannot be read.
    """
    t, roll, pitch, heading, down, _ = _columns(path, 6, header_rows=1)
    grid = np.arange(t[0], t[-1], 1.0)
    angles = [_angle(np.interp(grid, t, np.unwrap(np.radians(column))), rate_hz) for column in (roll, pitch, heading)]
    heave = resampled(np.interp(grid, t, -down), 1.0, rate_hz, SHIP_BAND_HZ)
    truth = _motion(rate_hz, heave, roll=angles[0], pitch=angles[1], yaw=angles[2])
    return measure(truth, imu_rate_hz=rate_hz, sensor=sensor, laser=laser, shake=shake, seed=seed)


def flume(path: Path, *, froude: float = 1.0) -> Recording:
    """A real accelerometer pair on a hull in regular waves, 200 Hz at model scale; ``froude`` is the scale of lengths,
    whose root is that of times.

    The reading is the mean of the two accelerometers as it is, plus gravity. The truth is that mean integrated twice in
    the frequency domain, without any shift in phase; it is no reference for the sensor's own scale.

    Raises:
        ValueError: the file has not the flume's columns.
        OSError: the file cannot be read.
    """
    starboard, port = _columns(path, 8, header_rows=1)[4:6]
    reading = (starboard + port) / 2.0
    model = _integrated_twice(reading, FLUME_RATE_HZ, FLUME_BAND_HZ)
    t = np.arange(reading.size) / FLUME_RATE_HZ * np.sqrt(froude)
    truth = _still(
        t,
        heave_m=model.value * froude,
        heave_velocity_mps=model.rate * np.sqrt(froude),
        heave_acceleration_mps2=model.acceleration,
    )
    return _unmeasured(truth, az_mps2=reading + GRAVITY_MPS2)


def flume_optical(path: Path, *, froude: float = 1.0) -> Array:
    """Heave (n,) by the camera, on the rows of :func:`flume`. Its clock drifts: it tells amplitude, not phase.

    Raises:
        ValueError, OSError: as :func:`flume`.
    """
    return np.asarray(_columns(path, 8, header_rows=1)[1] * froude)


def microswift(path: Path) -> Recording:
    """A real MEMS IMU that lies still; uncalibrated, its first axis up. Truth: no heave.

    Raises:
        ValueError: the file has not the buoy's columns.
        OSError: the file cannot be read.
    """
    with path.open(encoding="ascii") as file:
        stamps = [line.split(",", 1)[0] for line in file if line.strip()]
    up, second, third, *_, roll_rate, pitch_rate, yaw_rate = _columns(path, 10, skip_first=True)
    # Stamps of 1 s resolution: readings are spread evenly between the first and the last.
    seconds = (np.datetime64(stamps[-1].replace(" ", "T")) - np.datetime64(stamps[0].replace(" ", "T"))).astype(int)
    t = np.linspace(0.0, float(seconds), up.size)
    return _unmeasured(
        _still(t),
        ax_mps2=second,
        ay_mps2=third,
        az_mps2=up,
        gx_radps=np.radians(pitch_rate),
        gy_radps=np.radians(yaw_rate),
        gz_radps=np.radians(roll_rate),
    )


def resampled(values: Array, rate_hz: float, new_rate_hz: float, band_hz: tuple[float, float]) -> Series:
    """``values`` (n,) at ``rate_hz``, band-limited and faded at both ends, on a faster grid by the discrete Fourier
    transform (sinc interpolation), with the first two derivatives taken there.

    The new rate is met to within one sample in the whole record.
    """
    n = values.size
    faded = (values - values.mean()) * tukey(n, min(1.0, 2.0 * FADE_S * rate_hz / n))
    f = np.fft.rfftfreq(n, 1.0 / rate_hz)
    spectrum = np.where((f >= band_hz[0]) & (f <= band_hz[1]), np.fft.rfft(faded), 0.0)
    m = round(n * new_rate_hz / rate_hz)
    turn = 2j * np.pi * f
    value, rate, acceleration = (
        np.fft.irfft(part, m) * m / n for part in (spectrum, turn * spectrum, turn**2 * spectrum)
    )
    return Series(value, rate, acceleration)


def _integrated_twice(acceleration: Array, rate_hz: float, band_hz: tuple[float, float]) -> Series:
    """Zero-phase integrals of ``acceleration`` (n,) within a band, on its own grid."""
    n = acceleration.size
    faded = (acceleration - acceleration.mean()) * tukey(n, min(1.0, 2.0 * FLUME_FADE_S * rate_hz / n))
    f = np.fft.rfftfreq(n, 1.0 / rate_hz)
    inside = (f >= band_hz[0]) & (f <= band_hz[1])
    spectrum = np.where(inside, np.fft.rfft(faded), 0.0)
    turn = np.where(inside, 2j * np.pi * f, 1.0)
    value, rate, same = (np.fft.irfft(part, n) for part in (spectrum / turn**2, spectrum / turn, spectrum))
    return Series(value, rate, same)


def _angle(values: Array, rate_hz: float) -> Series:
    """An angle (n,) at 1 Hz on a faster grid: its straight line kept, the motion about it resampled."""
    t = np.arange(values.size, dtype=np.float64)
    slope, start = np.polyfit(t, values, 1)
    motion = resampled(values - start - slope * t, 1.0, rate_hz, (0.0, SHIP_BAND_HZ[1]))
    finer = np.arange(motion.value.size) / rate_hz
    return Series(motion.value + start + slope * finer, motion.rate + slope, motion.acceleration)


def _motion(
    rate_hz: float,
    heave: Series,
    *,
    surge: Array | None = None,
    sway: Array | None = None,
    roll: Series | None = None,
    pitch: Series | None = None,
    yaw: Series | None = None,
) -> Motion[Array]:
    """True motion from its parts, zero where there is none."""
    parts: dict[str, Array] = {
        "heave_m": heave.value,
        "heave_velocity_mps": heave.rate,
        "heave_acceleration_mps2": heave.acceleration,
    }
    for name, acceleration in (("surge", surge), ("sway", sway)):
        if acceleration is not None:
            parts[f"{name}_acceleration_mps2"] = acceleration
    for name, angle in (("roll", roll), ("pitch", pitch), ("yaw", yaw)):
        if angle is not None:
            parts |= {f"{name}_rad": angle.value, f"{name}_rate_radps": angle.rate}
    return _still(np.arange(heave.value.size) / rate_hz, **parts)


def _still(t_s: Array, **moving: Array) -> Motion[Array]:
    """A motion at ``t_s`` that rests but for the fields given."""
    fields: Mapping[str, Array] = dict.fromkeys(Motion.__struct_fields__, np.zeros_like(t_s)) | moving | {"t_s": t_s}
    return Motion(**fields)


def _unmeasured(truth: Motion[Array], **readings: Array) -> Recording:
    """A recording at the truth's instants that has no readings but those given."""
    names = [name for name in Recording.__struct_fields__ if name not in ("t_s", "truth")]
    columns: dict[str, Array] = dict.fromkeys(names, np.full_like(truth.t_s, np.nan)) | readings
    return Recording(t_s=truth.t_s, truth=truth, **columns)


def _columns(path: Path, count: int, *, header_rows: int = 0, skip_first: bool = False) -> Array:
    """The file's columns (count or, without the first, count - 1; n)."""
    wanted = range(1, count) if skip_first else None
    try:
        table = np.loadtxt(path, delimiter=",", skiprows=header_rows, ndmin=2, usecols=wanted)
    except ValueError as error:
        raise ValueError(f"{path}: {error}; is it a file of this kind?") from error
    if wanted is None and table.shape[1] != count:
        raise ValueError(f"{path} has {table.shape[1]} columns instead of {count}; is it a file of this kind?")
    return np.ascontiguousarray(table.T)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    commands = parser.add_subparsers(dest="command", required=True)
    simulated = commands.add_parser("sea", help="a simulated sea")
    simulated.add_argument("name", choices=(*NAMES, *directional.NAMES))
    simulated.add_argument("--duration", type=float, default=700.0, metavar="S", help="seconds (default 700)")
    real = {
        "hebrides": "wave-rider buoy displacement, as an IMU would feel it",
        "palmer": "a ship's roll, pitch, heading and heave, as an IMU would feel it",
        "flume": "an accelerometer pair on a model hull",
        "microswift": "a MEMS IMU at rest",
    }
    for name, text in real.items():
        commands.add_parser(name, help=text).add_argument("file", type=Path)
    commands.choices["flume"].add_argument(
        "--froude",
        type=float,
        default=1.0,
        metavar="N",
        help="scale of lengths, 64 for the ship (default 1: the model)",
    )
    for name in ("sea", "hebrides", "palmer"):
        command = commands.choices[name]
        command.add_argument("--rate", type=float, default=20.0, metavar="HZ", help="of the IMU (default 20)")
        command.add_argument("--sensor", default="A", metavar="A|B|C|ideal")
        command.add_argument(
            "--laser", default="on", metavar="PATTERN", help="on, off, 50%%, or outages START+LENGTH,... in seconds"
        )
        command.add_argument("--shake", default=NONE, metavar="NAME", help="what shakes it: line-3.1, slams, ...")
        command.add_argument("--seed", type=int, default=1)
    for command in commands.choices.values():
        command.add_argument("--out", type=Path, required=True, metavar="FILE.csv")
    return parser


def _recording(options: argparse.Namespace) -> Recording:
    if options.command == "flume":
        return flume(options.file, froude=options.froude)
    if options.command == "microswift":
        return microswift(options.file)
    names = ("sensor", "laser", "shake", "seed")
    errors = {"rate_hz": options.rate, **{name: getattr(options, name) for name in names}}
    if options.command == "sea":
        return sea(options.name, duration_s=options.duration, **errors)
    return (hebrides if options.command == "hebrides" else palmer)(options.file, **errors)


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; 0 when the files are written."""
    options = _parser().parse_args(arguments)
    try:
        recording = _recording(options)
        truth_path = options.out.with_suffix(".truth.csv")
        write_recording(options.out, recording)
        write_truth(truth_path, recording)
    except (ValueError, OSError) as error:
        print(f"recordings: {error}", file=sys.stderr)
        return 1
    print(f"{options.out}: {recording.t_s.size} rows, {recording.t_s[-1]:.0f} s; truth in {truth_path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""A simulated ship, its sensors on Modbus TCP, the daemon, a client on TCP: what arrives is the ship's motion."""

from __future__ import annotations

import asyncio
import itertools
import math
import statistics
import time
from typing import TYPE_CHECKING

import msgspec
import numpy as np
import pytest
from running import PATIENCE_S, SWELL, demo_config, metric, plant_of, running, stream_of

from heaved.daemon.state import StateFile
from heaved.estimation.heave import params as heave
from heaved.estimation.heave.saved_state import SavedState
from heaved.simulate.vessel import Motion

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

PERIOD_S = 3.0
GROWTH_S = 4.0
LOOK_S = 3.0
SHORT = msgspec.structs.replace(SWELL, frequency_hz=(1.0 / PERIOD_S,))


class Swell:
    """Regular motions: heave of 1 m at 3 s, which grows from rest, roll of 3 degrees at 9 s, pitch of 1 at 6.5 s."""

    def at(self, t_s: float) -> Motion[float]:
        u = min(max(t_s / GROWTH_S, 0.0), 1.0)
        # Smooth to the second derivative, so that the accelerometer sees no jump.
        growth = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        slope = 30.0 * u**2 * (1.0 - u) ** 2 / GROWTH_S
        bend = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / GROWTH_S**2
        w = 2.0 * math.pi / PERIOD_S
        sine, cosine = math.sin(w * t_s), math.cos(w * t_s)
        roll, roll_w = math.radians(3.0), 2.0 * math.pi / 9.0
        pitch, pitch_w = math.radians(1.0), 2.0 * math.pi / 6.5
        return Motion(
            t_s=t_s,
            heave_m=growth * sine,
            heave_velocity_mps=slope * sine + growth * w * cosine,
            heave_acceleration_mps2=bend * sine + 2.0 * slope * w * cosine - growth * w**2 * sine,
            surge_acceleration_mps2=0.0,
            sway_acceleration_mps2=0.0,
            roll_rad=roll * math.sin(roll_w * t_s),
            pitch_rad=pitch * math.sin(pitch_w * t_s),
            yaw_rad=0.7,
            roll_rate_radps=roll * roll_w * math.cos(roll_w * t_s),
            pitch_rate_radps=pitch * pitch_w * math.cos(pitch_w * t_s),
            yaw_rate_radps=0.0,
        )


def rms(values: Sequence[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


QUICK = heave.Params(
    observer="harmonic", window_s=15.0, refresh_s=1.0, highpass_period_s=8.0, initial_period_s=PERIOD_S
)


@pytest.mark.parametrize(
    ("params", "learned", "wait_s"),
    [(QUICK, SavedState(), 1.0), (heave.Params(), SavedState(sea=SHORT), 3.0 * PERIOD_S)],
    ids=["harmonic", "sea, of which an earlier run knew the period"],
)
async def test_the_clients_see_the_motion_of_the_ship(
    tmp_path: Path, params: heave.Params, learned: SavedState, wait_s: float
) -> None:
    """``wait_s``: from the first heave (harmonic: 15 s after the first sample; sea: at once, so three periods more)
    until it is looked at.
    """
    sea = Swell()
    config = demo_config(tmp_path, heave=params)
    StateFile(tmp_path / "state", SavedState).write(StateFile.encode(learned))
    frames = []
    async with (
        plant_of(config, sea=sea) as (plant, config),
        running(config) as daemon,
        asyncio.timeout(4.0 * PATIENCE_S),
        stream_of(daemon) as records,
    ):
        begin_s, predictions = math.inf, 0
        epoch_s = time.monotonic() - plant.time_s()
        async for record in records:
            if record["class"] == "MOTION":
                t_s = record["mono_s"] - epoch_s
                frames.append((t_s, record))
                if begin_s == math.inf and "heave_m" in record:
                    begin_s = t_s + wait_s
                # After a machine has stood still the rock predictor begins anew, so it is waited for.
                predictions += t_s > begin_s and "roll_deg" in record["rock"][0]
                if t_s > begin_s + LOOK_S and predictions > 25.0 * LOOK_S:
                    break
        # Nothing is lost on the way, and nothing is made twice.
        assert [record["seq"] for _, record in frames] == list(range(frames[0][1]["seq"], frames[-1][1]["seq"] + 1))
        assert all(after["mono_s"] > before["mono_s"] for (_, before), (_, after) in itertools.pairwise(frames))
        assert metric(daemon, "heaved_frames_dropped_total") == 0
        # The rock predictor may begin anew where a busy machine changes the rate of the samples: that is its way.
        assert metric(daemon, 'heaved_filter_resets_total{filter="heave"') == 0

    # A machine that stands still for a while makes frames that say they know nothing.
    settled = [(t_s, record, sea.at(t_s)) for t_s, record in frames if t_s > begin_s and "heave_m" in record]
    assert len(settled) > 25.0 * LOOK_S
    sigma_m = rms([truth.heave_m for _, _, truth in settled])
    # Three periods after the start the observer still settles; a wrong sign, unit or time would be beyond 1.
    assert rms([record["heave_m"] - truth.heave_m for _, record, truth in settled]) < 0.5 * sigma_m
    # 20 ms of error in time would show as more: the sensor's noise is 0.02 degrees. The median, because a frame that
    # fills in for a late sample holds the attitude of the last one.
    for axis in ("roll", "pitch"):
        off = [abs(record[f"{axis}_deg"] - math.degrees(getattr(truth, f"{axis}_rad"))) for _, record, truth in settled]
        assert statistics.median(off) < 0.03

    looking = [(t_s, record["rock"]) for t_s, record in frames if t_s > begin_s and "roll_deg" in record["rock"][0]]
    for number, horizon_s in enumerate((0.05, 0.10, 0.15)):
        predicted = [rock[number] for _, rock in looking]
        assert all(math.isclose(rock["horizon_s"], horizon_s) for rock in predicted)
        then = [math.degrees(sea.at(t_s + horizon_s).roll_rad) for t_s, _ in looking]
        assert rms([rock["roll_deg"] - truth for rock, truth in zip(predicted, then, strict=True)]) < 0.15

"""The craft's stage: what several devices say is put together as one device would say it."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from heaved.demo.craft_at_sea import hull as craft_hull
from heaved.estimation.craft.dynamics import Craft
from heaved.estimation.craft.fusion import AttitudeFusion, Params
from heaved.estimation.craft.stage import AttitudeStage
from heaved.samples import CraftSample
from heaved.simulate.hydrofoil import Passage, Voyage, sail

ATTITUDE = Params(enabled=True)


@pytest.fixture(scope="module")
def voyage() -> Voyage:
    """Heave from the trim."""
    craft = Craft(ATTITUDE.vessel)
    passage = Passage(stages=((0.0, 1.0),), duration_s=30.0)
    trim = craft.trim(passage.speed_mps)
    made = sail(craft.accelerations, trim, [4], passage, craft_hull(ATTITUDE.vessel))[0]
    return msgspec.structs.replace(
        made, heave_m=made.heave_m - trim[0], measured_heave_m=made.measured_heave_m - trim[0]
    )


def craft_samples(voyage: Voyage, fields: tuple[str, ...], delay_s: float = 0.0) -> list[CraftSample]:
    columns = {
        "heave_m": voyage.measured_heave_m,
        "pitch_rad": voyage.measured_pitch_rad,
        "speed_mps": voyage.speed_mps,
        "flap_fore_rad": voyage.flap_fore_rad,
        "flap_aft_rad": voyage.flap_aft_rad,
    }
    return [
        msgspec.structs.replace(CraftSample(t_s=t + delay_s), **{name: float(columns[name][i]) for name in fields})
        for i, t in enumerate(voyage.t_s.tolist())
    ]


ALL = ("heave_m", "pitch_rad", "speed_mps", "flap_fore_rad", "flap_aft_rad")


def test_one_device_of_all_is_the_estimator_itself(voyage: Voyage) -> None:
    stage, plain = AttitudeStage(ATTITUDE), AttitudeFusion(ATTITUDE)
    for sample in craft_samples(voyage, ALL):
        stage.push(sample)
        estimate = plain.step(
            sample.t_s, sample.heave_m, sample.pitch_rad, sample.speed_mps, sample.flap_fore_rad, sample.flap_aft_rad
        )
        assert stage.motion is not None
        assert estimate is not None
        assert stage.motion.heave_m == estimate.heave_m
        assert stage.motion.pitch_rate_std_radps == estimate.pitch_rate_std_radps
        assert stage.motion.probabilities == estimate.probabilities


def test_three_devices_that_take_turns_are_nearly_as_good_as_one(voyage: Voyage) -> None:
    """Pitch comes 10 ms before heave and half as often; speed and flaps between them."""
    parts = [
        *craft_samples(voyage, ("heave_m",)),
        *craft_samples(voyage, ("pitch_rad",), -0.01)[::2],
        *craft_samples(voyage, ("speed_mps", "flap_fore_rad", "flap_aft_rad"), -0.02),
    ]
    errors: dict[str, list[tuple[float, float]]] = {"one": [], "three": []}
    for name, samples in (("one", craft_samples(voyage, ALL)), ("three", sorted(parts, key=lambda s: s.t_s))):
        stage = AttitudeStage(ATTITUDE)
        for sample in samples:
            stage.push(sample)
            if math.isfinite(sample.heave_m) and sample.t_s > 5.0:
                i = round(sample.t_s * 20.0)
                assert stage.motion is not None
                assert not {"heave_missing", "pitch_missing", "flap_assumed"} & set(stage.motion.cautions)
                off = (stage.motion.heave_m - voyage.heave_m[i], stage.motion.pitch_rad - voyage.pitch_rad[i])
                errors[name].append(off)
    one, three = (np.sqrt(np.mean(np.square(errors[name]), axis=0)) for name in ("one", "three"))
    assert np.all(one < (0.05, 0.005))  # Better than the sensors.
    # Half of the pitch readings, each 10 ms old: root two, and 0.1 rad/s times 10 ms.
    assert three[0] < 1.2 * one[0] + 0.005
    assert three[1] < 1.5 * one[1] + 0.001


def test_pitch_alone_goes_on_when_heave_is_gone(voyage: Voyage) -> None:
    stage = AttitudeStage(ATTITUDE)
    for sample in craft_samples(voyage, ALL):
        gone = sample.t_s > 15.0
        stage.push(msgspec.structs.replace(sample, heave_m=math.nan) if gone else sample)
    assert stage.motion is not None
    assert stage.motion.t_s == pytest.approx(voyage.t_s[-1])
    assert "heave_missing" in stage.motion.cautions
    assert abs(stage.motion.pitch_rad - voyage.pitch_rad[-1]) < 5.0 * stage.motion.pitch_std_rad

"""An existing MRU beside ours, in a simulated sea. Oracle: what the simulated one was made to do wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import msgspec
import pytest
from pipelines import run, sea

from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.reference_mru.estimator import HeavePositive, Params, ReferenceMru
from heaved.estimation.rock import params as rock
from heaved.estimation.stages import Stages
from heaved.pipeline import Pipeline, assemble
from heaved.simulate.mru import MruModel, SimulatedMru
from heaved.simulate.seaway import seaway

if TYPE_CHECKING:
    from heaved.samples import MotionFrame, MruComparison, MruSample, Sample
    from heaved.simulate.sensors import Recording

RATE_HZ = 20.0
LENGTH_S = 150.0
SEED = 3
GOOD = MruModel(delay_s=0.0, noise_m=0.02, noise_deg=0.05, highpass_s=0.0)
ARRIVES_S = 0.2
"""After the moment that it is stamped with."""


def pipeline() -> Pipeline:
    return assemble(
        heave=heave.Params(),
        laser=reference.Params(),
        correction=correction.Params(),
        rock=rock.Params(),
        has_laser=False,
        stages=Stages(),
    )


@pytest.fixture(scope="module")
def recording() -> Recording:
    return sea("S5", LENGTH_S, rate_hz=RATE_HZ, seed=SEED, laser="off")


@pytest.fixture(scope="module")
def frames(recording: Recording) -> list[MotionFrame]:
    return run(pipeline(), recording.samples())


def readings(model: MruModel, sign: float = 1.0) -> list[MruSample]:
    mru = SimulatedMru(seaway("S5", SEED), model, seed=1)
    told = [mru.read(0.1 * k) for k in range(round(10.0 * (LENGTH_S - ARRIVES_S)))]
    return [
        msgspec.structs.replace(one, heave_m=sign * one.heave_m, heave_velocity_mps=sign * one.heave_velocity_mps)
        for one in told
    ]


def compared(frames: list[MotionFrame], told: list[MruSample], params: Params | None = None) -> MruComparison:
    stage = ReferenceMru(params or Params(window_s=80.0))
    events: list[tuple[float, MotionFrame | MruSample]] = [(frame.t_s, frame) for frame in frames]
    events += [(one.t_s + ARRIVES_S, one) for one in told]
    for _, event in sorted(events, key=lambda one: one[0]):
        stage.push(event) if hasattr(event, "fault") else stage.push_frame(event)  # type: ignore[arg-type]
    assert stage.comparison is not None
    return stage.comparison


def test_one_that_is_good_agrees(frames: list[MotionFrame]) -> None:
    found = compared(frames, readings(GOOD))
    assert found.warnings == ()
    assert found.heave.std_difference < 0.08
    assert found.heave.correlation > 0.99
    assert found.heave.delay_s == pytest.approx(0.0, abs=0.03)
    assert found.heave.scale == pytest.approx(1.0, abs=0.03)
    assert found.roll.std_difference < 0.003
    assert found.heave_velocity.correlation > 0.99


def test_its_delay_is_found(frames: list[MotionFrame]) -> None:
    found = compared(frames, readings(msgspec.structs.replace(GOOD, delay_s=0.5)))
    assert found.heave.delay_s == pytest.approx(0.5, abs=0.05)
    assert found.roll.delay_s == pytest.approx(0.5, abs=0.03)
    assert any("it is 0.5 s late (latency_ms" in text for text in found.warnings)


def test_the_lead_of_its_high_pass_is_found(frames: list[MotionFrame]) -> None:
    """Waves of 9 s behind two poles of 40 s: 25 degrees, 0.6 s early."""
    found = compared(frames, readings(msgspec.structs.replace(GOOD, highpass_s=40.0)))
    assert -0.9 < found.heave.delay_s < -0.3
    assert found.roll.delay_s == pytest.approx(0.0, abs=0.03)


def test_one_that_counts_down_is_turned_by_name(frames: list[MotionFrame]) -> None:
    down = readings(GOOD, sign=-1.0)
    assert any(text.endswith("the other way (heave_positive?)") for text in compared(frames, down).warnings)
    assert compared(frames, down, Params(heave_positive=HeavePositive.DOWN, window_s=80.0)).warnings == ()


def test_it_touches_nothing_of_ours(recording: Recording, frames: list[MotionFrame]) -> None:
    """To the bit, and though it is wrong: with readings that never cease to contradict ours."""
    first = frames[: round(40.0 * RATE_HZ)]
    samples: list[tuple[float, Sample]] = [(one.t_s, one) for one in recording.samples() if one.t_s <= first[-1].t_s]
    samples += [(one.t_s, one) for one in readings(msgspec.structs.replace(GOOD, delay_s=0.9), sign=-7.0)[:400]]
    pipe = pipeline()
    both = run(pipe, [sample for _, sample in sorted(samples, key=lambda one: one[0])])
    assert both[-1].reference_mru is not None
    as_alone = [repr(msgspec.structs.replace(frame, reference_mru=None)) for frame in both[:: len(both) // 50]]
    assert as_alone == [repr(frame) for frame in first[:: len(both) // 50]]

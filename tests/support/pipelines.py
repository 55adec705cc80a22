"""Pipelines and recordings for the tests of the whole estimator."""

from collections.abc import Iterable, Iterator

import msgspec
import numpy as np

from heaved.estimation.heave import params as heave
from heaved.estimation.heave.laser import correction, reference
from heaved.estimation.heave.sea.refit import look
from heaved.estimation.imu.conditioning import Conditioned
from heaved.estimation.lever_arm import Point
from heaved.estimation.rock import params as rock
from heaved.estimation.rock.estimator import RockEstimator
from heaved.pipeline import Pipeline, assemble
from heaved.samples import ImuSample, LaserSample, MotionFrame, RockPrediction, Sample
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import Recording, record
from heaved.workers.train_correction import fit

NO_FORECASTS = heave.Params(observer="harmonic", forecast_horizons_s=())


class NoRock(RockEstimator):
    """Stands in for the rock predictor, which shares nothing with the heave and costs more than it."""

    def __init__(self) -> None:
        super().__init__(rock.Params(horizons_s=()))

    def step(self, readings: Conditioned) -> tuple[RockPrediction, ...]:
        return self.at(readings.sample.t_s)


def pipeline(
    *,
    has_laser: bool = True,
    with_rock: bool = False,
    heave_params: heave.Params = NO_FORECASTS,
    laser_params: reference.Params | None = None,
    correction_params: correction.Params | None = None,
    point: tuple[Point, ...] = (),
    lead_s: float = 0.0,
) -> Pipeline:
    return assemble(
        heave=heave_params,
        laser=laser_params or reference.Params(),
        correction=correction_params or correction.Params(),
        rock=rock.Params() if with_rock else NoRock(),
        has_laser=has_laser,
        point=point,
        lead_s=lead_s,
    )


def sea(name: str, duration_s: float, *, seed: int = 1, rate_hz: float = 20.0, laser: str = "on") -> Recording:
    return record(seaway(name, seed), duration_s, imu_rate_hz=rate_hz, sensor="A", laser=laser, seed=seed)


def run(pipe: Pipeline, samples: Iterable[Sample], train: bool = False) -> list[MotionFrame]:
    """Every frame; with ``train`` each window is trained at once, as a replay does it."""
    frames = []
    for sample in samples:
        frame = pipe.step(sample)
        if (past := pipe.fit_due()) is not None:
            pipe.accept_fit(look(past))
        if train and (window := pipe.training_due()) is not None:
            pipe.accept(fit(window))
        if frame is not None:
            frames.append(frame)
    return frames


def column(frames: Iterable[MotionFrame], name: str) -> np.ndarray:
    return np.array([getattr(frame, name) for frame in frames])


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def numbers(frame: MotionFrame) -> Iterator[float]:
    """Every number that a frame publishes, its nested ones too."""

    def walk(value: object) -> Iterator[float]:
        if isinstance(value, float):
            yield value
        elif isinstance(value, dict):
            for part in value.values():
                yield from walk(part)
        elif isinstance(value, (list, tuple)):
            for part in value:
                yield from walk(part)

    yield from walk(msgspec.to_builtins(frame, enc_hook=list))


def imu_only(samples: Iterable[Sample]) -> list[ImuSample]:
    return [sample for sample in samples if isinstance(sample, ImuSample)]


def laser_only(samples: Iterable[Sample]) -> list[LaserSample]:
    return [sample for sample in samples if isinstance(sample, LaserSample)]

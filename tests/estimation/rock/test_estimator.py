"""The rock estimator, from a judged sample of the IMU to the records of its predictions."""

from __future__ import annotations

from math import nan, nextafter, pi

import msgspec
import numpy as np
import pytest
from evidence.rock.shaken import unjudged
from numpy.typing import NDArray

from heaved.estimation.imu.attitude import Attitude, angle_rates
from heaved.estimation.rock import params as rock
from heaved.estimation.rock.estimator import TURN, DirectRockPredictor, RockEstimator, heading
from heaved.samples import ImuSample

Array = NDArray[np.float64]

HORIZONS = rock.DEFAULT_HORIZONS_S


def attitude(t: float) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Roll, pitch, yaw (as heaved counts them) and their rates."""
    w = TURN / 8
    return (
        (0.3 * np.sin(w * t), 0.2 * np.cos(w * t), 6.2 + 0.2 * np.sin(w * t + 1)),
        (0.3 * w * np.cos(w * t), -0.2 * w * np.sin(w * t), 0.2 * w * np.cos(w * t + 1)),
    )


def body_rates(t: float) -> tuple[float, float, float]:
    """From the rotation itself, by central differences: R' = R [w]x; pitch and yaw are turned round."""

    def rotation(moment: float) -> Array:
        (roll, pitch, yaw), _ = attitude(moment)
        p, y = -pitch, -yaw
        rx = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
        ry = np.array([[np.cos(p), 0, np.sin(p)], [0, 1, 0], [-np.sin(p), 0, np.cos(p)]])
        rz = np.array([[np.cos(y), -np.sin(y), 0], [np.sin(y), np.cos(y), 0], [0, 0, 1]])
        return np.asarray(rz @ ry @ rx)

    turned = rotation(t).T @ (rotation(t + 1e-5) - rotation(t - 1e-5)) / 2e-5
    return turned[2, 1], turned[0, 2], turned[1, 0]


def sample(t: float, *, gyro: bool = True) -> ImuSample:
    (roll, pitch, yaw), _ = attitude(t)
    gx, gy, gz = body_rates(t) if gyro else (nan, nan, nan)
    return ImuSample(
        t_s=float(t), roll_rad=float(roll), pitch_rad=float(pitch), yaw_rad=float(yaw % TURN),
        gx_radps=float(gx), gy_radps=float(gy), gz_radps=float(gz),
    )  # fmt: skip


def test_angle_rates_are_the_derivatives_of_the_angles() -> None:
    for t in (0.3, 2.0, 5.5):
        one = sample(t)
        assert np.allclose(angle_rates(one, one.roll_rad, one.pitch_rad), attitude(t)[1], atol=1e-8)
    assert np.isnan(angle_rates(ImuSample(t_s=0.0, gx_radps=0.1), nan, nan)).all()


@pytest.mark.parametrize("gyro", [False, True])
def test_the_estimator_predicts_at_the_sample_and_between(gyro: bool) -> None:
    estimator = RockEstimator(rock.Params(horizons_s=(0.5,)))
    assert estimator.horizons_s == (0.05, 0.1, 0.15, 0.5)
    for k in range(4000):
        found = estimator.step(unjudged(ImuSample(t_s=k / 100) if k % 50 == 7 else sample(k / 100, gyro=gyro)))
    last_s = 39.99
    for moment, records in ((last_s, found), (last_s + 0.03, estimator.at(last_s + 0.03))):
        for p in records:
            roll, pitch, yaw = attitude(moment + p.horizon_s)[0]
            assert abs(p.roll_rad - roll) < 1e-3
            assert abs(p.pitch_rad - pitch) < 1e-3
            assert abs((p.yaw_rad - yaw + pi) % TURN - pi) < 1e-3
            assert 0.0 <= p.yaw_rad < TURN
            assert 0.0 < p.roll_std_rad <= p.roll_interval_rad
    scores = {(s.axis, s.horizon_s): s for s in estimator.scores()}
    assert set(scores) == {(axis, h) for axis in ("roll", "pitch", "yaw") for h in estimator.horizons_s}
    assert all(0.0 <= s.coverage <= 1.0 and s.error_rad >= 0.0 for s in scores.values())


def test_resets_only_grow() -> None:
    estimator = RockEstimator(rock.Params())
    rng = np.random.default_rng(6)
    seen = []
    for start in (0.0, 500.0):
        for k in range(3000):
            spike = 0.5 if rng.random() < 0.01 else 0.0
            moment = sample(k / 100, gyro=False)
            noisy = moment.roll_rad + spike + 1e-4 * rng.standard_normal()
            estimator.step(unjudged(msgspec.structs.replace(moment, t_s=start + moment.t_s, roll_rad=noisy)))
            if k % 100 == 0:
                seen.append(dict(estimator.resets))
        for _ in range(25):
            estimator.step(unjudged(sample(0.0, gyro=False)))
    assert estimator.resets["rock", "restart"] == 2
    counts = [found.get(("rock", "spike"), 0) for found in seen]
    assert counts == sorted(counts)
    assert counts[-1] > 30


def test_the_published_method_can_still_be_had() -> None:
    estimator = RockEstimator(rock.Params(predictor="ml"))
    assert estimator.horizons_s == HORIZONS
    for k in range(600):
        found = estimator.step(unjudged(sample(k / 20, gyro=False)))
    assert [p.horizon_s for p in found] == list(HORIZONS)
    assert abs(found[2].roll_rad - attitude(599 / 20 + 0.15)[0][0]) < 1e-3
    assert estimator.scores() == ()
    assert abs(estimator.at(599 / 20 + 0.02)[0].roll_rad - attitude(599 / 20 + 0.07)[0][0]) < 1e-2


def test_before_anything_is_known_nothing_is_claimed() -> None:
    estimator = RockEstimator(rock.Params())
    for k in range(100):
        found = estimator.step(unjudged(ImuSample(t_s=k / 100)))
    assert [p.horizon_s for p in found] == list(HORIZONS)
    assert all(np.isnan(p.roll_rad) and np.isnan(p.roll_interval_rad) for p in (*found, *estimator.at(1.01)))
    predictor = DirectRockPredictor()
    assert all(np.isnan(p.yaw_rad) for p in predictor.at(0.0))


@pytest.mark.parametrize("is_roll_gone", [False, True], ids=["no rates", "no roll"])
def test_rates_that_are_gone_do_not_make_predictions_feed_on_themselves(is_roll_gone: bool) -> None:
    """Three minutes of a broad sea with body rates, then 20 s without them, or without the roll that they turn with."""
    rng = np.random.default_rng(4)
    omega, phase = 2.0 * pi * rng.uniform(0.07, 0.16, (2, 40)), rng.uniform(0.0, TURN, (2, 40))
    size = np.array([[0.012], [0.006]])
    estimator, worst = RockEstimator(rock.Params()), 0.0
    for k in range(4000):
        t = 0.05 * k
        roll, pitch = (size * np.sin(omega * t + phase)).sum(axis=1) + 2e-4 * rng.standard_normal(2)
        rates = (size * omega * np.cos(omega * t + phase)).sum(axis=1) + 2e-4 * rng.standard_normal(2)
        is_gone = t > 180.0
        gx, gy, gz = (nan, nan, nan) if is_gone and not is_roll_gone else (float(rates[0]), -float(rates[1]), 0.0)
        sample = ImuSample(
            t_s=t, roll_rad=nan if is_gone and is_roll_gone else float(roll), pitch_rad=float(pitch), yaw_rad=0.0,
            gx_radps=gx, gy_radps=gy, gz_radps=gz,
        )  # fmt: skip
        half = next(p for p in estimator.step(unjudged(sample)) if p.horizon_s == 0.5)
        if is_gone:
            true = float((size[1] * np.sin(omega[1] * (t + 0.5) + phase[1])).sum())
            worst = max(worst, abs(half.pitch_rad - true))
    assert np.degrees(worst) < 0.15  # of 1.5 degrees RMS


def test_a_slow_sensor_is_predicted_from_when_it_measured() -> None:
    """Angles five times a second, each known 30 ms late, polled 100 times: for the time of every poll, and as well as
    the time is known.
    """
    estimator = RockEstimator(rock.Params())
    for k in range(6000):
        t_s = k / 100
        measured_s = t_s - 0.03
        readings = unjudged(sample(t_s, gyro=False))
        angles = None
        if k % 20 == 0:
            (roll, pitch, yaw), _ = attitude(measured_s)
            angles = Attitude(measured_s, float(roll), float(pitch), float(yaw % TURN), measured_s=measured_s)
            given = msgspec.structs.replace(
                readings.sample, roll_rad=angles.roll_rad, pitch_rad=angles.pitch_rad, yaw_rad=angles.yaw_rad
            )
        else:
            given = ImuSample(t_s=t_s)
        found = estimator.step(
            msgspec.structs.replace(
                readings, sample=given, attitude=angles, attitude_is_slow=True, attitude_std_s=0.002
            )
        )
        if k > 5000:
            for p in found[:4]:
                (roll, pitch, _), (roll_rate, _, _) = attitude(t_s + p.horizon_s)
                assert abs(p.roll_rad - roll) < 2e-3
                assert abs(p.pitch_rad - pitch) < 2e-3
                assert p.roll_std_rad > 0.9 * 0.002 * abs(roll_rate) - 1e-4


def test_a_hair_below_north_is_north_and_never_a_whole_turn() -> None:
    hair = -nextafter(0.0, 1.0)
    assert hair % TURN == TURN  # what the remainder rounds to
    assert heading(hair) == 0.0
    assert heading(-1.0) == TURN - 1.0

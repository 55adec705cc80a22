"""Checksum-valid nonsense of an earlier run: named and refused, whatever it is, and never an error of another kind."""

from __future__ import annotations

import re
from math import inf, nan
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from heaved.config import Config
from heaved.estimation.heave import saved_state
from heaved.estimation.heave.laser import correction
from heaved.estimation.heave.laser.axes import SavedAxes
from heaved.estimation.heave.laser.correction import SavedNetwork
from heaved.estimation.heave.laser.geometry import Geometry
from heaved.estimation.heave.laser.placement import LaserPlace, SavedPlace
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.heave.sea.model import SeaModel
from heaved.estimation.hull import estimate as hull
from heaved.estimation.hull.estimator import HullDeformation
from heaved.estimation.hull.remembered import SavedFlexure, SavedHull
from heaved.estimation.imu.attitude_memory import SavedAttitudeError
from heaved.estimation.stages import Stages
from heaved.pipeline import Pipeline, assemble
from heaved.simulate.flexure import SCENES, simulate

SEA = SeaModel(
    stages=7, frequency_hz=(0.1, 0.2), damping=(0.3, 0.2), level_m2phz=(4.0, 1.0), noise_psd=4e-6, bias_walk_psd=9e-10
)
WEIGHTS = np.concatenate((np.zeros(10 * 50 + 2 * 10 + 1), [0.0, 1.0, 0.0, 1.0])).astype("<f8").tobytes()
NETWORK = SavedNetwork(
    weights=WEIGHTS, width=50, hidden=10, output="linear", step_s=0.1, input_std_m=0.5, omega_radps=0.7, limit_m=0.3
)
COVARIANCE = tuple((np.diag([1e-4] * 3 + [5e-5] * 3) ** 2)[np.triu_indices(6)].tolist())
FLEXURE = SavedFlexure(
    std_rad=(1e-5, 2e-5, 1e-5), mu_radps=(0.1, 0.2, 0.1), lambda_radps=(1.0, 1.0, 0.9), noise_radps=(1e-6, 1e-6, 2e-6)
)
HULL = SavedHull(rotation_rad=(0.01, 0.01, 0.5), scale=(1e-5, 0.0, 0.0), covariance=COVARIANCE, flexure=FLEXURE)
ERROR = SavedAttitudeError(lean_per_s=0.12, late_s=0.04, covariance=(1e-4, 1e-5, 1e-4))
PLACE = SavedPlace(
    configured=Geometry(),
    geometry=Geometry(forward_m=8.0, port_m=-3.0),
    place=LaserPlace(is_elsewhere=True, ahead_m=8.0, ahead_std_m=0.1, port_m=-3.0, port_std_m=0.1),
)
AXES = SavedAxes(weights=(0.04, 0.02, -0.04, -0.02, 0.0, 0.01))
LEARNED = SavedState(sea=SEA, lead_learned_s=0.05, gain_learned=1.02, correction=NETWORK)
SOUND = {
    "nothing": SavedState(),
    "all": LEARNED,
    "a still sea": SavedState(sea=msgspec.structs.replace(SEA, level_m2phz=(0.0, 0.0))),
    "the harmonic observer's": SavedState(frequencies_hz=(0.08, 0.12)),
    "the hull's": SavedState(hull=HULL),
    "the place of the laser": SavedState(laser_place=PLACE),
    "the axes of the accelerometers": SavedState(axes=AXES),
    "the attitude's errors": SavedState(attitude_error=ERROR),
    "none of an attitude, for sure": SavedState(
        attitude_error=SavedAttitudeError(lean_per_s=0.0, late_s=0.0, covariance=(0.0, 0.0, 0.0))
    ),
    "a hull's that was not fitted": SavedState(hull=msgspec.structs.replace(HULL, flexure=None)),
}


def of_sea(**changes: object) -> SavedState:
    return SavedState(sea=msgspec.structs.replace(SEA, **changes))


def of_hull(**changes: object) -> SavedState:
    return SavedState(hull=msgspec.structs.replace(HULL, **changes))


def of_error(**changes: object) -> SavedState:
    return SavedState(attitude_error=msgspec.structs.replace(ERROR, **changes))


def of_place(**changes: object) -> SavedState:
    return SavedState(laser_place=msgspec.structs.replace(PLACE, **changes))


def of_flexure(**changes: object) -> SavedState:
    return of_hull(flexure=msgspec.structs.replace(FLEXURE, **changes))


def of_network(**changes: object) -> SavedState:
    return SavedState(correction=msgspec.structs.replace(NETWORK, **changes))


NONSENSE = {
    "frequency 0": (of_sea(frequency_hz=(0.0, 0.2)), "frequency of the sea 0 Hz"),
    "frequency 1e300": (of_sea(frequency_hz=(1e300, 0.2)), "frequency of the sea 1e+300 Hz"),
    "negative frequency": (of_sea(frequency_hz=(-0.1, 0.2)), "frequency of the sea -0.1 Hz"),
    "no frequency": (of_sea(frequency_hz=(nan, 0.2)), "frequency of the sea nan"),
    "no damping": (of_sea(damping=(0.0, 0.2)), "damping of the sea 0"),
    "too few dampings": (of_sea(damping=(0.2,)), "2 frequencies, 1 dampings"),
    "an endless list": (
        of_sea(frequency_hz=(0.1,) * 100_000, damping=(0.1,) * 100_000, level_m2phz=(1.0,) * 100_000),
        "100000 values for the frequency",
    ),
    "negative level": (of_sea(level_m2phz=(4.0, -1.0)), "level of the sea -1"),
    "infinite level": (of_sea(level_m2phz=(inf, 1.0)), "level of the sea inf"),
    "a sea of 100 m": (of_sea(level_m2phz=(1e6, 1e6)), "heaves more than 20 m"),
    "no noise": (of_sea(noise_psd=0.0), "noise of the accelerometer 0"),
    "a bias that runs away": (of_sea(bias_walk_psd=1e9), "bias walk"),
    "a thousand resonators": (of_sea(stages=1000), "number of resonators"),
    "no resonator": (of_sea(stages=0), "number of resonators"),
    "frequency 0 of the observer": (SavedState(frequencies_hz=(0.0,)), "frequency of the observer 0 Hz"),
    "many of the observer": (SavedState(frequencies_hz=(0.1,) * 1000), "1000 values"),
    "a lead of a year": (SavedState(lead_learned_s=3e7), "learned lead"),
    "no lead": (SavedState(lead_learned_s=nan), "learned lead nan"),
    "no gain": (SavedState(gain_learned=0.0), "learned gain 0"),
    "a gain of 1e300": (SavedState(gain_learned=1e300), "learned gain 1e+300"),
    "a step of 0": (of_network(step_s=0.0), "spacing of the correction's inputs 0 s"),
    "a limit of 1e300 m": (of_network(limit_m=1e300), "limit of the correction 1e+300 m"),
    "a frequency of 1e300": (of_network(omega_radps=1e300), "wave frequency"),
    "a hull that is turned by years": (of_hull(rotation_rad=(0.0, 1e300, 0.0)), "deformation of the hull 1e+300 rad"),
    "a hull that is turned by more than half": (of_hull(rotation_rad=(3.0, 3.0, 0.0)), "length of that rotation"),
    "a hull that is turned by nothing known": (of_hull(rotation_rad=(nan, 0.0, 0.0)), "deformation of the hull nan"),
    "gyros that are twice as large": (of_hull(scale=(2.0, 0.0, 0.0)), "scale of the gyros 2"),
    "a hull known to nothing": (of_hull(covariance=(0.0,) * 21), "uncertainty of the deformation of the hull 0"),
    "no covariance": (of_hull(covariance=()), "0 values for the covariance of the hull"),
    "a covariance that is not finite": (of_hull(covariance=(inf, *COVARIANCE[1:])), "covariance of the hull inf"),
    "a covariance that is none": (
        of_hull(covariance=(COVARIANCE[0], 2e-8, *COVARIANCE[2:])),
        "covariance of the hull is not positive definite",
    ),
    "a hull that was confirmed in the future": (of_hull(unconfirmed_s=-1.0), "last confirmed -1 s"),
    "a flexure of nothing": (of_flexure(std_rad=(0.0, 1e-5, 1e-5)), "sigma of the flexure of the hull 0"),
    "a flexure without damping": (of_flexure(mu_radps=(0.0, 0.1, 0.1)), "mu of the flexure of the hull 0"),
    "a flexure of no frequency": (of_flexure(lambda_radps=(nan, 1.0, 1.0)), "lambda of the flexure of the hull nan"),
    "gyros without noise": (of_flexure(noise_radps=(0.0, 1e-6, 1e-6)), "noise of the flexure of the hull 0"),
    "a lean the other way": (of_error(lean_per_s=-0.1), "lean of the attitude -0.1 1/s"),
    "no lean": (of_error(lean_per_s=nan), "lean of the attitude nan"),
    "a lateness of a year": (of_error(late_s=3e7), "lateness of the attitude 3e+07 s"),
    "an attitude known to less than nothing": (
        of_error(covariance=(-1e-4, 0.0, 1e-4)),
        "variance of the attitude's errors -0.0001",
    ),
    "errors whose covariance is none": (of_error(covariance=(1e-4, 2e-4, 1e-4)), "not positive"),
    "errors without a covariance": (of_error(covariance=(1e-4, nan, 1e-4)), "not positive"),
    "errors that were confirmed in the future": (of_error(unconfirmed_s=-1.0), "last confirmed -1 s"),
    "a laser on the moon": (of_place(geometry=Geometry(up_m=4e8)), "place of the laser 4e+08 m"),
    "a laser nowhere": (of_place(geometry=Geometry(port_m=nan)), "place of the laser nan m"),
    "a beam that is level": (of_place(geometry=Geometry(beam=(1.0, 0.0, 0.0))), "beam of the laser is level"),
    "a beam of no direction": (of_place(geometry=Geometry(beam=(0.0, 0.0, 0.0))), "beam of the laser is level"),
    "a beam that is none": (of_place(geometry=Geometry(beam=(0.0, 0.0, nan))), "beam of the laser nan"),
    "a laser that was found nowhere": (of_place(place=LaserPlace()), "place where the laser was found nan m"),
    "a laser that was found nearly anywhere": (
        of_place(place=msgspec.structs.replace(PLACE.place, ahead_std_m=inf)),
        "uncertainty of the place of the laser inf m",
    ),
    "a laser that was seen in the future": (of_place(unconfirmed_s=-1.0), "last seen there -1 s"),
    "axes that are few": (SavedState(axes=SavedAxes(weights=(0.1,))), "1 leaks of the accelerometers' axes"),
    "axes on their side": (SavedState(axes=SavedAxes(weights=(1.0,) * 6)), "leak of the accelerometers' axes 1"),
    "no axes": (SavedState(axes=SavedAxes(weights=(nan,) * 6)), "leak of the accelerometers' axes nan"),
    "axes of the future": (SavedState(axes=SavedAxes(weights=(0.0,) * 6, unconfirmed_s=-1.0)), "confirmed -1 s"),
    "no spread": (of_network(input_std_m=nan), "heave that the correction was trained on nan"),
}


@pytest.mark.parametrize("name", SOUND)
def test_what_was_learned_is_taken(name: str) -> None:
    saved_state.check(SOUND[name])


@pytest.mark.parametrize("name", NONSENSE)
def test_nonsense_is_named(name: str) -> None:
    state, said = NONSENSE[name]
    with pytest.raises(ValueError, match=re.escape(said)):
        saved_state.check(state)


def pipeline() -> Pipeline:
    c = Config()
    return assemble(
        heave=c.heave,
        laser=c.laser,
        correction=correction.Params(),
        rock=c.rock,
        has_laser=True,
        quiet=c.quiet,
        stages=Stages(hull.Params(enabled=True)),
    )


NUMBERS = st.floats() | st.floats(0.01, 2.0) | st.sampled_from([0.0, -1.0, 1e300, 5e-324, 0.1])
LISTS = st.lists(NUMBERS, max_size=5).map(tuple)
SMALL = st.floats(-1e-8, 1e-8) | NUMBERS
THREE = st.tuples(*[st.floats(1e-6, 0.2) | NUMBERS] * 3)
GEOMETRY = st.builds(Geometry, forward_m=NUMBERS, port_m=NUMBERS, up_m=NUMBERS, beam=THREE)
RECORD = simulate(SCENES["A1"], 1, duration_s=5.0)


def test_what_was_learned_is_restored_with_its_age() -> None:
    restored = pipeline()
    restored.restore(LEARNED, age_s=60.0)
    assert restored.state() == LEARNED
    with_hull = pipeline()
    with_hull.restore(SavedState(hull=HULL, attitude_error=ERROR, laser_place=PLACE, axes=AXES), age_s=60.0)
    assert with_hull.state() == SavedState(
        hull=msgspec.structs.replace(HULL, unconfirmed_s=60.0),
        attitude_error=msgspec.structs.replace(ERROR, unconfirmed_s=60.0),
        laser_place=msgspec.structs.replace(PLACE, unconfirmed_s=60.0),
        axes=msgspec.structs.replace(AXES, unconfirmed_s=60.0),
    )


@given(hull_stored=st.builds(
    SavedHull,
    rotation_rad=THREE, scale=THREE, unconfirmed_s=NUMBERS,
    covariance=st.lists(SMALL, min_size=20, max_size=22).map(tuple) | st.just(COVARIANCE),
    flexure=st.none() | st.just(FLEXURE)
    | st.builds(SavedFlexure, std_rad=THREE, mu_radps=THREE, lambda_radps=THREE, noise_radps=THREE),
))  # fmt: skip
def test_any_hull_is_tried_or_refused(hull_stored: SavedHull) -> None:
    """And where it is tried, no reading makes it raise or publish what is not finite."""
    try:
        saved_state.check(SavedState(hull=hull_stored))
    except ValueError:
        return
    deformation = HullDeformation(hull.Params(start_s=2.0))
    deformation.restore(hull_stored, 10.0)
    for t_s, midships, local in zip(
        RECORD.midships_t_s.tolist(), RECORD.midships_radps, RECORD.local_radps, strict=True
    ):
        found = deformation.step(t_s, midships, local)
    std_rad = np.array(found.angles.std_rad)
    assert np.isfinite(std_rad).all()
    assert np.isfinite(found.local_from_midships).all()


@given(
    sea=st.none() | st.builds(
        SeaModel, stages=st.integers(-1, 70), frequency_hz=LISTS, damping=LISTS, level_m2phz=LISTS, noise_psd=NUMBERS,
        bias_walk_psd=NUMBERS,
    ),
    network=st.none() | st.builds(
        SavedNetwork, weights=st.sampled_from([WEIGHTS, WEIGHTS[:-8], b""]), width=st.sampled_from([50, 0]),
        hidden=st.sampled_from([10, -1]), output=st.sampled_from(["linear", "?"]), step_s=NUMBERS, input_std_m=NUMBERS,
        omega_radps=NUMBERS, limit_m=NUMBERS,
    ),
    place=st.none() | st.builds(
        SavedPlace, configured=st.just(Geometry()), geometry=GEOMETRY, unconfirmed_s=NUMBERS,
        place=st.just(PLACE.place) | st.builds(
            LaserPlace, ahead_m=NUMBERS, ahead_std_m=NUMBERS, port_m=NUMBERS, port_std_m=NUMBERS,
        ),
    ),
    error=st.none() | st.builds(
        SavedAttitudeError, lean_per_s=NUMBERS, late_s=NUMBERS, covariance=THREE, unconfirmed_s=NUMBERS
    ),
    others=st.fixed_dictionaries({"frequencies_hz": LISTS, "gain_learned": NUMBERS, "lead_learned_s": NUMBERS}),
)  # fmt: skip
def test_any_state_is_restored_or_refused(
    sea: SeaModel | None,
    network: SavedNetwork | None,
    place: SavedPlace | None,
    error: SavedAttitudeError | None,
    others: dict[str, Any],
) -> None:
    state = SavedState(sea=sea, correction=network, attitude_error=error, laser_place=place, **others)
    try:
        saved_state.check(state)
        restored = pipeline()
        restored.restore(state)
    except ValueError:
        return
    restored.coast(1.0)

"""A fit of the sea, packed and unpacked: the same to the last bit, whatever is in its arrays."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from running import SWELL

from heaved.estimation.heave.sea.refit import Candidate, SeaFit
from heaved.recorder.calls import pack_fit, unpack_fit


@given(
    st.integers(0, 6),
    st.booleans(),
    st.lists(st.floats(allow_nan=False), max_size=9),
    st.integers(0, 2**32 - 1),
)
def test_a_fit_comes_back_to_the_last_bit(n: int, is_symmetric: bool, told: list[float], seed: int) -> None:
    square = np.random.default_rng(seed).normal(size=(n, n))
    fit = SeaFit(
        number=3,
        model=SWELL,
        x=np.arange(float(n)).tobytes(),
        steady_covariance=(square + square.T if is_symmetric else square).tobytes(),
        predicted_m=np.array(told).tobytes(),
        innovation=np.array(told[::-1]).tobytes(),
        candidates=(Candidate(window_s=120.0, model=SWELL, score=-1.5, steady_dt_s=0.05),),
    )
    assert msgspec.msgpack.encode(unpack_fit(pack_fit(fit))) == msgspec.msgpack.encode(fit)


def test_what_the_next_fit_begins_with_is_left_out() -> None:
    one = Candidate(window_s=120.0, model=SWELL, steady_covariance=bytes(80_000))
    found = unpack_fit(pack_fit(SeaFit(number=3, candidates=(one,))))
    assert found.candidates[0] == msgspec.structs.replace(one, steady_covariance=b"")


@pytest.mark.parametrize("record", [b"", b"\x80", msgspec.msgpack.encode(SeaFit(number=1, x=b"123"))])
def test_what_is_no_fit_is_said_to_be_none(record: bytes) -> None:
    with pytest.raises(msgspec.MsgspecError):
        unpack_fit(record)

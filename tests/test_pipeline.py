"""What the pipeline does without on a machine that cannot do all, and that the heave does not notice."""

from __future__ import annotations

from math import isfinite, isnan
from typing import TYPE_CHECKING

import msgspec
from pipelines import pipeline, run, sea

from heaved.estimation.lever_arm import Point
from heaved.estimation.motion_frame import LEFT_OUT

if TYPE_CHECKING:
    from heaved.samples import MotionFrame

FROM, TO = 1400, 1800


def frames(*, relieved: bool, lead_s: float = 0.0) -> list[MotionFrame]:
    points = (Point(name="tip", forward_m=10.0, port_m=2.0, up_m=20.0),)
    pipe = pipeline(with_rock=True, point=points, lead_s=lead_s)
    samples = list(sea("S4", 60.0).samples())
    found = []
    for start, end, is_relieved in ((0, FROM, False), (FROM, TO, relieved), (TO, len(samples), False)):
        pipe.relieve(is_relieved=is_relieved)
        found += run(pipe, samples[start:end])
    return found


def without_predictions(frame: MotionFrame) -> bytes:
    """All that is published but predictions of roll and pitch and what is made of them."""
    quality = msgspec.structs.replace(frame.quality, reasons=())
    return msgspec.msgpack.encode(
        msgspec.structs.replace(
            frame, rock=(), points=(), roll_rate_radps=0.0, pitch_rate_radps=0.0, yaw_rate_radps=0.0, quality=quality
        )
    )


def test_the_heave_is_the_same_without_what_it_does_without() -> None:
    usual, relieved = frames(relieved=False), frames(relieved=True)
    assert [without_predictions(frame) for frame in relieved] == [without_predictions(frame) for frame in usual]
    said = [LEFT_OUT[0] in frame.quality.reasons for frame in relieved]
    assert any(said)
    assert not any(LEFT_OUT[0] in frame.quality.reasons for frame in usual)
    for frame, other, is_left_out in zip(relieved, usual, said, strict=True):
        # The same horizons, so that nobody who counts on them is surprised; nothing is said to be known.
        assert [one.horizon_s for one in frame.rock] == [one.horizon_s for one in usual[0].rock]
        if is_left_out:
            assert all(isnan(one.roll_rad) and isnan(one.roll_std_rad) for one in frame.rock)
            assert isfinite(frame.heave_m)
            # Points move with the roll of the sample; how fast it leans away is not known as well.
            point, usual_m = frame.points[0], other.points[0].heave_m
            assert abs(point.heave_m - usual_m) <= 2.0 * point.heave_std_m
    first, last = said.index(True), len(said) - said[::-1].index(True)
    assert all(said[first:last])
    assert isfinite(relieved[first - 1].rock[0].roll_rad)
    assert isfinite(relieved[-1].rock[0].roll_rad)


def test_predictions_are_not_left_out_where_points_are_published_ahead() -> None:
    usual, relieved = frames(relieved=False, lead_s=0.5), frames(relieved=True, lead_s=0.5)
    assert [msgspec.msgpack.encode(frame) for frame in relieved] == [msgspec.msgpack.encode(frame) for frame in usual]

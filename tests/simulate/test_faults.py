"""The text form of fault plans."""

import pytest

from heaved.simulate.faults import FaultKind, PlannedFault, parse_faults


def test_plan_is_read() -> None:
    assert parse_faults("laser:dropout@60+30, imu:late@10.5+5=120,imu:exception@1+2=6,imu-2:spike@0+0.1=-9.5") == (
        PlannedFault(device="laser", kind=FaultKind.DROPOUT, start_s=60.0, duration_s=30.0),
        PlannedFault(device="imu", kind=FaultKind.LATE, start_s=10.5, duration_s=5.0, amount=120.0),
        PlannedFault(device="imu", kind=FaultKind.EXCEPTION, start_s=1.0, duration_s=2.0, amount=6.0),
        PlannedFault(device="imu-2", kind=FaultKind.SPIKE, start_s=0.0, duration_s=0.1, amount=-9.5),
    )
    assert parse_faults("") == ()
    assert [fault.amount for fault in parse_faults("a:late@0+1,a:exception@0+1,a:spike@0+1,a:nan@0+1")] == [
        200.0,
        4.0,
        5.0,
        0.0,
    ]


def test_a_fault_lasts_from_its_start_until_just_before_its_end() -> None:
    fault = PlannedFault(device="imu", kind=FaultKind.NAN, start_s=2.0, duration_s=3.0)
    assert [fault.active(t) for t in (1.99, 2.0, 4.99, 5.0)] == [False, True, True, False]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("laser", "DEVICE:KIND@START"),
        ("laser:dropout", "DEVICE:KIND@START"),
        ("laser:dropout@60", "DEVICE:KIND@START"),
        ("laser:dropout@60+30,imu:slow@1+1", r"'imu:slow@1\+1'.*'slow'.*dropout, late"),
        ("laser:frozen@60+30=2", "takes no amount"),
        ("imu:late@1+1=-5", "5 ms early"),
        ("imu:exception@1+1=4.5", "whole number"),
        ("imu:exception@1+1=300", "1 to 255"),
    ],
)
def test_faults_in_the_plan_are_explained(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        parse_faults(text)

"""Which bytes are an answer, and what a device's answers say of it over time: pure, on invented clocks and frames."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from modbus_slaves import counter_profile, crc, device, mbap_answer, rtu, rtu_answer
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU

from heaved.devices.frames import (
    Request,
    crc16,
    explain_exception,
    explain_rtu_silence,
    explain_tcp_silence,
    find_rtu_answer,
    find_tcp_answer,
    tcp_stream_is_whole,
)
from heaved.devices.liveness import Contact, LivenessCheck
from heaved.devices.profile import Block, Field, Profile, Quantity
from heaved.devices.station import Reading, Station, cuts
from heaved.links import SerialLink
from heaved.samples import Fault

ASKED = Request(80, 3, 2)
GOOD = rtu_answer(b"\x50\x03", [0x1234, 0x5678])
LATE = rtu_answer(b"\x50\x03", [1, 2, 3])
OTHER = rtu_answer(b"\x07\x03", [1, 2])
BUSY = rtu(b"\x50\x83\x06")

# ---- answers ---------------------------------------------------------------------------------------------------------


@given(st.binary(max_size=64))
def test_crc_is_that_of_the_standard(data: bytes) -> None:
    assert crc16(data).to_bytes(2, "little") == crc(data)
    assert crc16(data + crc(data)) == 0


@pytest.mark.parametrize(
    ("heard", "found"),
    [
        (GOOD, GOOD),
        (BUSY, BUSY),
        (LATE + GOOD, GOOD),
        (OTHER + GOOD, GOOD),
        (b"\x00\xff\x50\x03\x04" + GOOD, GOOD),
        (GOOD + b"\x00", GOOD),
        (b"", b""),
        (LATE, b""),
        (OTHER, b""),
        (GOOD[:-1], b""),
        (GOOD[:-1] + bytes((GOOD[-1] ^ 1,)), b""),
        (rtu_answer(b"\x50\x04", [1, 2]), b""),
        (rtu(b"\x50\x84\x02"), b""),
    ],
)
def test_rtu_answer_among_other_bytes(heard: bytes, found: bytes) -> None:
    assert find_rtu_answer(heard, ASKED) == found


@given(st.binary(max_size=80))
def test_no_noise_is_an_answer_unless_it_is_one(noise: bytes) -> None:
    found = find_rtu_answer(noise, ASKED)
    assert found == b"" or (found in noise and crc(found[:-2]) == found[-2:] and found[0] == 80)
    assert find_rtu_answer(noise[:2] + GOOD, ASKED) in (GOOD, b"")
    explain_rtu_silence(noise, ASKED)
    explain_tcp_silence(noise, 1, ASKED)
    find_tcp_answer(noise, 1, ASKED)


SENT = rtu(b"\x50\x03\x00\x34\x00\x02")


@pytest.mark.parametrize("heard", [b"", SENT])
def test_a_late_answer_explains_a_silence(heard: bytes) -> None:
    explanation = explain_rtu_silence(heard, ASKED, sent=SENT, late_s=0.0614)
    assert explanation.fault is Fault.TIMEOUT
    assert "the latest came 61 ms after its request: raise timeout_ms" in explanation.detail
    assert "61 ms after its request" in explain_tcp_silence(b"", 9, ASKED, late_s=0.0614).detail


@pytest.mark.parametrize(
    ("heard", "fault", "words"),
    [
        (b"", Fault.TIMEOUT, "check power"),
        (LATE, Fault.LENGTH, "3 registers instead of 2"),
        (OTHER, Fault.TIMEOUT, "device id 7"),
        (b"\x00\x01\x02", Fault.CRC, "00 01 02"),
        (SENT, Fault.TIMEOUT, "only the own request came back"),
        (SENT + b"\x00\x01\x02", Fault.CRC, "3 bytes that are no valid frame (00 01 02)"),
        (SENT + GOOD[:5], Fault.TIMEOUT, "only begun (5 of 9 bytes): raise timeout_ms"),
        (GOOD[:1], Fault.TIMEOUT, "only begun (1 of 9 bytes): raise timeout_ms"),
        (GOOD[4:], Fault.CRC, "the rest of a late answer, raise timeout_ms"),
    ],
)
def test_rtu_silence_is_explained(heard: bytes, fault: Fault, words: str) -> None:
    explanation = explain_rtu_silence(heard, ASKED, sent=SENT)
    assert explanation.fault is fault
    assert words in explanation.detail


TCP_GOOD = mbap_answer(9, 80, b"\x03\x04\x12\x34\x56\x78")
TCP_LATE = mbap_answer(8, 80, b"\x03\x04\x00\x00\x00\x00")


def test_tcp_answer_is_the_one_with_the_number() -> None:
    assert find_tcp_answer(TCP_LATE + TCP_GOOD, 9, ASKED) == TCP_GOOD
    assert find_tcp_answer(TCP_LATE, 9, ASKED) == b""
    assert find_tcp_answer(TCP_GOOD[:-1], 9, ASKED) == b""
    assert find_tcp_answer(TCP_GOOD, 9, Request(81, 3, 2)) == b""
    assert find_tcp_answer(TCP_GOOD, 9, Request(80, 4, 2)) == b""
    assert find_tcp_answer(TCP_GOOD, 9, Request(0, 3, 2)) == TCP_GOOD
    assert find_tcp_answer(mbap_answer(9, 80, b"\x83\x02"), 9, ASKED) == mbap_answer(9, 80, b"\x83\x02")


@pytest.mark.parametrize(
    ("heard", "fault", "words", "whole"),
    [
        (b"", Fault.TIMEOUT, "no answer", True),
        (TCP_LATE, Fault.TIMEOUT, "late ones", True),
        (TCP_GOOD, Fault.TIMEOUT, "just too late: raise timeout_ms", True),
        (mbap_answer(9, 81, b"\x03\x02\x00\x00"), Fault.EXCEPTION, "81", True),
        (TCP_GOOD[:-1], Fault.CRC, "no whole", False),
        (b"HTTP/1.1 400", Fault.CRC, "check the port", False),
    ],
)
def test_tcp_silence_is_explained(heard: bytes, fault: Fault, words: str, whole: bool) -> None:
    explanation = explain_tcp_silence(heard, 9, ASKED)
    assert explanation.fault is fault
    assert words in explanation.detail
    assert tcp_stream_is_whole(heard) is whole


@given(st.binary(min_size=2, max_size=60), st.integers(0, 12), st.booleans())
def test_what_is_let_through_can_be_read(pdu: bytes, number: int, is_read: bool) -> None:
    """Whatever stands behind a right header: pymodbus, which gets the answer, must not fail over it."""
    body = b"\x03" + pdu[1:] if is_read else pdu
    frame = mbap_answer(number, 80, body)
    if found := find_tcp_answer(frame, 9, ASKED):
        assert found == frame
        _, response = FramerSocket(DecodePDU(False)).handleFrame(found, 80, 9)
        assert response is not None
        if not response.isError():
            assert 2 * len(response.registers) == body[1] == len(body) - 2
    elif number == 9 and body[0] == 3:
        assert body[1] != len(body) - 2 or body[1] % 2
        assert explain_tcp_silence(frame, 9, ASKED).fault is Fault.LENGTH


def test_exceptions_have_names() -> None:
    assert "illegal data address" in explain_exception(2)
    assert "exception 77, unknown" in explain_exception(77)


# ---- stuck and stale -------------------------------------------------------------------------------------------------


def test_stuck_only_after_its_time_and_gone_with_the_first_change() -> None:
    check = LivenessCheck(device("tcp://h:1", stuck_after_s=2.0))
    values: dict[Quantity, float] = {"az_mps2": 9.8, "ax_mps2": 0.1, "ay_mps2": 0.2}
    faults = [check.judge(values, 100.0 + 0.5 * number)[0] for number in range(7)]
    # 0, 0.5, 1, 1.5, 2.0 s: not longer than two seconds yet.
    assert faults == [Fault.NONE] * 5 + [Fault.STUCK] * 2
    assert check.judge({**values, "ay_mps2": 0.20001}, 104.0)[0] is Fault.NONE
    assert check.judge(values, 104.5)[0] is Fault.NONE


def test_stuck_outlives_a_gap_in_the_answers() -> None:
    """A gateway that serves its memory after the sensor was unplugged."""
    check = LivenessCheck(device("tcp://h:1", stuck_after_s=2.0))
    values: dict[Quantity, float] = {"az_mps2": 9.8, "ax_mps2": 0.1, "ay_mps2": 0.2}
    assert check.judge(values, 0.0)[0] is Fault.NONE
    fault, detail = check.judge(values, 60.0)
    assert fault is Fault.STUCK
    assert "az_mps2" in detail
    assert "60.0 s" in detail


def test_stuck_is_never_judged_if_so_configured() -> None:
    check = LivenessCheck(device("tcp://h:1", stuck_after_s=0.0))
    values: dict[Quantity, float] = {"az_mps2": 9.8, "ax_mps2": 0.1, "ay_mps2": 0.2}
    assert {check.judge(values, float(t_s))[0] for t_s in range(0, 10_000, 100)} == {Fault.NONE}


def test_one_frozen_block_is_found_though_the_other_lives() -> None:
    blocks = (
        Block(start=0, fields=(Field(quantity="az_mps2", offset=0, unit="g"),)),
        Block(start=9, fields=(Field(quantity="roll_rad", offset=0, unit="deg"),
                               Field(quantity="temperature_c", offset=1, unit="degC"))),
    )  # fmt: skip
    check = LivenessCheck(device("tcp://h:1", profile=Profile(name="two", blocks=blocks), stuck_after_s=1.0))
    faults = [
        check.judge({"az_mps2": t_s, "roll_rad": 0.5, "temperature_c": t_s}, t_s) for t_s in (0.0, 0.6, 1.2)
    ]  # the temperature is no measurement
    assert [fault for fault, _ in faults] == [Fault.NONE, Fault.NONE, Fault.STUCK]
    assert "roll_rad" in faults[2][1]


def gauge(type_: str = "uint32", unit: str = "ms") -> Profile:
    return Profile(name="gauge", blocks=(Block(start=0, fields=(
        Field(quantity="laser_m", offset=0, unit="mm"),
        Field(quantity="device_time_s", offset=1, type=type_, unit=unit),  # type: ignore[arg-type]
    )),))  # fmt: skip


def test_stale_when_the_device_clock_stands() -> None:
    check = LivenessCheck(device("tcp://h:1", role="laser", profile=gauge(), rate_hz=100.0, stuck_after_s=0.0))
    for number in range(100):  # polled twice as often as it measures: every time is seen twice
        fault, _ = check.judge({"laser_m": 1.0, "device_time_s": number // 2 * 0.02}, number * 0.01)
        assert fault is Fault.NONE
    assert check.judge({"laser_m": 2.0, "device_time_s": 0.98}, 1.4)[0] is Fault.NONE
    fault, detail = check.judge({"laser_m": 3.0, "device_time_s": 0.98}, 1.6)
    assert fault is Fault.STALE
    assert "0.98" in detail
    # A clock that begins anew runs, too.
    assert check.judge({"laser_m": 3.0, "device_time_s": 0.0}, 1.7)[0] is Fault.NONE


@pytest.mark.parametrize(
    ("rate_hz", "unit", "limit_s"),
    [(100.0, "ms", 0.5), (1.0, "ms", 2.5), (100.0, "s", 2.5)],
    ids=["half a second", "slow polls", "a clock of whole seconds"],
)
def test_stale_allows_for_coarse_clocks_and_slow_polls(rate_hz: float, unit: str, limit_s: float) -> None:
    spec = device("tcp://h:1", role="laser", profile=gauge(unit=unit), rate_hz=rate_hz, stuck_after_s=0.0)
    for after_s, fault in ((0.99 * limit_s, Fault.NONE), (1.01 * limit_s, Fault.STALE)):
        check = LivenessCheck(spec)
        check.judge({"laser_m": 1.0, "device_time_s": 5.0}, 0.0)
        assert check.judge({"laser_m": 1.1, "device_time_s": 5.0}, after_s)[0] is fault


# ---- when a slave may be asked ---------------------------------------------------------------------------------------


def contact(**changes: object) -> Contact:
    settings: dict[str, object] = {
        "numbered": False, "lengths": (12,), "alone": True, "timeout_s": 0.05, "opened_s": 0.0,
    }  # fmt: skip
    return Contact(**{**settings, **changes})  # type: ignore[arg-type]


CUTS = tuple(range(1, 12))


def settled(**changes: object) -> Contact:
    """A slave that has answered for so long that nothing older can be under way."""
    slave = contact(**changes)
    slave.answered(9.0)
    assert slave.plan(10.0, 12) == (12,)
    slave.answered(10.0)
    return slave


def test_numbered_answers_need_no_care() -> None:
    tcp = contact(numbered=True)
    for number in range(100):
        assert tcp.plan(number * 0.05, 12, CUTS) == (12,)
        tcp.missed(number * 0.05, 12)


def test_no_length_is_asked_for_while_an_answer_of_it_may_come() -> None:
    slave = contact()
    (length,) = slave.plan(0.01, 12)  # opened just now: somebody else may have asked, whose answer would come first
    assert length > 12
    slave.answered(0.02)
    assert slave.plan(0.03, 12) == (12,)
    slave.answered(0.04)
    slave.missed(1.0, 12)
    (length,) = slave.plan(1.01, 12)
    assert length > 12
    slave.answered(1.02)
    assert slave.plan(1.49, 12) != (12,)  # it answers, but not necessarily in order
    assert slave.plan(1.51, 12) == (12,)
    slave.reopened(1.52)
    assert slave.plan(1.53, 12) != (12,)


def test_no_two_requests_under_way_look_the_same() -> None:
    slave = settled()
    slave.missed(10.05, 12)
    taken = {12}
    while parts := slave.plan(10.1, 12, CUTS):
        assert sum(parts) >= 12
        assert taken.isdisjoint(parts)
        slave.missed(10.1, parts[0])
        taken.add(parts[0])
    # All lengths are taken: it rests, until no answer to any of them can come any more.
    assert {12, *range(13, 21)} < taken
    assert slave.plan(10.59, 12, CUTS) == ()
    assert slave.plan(10.61, 12, CUTS) == (12,)


def test_an_overdue_answer_is_waited_for_while_the_slave_answers_nothing() -> None:
    """A slave that works through its requests one after the other gets later with each."""
    slave = settled()
    for number in range(6):
        slave.missed(10.1 + 0.1 * number, 12 + number)
    assert slave.plan(10.65, 12, CUTS, most=17) == ()  # it is silent by now
    slave.refused(10.66, 13, 6)
    assert slave.plan(10.67, 12, CUTS, most=17) != (12,)  # although asked for over half a second ago
    slave.answered(10.68)
    assert slave.plan(10.69, 12, CUTS, most=17) == (12,)
    assert slave.plan(10.69, 15, CUTS, most=17) != (15,)


def test_a_slave_that_refuses_longer_reads_is_read_in_parts() -> None:
    slave = settled()
    slave.missed(10.1, 12)
    (longer,) = slave.plan(10.11, 12, (1, 2, 6, 11))
    assert not slave.is_plain
    slave.refused(10.12, longer, 2)
    assert slave.plan(10.13, 12, (1, 2, 6, 11)) == (11, 1)
    slave.answered(10.14)
    slave.missed(10.15, 1)
    assert slave.plan(10.16, 12, (1, 2, 6, 11)) == (6, 6)
    # Values of two registers: no part may end within them.
    assert slave.plan(10.16, 12, (2, 4, 6, 8)) == (8, 4)


@pytest.mark.parametrize(
    ("role", "field", "found"),
    [
        ("laser", Field(quantity="laser_m", offset=0, unit="m"), Fault.STUCK),
        ("crane", Field(quantity="boom_rad", offset=0, unit="rad"), Fault.NONE),
    ],
)
def test_a_crane_that_stands_still_has_no_frozen_encoder(role: str, field: Field, found: Fault) -> None:
    """The same registers of a laser are stuck after two seconds; a clock that stands is stale for either."""
    clock = Field(quantity="device_time_s", offset=1, unit="s")
    spec = device("tcp://h:1", role=role, profile=Profile(name="p", blocks=(Block(start=0, fields=(field, clock)),)))
    check = LivenessCheck(spec)
    faults = [check.judge({field.quantity: 1.0, "device_time_s": 0.1 * k}, 0.1 * k)[0] for k in range(100)]
    assert faults[-1] is found
    assert check.judge({field.quantity: 1.0, "device_time_s": 9.9}, 20.0)[0] is Fault.STALE


def test_no_read_goes_beyond_what_may_be_asked_for() -> None:
    """125 registers (Modbus application protocol, 6.3), and register 65535."""
    slave = settled()
    slave.missed(10.1, 125)
    assert slave.plan(10.11, 125, (60,), most=1000) == (60, 65)
    slave = settled()
    slave.missed(10.1, 12)
    assert slave.plan(10.11, 12, (6,), most=12) == (6, 6)
    assert slave.plan(10.11, 12, (6,), most=13) == (13,)


def test_what_comes_unasked_may_come_again() -> None:
    slave = settled()
    slave.heard(10.1, 12)
    assert slave.plan(10.11, 12) != (12,)
    slave = settled()
    slave.missed(10.1, 12)
    slave.heard(10.15, 12)  # that was it
    assert slave.plan(10.16, 12) == (12,)


def test_an_exception_proves_nothing_of_what_is_under_way() -> None:
    slave = settled()
    slave.refused(10.1, 12, 6)  # busy: the only request under way was refused
    assert slave.plan(10.11, 12) == (12,)
    assert slave.is_plain
    slave.missed(10.2, 12)
    (longer,) = slave.plan(10.21, 12)
    slave.refused(10.22, longer, 6)  # this may be of either
    assert slave.plan(10.23, 12) not in ((12,), (longer,))


def test_slave_without_another_length_rests_half_a_second_or_two_timeouts() -> None:
    for timeout_s, rest_s in ((0.05, 0.5), (1.0, 2.0)):
        slave = settled(timeout_s=timeout_s)
        slave.missed(15.0, 1)
        (longer,) = slave.plan(15.1, 1)
        slave.refused(15.1, longer, 2)
        slave.answered(18.0)
        assert slave.plan(18.0, 1) == (1,)
        slave.missed(18.0, 1)
        assert slave.plan(18.0 + 0.99 * rest_s, 1) == ()
        assert slave.plan(18.0 + 1.01 * rest_s, 1) == (1,)


@pytest.mark.parametrize("numbered", [True, False])
def test_silent_slave_among_others_is_asked_twice_a_second(numbered: bool) -> None:
    slave = settled(numbered=numbered, alone=False)
    asked, now_s = [], 10.0
    while now_s < 20.0:
        if lengths := slave.plan(now_s, 12, CUTS):
            now_s += 0.05
            asked.append((now_s, lengths))
            slave.missed(now_s, lengths[0])
        now_s += 0.01
    # Half a second at full rate, then at most two probes a second, and each for what is wanted: some devices answer
    # nothing else.
    late = [lengths for t_s, lengths in asked if t_s > 11.2]
    assert 14 <= len(late) <= 18
    assert set(late) == {(12,)}
    slave.answered(now_s)
    assert slave.plan(now_s + 0.01, 12)


def test_a_block_is_divided_between_its_values() -> None:
    fields = (
        Field(quantity="ax_mps2", offset=0, unit="g"),
        Field(quantity="az_mps2", offset=1, type="float32", unit="g"),
        Field(quantity="roll_rad", offset=5, type="int32", unit="deg"),
    )
    assert cuts(Block(start=0, fields=fields)) == (1, 3, 4, 5)


# ---- results ---------------------------------------------------------------------------------------------------------


def test_results_of_a_station() -> None:
    link = SerialLink("/dev/a", 115200)
    spec = device("rtu:///dev/a?baudrate=115200", latency_ms=-5.0, rate_hz=10.0, profile=counter_profile(2))
    station = Station(spec, link, contact(), 100.0)
    good = Reading(sent_s=100.001, values={"az_mps2": 9.8, "ax_mps2": 0.1})
    first = station.result(good, 100.0, 100.0005, 100.01, connection_number=1)
    assert first.sample.t_s == pytest.approx(100.001 + 80 / 115200 - 0.005)
    assert (first.due_s, first.sent_s, first.fault, first.detail, first.skipped) == (100.0, 100.001, Fault.NONE, "", 0)
    assert first.lateness_s == pytest.approx(0.0005)
    assert first.duration_s == pytest.approx(0.0095)
    assert not first.reconnected
    away = Reading(fault=Fault.DISCONNECTED, detail="gone")
    second = station.result(away, station.pace.due_s, 100.1, 100.45, connection_number=1)
    assert second.sample.t_s == pytest.approx(100.1 - 0.005)
    assert second.detail == "imu (/dev/a (115200 8N1), id 80): gone"
    assert station.pace.due_s == pytest.approx(100.4)  # 100.2 and 100.3 have passed
    third = station.result(msgspec.structs.replace(good, sent_s=100.46), station.pace.due_s, 100.46, 100.47, 2)
    assert third.skipped == 2
    assert third.reconnected
    fourth = station.result(msgspec.structs.replace(good, sent_s=100.5), station.pace.due_s, 100.5, 100.51, 2)
    assert not fourth.reconnected
    assert fourth.skipped == 0


def test_profile_without_the_role_is_refused() -> None:
    with pytest.raises(ValueError, match="nothing for the role laser"):
        Station(device("rtu:///dev/a", role="laser"), SerialLink("/dev/a"), contact(), 0.0)

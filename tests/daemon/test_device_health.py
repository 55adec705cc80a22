"""What is said of a device, against sequences of polls written as text."""

from __future__ import annotations

import pytest

from heaved.daemon.device_health import BACK_AFTER_RELAPSE_S, BACK_AFTER_S, DeviceHealth, Event
from heaved.samples import Fault

PERIOD_S = 0.01


class Polls:
    """100 polls a second of one device; collects the lines that would be logged."""

    def __init__(self) -> None:
        self.health = DeviceHealth("imu")
        self.now_s = 50.0
        self.lines: list[Event] = []

    def feed(self, count: int, fault: Fault = Fault.NONE) -> None:
        for _ in range(count):
            self.now_s += PERIOD_S
            event = self.health.observe(self.now_s, fault, "" if fault is Fault.NONE else f"{fault.value} happened")
            if event is not None:
                self.lines.append(event)

    def texts(self) -> list[str]:
        return [line.text for line in self.lines]


@pytest.fixture
def polls() -> Polls:
    return Polls()


def test_an_outage_is_two_lines_however_long(polls: Polls) -> None:
    polls.feed(200)
    polls.feed(1000, Fault.TIMEOUT)
    polls.feed(500)
    assert polls.texts() == ["device up", "device down", "device back"]
    down, back = polls.lines[1:]
    assert (down.level, down.fields["fault"], down.fields["detail"]) == ("warning", "timeout", "timeout happened")
    assert back.level == "info"
    assert back.fields["timeout"] == 1000
    assert back.fields["away_s"] == pytest.approx(10.0, abs=0.02)


def test_absent_from_the_start(polls: Polls) -> None:
    polls.feed(1000, Fault.DISCONNECTED)
    assert polls.texts() == ["device down"]
    assert not polls.health.up
    polls.feed(300)
    assert polls.texts() == ["device down", "device back"]
    assert polls.health.up


def test_up_follows_at_once_what_the_log_says_later(polls: Polls) -> None:
    polls.feed(1)
    assert polls.health.up
    polls.feed(2, Fault.CRC)
    assert polls.health.up
    polls.feed(1, Fault.CRC)
    assert not polls.health.up
    assert polls.texts() == ["device up"]
    polls.feed(1)
    assert polls.health.up


def test_another_fault_during_an_outage_is_said_once_for_each_kind(polls: Polls) -> None:
    polls.feed(100)
    for _ in range(200):
        polls.feed(1, Fault.TIMEOUT)
        polls.feed(1, Fault.DISCONNECTED)
    assert polls.texts() == ["device up", "device down", "device still down, another fault"]


def test_a_device_that_fails_again_differently_is_not_said_to_be_still_down(polls: Polls) -> None:
    polls.feed(100)
    polls.feed(300, Fault.TIMEOUT)
    polls.feed(300)
    polls.feed(300, Fault.TIMEOUT)
    assert polls.texts()[-1] == "device down"
    polls.feed(500)
    polls.feed(1, Fault.CRC)  # A single one, of a device that is up: no news.
    polls.feed(500)
    assert polls.texts()[-1] == "device down"
    polls.feed(300, Fault.CRC)
    assert polls.texts()[-1] == "device down again, another fault"
    polls.feed(300, Fault.TIMEOUT)
    assert len(polls.lines) == 5


def test_single_faults_are_summed_up(polls: Polls) -> None:
    """One poll in twenty is lost, for five minutes."""
    for _ in range(1500):
        polls.feed(19)
        polls.feed(1, Fault.TIMEOUT)
    assert polls.health.up
    assert polls.texts() == ["device up"] + ["device loses samples"] * 4
    assert all(line.fields["timeout"] == pytest.approx(300, abs=1) for line in polls.lines[1:])
    assert all(line.fields["polls"] == pytest.approx(6000, abs=25) for line in polls.lines[1:])


def test_a_device_that_fails_mostly_but_never_for_long_is_reported_soon_and_not_often(polls: Polls) -> None:
    """Wrong byte order: nine polls in ten are out of range, for two minutes."""
    for number in range(1200):
        polls.feed(1)
        polls.feed(9, Fault.OUT_OF_RANGE)
        if number == 60:
            assert polls.texts() == ["device up", "device loses samples"]
    assert polls.texts() == ["device up"] + ["device loses samples"] * 2
    assert polls.lines[1].fields["detail"] == "out_of_range happened"


def test_a_loose_plug_does_not_flood_the_log(polls: Polls) -> None:
    """Two seconds away, five seconds there, for an hour."""
    polls.feed(100)
    for _ in range(514):
        polls.feed(200, Fault.DISCONNECTED)
        polls.feed(500)
    assert len(polls.lines) <= 5
    assert "failed again" in str(polls.lines[3].fields["note"])
    polls.feed(int(BACK_AFTER_RELAPSE_S / PERIOD_S) + 10)
    assert polls.texts()[-1] == "device back"


def test_back_only_when_it_holds(polls: Polls) -> None:
    polls.feed(10)
    polls.feed(200, Fault.TIMEOUT)
    polls.feed(int(BACK_AFTER_S / PERIOD_S) - 5)
    assert polls.texts() == ["device up", "device down"]
    polls.feed(10)
    assert polls.texts() == ["device up", "device down", "device back"]


def test_measured_rate(polls: Polls) -> None:
    polls.feed(1000)
    assert polls.health.rate_hz(polls.now_s) == pytest.approx(100.0, rel=0.01)


def test_the_rate_is_known_soon_after_the_first_sample_and_after_an_outage(polls: Polls) -> None:
    polls.feed(60)
    assert polls.health.rate_hz(polls.now_s) == pytest.approx(100.0, rel=0.02)
    polls.feed(1000, Fault.TIMEOUT)
    assert polls.health.rate_hz(polls.now_s) == 0.0
    polls.feed(60)
    assert polls.health.rate_hz(polls.now_s) == pytest.approx(100.0, rel=0.02)
    for _ in range(500):
        polls.feed(1)
        polls.feed(1, Fault.CRC)
    assert polls.health.rate_hz(polls.now_s) == pytest.approx(50.0, rel=0.02)
    polls.feed(600, Fault.TIMEOUT)
    assert polls.health.rate_hz(polls.now_s) == 0.0


def test_results_by_fault(polls: Polls) -> None:
    polls.feed(7)
    polls.feed(3, Fault.STUCK)
    assert dict(polls.health.results) == {Fault.NONE: 7, Fault.STUCK: 3}
    assert polls.health.last_fault is Fault.STUCK
    assert polls.health.last_fault_s == polls.now_s


def test_polls_before_the_line_has_opened_are_no_losses(polls: Polls) -> None:
    polls.feed(26, Fault.DISCONNECTED)
    polls.feed(10_000)
    assert polls.texts() == ["device up"]

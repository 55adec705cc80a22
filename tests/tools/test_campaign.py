"""tools/campaign.py: what its slaves send, what its judge finds wrong, and a few seconds of it with a real daemon."""

from __future__ import annotations

import asyncio
import json
import random
from typing import TYPE_CHECKING

import pytest
from evidence.campaign import deviations, episodes
from evidence.campaign.deviations import Asked, crc
from evidence.campaign.judge import Judge, Line, _Quality
from evidence.campaign.run import Campaign, Life, Settings, table
from evidence.campaign.slaves import Slave
from evidence.campaign.truth import ClockRegisters, Truth
from modbus_slaves import crc as crc_bit_by_bit

if TYPE_CHECKING:
    from pathlib import Path

    from evidence.campaign.rig import Rig

SERIAL = Asked(bytes.fromhex("500300340003") + crc(bytes.fromhex("500300340003")), False, 0, 0x50, 3, 0x34, 3)
TCP = Asked(bytes.fromhex("00ff00000006500300340003"), True, 0xFF, 0x50, 3, 0x34, 3)
REGISTERS = [0x0102, 0xFFFE, 0x0800]


def test_the_checksum_is_that_of_the_standard() -> None:
    chance = random.Random(1)
    for length in range(1, 40):
        data = chance.randbytes(length)
        assert crc(data) == crc_bit_by_bit(data)


@pytest.mark.parametrize("asked", [SERIAL, TCP], ids=["serial", "tcp"])
@pytest.mark.parametrize("kind", [kind for kind in deviations.BYTES if kind not in deviations.FOR_TCP_ALONE])
def test_what_deviates_is_not_the_answer_alone_and_in_time(kind: str, asked: Asked) -> None:
    honest = asked.frame(asked.read(REGISTERS))
    chance = random.Random(2)
    for _ in range(50):
        sent = deviations.BYTES[kind](asked, REGISTERS, [(0.0, honest)], chance, 0.05)
        if kind == "late":
            assert sent[0][0] >= 0.05
        elif kind == "in pieces":
            assert b"".join(data for _, data in sent) == honest
        else:
            assert [data for _, data in sent] != [honest]


def test_deviations_of_one_answer_can_be_seen_beside_each_other() -> None:
    chance = random.Random(3)
    for _ in range(500):
        kinds = deviations.together(chance.sample([*deviations.BYTES, *deviations.VALUES], 4))
        assert kinds
        assert len(set(kinds)) == len(kinds)
        assert kinds == ["silent"] or "silent" not in kinds
        assert not ("exception" in kinds and set(kinds) & set(deviations.VALUES))


def test_a_slave_counts_what_it_injects_and_is_honest_when_it_is_told_to_be() -> None:
    counted: list[str] = []
    slave = Slave("imu", lambda _: REGISTERS, 0x34, 0x50, 0.05, random.Random(4), counted.append)
    honest = [(0.0, TCP.frame(TCP.read(REGISTERS)))]
    assert slave.answer(TCP, 0.0) == honest
    slave.behave("exception", "duplicated", share=1.0, most=2)
    assert all(slave.answer(TCP, 0.0) != honest for _ in range(100))
    assert len(counted) == sum(slave.events.values()) > 100
    slave.behave()
    assert slave.answer(TCP, 0.0) == honest


def test_readings_tell_when_they_were_made() -> None:
    high, low = ClockRegisters(100.0).at(100.0 + 70.123)
    assert abs((high << 16) + low - 70_123) <= 1


def _line(mono_s: float, heave_m: float, state: str = "valid", roll_deg: float = 0.0, *reasons: str) -> Line:
    return Line(
        seq=1, mono_s=mono_s, quality=_Quality(heave=state, reasons=reasons), heave_m=heave_m, heave_std_m=0.01,
        roll_deg=roll_deg, pitch_deg=0.0,
    )  # fmt: skip


def test_the_judge_knows_what_is_wrong() -> None:
    judge = Judge(Truth("S0", 1, 0.0, 10.0))
    judge.now = "fault"
    score = judge.scores["fault"]
    judge._take(_line(1.0, 0.03))
    assert score.wrong == []
    assert score.worst_stds == pytest.approx(3.0)
    judge._take(_line(1.1, 5.0, "degraded", 20.0, "imu: timeout, extrapolated"))
    assert score.wrong == []  # It says that it is not to be relied upon.
    assert judge.last_good_s == judge.last_valid_s == 1.0
    for wrong in (
        _line(1.2, 0.05),
        _line(1.3, float("nan")),
        _line(1.4, 0.0, "valid", 2.0),
        _line(1.5, 99.0, "invalid"),
    ):
        before = len(score.wrong)
        judge._take(wrong)
        assert len(score.wrong) == before + 1
    assert score.lines == 6


OF_A_BUSY_MACHINE = ("no fresh readings", "exit code 1", "before an end are not in the recording")


def _few(rig: Rig) -> list[episodes.Episode]:
    return [
        episodes.Episode("answers of the IMU, combined", episodes.answers("imu", tuple(deviations.BYTES), 3)),
        episodes.Episode("TCP reset", episodes.resets("imu")),
        episodes.Episode("clients of stream", episodes.clients("stream")),
        episodes.Episode("SIGSTOP, SIGCONT", episodes.stopped),
    ]


async def test_the_daemon_lives_through_a_few_seconds_of_it(tmp_path: Path) -> None:
    settings = Settings(
        seed=1, minutes=2.5 / 60.0, quick=("crane",), with_page=False, own_disk=False, settles_s=0.0, laser_away_s=0.0
    )
    async with asyncio.timeout(60.0):
        found = await Campaign(settings, tmp_path).run([Life("a few seconds", 1.0, False, _few)])
    (life,) = found.lives
    assert life.exit_code in (0, 1)  # It says with 1 that a part did not stop in time, as on a busy machine.
    assert "Traceback" not in (tmp_path / "log").read_text()
    assert life.lines > 0
    assert found.events > 50
    assert 0 < found.bad_answers <= found.events
    assert [
        what for what in found.failures if not any(word in what for word in OF_A_BUSY_MACHINE) or "inf s" in what
    ] == []
    (kept,) = life.kept
    assert kept.missing == 0
    assert kept.clock_readings > 0
    assert kept.wrong_readings == 0
    assert "a few seconds" in table(found)
    assert json.loads((tmp_path / "disk" / "state" / "state.json").read_bytes())["version"]

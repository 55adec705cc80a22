"""From a line to a table: a sensor is found, measured and written down, whatever befalls the line meanwhile."""

from __future__ import annotations

import asyncio
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from modbus_slaves import rtu, rtu_answer
from picky_slaves import PickySlave
from wt901 import Wt901

from heaved.config.read import packaged_profiles, parse
from heaved.devices import probe as probing
from heaved.links import SerialLink, TcpLink
from heaved.setup import survey as surveying
from heaved.setup.probe import Wishes, examine_line, live_profile, watch
from heaved.setup.probe_report import lines, tree

if TYPE_CHECKING:
    from collections.abc import Callable

    from heaved.links import Link
    from heaved.setup.polling import Polls
    from heaved.setup.probe_report import Examined

WITMOTION = tuple(profile for profile in packaged_profiles() if profile.name == "witmotion-wt901c485")


@pytest.fixture(autouse=True)
def quick_looks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(probing, "READ_PAUSE_S", 0.02)
    monkeypatch.setattr(probing, "LATEST_S", 0.0)
    monkeypatch.setattr(surveying, "PAUSE_S", 0.005)


async def examined(
    link: Link, *, seconds: float = 0.0, ids: tuple[int, ...] = (80,), timeout_s: float = 0.5
) -> tuple[list[Examined], list[str]]:
    everybody: list[Examined] = []
    wishes = Wishes(ids=ids, timeout_s=timeout_s, seconds=seconds, registers=(0x30, 0x3F))
    hints = await examine_line(
        link, wishes, WITMOTION, (), lambda done, total, what: None, everybody.append
    )  # fmt: skip
    return everybody, hints


async def on_pty(
    answer: Callable[[bytes], bytes], *, seconds: float = 0.0, ids: tuple[int, ...] = (80,), timeout_s: float = 0.5
) -> tuple[list[Examined], list[str], str]:
    slave = PickySlave(115200, answer)
    try:
        everybody, hints = await examined(SerialLink(slave.path, 115200), seconds=seconds, ids=ids, timeout_s=timeout_s)
    finally:
        slave.close()
    return everybody, hints, slave.path


async def test_a_sensor_is_found_measured_and_written_down() -> None:
    (found,), hints, path = await on_pty(Wt901(bandwidth=6), seconds=0.4)
    assert hints == []
    table, shown = found.table, found.measured
    assert table is not None
    assert shown is not None
    device = table.device
    assert (device.role, device.device_id, device.profile) == ("imu", 80, WITMOTION[0])
    assert device.link == f"rtu://{path}?baudrate=115200&parity=N"
    # Register 0x1F says 6: 5 Hz, of which the low-pass lags by 0.2 / 5 Hz.
    assert (device.bandwidth_hz, device.latency_ms) == (5.0, -40.0)
    assert device.timeout_ms == shown.round_trips.timeout_ms
    assert shown.round_trips.answers > 2
    assert shown.round_trips.lost == 0
    told = "\n".join(lines(found, device.rate_hz))
    document = tomllib.loads(told[told.index("[[device]]") :])
    assert parse(document, file="it", directory=Path("/nonexistent")).device == (device,)
    assert "no poll can say" in told


async def test_two_on_a_line_share_it_and_have_names_of_their_own() -> None:
    one, other = Wt901(80), Wt901(81)
    everybody, _, _ = await on_pty(lambda request: one(request) or other(request), ids=(80, 81))
    tables = [found.table for found in everybody]
    assert [table.device.name for table in tables if table is not None] == ["imu", "imu-2"]
    # 115200 baud carry 100 polls a second of one.
    assert [table.device.rate_hz for table in tables if table is not None] == [50.0, 50.0]


async def test_a_device_that_nobody_knows_is_surveyed_and_guessed_at() -> None:
    inner = Wt901()

    def elsewhere(request: bytes) -> bytes:
        """The same accelerations, but four registers on, and nothing else."""
        first, count = int.from_bytes(request[2:4]), int.from_bytes(request[4:6])
        if request[0] != 80 or request[1] != 3 or first < 0x38 or first + count > 0x3B:
            return rtu(bytes((request[0], request[1] | 0x80, 2))) if request[0] == 80 else b""
        moved = request[:2] + (first - 4).to_bytes(2) + request[4:6]
        return inner(rtu(moved))

    (found,), _, _ = await on_pty(elsewhere)
    assert found.device.findings == []
    assert found.table is not None
    text = "\n".join(lines(found, 100.0))
    assert "holding 0x38: three int16 as long as gravity at a scale of 16 g / 32768" in text
    assert "# Not proved: the profile is guessed from gravity alone" in text
    document = tomllib.loads(text[text.index("[[device]]") :])
    (device,) = parse(document, file="it", directory=Path("/nonexistent")).device
    assert device.profile.blocks[0].start == 0x38
    assert live_profile(found) == found.table.device.profile
    assert tree(found)["registers"][0]["address"] == 0x38


async def test_registers_that_mean_nothing_can_be_watched_too() -> None:
    (found,), _, _ = await on_pty(
        lambda request: (
            rtu_answer(request, [5] * int.from_bytes(request[4:6]))
            if request[1] == 3 and int.from_bytes(request[2:4]) >= 0x30 and sum(request[3:6:2]) <= 0x34
            else rtu(bytes((request[0], request[1] | 0x80, 2)))
        )
    )
    assert found.table is None
    profile = live_profile(found)
    assert profile is not None
    assert [(block.start, block.fields[0].offset) for block in profile.blocks] == [(0x30, 3)]


async def test_an_adapter_that_is_pulled_out_while_it_measures_loses_nothing() -> None:
    sensor = Wt901()
    slave = PickySlave(115200, sensor)
    pulled = False

    def pull() -> None:
        nonlocal pulled
        if len(slave.requests) > 200 and not pulled:
            pulled = True
            slave.unplug()

    sensor.hears = lambda: asyncio.get_running_loop().call_soon(pull)
    (found,), _ = await examined(SerialLink(slave.path, 115200), seconds=60.0)
    assert found.table is not None
    assert found.measured is not None
    assert any("the measuring ended early" in note for note in found.notes)


async def test_a_sensor_that_falls_silent_while_it_is_measured() -> None:
    sensor, requests = Wt901(), 0

    def answer(request: bytes) -> bytes:
        nonlocal requests
        requests += 1
        return sensor(request) if requests < 200 else b""

    (found,), _, _ = await on_pty(answer, seconds=60.0, timeout_s=0.06)
    assert found.table is not None
    (note,) = found.notes
    assert "id 80 has stopped answering: no answer" in note


async def test_ctrl_c_ends_the_measuring_and_not_what_is_known() -> None:
    slave = PickySlave(115200, sensor := Wt901())
    task = asyncio.create_task(examined(SerialLink(slave.path, 115200), seconds=600.0))
    # Asked 12 registers at a time, again and again: it is being measured.
    sensor.hears = lambda: task.cancel() if len(slave.requests) == 200 else None
    try:
        (found,), _ = await task
    finally:
        slave.close()
    assert found.notes == ("cut short by Ctrl-C",)
    assert found.measured is not None
    assert found.table is not None


async def test_a_line_that_cannot_be_opened_says_why() -> None:
    with pytest.raises(ConnectionError, match="/nonexistent/tty is not there: plug the adapter in"):
        await examined(SerialLink("/nonexistent/tty"))
    with pytest.raises(ConnectionError, match="connection refused"):
        await examined(TcpLink("127.0.0.1", 1))


async def test_watching_goes_on_through_silence_until_ctrl_c() -> None:
    from heaved.setup.live import View

    slave = PickySlave(115200, lambda request: sensor(request) if len(slave.requests) % 3 else b"")
    sensor = Wt901()
    answers: list[int] = []
    lost: list[int] = []

    def push(polls: Polls) -> None:
        answers.append(len(polls.registers))
        lost.append(sum(polls.lost.values()))
        if len(answers) == 12:
            task.cancel()

    wishes = Wishes(ids=(80,), timeout_s=0.1, seconds=0.0)
    task = asyncio.create_task(watch(View("it", WITMOTION[0]), SerialLink(slave.path, 115200), 80, wishes, push))
    try:
        await task
    finally:
        slave.close()
    assert lost[-1] == 4
    assert answers[-1] == 8

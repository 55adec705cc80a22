"""The live view: raw and decoded side by side, and what moves is marked."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from heaved.config.read import packaged_profiles
from heaved.devices.profile import Quantity, decode, encode
from heaved.setup.live import View, cells
from heaved.setup.polling import Polls

PROFILE = next(profile for profile in packaged_profiles() if profile.name == "witmotion-wt901c485")
STILL = [3, 0xFFFE, 2048, 0, 1, 0, 11, 12, 13, 364, 0xFF4A, 91]


def shown(view: View, now_s: float, width: int = 130) -> list[str]:
    console = Console(file=io.StringIO(), width=width, color_system=None)
    console.print(view.render(now_s, width))
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().splitlines()


def push(view: View, registers: list[int], now_s: float) -> None:
    (block,) = PROFILE.blocks
    view.push(
        Polls([now_s], [0.01], [tuple(registers)], [decode(block, registers).values], {}), now_s
    )  # fmt: skip


def row(lines: list[str], address: str) -> list[str]:
    return next(line for line in lines if f" {address} " in line).split()


def test_every_register_has_a_row_also_between_the_fields() -> None:
    assert [cell.address for cell in cells(PROFILE.blocks)] == list(range(0x34, 0x40))
    sim = next(profile for profile in packaged_profiles() if profile.name == "heaved-sim-imu")
    assert [cell.indices for cell in cells(sim.blocks)] == [(2 * i, 2 * i + 1) for i in range(9)]


def test_raw_and_decoded_stand_side_by_side() -> None:
    view = View("id 80 on /dev/ttyUSB0", PROFILE)
    assert "waiting for the first answer" in shown(view, 0.0)[1]
    push(view, STILL, 1.0)
    lines = shown(view, 1.0)
    assert row(lines, "0x36") == [
        "az", "0x36", "0800", "2048", "int16", "9.807", "m/s2", "9.807", "9.807",
    ]  # fmt: skip
    assert row(lines, "0x35")[2:4] == ["FFFE", "-2"]
    # 0xFF4A is -182 counts, a degree, and pitch has its sign turned.
    assert row(lines, "0x3E")[:7] == ["pitch", "0x3E", "FF4A", "-182", "int16", "1.000", "deg"]
    assert row(lines, "0x3A") == ["0x3A", "000B", "11", "-", "11", "11"]


@pytest.mark.parametrize("width", [130, 100, 80, 60])
@pytest.mark.parametrize("name", ["witmotion-wt901c485", "heaved-sim-imu"])
def test_no_number_is_cut_short_on_a_narrow_terminal(name: str, width: int) -> None:
    profile = next(profile for profile in packaged_profiles() if profile.name == name)
    view = View("it", profile)
    (block,) = profile.blocks
    values: dict[Quantity, float] = {field.quantity: -150.0 for field in block.fields}
    if name == "witmotion-wt901c485":
        values = dict.fromkeys(values, -1.5)
    registers = encode(block, values)
    for k in range(3):
        view.push(Polls([float(k)], [0.01], [tuple(registers)], [values], {}), float(k))
    lines = shown(view, 3.0, width)
    assert not any("…" in line for line in lines[:-1])
    assert max(map(len, lines)) <= width
    assert ("int16" in lines[5] or "float32" in lines[5]) is (width >= 100)
    # Raw numbers of one register fit the usual 80 columns.
    assert ("raw" in lines[2]) is (width >= 100 or (width == 80 and name == "witmotion-wt901c485"))


def test_what_moves_is_marked_and_counted_and_the_mark_fades() -> None:
    view = View("it", PROFILE)
    for k in range(100):
        push(view, [STILL[0] + k % 2, *STILL[1:]], 0.1 * k)
    assert not any("◀" in line for line in shown(view, 9.9)[2:-1])
    lifted = [*STILL[:9], 364 + 500, *STILL[10:]]
    push(view, lifted, 10.0)
    push(view, [*lifted[:9], 364 + 900, *lifted[10:]], 10.1)
    lines = shown(view, 10.1)
    marked = [line for line in lines[2:-1] if "◀" in line]
    assert len(marked) == 1
    assert "roll" in marked[0]
    assert row(lines, "0x34")[-1] == "9.9"
    assert "10.0 polls a second" in lines[1]
    assert not any("◀" in line for line in shown(view, 12.0)[2:-1])


def test_silence_and_lost_answers_are_told() -> None:
    view = View("it", PROFILE)
    push(view, STILL, 0.0)
    view.push(Polls(lost={"no answer: check\x1b[2J power": 3}), 5.0)
    lines = shown(view, 5.0)
    assert "no answer for 5 s" in lines[1]
    assert any("3 without an answer, the latest: no answer: check\\x1b[2J power" in line for line in lines)

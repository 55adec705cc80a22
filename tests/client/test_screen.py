"""The live view: what it draws, and that it lives through a restart of the daemon."""

from __future__ import annotations

import asyncio
import io
import re
import threading
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
from rich.cells import cell_len
from rich.console import Console
from stream_peers import Serve, make_frame, make_status

from heaved.client.screen import View, bar, watch
from heaved.outputs import wire
from heaved.outputs.records import MotionRecord, ObserverStatus, PointRecord
from heaved.samples import HeaveState, Vibration

_STYLES = re.compile(r"\x1b\[[0-9;]*m")


def motion(heave: HeaveState = HeaveState.VALID, **changes: object) -> MotionRecord:
    line = wire.encode_motion(make_frame(5.0, heave), seq=1, utc_s=1767225600.0, sent_mono_s=5.002)
    return msgspec.structs.replace(msgspec.json.decode(line, type=MotionRecord), **changes)


def drawn(view: View, now_s: float, width: int = 100, **options: Any) -> str:
    """What a terminal of this width shows; without colours, unless asked for."""
    out = io.StringIO()
    options = {"color_system": None, "markup": False, "highlight": False, "emoji": False, **options}
    Console(file=out, width=width, force_terminal=True, **options).print(view.render(now_s, width))
    return out.getvalue() if options["color_system"] else _STYLES.sub("", out.getvalue())


@pytest.mark.parametrize(
    ("heave_m", "greatest_m", "text"),
    [
        (0.0, 0.9, "  -1 m [··········|··········] +1 m"),
        (0.5, 0.9, "  -1 m [··········|█████·····] +1 m"),
        (-0.2, 1.0, "  -1 m [········██|··········] +1 m"),
        (1.0, 1.1, "  -2 m [··········|█████·····] +2 m"),
        (None, 0.0, "  -0.1 m [········|········] +0.1 m"),
        (30.0, 30.0, "  -30 m [·········|█████████] +30 m"),
    ],
)
def test_bar(heave_m: float | None, greatest_m: float, text: str) -> None:
    assert bar(heave_m, greatest_m, 35) == text


def test_view_of_good_data() -> None:
    view = View("here:5570")
    assert "connecting" in drawn(view, 0.0)
    view.connected("1.2.3", 10.0)
    view.push(motion(points=(PointRecord(name="crane-tip", heave_m=-2.345, heave_velocity_mps=0.5),)), 10.1)
    view.push(make_status(), 10.1)
    text = drawn(view, 10.2)
    for expected in ("heaved 1.2.3 at here:5570", "connected for 200.0 ms", "✔ HEAVE VALID",
                     "+1.25 m  ±0.020 m  -0.50 m/s", "age 102.0 ms", "99.5 Hz"):  # fmt: skip
        assert expected in text
    rows = [line.split() for line in text.splitlines()]
    assert ["roll", "+5.73°", "+5.73°", "+5.73°", "+5.73°", "+5.73°"] in rows
    assert ["pitch", "-2.86°", "-2.86°", "-2.86°", "-2.86°", "-2.86°"] in rows
    assert ["yaw", "-", "-", "-", "-", "-"] in rows
    assert ["heave", *["+1.00", "m", "±0.10"] * 4] in rows
    assert ["crane-tip", "-2.35", "m", "+0.50", "m/s"] in rows
    assert ["imu", "imu", "✔", "up", "99.5", "Hz", "-"] in rows


def test_view_of_a_hull_that_shakes() -> None:
    view = View("here:5570")
    view.connected("1.2.3", 0.0)
    shaking = (Vibration(frequency_hz=3.1, width_hz=0.02, rms_mps2=0.21),)
    view.push(make_status(observer=ObserverStatus(name="sea", vibration=shaking, noise_mps2_rthz=1e-3)), 0.0)
    told = "accelerometer   noise 1.0e-03 m/s2/√Hz   vibration: seen at 3.1 Hz, 0.21 m/s2"
    assert told in drawn(view, 0.1)


NUMBERS = ("1.25", "5.73", "0.50", "1.00 m", "0.77")


@pytest.mark.parametrize(
    ("heave", "now_s", "trouble", "said", "gone"),
    [
        (HeaveState.VALID, 15.0, None, "✖ DATA 5.0 s OLD", NUMBERS),
        (
            HeaveState.VALID,
            10.1,
            "here:5570: Connection refused",
            "here:5570: Connection refused - trying again",
            NUMBERS,
        ),
        (HeaveState.INVALID, 10.1, None, "✖ HEAVE INVALID", ("1.25", "0.50", "1.00 m", "0.77")),
        (HeaveState.SETTLING, 10.1, None, "◔ HEAVE SETTLING", ()),
        (HeaveState.DEGRADED, 10.1, None, "▲ HEAVE DEGRADED", ()),
    ],
)
def test_what_must_not_be_used_is_no_number(
    heave: HeaveState, now_s: float, trouble: str | None, said: str, gone: tuple[str, ...]
) -> None:
    view = View("here:5570")
    view.connected("1.2.3", 10.0)
    view.push(motion(heave, points=(PointRecord(name="tip", heave_m=0.77),)), 10.0)
    if trouble is not None:
        view.lost(trouble)
    text = drawn(view, now_s)
    assert said in text
    assert not [number for number in gone if number in text]
    assert all(number in text for number in NUMBERS if number not in gone)


def test_view_of_a_daemon_that_came_back() -> None:
    view = View("here:5570")
    view.connected("1.2.3", 10.0)
    view.push(make_status(), 10.0)
    assert "imu" in drawn(view, 10.1)
    view.lost("here:5570: Connection refused")
    assert "imu" not in drawn(view, 16.0)  # Who knows.
    view.connected("1.2.4", 20.0)
    view.push(motion(HeaveState.DEGRADED, dropped=7), 20.0)
    assert "connection 2 since this view began, 7 frames lost" in drawn(view, 20.1)


def test_what_is_wrong_is_seen_on_a_narrow_and_low_terminal() -> None:
    view = View("here:5570")
    view.connected("1.2.3", 0.0)
    reasons = ("no attitude or no horizontal acceleration: tilt not removed", "laser: no fresh reference")
    quality = msgspec.structs.replace(motion(HeaveState.DEGRADED).quality, reasons=reasons)
    view.push(motion(quality=quality), 0.0)
    device = msgspec.structs.replace(
        make_status().devices[0],
        up=False,
        detail="imu (tcp://192.168.100.200:15511, id 1): connection refused: check the port",
    )
    view.push(make_status(devices=(device,)), 0.0)
    lines = drawn(view, 0.1, 80).splitlines()[:12]
    at = next(row for row, line in enumerate(lines) if "DEGRADED" in line)
    assert [line.strip("║ ") for line in lines[at + 3 : at + 5]] == list(reasons)
    assert "✖ imu (imu) DOWN: connection refused: check the port" in lines


def test_outputs_are_shown_and_one_that_is_down_says_what_to_do() -> None:
    view = View("here:5570")
    view.connected("1.2.3", 0.0)
    good = SimpleNamespace(
        name="mru", kind="tss1", link="udp://x", up=True, sent=1234, lost={"slow": 3, "down": 0}, detail=""
    )
    bad = SimpleNamespace(
        name="plc", kind="registers", link="tcp://y", up=False, sent=0, lost={}, detail="refused: is it on?"
    )
    status = SimpleNamespace(devices=(), observer=None, reference_mru=None, outputs=(good, bad))
    view._status = status  # type: ignore[assignment]
    text = drawn(view, 0.1)
    assert "✖ output plc (registers) DOWN: refused: is it on?" in text
    rows = [line.split() for line in text.splitlines()]
    assert ["mru", "tss1", "✔", "up", "1234", "slow", "3"] in rows
    assert ["plc", "registers", "✖", "DOWN", "0", "-"] in rows


@pytest.mark.parametrize("width", [1, 20, 40, 80, 120, 200])
def test_no_line_is_wider_than_the_terminal(width: int) -> None:
    view = View("here:5570")
    view.connected("1.2.3", 0.0)
    view.push(motion(heave_m=-123456.0), 0.0)
    view.push(make_status(), 0.0)
    assert max(cell_len(line) for line in drawn(view, 0.0, width).splitlines()) <= width


def test_all_of_a_usual_ship_fits_on_80_by_24() -> None:
    view = View("127.0.0.1:5570")
    view.connected("1.2.3", 0.0)
    points = tuple(PointRecord(name=name, heave_m=-1.0, heave_std_m=0.1) for name in ("crane-tip", "moon-pool"))
    turned = motion(points=points, heave_m=-12.34)
    rock = tuple(
        msgspec.structs.replace(one, yaw_deg=-179.99, roll_deg=-12.34, roll_interval_deg=12.34, yaw_interval_deg=0.12)
        for one in turned.rock
    )
    view.push(msgspec.structs.replace(turned, rock=rock, yaw_deg=-179.99), 0.0)
    imu = make_status().devices[0]
    view.push(make_status(devices=(imu, msgspec.structs.replace(imu, name="laser", role="laser"))), 0.0)
    for width in (60, 80, 120, 160):
        assert "…" not in drawn(view, 0.1, width)
    text = drawn(view, 0.1, 80)
    assert len(text.splitlines()) <= 24
    assert text.count("-179.99° ±0.12") == 4


def test_without_colours_nothing_is_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    view = View("here:5570")
    view.connected("1.2.3", 0.0)
    view.push(motion(HeaveState.INVALID), 0.0)
    view.push(make_status(), 0.0)
    coloured = drawn(view, 0.1, color_system="standard")
    monkeypatch.setenv("NO_COLOR", "1")
    plain = drawn(view, 0.1, color_system="standard")
    colours = re.compile(r"\x1b\[(?:[\d;]*;)?(?:3[0-7]|4[0-7]|9[0-7])(?:;[\d;]*)?m")
    assert colours.search(coloured)
    assert not colours.search(plain)
    assert _STYLES.sub("", plain) == _STYLES.sub("", coloured)


EVIL = "\x1b]0;x\x07\x9b31m\u202e\n\r[bold red]:warning:[/]"


def test_nothing_of_the_stream_commands_the_terminal() -> None:
    view = View(f"here{EVIL}")
    view.connected(f"1.2.3{EVIL}", 0.0)
    quality = msgspec.structs.replace(motion().quality, reasons=(f"swell{EVIL}",))
    view.push(motion(quality=quality, time=EVIL, points=(PointRecord(name=EVIL, heave_m=1.0),)), 0.0)
    device = msgspec.structs.replace(
        make_status().devices[0], name=EVIL, role=EVIL, up=False, last_fault=EVIL, detail=EVIL
    )
    view.push(make_status(devices=(device,)), 0.0)
    for now_s in (0.0, 9.0):
        text = drawn(view, now_s, 400)
        assert all(line.isprintable() for line in text.splitlines())
        assert "[bold red]:warning:[/]" in text  # Nor does the markup.
    view.lost(f"gone{EVIL}")
    assert all(line.isprintable() for line in drawn(view, 0.0, 400).splitlines())


class EnoughSeen(Exception):  # noqa: N818  # no error
    """Ends the live view, as the user would."""


class Screen(io.StringIO):
    """A terminal that waits for texts, one after the other; ends the view after the last."""

    def __init__(self, *texts: str) -> None:
        super().__init__()
        self.seen = {text: threading.Event() for text in texts}

    def write(self, text: str) -> int:
        for wanted, event in self.seen.items():
            if not event.is_set():
                if wanted in _STYLES.sub("", text):
                    event.set()
                    if all(event.is_set() for event in self.seen.values()):
                        raise EnoughSeen
                break
        return super().write(text)


async def test_watch_lives_through_a_restart(serve: Serve) -> None:
    served = await serve()
    screen = Screen("VALID", "trying again", "connection 2 since")
    watching = asyncio.create_task(asyncio.to_thread(watch, served.host, served.port, screen))
    seen = list(screen.seen.values())
    while not seen[0].is_set():
        served.publish()
        await asyncio.sleep(0.005)
    await served.publisher.close(0.0)
    await asyncio.to_thread(seen[1].wait)
    again = await serve(port=served.port)
    while not watching.done():
        again.publish()
        await asyncio.sleep(0.005)
    with pytest.raises(EnoughSeen):
        await watching
    text = screen.getvalue()
    assert text.startswith("\x1b[?1049h")  # Its own screen, no cursor ...
    assert text.index("\x1b[?25l") < text.index("HEAVE VALID")
    assert text.endswith("\x1b[?25h\x1b[?1049l")  # ... and both given back.

"""The live view: what it draws, and that it lives through a restart of the daemon."""

from __future__ import annotations

import asyncio
import io
import re
import threading

import msgspec
import pytest
from stream_peers import Serve, make_frame, make_status

from heaved.client.screen import View, bar, big, watch
from heaved.outputs import wire
from heaved.outputs.records import MotionRecord, ObserverStatus
from heaved.samples import HeaveState, Vibration

_COLOURS = re.compile(r"\x1b\[[0-9;]*m")


def motion(heave: HeaveState = HeaveState.VALID, **changes: object) -> MotionRecord:
    line = wire.encode_motion(make_frame(5.0, heave), seq=1, utc_s=1767225600.0, sent_mono_s=5.002)
    return msgspec.structs.replace(msgspec.json.decode(line, type=MotionRecord), **changes)


def drawn(view: View, now_s: float, width: int = 100) -> str:
    return _COLOURS.sub("", "\n".join(view.render(now_s, width)))


def test_big_letters() -> None:
    assert big("+1.0") == [
        "     █    ███",
        " █  ██    █ █",
        "███  █    █ █",
        " █   █    █ █",
        "    ███ █ ███",
    ]
    assert len({len(row) for row in big("-0123456789. m")}) == 1


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
    view.push(motion(), 10.1)
    view.push(make_status(), 10.1)
    text = drawn(view, 10.2)
    for expected in ("heaved 1.2.3 at here:5570", "connected for 200.0 ms", "VALID", "±0.020 m   -0.50 m/s",
                     "roll +5.73°   pitch -2.86°   yaw -", "age 102.0 ms", "imu (imu) up   99.5 Hz"):  # fmt: skip
        assert expected in text
    for row in big("+1.25 m"):
        assert row.rstrip() in text


def test_view_of_a_hull_that_shakes() -> None:
    view = View("here:5570")
    view.connected("1.2.3", 0.0)
    shaking = (Vibration(frequency_hz=3.1, width_hz=0.02, rms_mps2=0.21),)
    view.push(make_status(observer=ObserverStatus(name="sea", vibration=shaking, noise_mps2_rthz=1e-3)), 0.0)
    told = "accelerometer   noise 1.0e-03 m/s2/√Hz   vibration: seen at 3.1 Hz, 0.21 m/s2"
    assert told in drawn(view, 0.1)


def test_view_of_old_data_and_of_trouble() -> None:
    view = View("here:5570")
    view.connected("1.2.3", 10.0)
    view.push(motion(), 10.0)
    assert "DATA 5.0 s OLD" in drawn(view, 15.0)
    assert "VALID" not in drawn(view, 15.0)
    view.lost("here:5570: Connection refused")
    assert "Connection refused - trying again" in drawn(view, 16.0)
    view.connected("1.2.4", 20.0)
    view.push(motion(HeaveState.DEGRADED, dropped=7), 20.0)
    text = drawn(view, 20.1)
    assert "connection 2 since this view began, 7 frames lost" in text
    assert "DEGRADED" in text


def test_what_is_wrong_is_seen_on_a_narrow_terminal() -> None:
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
    lines = drawn(view, 0.1, 80).splitlines()
    at = next(row for row, line in enumerate(lines) if "DEGRADED" in line)
    assert [line.strip() for line in lines[at : at + 2]] == [f"DEGRADED: {reasons[0]}", reasons[1]]
    assert "    connection refused: check the port" in lines


@pytest.mark.parametrize("width", [1, 20, 40, 80, 200])
def test_no_line_is_wider_than_the_terminal(width: int) -> None:
    view = View("here:5570")
    view.connected("1.2.3", 0.0)
    view.push(motion(heave_m=-123456.0), 0.0)
    view.push(make_status(), 0.0)
    assert max(len(line) for line in drawn(view, 0.0, width).splitlines()) <= width


EVIL = "\x1b]0;x\x07\x9b31m\u202e\n\r"


def test_nothing_of_the_stream_commands_the_terminal() -> None:
    view = View(f"here{EVIL}")
    view.connected(f"1.2.3{EVIL}", 0.0)
    quality = msgspec.structs.replace(motion().quality, reasons=(f"swell{EVIL}",))
    view.push(motion(quality=quality, time=EVIL), 0.0)
    device = msgspec.structs.replace(
        make_status().devices[0], name=EVIL, role=EVIL, up=False, last_fault=EVIL, detail=EVIL
    )
    view.push(make_status(devices=(device,)), 0.0)
    for now_s in (0.0, 9.0):
        assert all(line.isprintable() for line in drawn(view, now_s, 400).split("\n"))
    view.lost(f"gone{EVIL}")
    assert all(line.isprintable() for line in drawn(view, 0.0, 400).split("\n"))


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
                if wanted in _COLOURS.sub("", text):
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
    assert text.startswith("\x1b[?1049h\x1b[?25l")  # Its own screen, no cursor ...
    assert text.endswith("\x1b[?25h\x1b[?1049l")  # ... and both given back.

"""The page in a browser: what is on the screen is what the stream says, and nothing that is old or strange passes."""

from __future__ import annotations

import asyncio
import time
from contextlib import asynccontextmanager, contextmanager
from typing import TYPE_CHECKING

import msgspec
import pytest
from page_shots import CHROMIUM, Browser, browser
from stream_peers import Serve, make_frame, make_status
from waiting import holds

from heaved.outputs import wire
from heaved.outputs.records import DeviceStatus, MotionRecord, ReferenceStatus
from heaved.page.follower import Link
from heaved.page.server import PageServer
from heaved.samples import HeaveState, MotionFrame, PointMotion, SeaState, WaveSystem

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterator

    from heaved.outputs.stream import Publisher

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")

EVIL = "<img src=x onerror=\"document.title='owned'\"><script>document.title='owned'</script>"


@asynccontextmanager
async def page(stream_port: int) -> AsyncIterator[tuple[Browser, PageServer]]:
    """A browser that shows the page of the daemon at this port."""
    server = PageServer(host="127.0.0.1", port=0, allow=(), stream_host="127.0.0.1", stream_port=stream_port)
    host, port = await server.start()
    try:
        async with browser() as tab:
            await tab.show(f"http://{host}:{port}/", 1280, 800)
            yield tab, server
    finally:
        await server.close()


@contextmanager
def publishing(publisher: Publisher, made: Callable[[float], MotionFrame]) -> Iterator[None]:
    """Frames of now, at about 50 Hz."""

    async def publish() -> None:
        while True:
            publisher.publish(made(time.monotonic()))
            await asyncio.sleep(0.02)

    task = asyncio.create_task(publish())
    try:
        yield
    finally:
        task.cancel()


async def shown(tab: Browser, *ids: str) -> list[str]:
    texts = [await tab.evaluate(f"document.getElementById('{one}').textContent") for one in ids]
    return [str(text) for text in texts]


async def until_text(tab: Browser, name: str, text: str) -> None:
    await tab.until(f"document.getElementById('{name}').textContent.includes({msgspec.json.encode(text).decode()})")


async def lines_of(tab: Browser, name: str) -> str:
    return str(await tab.evaluate(f"document.getElementById('{name}').innerText"))


def with_points(t_s: float) -> MotionFrame:
    tip = PointMotion(name="crane-tip", heave_m=-2.345, heave_std_m=0.03, heave_velocity_mps=0.5)
    return msgspec.structs.replace(make_frame(t_s), points=(tip,), reference_m=1.2504)


async def test_what_is_shown_is_what_the_stream_says(serve: Serve) -> None:
    served = await serve(clock=time.monotonic)
    async with page(served.port) as (tab, _):
        with publishing(served.publisher, with_points):
            await until_text(tab, "title", "HEAVE VALID")
            await tab.until("document.getElementById('age').textContent.endsWith(' ms')")
            assert await shown(tab, "heave-m", "heave-2std", "heave-velocity", "heave-way") == [
                "+1.25", "0.04", "−0.50", "▼",
            ]  # fmt: skip
            assert await shown(tab, "roll", "pitch") == ["+5.7°", "−2.9°"]  # 0.1 and -0.05 rad.
            assert await shown(tab, "roll-ahead") == ["in 1.0 s +5.7° ± 0.1°"]  # 2 x 0.001 rad.
            assert (await shown(tab, "reference"))[0] == "+1.250 m, valid"
            assert (await lines_of(tab, "point-rows")).split() == [
                "crane-tip",
                "−2.35",
                "±",
                "0.06",
                "m",
                "+0.50",
                "m/s",
            ]
            assert "heaved 1.2.3 at 127.0.0.1" in (await shown(tab, "where"))[0]
            await until_text(tab, "device-rows", "✔ imu (imu) up")
            assert "99.5 Hz" in (await shown(tab, "device-rows"))[0]
            sea = SeaState(
                significant_height_m=2.34, peak_period_s=8.76, mean_period_s=7.1, t_s=time.monotonic(), window_s=60.0,
                systems=(WaveSystem(kind="swell", significant_height_m=1.2, peak_period_s=12.3),),
                frequencies_hz=(0.05, 0.1, 0.15, 0.2), spectrum_m2phz=(0.1, 5.0, 2.0, 0.2),
            )  # fmt: skip
            served.publisher.publish_slow(msgspec.structs.replace(make_frame(time.monotonic()), sea=sea))
            await until_text(tab, "systems", "swell 1.2 m, 12.3 s")
            assert await shown(tab, "hs", "tp", "tm") == ["2.3", "8.8", "7.1"]


async def test_a_stream_that_stops_is_an_alarm_and_no_number_stays(serve: Serve) -> None:
    served = await serve(clock=time.monotonic)
    numbers = ("heave-m", "heave-2std", "heave-velocity", "roll", "pitch", "reference")
    async with page(served.port) as (tab, server):
        with publishing(served.publisher, with_points):
            await until_text(tab, "heave-m", "+1.25")
            await until_text(tab, "point-rows", "−2.35")
        # No frame any more, though the daemon lives and says its STATUS.
        await until_text(tab, "title", "OLD")
        assert await tab.evaluate("document.getElementById('band').className") == "alarm"
        assert await shown(tab, *numbers) == ["–"] * len(numbers)
        assert "−2.35" not in (await shown(tab, "point-rows"))[0]
        assert await tab.evaluate("document.body.classList.contains('withheld')")
        with publishing(served.publisher, with_points):
            await until_text(tab, "heave-m", "+1.25")
            await served.publisher.close(0.0)
            await until_text(tab, "title", "NO DAEMON")
        assert "trying again" in (await shown(tab, "reason"))[0]
        assert await shown(tab, *numbers) == ["–"] * len(numbers)
        assert await shown(tab, "device-rows") == ["–"]
        served = await serve(port=served.port, clock=time.monotonic)
        with publishing(served.publisher, with_points):
            await until_text(tab, "title", "HEAVE VALID")
            await server.close()
            await until_text(tab, "title", "NO CONNECTION")
            assert await shown(tab, *numbers) == ["–"] * len(numbers)


@pytest.mark.parametrize(
    ("state", "title", "level", "heave"),
    [
        (HeaveState.INVALID, "HEAVE INVALID", "alarm", "–"),
        (HeaveState.SETTLING, "SETTLING", "settling", "+1.25"),
        (HeaveState.DEGRADED, "DEGRADED", "caution", "+1.25"),
    ],
)
async def test_what_the_heave_is_worth_is_said_with_every_reason(
    serve: Serve, state: HeaveState, title: str, level: str, heave: str
) -> None:
    served = await serve(clock=time.monotonic)
    reasons = ("imu: no answer", "laser: no fresh reference", "tilt not removed")

    def made(t_s: float) -> MotionFrame:
        frame = make_frame(t_s, state)
        return msgspec.structs.replace(frame, quality=msgspec.structs.replace(frame.quality, reasons=reasons))

    async with page(served.port) as (tab, _):
        with publishing(served.publisher, made):
            await until_text(tab, "title", title)
            assert await tab.evaluate("document.getElementById('band').className") == level
            assert await shown(tab, "heave-m") == [heave]
            assert await tab.evaluate("document.body.classList.contains('soft')") is (level == "settling")
            assert reasons[0] in (await shown(tab, "reason"))[0]
            listed = (await lines_of(tab, "reasons")).split("\n")
            assert [line.removeprefix("• ") for line in listed] == list(reasons)


async def test_an_mru_beside_ours_is_shown_where_there_is_one(serve: Serve) -> None:
    said = [None, ReferenceStatus()]
    said += [
        ReferenceStatus(
            heave_difference_m=-0.123, heave_std_difference_m=0.21, compared_s=300.0, age_s=0.1,
            warnings=(f"reference MRU: heave differs {EVIL}",),
        ),
        ReferenceStatus(age_s=42.0),
    ]  # fmt: skip
    served = await serve(clock=time.monotonic, status=lambda: make_status(reference_mru=said[0]))
    async with page(served.port) as (tab, _):
        with publishing(served.publisher, with_points):
            await until_text(tab, "title", "HEAVE VALID")
            assert await tab.evaluate("document.getElementById('reference-mru-row').hidden")
            for text in ("nothing to compare yet", "−0.12 m, 0.21 m RMS in 300 s", "nothing for 42 s"):
                del said[0]
                served.publisher.publish_record(make_status(reference_mru=said[0]))
                await until_text(tab, "reference-mru", text)
                if "RMS" in text:
                    await until_text(tab, "title", "HEAVE VALID, BUT")
                    assert (await shown(tab, "reason"))[0] == f"reference MRU: heave differs {EVIL}"


async def test_a_device_that_is_down_is_said_and_its_name_is_only_text(serve: Serve) -> None:
    detail = f"{EVIL} (tcp://10.0.0.9:502, id 1): connection refused: check the port"
    device = DeviceStatus(name=EVIL, role=EVIL, up=False, last_fault=EVIL, detail=detail)
    served = await serve(clock=time.monotonic, status=lambda: make_status(devices=(device,), release=EVIL))

    def made(t_s: float) -> MotionFrame:
        frame = make_frame(t_s)
        quality = msgspec.structs.replace(frame.quality, reasons=(EVIL,))
        return msgspec.structs.replace(frame, quality=quality, points=(PointMotion(name=EVIL, heave_m=0.1),))

    async with page(served.port) as (tab, _):
        with publishing(served.publisher, made):
            await until_text(tab, "title", "HEAVE VALID, BUT")
            assert (await shown(tab, "reason"))[0] == f"{EVIL} is DOWN"
            assert "DOWN" in (await shown(tab, "device-rows"))[0]
            assert EVIL in (await shown(tab, "point-rows"))[0]
            assert EVIL in (await shown(tab, "reasons"))[0]
            assert await tab.evaluate("document.querySelectorAll('img').length") == 0
            assert await tab.evaluate("document.scripts.length") == 2  # Those of the page.
            assert "owned" not in await tab.evaluate("document.title")


async def test_a_page_that_was_out_of_sight_begins_with_nothing(serve: Serve) -> None:
    served = await serve(clock=time.monotonic)
    hide = "Object.defineProperty(document, 'hidden', {value: %s, configurable: true}); document.dispatchEvent(new Event('visibilitychange')); document.getElementById('heave-m').textContent"  # noqa: E501
    async with page(served.port) as (tab, server):
        with publishing(served.publisher, with_points):
            await until_text(tab, "heave-m", "+1.25")
            assert await tab.evaluate(hide % "true") == "–"
            await holds(lambda: not server.hub.viewers)
            assert await tab.evaluate(hide % "false") == "–"
            await until_text(tab, "heave-m", "+1.25")
            # Its clockwork stands still for longer than it may, as if the machine had slept: it begins afresh.
            before = set(server.hub.viewers)
            stand_still = "const until = performance.now() + 3600; while (performance.now() < until); 0"
            await tab.evaluate(stand_still)
            await holds(lambda: server.hub.viewers and not server.hub.viewers & before)
            await until_text(tab, "heave-m", "+1.25")


async def test_frames_that_flow_but_were_held_up_on_the_way_are_old() -> None:
    async with page(1) as (tab, server):
        line = wire.encode_motion(make_frame(1.0), seq=1, utc_s=0.0, sent_mono_s=1.0).strip()
        record = msgspec.json.decode(line, type=MotionRecord)
        late_s = 0.0

        async def flow() -> None:
            while True:
                server.hub.link(Link(stream="here", is_up=True, trouble="", connections=1))
                server.hub.hear(record, line, time.monotonic() - late_s)
                await asyncio.sleep(0.02)

        flowing = asyncio.create_task(flow())
        await until_text(tab, "heave-m", "+1.25")
        late_s = 5.0
        await until_text(tab, "title", "DATA 5.")
        assert await shown(tab, "heave-m", "roll") == ["–", "–"]
        flowing.cancel()


async def test_a_fault_of_the_page_itself_leaves_no_number(serve: Serve) -> None:
    served = await serve(clock=time.monotonic)
    async with page(served.port) as (tab, server):
        with publishing(served.publisher, with_points):
            await until_text(tab, "heave-m", "+1.25")
            server.hub.hear(make_status(), b'{"class":"STATUS","devices":[null]}', time.monotonic())
            await until_text(tab, "title", "PAGE FAULT")
            assert await shown(tab, "heave-m", "roll", "hs", "point-rows") == ["–", "–", "–", "–"]
            await until_text(tab, "title", "HEAVE VALID")  # Once that STATUS is too old to be shown.


async def test_choices_are_remembered_and_have_their_keys(serve: Serve) -> None:
    served = await serve(clock=time.monotonic)
    theme = "document.documentElement.dataset.theme"
    press = "document.dispatchEvent(new KeyboardEvent('keydown', {key: '%s'}))"
    async with page(served.port) as (tab, _):
        assert await tab.evaluate(theme) == "day"
        for key, name in (("c", "contrast"), ("d", "day"), ("n", "night")):
            await tab.evaluate(press % key)
            assert await tab.evaluate(theme) == name
        for key, name in (("2", "2 min"), ("1", "1 min"), ("0", "10 min")):
            await tab.evaluate(press % key)
            assert await shown(tab, "span-name") == [name]
        address = await tab.evaluate("location.href")
        await tab.show(str(address), 800, 1280)
        assert await tab.evaluate(theme) == "night"
        assert await shown(tab, "span-name") == ["10 min"]
        await tab.evaluate("document.querySelector('[data-choose=day]').click()")
        assert await tab.evaluate(theme) == "day"
        await tab.evaluate(press % "h")
        assert await tab.evaluate("document.getElementById('help').open")


async def test_nothing_is_asked_of_elsewhere_and_nothing_is_wider_than_the_screen(serve: Serve) -> None:
    served = await serve(clock=time.monotonic)
    async with page(served.port) as (tab, _):
        with publishing(served.publisher, with_points):
            await until_text(tab, "heave-m", "+1.25")
            origin = await tab.evaluate("location.origin")
            asked = await tab.evaluate("performance.getEntriesByType('resource').map((entry) => entry.name)")
            assert asked
            assert all(str(one).startswith(f"{origin}/") for one in asked)
            for width, height in ((1280, 800), (1024, 768), (800, 1280), (1920, 1080), (390, 844)):
                await tab.show(f"{origin}/", width, height)
                await until_text(tab, "heave-m", "+1.25")
                assert await tab.evaluate("document.documentElement.scrollWidth <= innerWidth"), width
                wider = "[...document.querySelectorAll('section')].filter((one) => one.scrollWidth > one.clientWidth)"
                assert await tab.evaluate(f"{wider}.map((one) => one.id)") == [], width

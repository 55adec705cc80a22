"""What is kept for browsers: bounded, as it came, and nothing of a connection that is gone."""

from __future__ import annotations

import json
from typing import Any

import msgspec
import pytest
from stream_peers import make_frame, make_status

from heaved.outputs import wire
from heaved.outputs.records import DelayedRecord, MotionRecord
from heaved.page.follower import Link
from heaved.page.hub import HISTORY_HZ, HISTORY_S, Hub, Viewer
from heaved.samples import HeaveState

Events = list[tuple[str, Any]]


def hub() -> Hub:
    made = Hub("page", lambda: 100.0)
    made.link(Link(stream="here:5570", is_up=True, trouble="", release="1.2.3", connections=1))
    return made


def hear_motion(told: Hub, at_s: float, heave: HeaveState = HeaveState.VALID, **changes: Any) -> bytes:
    line = wire.encode_motion(make_frame(at_s, heave), seq=1, utc_s=1.7e9 + at_s, sent_mono_s=at_s)
    record = msgspec.json.decode(line, type=MotionRecord)
    if changes:
        record = msgspec.structs.replace(record, **changes)
        line = msgspec.json.encode(record)
    told.hear(record, line.strip(), at_s)
    return line.strip()


def events(text: bytes) -> Events:
    """As the HTML standard has it (9.2.6), for events of one line of data."""
    found = []
    for block in text.decode().split("\n\n")[:-1]:
        name, data = block.split("\n")
        assert name.startswith("event: ")
        assert data.startswith("data: ")
        found.append((name.removeprefix("event: "), json.loads(data.removeprefix("data: "))))
    return found


def taken(viewer: Viewer, now_s: float = 100.0) -> dict[str, Any]:
    found = events(viewer.take(now_s))
    assert len({name for name, _ in found}) == len(found)
    return dict(found)


def test_a_browser_that_comes_is_told_what_is_known() -> None:
    told = hub()
    for step in range(30):
        hear_motion(told, 50.0 + step / 20)
    status = wire.encode_record(make_status()).strip()
    told.hear(make_status(), status, 51.0)
    first = taken(told.join(), 123.5)
    assert list(first) == ["clock", "link", "history", "status"]
    assert first["clock"] == {"sent_s": 123.5}
    assert first["link"] == {
        "page": "page", "stream": "here:5570", "is_up": True, "trouble": "", "release": "1.2.3", "connections": 1,
    }  # fmt: skip
    assert first["status"] == {"read_s": 51.0, "record": json.loads(status)}
    history = first["history"]
    assert history["at_s"] == [50.0, 50.2, 50.4, 50.6, 50.8, 51.0, 51.2, 51.4]
    assert history["heave_m"] == [1.25] * 8
    assert history["reference_m"] == [None] * 8
    assert history["pitch_deg"] == pytest.approx([-2.8648] * 8, abs=1e-3)


def test_a_frame_reaches_every_browser_as_it_came() -> None:
    told = hub()
    viewers = [told.join(), told.join()]
    for viewer in viewers:
        viewer.take(0.0)
    lines = [hear_motion(told, 60.0), hear_motion(told, 60.05)]
    for viewer in viewers:
        found = taken(viewer)
        assert found["motion"] == {
            "lost": 0,
            "frames": [
                {"at_s": 60.0, "record": json.loads(lines[0])}, {"at_s": 60.05, "record": json.loads(lines[1])},
            ],
        }  # fmt: skip
        assert list(taken(viewer)) == ["clock"]


def test_a_slow_browser_loses_the_oldest_and_is_told() -> None:
    told = hub()
    slow = told.join()
    for step in range(1000):
        hear_motion(told, 60.0 + step / 20)
        told.hear(make_status(frames=step), wire.encode_record(make_status(frames=step)).strip(), 60.0 + step / 20)
    found = taken(slow)
    frames = found["motion"]["frames"]
    assert len(frames) == 40
    assert frames[-1]["at_s"] == pytest.approx(109.95)
    assert found["motion"]["lost"] == 960
    assert found["status"]["record"]["frames"] == 999
    hear_motion(told, 110.0)
    assert taken(slow)["motion"]["lost"] == 0


def test_the_history_is_bounded_and_has_no_heave_that_is_invalid() -> None:
    told = hub()
    for step in range(round(2 * HISTORY_S * HISTORY_HZ)):
        hear_motion(told, step / HISTORY_HZ)
    hear_motion(told, 10_000.0, HeaveState.INVALID)
    hear_motion(told, 10_001.0, HeaveState.SETTLING, heave_m=None)
    hear_motion(told, 9_000.0)  # A clock that was set back does not spoil the order.
    history = taken(told.join())["history"]
    assert {len(column) for column in history.values()} == {round(HISTORY_S * HISTORY_HZ)}
    assert history["heave_m"][-3:] == [1.25, None, None]
    assert history["at_s"] == sorted(history["at_s"])


def test_nothing_of_a_lost_connection_counts_as_known() -> None:
    told = hub()
    viewer = told.join()
    hear_motion(told, 60.0)
    told.hear(make_status(), wire.encode_record(make_status()).strip(), 60.0)
    viewer.take(0.0)
    told.link(Link(stream="here:5570", trouble="here:5570: the daemon closed the connection"))
    assert taken(viewer)["link"]["is_up"] is False
    assert list(taken(told.join())) == ["clock", "link", "history"]


def test_delayed_heave_is_told_now_and_then_with_how_far_off_the_heave_was() -> None:
    now_s = 0.0
    told = Hub("page", lambda: now_s)
    viewer = told.join()
    seen: Events = []
    for step in range(2000):
        now_s = 1000.0 + step / 20
        hear_motion(told, now_s, compensation_lead_s=0.2)  # Its heave is 1.25 m, always.
        record = DelayedRecord(time="", mono_s=0.0, heave_m=1.0, std_m=0.01)
        told.hear(record, wire.encode_record(record).strip(), now_s - 30.0)
        seen += events(viewer.take(now_s))
    delayed = [event for name, event in seen if name == "delayed"]
    assert len(delayed) == pytest.approx(500, abs=25)  # 5 of 20 in a second.
    divergences = [event for name, event in seen if name == "divergence"]
    assert divergences[-1]["rms_m"] == pytest.approx(0.25)
    assert divergences[-1]["span_s"] == pytest.approx(70.0, abs=2.0)


def test_a_browser_that_left_is_told_nothing() -> None:
    told = hub()
    viewer = told.join()
    viewer.take(0.0)
    told.leave(viewer)
    hear_motion(told, 60.0)
    assert list(taken(viewer)) == ["clock"]
    assert told.viewers == set()

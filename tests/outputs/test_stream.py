"""The stream over loopback: everyone gets every frame, nobody waits for anybody."""

from __future__ import annotations

import asyncio
import itertools
import random
import socket
from collections import Counter

import msgspec
import pytest
from stream_peers import Connect, Peer, Serve, Served, make_frame, make_status

from heaved.outputs import stream as publisher_module
from heaved.outputs import subscriber as subscriber_module
from heaved.outputs.listen import ListenError
from heaved.outputs.records import DelayedRecord, SeaRecord, StatusRecord
from heaved.outputs.stream import Publisher
from heaved.outputs.subscriber import Subscriber
from heaved.samples import CraftMotion, DelayedHeave, HullAngles, SeaState


async def connect_slow(served: Served) -> socket.socket:
    """A client that reads nothing, and whose kernel does not read ahead for it either."""
    connection = socket.socket()
    connection.setblocking(False)
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    await asyncio.get_running_loop().sock_connect(connection, (served.host, served.port))
    return connection


async def until_clients(served: Served, count: int) -> None:
    while served.publisher.clients != count:  # noqa: ASYNC110 - it has no event to wait for
        await asyncio.sleep(0)


async def test_version_comes_first_then_every_frame_at_once(serve: Serve) -> None:
    served = await serve()
    peer = Peer(*await asyncio.open_connection(served.host, served.port))
    assert await peer.record() == {"class": "VERSION", "release": "1.2.3", "proto_major": 1, "proto_minor": 5}
    served.publish(3)
    records = await peer.records(3)
    assert [(record["class"], record["seq"], record["dropped"]) for record in records] == [
        ("MOTION", 1, 0), ("MOTION", 2, 0), ("MOTION", 3, 0),
    ]  # fmt: skip
    assert served.counts.sent == 3
    await peer.close()
    while served.publisher.clients:  # That nobody is left shows on sending.
        served.publish()
        await asyncio.sleep(0)
    assert served.counts.clients == 0


async def test_age_is_from_validity_to_sending(serve: Serve, connect: Connect) -> None:
    served = await serve()
    peer = await connect(served)
    served.clock.now_s = 100.0
    served.publisher.publish(make_frame(99.75))
    assert (await peer.record())["age_s"] == 0.25


async def test_a_stuck_client_costs_the_others_nothing(serve: Serve, connect: Connect) -> None:
    served = await serve(queue_frames=50, stuck_s=3600.0)
    slow = await connect_slow(served)
    fast = await connect(served)
    seen = []
    for _ in range(40):
        served.publish(40)
        seen += await fast.records(40)
    assert [record["seq"] for record in seen] == list(range(1, 1601))
    assert all(record["dropped"] == 0 for record in seen)
    lost = served.counts.dropped["slow_client"]
    assert lost > 0
    assert served.publisher.dropped == lost

    # Now it reads: whole lines, and every gap is announced by the line after it.
    slow_peer = Peer(*await asyncio.open_connection(sock=slow))
    assert (await slow_peer.record())["class"] == "VERSION"
    records = [await slow_peer.record()]
    while records[-1]["seq"] < 1600:
        records.append(await slow_peer.record())
    for before, after in itertools.pairwise(records):
        assert after["seq"] - before["seq"] - 1 == after["dropped"]
    assert sum(record["dropped"] for record in records) == lost
    assert len(records) == 1600 - lost
    assert served.counts.sent == 1600 + len(records)
    # What waited says so: its age is that at sending, not that at queueing.
    served.publish()
    assert (await slow_peer.record())["dropped"] == 0
    await slow_peer.close()


async def test_frames_that_go_together_are_all_there_in_order_and_as_old_as_they_say(
    serve: Serve, connect: Connect
) -> None:
    served = await serve(queue_frames=1000)
    slow = await connect_slow(served)
    fast, thin = await connect(served), await connect(served)
    await thin.ask('?WATCH={"classes":["MOTION"],"rate_hz":10}')
    await thin.settle()
    served.publisher.together = 4
    records = []
    for number in range(402):
        served.clock.now_s = 100.0 + 0.01 * number
        served.publisher.publish(make_frame(served.clock.now_s))
        if number % 4 == 3:
            records += await fast.records(4)
    served.publisher.together = 1  # What waits goes with the next one.
    served.clock.now_s += 0.01
    served.publisher.publish(make_frame(served.clock.now_s))
    records += await fast.records(3)
    assert [record["seq"] for record in records] == list(range(1, 404))
    assert [record["age_s"] for record in records] == pytest.approx([0.03, 0.02, 0.01, 0.0] * 100 + [0.02, 0.01, 0.0])
    assert all(record["dropped"] == 0 for record in records)
    assert len(await thin.records(40)) == 40
    peer = Peer(*await asyncio.open_connection(sock=slow))
    assert (await peer.record())["class"] == "VERSION"
    assert [record["seq"] for record in await peer.records(403)] == list(range(1, 404))
    await peer.close()


async def test_what_waits_for_others_is_delivered_at_the_end(serve: Serve, connect: Connect) -> None:
    served = await serve()
    peer = await connect(served)
    served.publisher.together = 4
    served.publish(2)
    closing = asyncio.create_task(served.publisher.close())
    assert [record["seq"] for record in await peer.records(2)] == [1, 2]
    await peer.close()
    await closing


async def test_age_of_a_line_that_waited(serve: Serve) -> None:
    served = await serve(queue_frames=1000)
    slow = await connect_slow(served)
    await until_clients(served, 1)
    served.publish(500)
    served.clock.now_s += 30.0
    peer = Peer(*await asyncio.open_connection(sock=slow))
    assert (await peer.record())["class"] == "VERSION"
    records = await peer.records(500)
    assert records[0]["age_s"] == 0.0
    assert records[-1]["age_s"] == pytest.approx(30.0, abs=1e-6)
    await peer.close()


async def test_a_hopeless_client_is_disconnected(serve: Serve) -> None:
    served = await serve(queue_frames=10, stuck_s=10.0)
    slow = await connect_slow(served)
    await until_clients(served, 1)
    served.publish(1000, period_s=0.009)  # Full long before the end, for 9 s at the most.
    assert served.publisher.clients == 1
    served.publish(1000, period_s=0.009)
    assert served.publisher.clients == 0
    assert served.counts.errors == {"stuck": 1}
    slow.close()


async def test_a_slow_client_that_makes_progress_stays(serve: Serve) -> None:
    served = await serve(queue_frames=10, stuck_s=10.0)
    slow = await connect_slow(served)
    peer = Peer(*await asyncio.open_connection(sock=slow))
    assert (await peer.record())["class"] == "VERSION"
    for _ in range(5):
        served.publish(1000, period_s=0.008)
        last = served.publisher.dropped
        while (await peer.record())["dropped"] == 0:
            pass  # Until it has seen a gap, it has not come past what the kernel held.
    assert last > 1000
    assert served.publisher.clients == 1
    await peer.close()


async def test_one_client_too_many(serve: Serve, connect: Connect) -> None:
    served = await serve(max_clients=64)
    peers = [await connect(served) for _ in range(64)]
    extra = Peer(*await asyncio.open_connection(served.host, served.port))
    (error,) = await extra.rest()
    assert error["class"] == "ERROR"
    assert "64 clients" in error["message"]
    assert "[stream] max_clients" in error["message"]
    assert served.counts.errors == {"too_many_clients": 1}
    assert served.counts.clients == 64
    served.publish()
    for peer in peers:
        assert (await peer.record())["seq"] == 1
    await peers[0].close()
    while served.publisher.clients == 64:
        served.publish()
        await asyncio.sleep(0)
    again = Peer(*await asyncio.open_connection(served.host, served.port))
    assert (await again.record())["class"] == "VERSION"
    await again.close()
    await extra.close()


async def test_a_megabyte_without_line_end(serve: Serve, connect: Connect) -> None:
    served = await serve()
    peer = await connect(served)
    other = await connect(served)
    peer.writer.write(b"x" * (1 << 20))
    (error,) = await peer.rest()
    assert error["class"] == "ERROR"
    assert "longer than 512 bytes" in error["message"]
    await until_clients(served, 1)
    served.publish()
    assert (await other.record())["seq"] == 1
    assert served.counts.errors == {"line_too_long": 1}


async def test_a_line_of_512_bytes_is_read(serve: Serve, connect: Connect) -> None:
    served = await serve()
    peer = await connect(served)
    await peer.ask("?STATUS" + " " * (512 - len("?STATUS\n")))
    assert (await peer.record())["class"] == "STATUS"


async def test_five_errors_close(serve: Serve, connect: Connect) -> None:
    served = await serve()
    peer = await connect(served)
    for count in range(4):
        await peer.ask(f"?NONSENSE{count}")
        error = await peer.record()
        assert error["class"] == "ERROR"
        assert f"?NONSENSE{count}" in error["message"]
        assert "?WATCH=" in error["message"]
    await peer.ask("?STATUS")
    assert (await peer.record())["class"] == "STATUS"
    await peer.ask("?NONSENSE4", "?STATUS")
    (error,) = await peer.rest()
    assert "closed" in error["message"]
    await until_clients(served, 0)
    assert served.counts.errors == {"bad_request": 5}


async def test_a_flood_of_requests_closes(serve: Serve, connect: Connect) -> None:
    served = await serve()
    peer = await connect(served)
    await peer.ask(*["?STATUS"] * 1000)
    classes = [record["class"] for record in await peer.rest()]
    assert classes == ["STATUS"] * 20 + ["ERROR"] * 5


async def test_status_and_version_are_answered(serve: Serve, connect: Connect) -> None:
    served = await serve(status=lambda: make_status(clients=17))
    peer = await connect(served)
    await peer.ask("?STATUS", "?VERSION")
    status, version = await peer.records(2)
    assert msgspec.convert(status, StatusRecord) == make_status(clients=17)
    assert version["release"] == "1.2.3"


async def test_watch_chooses_classes(serve: Serve, connect: Connect) -> None:
    sea_record = SeaRecord(
        time="2026-01-01T00:00:00.000000Z", significant_height_m=2.5, peak_period_s=9.0, mean_period_s=7.5,
        is_still=False, systems=(), frequencies_hz=(), spectrum_m2phz=(), model="", window_s=600.0, vibration=(),
    )  # fmt: skip
    served = await serve()
    both, sea, nothing = [await connect(served) for _ in range(3)]
    await both.ask('?WATCH={"classes":["MOTION","SEA"]}')
    await sea.ask('?WATCH={"classes":["SEA"]}')
    await nothing.ask('?WATCH={"classes":[]}')
    for peer in (both, sea, nothing):
        assert await peer.settle() == []
    served.publish()
    served.publisher.publish_record(sea_record)
    served.publisher.publish_record(DelayedRecord(time="", mono_s=1.0, heave_m=0.5, std_m=0.01))
    assert [record["class"] for record in await both.settle()] == ["MOTION", "SEA"]
    assert [msgspec.convert(record, SeaRecord) for record in await sea.settle()] == [sea_record]
    assert await nothing.settle() == []
    assert served.counts.sent == 1


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 30.0, 70.0, 100.0, 1000.0])
@pytest.mark.parametrize("jitter_s", [0.0, 0.002])
async def test_watch_thins_out_to_the_wanted_mean_rate(
    serve: Serve, connect: Connect, rate_hz: float, jitter_s: float
) -> None:
    noise = random.Random(1)
    served = await serve(queue_frames=1000)
    peer = await connect(served)
    await peer.ask(f'?WATCH={{"rate_hz":{rate_hz}}}')
    assert await peer.settle() == []
    for k in range(1, 1001):  # 10 s of frames at 100 Hz.
        served.publisher.publish(make_frame(k * 0.01 + noise.uniform(-jitter_s, jitter_s)))
    seqs = [record["seq"] for record in await peer.settle() if record["class"] == "MOTION"]
    assert len(seqs) == pytest.approx(min(10.0 * rate_hz, 1000.0), abs=1.0)
    gaps = {after - before for before, after in itertools.pairwise(seqs)}
    assert max(gaps) - min(gaps) <= 1 + (jitter_s > 0.0)


async def test_the_wanted_rate_holds_for_every_class(serve: Serve, connect: Connect) -> None:
    """HULL comes 10 times a second, ATTITUDE 20 times, STATUS a little less than once."""
    served = await serve(queue_frames=10_000)
    each, every, rare = [await connect(served) for _ in range(3)]
    classes = '"classes":["MOTION","HULL","ATTITUDE","DELAYED","STATUS","SEA"]'
    await each.ask(f'?WATCH={{{classes},"rate_hz":1}}')
    await every.ask(f"?WATCH={{{classes}}}")
    await rare.ask(f'?WATCH={{{classes},"rate_hz":0.1}}')
    for peer in (each, every, rare):
        assert await peer.settle() == []
    for k in range(2000):  # 100 s of frames at 20 Hz.
        served.clock.now_s = t_s = 0.05 * k
        served.publisher.publish(
            msgspec.structs.replace(make_frame(t_s), delayed=DelayedHeave(t_s=t_s - 60.0, heave_m=0.5, std_m=0.01))
        )
        hull = HullAngles(t_s=t_s, state="converged") if k % 2 == 0 else None
        served.publisher.publish_stages(hull, make_attitude(t_s))
        if k % 21 == 0:
            served.publisher.publish_record(make_status())
        if k % 600 == 0:
            served.publisher.publish_slow(msgspec.structs.replace(make_frame(t_s), sea=make_sea(t_s)))
    counts = [Counter(record["class"] for record in await peer.settle()) for peer in (each, every, rare)]
    assert counts[1] == {"MOTION": 2000, "HULL": 1000, "ATTITUDE": 2000, "DELAYED": 2000, "STATUS": 96, "SEA": 4}
    assert counts[0] == {"MOTION": 100, "HULL": 100, "ATTITUDE": 100, "DELAYED": 100, "STATUS": 96, "SEA": 4}
    # That of 99.75 s is the nearest to 100 s, too.
    assert counts[2] == {"MOTION": 10, "HULL": 10, "ATTITUDE": 10, "DELAYED": 10, "STATUS": 11, "SEA": 4}


def make_attitude(t_s: float) -> CraftMotion:
    return CraftMotion(
        t_s=t_s,
        heave_m=0.5,
        heave_velocity_mps=0.1,
        pitch_rad=0.01,
        pitch_rate_radps=0.0,
        heave_std_m=0.02,
        heave_velocity_std_mps=0.05,
        pitch_std_rad=0.001,
        pitch_rate_std_radps=0.01,
    )


def make_sea(t_s: float) -> SeaState:
    return SeaState(
        t_s=t_s,
        window_s=300.0,
        significant_height_m=2.0,
        peak_period_s=8.0,
        mean_period_s=7.0,
        systems=(),
        frequencies_hz=(0.1,),
        spectrum_m2phz=(1.0,),
    )


async def test_a_client_that_has_closed_its_side_is_served_on(serve: Serve, connect: Connect) -> None:
    served = await serve()
    peer = await connect(served)
    await peer.ask("?STATUS")
    peer.writer.write_eof()
    assert (await peer.record())["class"] == "STATUS"
    served.publish(2)
    assert [record["seq"] for record in await peer.records(2)] == [1, 2]


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(subscriber_module, "_SILENT_S", 0.05)


@pytest.mark.parametrize("watched", ['{"classes":["HULL"]}', '{"classes":[]}', '{"classes":["SEA","ATTITUDE"]}'])
async def test_clients_that_have_gone_while_nothing_is_sent_make_room(
    serve: Serve, connect: Connect, impatient: None, watched: str
) -> None:
    served = await serve(max_clients=8)
    peers = [await connect(served) for _ in range(8)]
    for peer in peers:
        await peer.ask(f"?WATCH={watched}")
        assert await peer.settle() == []
        peer.writer.close()
    await until_clients(served, 0)
    assert served.counts.errors == {}
    assert (await (await connect(served)).settle()) == []


async def test_a_half_closed_client_of_a_silent_class_is_told_why_it_is_closed(
    serve: Serve, connect: Connect, impatient: None
) -> None:
    served = await serve()
    peer = await connect(served)
    await peer.ask('?WATCH={"classes":["HULL"]}')
    peer.writer.write_eof()
    (error,) = await peer.rest()
    assert error["class"] == "ERROR"
    assert "you have closed your side" in error["message"]
    assert "(HULL)" in error["message"]


async def test_a_half_closed_client_to_which_something_is_sent_stays(
    serve: Serve, connect: Connect, impatient: None
) -> None:
    """Through many times the patience with a silent one; that it has gone altogether shows then on sending."""
    served = await serve()
    judged = []
    judge = Subscriber._judge_silence

    def judge_and_tell(self: Subscriber) -> None:
        judge(self)
        judged.append(served.publisher.clients)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Subscriber, "_judge_silence", judge_and_tell)
        peer = await connect(served)
        peer.writer.write_eof()
        while len(judged) < 4:
            served.publish()
            assert (await peer.record())["class"] == "MOTION"
            await asyncio.sleep(0.001)
    assert judged == [1] * 4
    await peer.close()
    while served.publisher.clients:
        served.publish()
        await asyncio.sleep(0)


async def test_close_delivers_what_is_queued(serve: Serve) -> None:
    served = await serve(queue_frames=500)
    slow = await connect_slow(served)
    await until_clients(served, 1)
    served.publish(500)
    closing = asyncio.create_task(served.publisher.close(drain_s=60.0))
    peer = Peer(*await asyncio.open_connection(sock=slow))
    records = await peer.rest()
    assert [record["seq"] for record in records[1:]] == list(range(1, 501))
    await closing
    await peer.close()


async def test_close_does_not_wait_for_a_stuck_client(serve: Serve) -> None:
    served = await serve()
    slow = await connect_slow(served)
    await until_clients(served, 1)
    served.publish(500)
    await served.publisher.close(drain_s=0.01)
    assert served.publisher.clients == 0
    slow.close()


async def test_port_in_use_says_where_and_what_to_do(serve: Serve) -> None:
    served = await serve()
    with pytest.raises(ListenError) as raised:
        await serve(port=served.port)
    assert f"127.0.0.1:{served.port}" in str(raised.value)
    assert "stop the other program or change [stream] port" in str(raised.value)


async def test_an_address_of_another_machine_says_so(serve: Serve) -> None:
    with pytest.raises(ListenError, match=r"192\.0\.2\.1.*change \[stream\] host"):  # RFC 5737: nobody's address.
        await serve(host="192.0.2.1", allow=("192.0.2.0/24",))


async def test_beyond_this_machine_only_with_a_list(serve: Serve) -> None:
    with pytest.raises(ValueError, match=r"\[stream\] host 0\.0\.0\.0 can be reached from other machines"):
        await serve(host="0.0.0.0")


async def test_a_peer_outside_the_list_is_told_so(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    served = await serve()
    monkeypatch.setattr(publisher_module, "is_allowed", lambda _address, _networks: False)
    peer = Peer(*await asyncio.open_connection(served.host, served.port))
    (error,) = await peer.rest()
    assert error == {"class": "ERROR", "message": "127.0.0.1 is not in a network of [stream] allow"}
    assert served.counts.errors == {"not_allowed": 1}
    assert served.publisher.clients == 0
    await peer.close()


async def test_nobody_there(serve: Serve) -> None:
    served = await serve()
    served.publish(10)
    served.publisher.publish_record(make_status())
    assert served.counts.sent == 0
    assert isinstance(served.publisher, Publisher)

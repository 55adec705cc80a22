"""[mqtt] and [influx] in the daemon: made of the configuration, told each frame, left alone by other changes."""

from __future__ import annotations

import asyncio
import json
import socket
from contextlib import AsyncExitStack
from typing import TYPE_CHECKING

import aiomqtt
from far_ends import MOSQUITTO, TIMEOUT_S, free_port, needs_mosquitto, running, until
from stream_peers import make_frame, make_status

from heaved.config import Config
from heaved.daemon.outputs import Outputs
from heaved.outputs.influx import InfluxParams
from heaved.outputs.mqtt import MqttParams

if TYPE_CHECKING:
    from pathlib import Path


@needs_mosquitto
async def test_both_are_told_and_a_reload_ends_none_that_has_not_changed(tmp_path: Path) -> None:
    port, file = free_port(), tmp_path / "mosquitto.conf"
    file.write_text(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    outputs = Outputs(lambda t_s: 1.7e9 + t_s, lambda: 100.0, make_status)
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(running(port, str(MOSQUITTO), "-c", str(file)))
        client = await stack.enter_async_context(aiomqtt.Client("127.0.0.1", port, identifier="reader"))
        await client.subscribe("heaved/#")
        receiver = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        receiver.bind(("127.0.0.1", 0))
        receiver.setblocking(False)

        async def topic(name: str) -> bytes:
            async for message in client.messages:
                if str(message.topic) == f"heaved/{name}":
                    assert isinstance(message.payload, bytes)
                    return message.payload
            raise AssertionError("the broker is gone")

        udp = InfluxParams(enabled=True, link=f"udp://127.0.0.1:{receiver.getsockname()[1]}", batch_s=0.1)
        mqtt = MqttParams(enabled=True, link=f"mqtt://127.0.0.1:{port}")
        try:
            await outputs.have(Config(mqtt=mqtt, influx=udp), TIMEOUT_S)
            await until(lambda: all(health.is_up for health in outputs.health), lambda: outputs.health)
            outputs.publish(make_frame(99.5))
            motion = json.loads(await asyncio.wait_for(topic("motion"), TIMEOUT_S))
            assert (motion["mono_s"], motion["age_s"]) == (99.5, 0.5)
            lines = b""
            while b"heaved_motion," not in lines:
                received = asyncio.get_running_loop().sock_recv(receiver, 65536)
                lines += await asyncio.wait_for(received, TIMEOUT_S)
            before = {health.name: health for health in outputs.health}
            await outputs.have(Config(mqtt=mqtt), TIMEOUT_S)
            assert outputs.health == [before["mqtt"]]
            outputs.publish(make_frame(200.0))
            assert json.loads(await asyncio.wait_for(topic("motion"), TIMEOUT_S))["mono_s"] == 200.0
            assert before["mqtt"].connections == 1
        finally:
            assert await outputs.stop(TIMEOUT_S)
        assert await asyncio.wait_for(topic("availability"), TIMEOUT_S) == b"offline"

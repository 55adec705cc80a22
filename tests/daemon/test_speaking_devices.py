"""A crane whose encoder box speaks by itself, in a running daemon. Oracle: the height of its tip, worked out here."""

from __future__ import annotations

import asyncio
import contextlib
import math
import socket
from functools import reduce
from typing import TYPE_CHECKING

import msgspec
import pytest
from output_peers import free_port
from running import demo_config, plant_of, running, until

from heaved.devices.profile import DeviceSpec, Profile, Sentence, SentenceField
from heaved.estimation.crane.geometry import Params
from heaved.estimation.lever_arm import Point
from heaved.samples import HeaveState

if TYPE_CHECKING:
    from collections.abc import AsyncIterator
    from pathlib import Path

BOOM_M, PEDESTAL_M = 40.0, (10.0, -5.0, 6.0)
SLEW_DEG, BOOM_DEG = 30.0, 60.0
HEIGHT_M = PEDESTAL_M[2] + BOOM_M * math.sin(math.radians(BOOM_DEG))
BOX = Profile(
    name="box",
    sentences=(
        Sentence(
            header="$--XDR",
            checksum="required",
            fields=(
                SentenceField(quantity="slew_rad", transducer="SLEW", unit="deg"),
                SentenceField(quantity="boom_rad", transducer="BOOM", unit="deg", min=-10.0, max=90.0),
            ),
        ),
    ),
)


def sentence(boom_deg: float) -> bytes:
    body = f"YCXDR,A,{SLEW_DEG:.1f},D,SLEW,A,{boom_deg:.1f},D,BOOM"
    return f"${body}*{reduce(lambda a, b: a ^ b, body.encode(), 0):02X}\r\n".encode()


@contextlib.asynccontextmanager
async def speaking(port: int, data: bytes) -> AsyncIterator[None]:
    """A box that says ``data`` twenty times a second."""

    async def speak() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
            while True:
                box.sendto(data, ("127.0.0.1", port))
                await asyncio.sleep(0.05)

    task = asyncio.create_task(speak())
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def test_the_tip_follows_the_sentences_and_goes_with_them(tmp_path: Path) -> None:
    port = free_port(socket.SOCK_DGRAM)
    crane = DeviceSpec(name="box", role="crane", link=f"udp-listen://127.0.0.1:{port}", profile=BOX, rate_hz=20.0)
    async with plant_of(demo_config(tmp_path)) as (_, polled):
        config = msgspec.structs.replace(
            polled,
            device=(*polled.device, crane),
            crane=Params(pedestal_m=PEDESTAL_M, boom_length_m=BOOM_M, max_age_s=1.0),
            point=(Point(name="tip", frame="boom"),),
        )
        async with running(config) as daemon:
            record = await until(daemon, lambda frame: frame["points"][0].get("reasons"))
            assert record["points"][0]["reasons"] == ["no reading of the crane yet"]
            assert record["points"][0]["state"] == HeaveState.INVALID.value
            async with speaking(port, sentence(BOOM_DEG)):
                record = await until(daemon, lambda frame: "own_height_m" in frame["points"][0])
                assert record["points"][0]["own_height_m"] == pytest.approx(HEIGHT_M, abs=0.1)
                (health,) = [one for one in daemon.status().devices if one.name == "box"]
                assert health.up
            record = await until(daemon, lambda frame: frame["points"][0].get("state") == "invalid")
            assert "own_height_m" not in record["points"][0]
            assert "old" in record["points"][0]["reasons"][0]
            # One that is wrong on the line says nothing.
            async with speaking(port, sentence(10.0).replace(b"10.0,D,BOOM", b"80.0,D,BOOM")):
                devices = daemon.status().devices
                while next(one for one in devices if one.name == "box").results.get("crc", 0) < 3:
                    await until(daemon, lambda _frame: True)
                    devices = daemon.status().devices
                record = await until(daemon, lambda _frame: True)
                assert "own_height_m" not in record["points"][0]

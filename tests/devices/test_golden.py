"""The profiles that are shipped, each against whole serial frames: the makers' own where their manuals print them, else
built by hand from the manual's map. The bus must send exactly the request, and make of the answer what the manual says.
"""

from __future__ import annotations

import tomllib
from functools import reduce
from math import pi, radians
from pathlib import Path

import msgspec
import pytest
from modbus_slaves import Results, RtuSlave, crc, rtu, rtu_answer, running

from heaved.devices.profile import DeviceSpec, Profile, Quantity, Role, decode, encode, profile_faults
from heaved.devices.sentences import SentenceReader
from heaved.samples import Fault, ImuSample

FOLDER = Path(__file__).parents[2] / "config" / "devices"
G = 9.80665


def load(name: str) -> Profile:
    return msgspec.convert(tomllib.loads((FOLDER / f"{name}.toml").read_text()), Profile)


# name, role, request, answer, values in SI units. Frames are given with the CRC where the maker prints it (marked).
WT901 = (
    "0052 ffae 0800"  # accel: 82, -82, 2048 of 1/2048 g
    "4000 c000 0001"  # gyro: half, minus half of 2000 deg/s; one count
    "1111 2222 3333"  # magnetometer, ignored
    "2000 1000 c000"  # 45, 22.5, -90 degrees
)
WT901_VALUES = {
    "ax_mps2": 82 / 2048 * G, "ay_mps2": -82 / 2048 * G, "az_mps2": G,
    "gx_radps": radians(1000.0), "gy_radps": radians(-1000.0), "gz_radps": radians(2000 / 32768),
    "roll_rad": pi / 4, "pitch_rad": -pi / 8, "yaw_rad": pi / 2,
}  # fmt: skip
HWT905 = (
    "0052 ffae 0800 4000 c000 0001 1111 2222 3333"
    "afc8 0000"  # 45000, low word first: 45 degrees
    "a81c ffff"  # -22500
    "a070 fffe"  # -90000
    "0992"  # 24.50 degrees Celsius
)
FRAMES = [
    ("witmotion-wt901c485", "imu", "50 03 0034 000c", "50 03 18" + WT901, WT901_VALUES),
    ("heaved-sim-imu16", "imu", "50 03 0034 000c", "50 03 18" + WT901, WT901_VALUES),
    (
        "witmotion-hwt905-485", "imu", "50 03 0034 0010", "50 03 20" + HWT905,
        {**WT901_VALUES, "pitch_rad": pi / 8, "temperature_c": 24.5},
    ),
    (
        "witmotion-hwt9073-485", "imu", "50 03 0034 0010", "50 03 20" + HWT905,
        {**WT901_VALUES, "pitch_rad": pi / 8, "temperature_c": 24.5},
    ),
    # The numbers of the maker's table of registers (RF602 manual 1.2.0, 11.8.1): range 500, value 15894.
    ("riftek-rf602", "laser", "01 04 0005 0002", "01 04 04 01f4 3e16", {"laser_m": 15894 * 500 / 16384 / 1000}),
    ("riftek-rf602-500", "laser", "01 04 0006 0001", "01 04 02 3e16", {"laser_m": 15894 * 500 / 16384 / 1000}),
    # The maker's example (SMC IMU user guide 3.1, 4.6): 0.305 m, -0.088 m/s, 0.16 and -0.63 degrees (bow down), 159.
    (
        "smc-imu-108", "reference_mru", "01 03 0003 0006", "01 03 0c 0131 ffa8 ffba 0010 ffc1 009f",
        {
            "heave_m": 0.305, "heave_velocity_mps": -0.088, "roll_rad": radians(0.16), "pitch_rad": radians(0.63),
            "device_time_s": 159.0,
        },
    ),
    # The request as its driver has it, CRC included; 12.34, -5.67 and 90 degrees from 20000.
    (
        "bewis-mins127", "reference_mru", "01 03 00 01 00 03 54 0B", "01 03 06 52f2 4be9 7148",
        {"roll_rad": radians(12.34), "pitch_rad": radians(5.67), "yaw_rad": -radians(90.0)},
    ),
    (
        "generic-imu-float32", "imu", "01 03 0000 0012",
        "01 03 24 3d800000 bd000000 40400000 3e000000 be000000 00000000 3f000000 be800000 411c0000",
        {
            "ax_mps2": 0.5, "ay_mps2": -0.25, "az_mps2": 9.75, "gx_radps": 0.125, "gy_radps": -0.125, "gz_radps": 0.0,
            "roll_rad": 0.0625, "pitch_rad": -0.03125, "yaw_rad": 3.0,
        },
    ),
    # Maker's frames, CRC included (WT53R-485 manual v23-0720, 6.2): 0x070B = 1803 mm.
    ("witmotion-wt53r-485", "laser", "50 03 00 34 00 01 C8 45", "50 03 02 07 0B 06 7F", {"laser_m": 1.803}),
    # Maker's distance (OM20/OM30 RS485 manual V1, 7.2): 202 = 7C37, 203 = 428B is 69.743 mm.
    (
        "baumer-om20", "laser", "01 04 00c8 000d",
        "01 04 1a 0000 0000 7c37 428b 0000 447a 0003 03e8 0000 0011 0000 a120 0007",
        {"laser_m": 0.069743, "signal": 0.0, "device_time_s": 0.5},
    ),
    (
        "baumer-om30", "laser", "01 04 00c8 000d",
        "01 04 1a 0001 0000 7c37 428b 0000 447a 0003 03e8 0000 0011 0000 a120 0007",
        {"laser_m": 0.069743, "signal": 1.0, "device_time_s": 0.5},
    ),
    (
        "benewake-tf02-i", "laser", "01 03 0000 0005", "01 03 0a 00fa 03e8 0000 0001 86a0",
        {"laser_m": 2.5, "signal": 1000.0, "device_time_s": 100.0},
    ),
    (
        "heaved-sim-imu", "imu", "01 03 0000 0012",
        # 0.5, -0.25, 9.75; 0.125, -0.125, 0; 0.0625, -0.03125, 3.0
        "01 03 24 3f000000 be800000 411c0000 3e000000 be000000 00000000 3d800000 bd000000 40400000",
        {
            "ax_mps2": 0.5, "ay_mps2": -0.25, "az_mps2": 9.75, "gx_radps": 0.125, "gy_radps": -0.125, "gz_radps": 0.0,
            "roll_rad": 0.0625, "pitch_rad": -0.03125, "yaw_rad": 3.0,
        },
    ),
    (
        "heaved-sim-laser", "laser", "01 03 0000 0004", "01 03 08 41480000 000186a0",
        {"laser_m": 12.5, "device_time_s": 100.0},
    ),
    (
        "heaved-sim-imu2", "imu2", "01 03 0000 0006", "01 03 0c 3e000000 be800000 3d800000",
        {"gx_radps": 0.125, "gy_radps": -0.25, "gz_radps": 0.0625},
    ),
    (
        "heaved-sim-craft", "craft", "01 03 0000 000a", "01 03 14 3f000000 3d800000 41900000 be000000 3e000000",
        {"heave_m": 0.5, "pitch_rad": 0.0625, "speed_mps": 18.0, "flap_fore_rad": -0.125, "flap_aft_rad": 0.125},
    ),
    (
        # 350.25 deg, 60.5 deg, -12.34 deg, 70.123 m
        "heaved-sim-crane", "crane", "01 03 0000 0005", "01 03 0a 88d1 17a2 fb2e 0001 11eb",
        {"slew_rad": 6.113015705, "boom_rad": 1.055924197, "jib_rad": -0.215373630, "line_out_m": 70.123},
    ),
]  # fmt: skip


# Telegrams that makers print, and what they say there (of TSS1: NovAtel, SMC, SBG, CodaOctopus, a Seatex MRU
# of USCGC Healy). Checksums are worked out here: printed ones are wrong in places.
TELEGRAMS = [
    ("tss1", ":00FFCA -0003F-0325  0319", (-0.03, -3.25, 3.19)),
    ("tss1", ":000064 -0003U 0007 -0056", (-0.03, 0.07, -0.56)),
    ("tss1", ":05FEFF  0000H 0102 -0049", (0.0, 1.02, -0.49)),
    ("tss1", ":1A4770 -0016H 0429 -0680", (-0.16, 4.29, -6.80)),
    ("tss1", ":1a4770 -0016H 0429 -0680", (-0.16, 4.29, -6.80)),
    ("tss1", ":053C22  0000f-0046 -0563", None),
    ("tss1", ":053C22  0000?-0046 -0563", (None, -0.46, -5.63)),
    ("tss1", ":053C22       H-0046 -0563", None),
    ("tss1", ":053C22      H-0046 -0563", (None, -0.46, -5.63)),
    ("pashr", "$PASHR,123816.80,312.95,T,-0.83,-0.42,-0.01,0.234,0.224,0.298,2,1", (-0.01, -0.83, -0.42)),
    ("pashr", "$PASHR,,,,,,,,,,0,0", None),
    ("pashr", "$PASHR,ATT,88536.0,345.96,0.0390,-0.9052,0.0024,0.0144,0", None),
    ("psxn23", "$PSXN,23,0.02,-0.76,330.56,0.11", (-0.11, 0.02, -0.76)),
    ("prdid", "$PRDID,-000.84,+001.17,259.89", (None, 1.17, -0.84)),
    ("pnorsub2", "$PNORSUB2,203798,2,+0.117,-0.505,259.893,1.350,0.023,1", (-1.35, 0.117, -0.505)),
    ("pnorsub2", "$PNORSUB2,203798,2,+0.117,-0.505,259.893,1.350,0.023,0", None),
]


@pytest.mark.parametrize(("name", "printed", "said"), TELEGRAMS, ids=[f"{t[0]} {t[1]}" for t in TELEGRAMS])
def test_telegrams(name: str, printed: str, said: tuple[float | None, float, float] | None) -> None:
    sum_ = reduce(lambda a, b: a ^ b, printed[1:].encode(), 0)
    line = printed if name == "tss1" else f"{printed}*{sum_:02x}"
    (found,) = SentenceReader(load(name).sentences).feed(f"{line}\r\n".encode())
    if said is None:
        assert (found.values, bool(found.detail)) == ({}, True)
        return
    assert found.fault is Fault.NONE
    heave_m, roll_deg, pitch_deg = said
    assert found.values.get("heave_m") == (None if heave_m is None else pytest.approx(heave_m))
    assert found.values["roll_rad"] == pytest.approx(radians(roll_deg))
    assert found.values["pitch_rad"] == pytest.approx(radians(pitch_deg))


def frame(text: str, length: int) -> bytes:
    """The frame; a printed CRC must be right, a missing one is added."""
    data = bytes.fromhex(text)
    if len(data) == length:
        assert crc(data[:-2]) == data[-2:]
        return data
    assert len(data) == length - 2
    return rtu(data)


def test_every_profile_has_a_golden_frame() -> None:
    assert {path.stem for path in FOLDER.glob("*.toml")} == {row[0] for row in (*FRAMES, *TELEGRAMS)}


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.toml")), ids=lambda path: path.stem)
def test_profile_is_sound_and_named_as_its_file(path: Path) -> None:
    profile = load(path.stem)
    assert profile.name == path.stem
    assert profile_faults(profile) == []


@pytest.mark.parametrize(("name", "role", "request_text", "answer_text", "values"), FRAMES, ids=[f[0] for f in FRAMES])
async def test_golden_frames(
    name: str, role: Role, request_text: str, answer_text: str, values: dict[Quantity, float]
) -> None:
    request = frame(request_text, 8)
    answer = frame(answer_text, 5 + bytes.fromhex(answer_text)[2])
    words = [int.from_bytes(answer[at : at + 2]) for at in range(3, len(answer) - 2, 2)]
    # The first read is a longer one; the golden answer belongs to the golden request alone.
    longer = [*words, 0]
    slave = RtuSlave(lambda asked: answer if asked == request else rtu_answer(asked, longer))
    spec = DeviceSpec(
        name=name, role=role, link=f"rtu://{slave.path}", device_id=request[0], profile=load(name),
        rate_hz=50.0, timeout_ms=500.0,
    )  # fmt: skip
    results = Results()
    async with running([spec], results):
        result = await results.until(lambda result: result.fault is Fault.NONE and request in slave.requests)
    slave.close()
    assert all(asked[:4] == request[:4] for asked in slave.requests)
    heard = msgspec.structs.asdict(result.sample) | {str(name): value for name, value in result.extra.items()}
    for quantity, value in values.items():
        assert heard[quantity] == pytest.approx(value, rel=1e-5), quantity
    assert isinstance(result.sample, ImuSample) == (role == "imu")
    # And the way back, which is the simulator's: the same registers, but for those that no field covers.
    block = spec.profile.blocks[0]
    sent = encode(block, values)
    if block.fields[0].scale_from is not None:
        # The range of this sensor is one of many that could tell the value.
        assert decode(block, sent).values["laser_m"] == pytest.approx(values["laser_m"], abs=values["laser_m"] / 16384)
        return
    covered = {field.offset + i for field in block.fields for i in range(2 if field.type[-2:] == "32" else 1)}
    for offset in covered:
        low = answer[3 + 2 * offset : 5 + 2 * offset]
        if block.fields[0].quantity != "signal" or offset not in (2, 3):  # 69.743 is printed rounded
            assert sent[offset].to_bytes(2) == low


@pytest.mark.parametrize(
    ("name", "registers", "fault"),
    [
        ("baumer-om20", "0002 0000 7c37 428b 0000 447a 0003 03e8 0000 0011 0000 a120 0007", Fault.OUT_OF_RANGE),
        ("benewake-tf02-i", "1194 0014 0000 0001 86a0", Fault.OUT_OF_RANGE),
        ("witmotion-wt53r-485", "0000", Fault.OUT_OF_RANGE),
        ("riftek-rf602", "01f4 0000", Fault.OUT_OF_RANGE),
        ("riftek-rf602", "01f4 4001", Fault.OUT_OF_RANGE),
        ("riftek-rf602", "01f4 ffff", Fault.OUT_OF_RANGE),
        ("riftek-rf602", "0000 2000", Fault.OUT_OF_RANGE),
        ("riftek-rf602-500", "0000", Fault.OUT_OF_RANGE),
        ("riftek-rf602-500", "4001", Fault.OUT_OF_RANGE),
    ],
    ids=[
        "critical signal",
        "weak echo",
        "no reading",
        "nothing in range",
        "beyond the range",
        "no result",
        "no range",
        "nothing in a range that is known",
        "beyond a range that is known",
    ],
)
def test_readings_that_the_maker_calls_invalid_are_faults(name: str, registers: str, fault: Fault) -> None:
    data = bytes.fromhex(registers)
    words = [int.from_bytes(data[i : i + 2]) for i in range(0, len(data), 2)]
    assert decode(load(name).blocks[0], words).fault is fault

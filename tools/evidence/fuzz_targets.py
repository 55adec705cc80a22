"""What meets bytes from outside, and what must hold of it whatever they are.

Each target is a function of bytes that raises for what must not be: an exception that is not documented, an answer that
depends on the pieces in which bytes come, text that a terminal would obey, a value that is no number. The tools feed
them by coverage (``tools/fuzz.py``), the tests by hypothesis and with what was found once.
"""

from __future__ import annotations

import asyncio
import atexit
import io
import shutil
import ssl
import struct
import tempfile
import time
from contextlib import suppress
from functools import cache, partial
from itertools import islice
from math import isclose, isfinite, nan
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import msgspec

from heaved.client.stream_client import UnreachableError, decode_record
from heaved.config import Config
from heaved.config.read import ConfigError, data_directory, load, load_to_run, packaged_profiles, packaged_sentences
from heaved.daemon.daemon import make_pipeline
from heaved.daemon.recorded import FramePacker, layout_of
from heaved.daemon.state import StateError, StateFile
from heaved.devices import frames
from heaved.devices.probe import parse_ids
from heaved.devices.profile import SI, block_registers, decode, encode
from heaved.devices.recording import Recording, RecordingError
from heaved.devices.sentences import SentenceReader
from heaved.estimation.heave import saved_state
from heaved.estimation.heave.laser.geometry import Geometry
from heaved.estimation.heave.laser.placement import LaserPlace, SavedPlace
from heaved.estimation.heave.saved_state import SavedState
from heaved.estimation.heave.sea.model import SeaModel
from heaved.estimation.hull.remembered import SavedFlexure, SavedHull
from heaved.estimation.imu.attitude_memory import SavedAttitudeError
from heaved.links import SerialLink, parse_any_link, parse_service_link
from heaved.networks import is_allowed, parse_networks
from heaved.outputs import modbus_frames, wire
from heaved.outputs.http import HttpServer, Verdict
from heaved.outputs.records import ErrorRecord, VersionRecord
from heaved.outputs.requests import MAX_REQUEST_BYTES, BadRequest, LineSplitter, parse_request
from heaved.outputs.tls_connection import TlsConnection
from heaved.page.follower import Follower
from heaved.page.server import PageServer, is_own_host
from heaved.recorder import messages
from heaved.recorder.found import RecordedError
from heaved.recorder.layout import CALLS, FRAMES, SAMPLES, Header, Settings
from heaved.recorder.messages import Kind, MessageError, Splitter, packed
from heaved.recorder.serve import Recorder
from heaved.samples import Fault
from heaved.text import printable, printable_lines

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from heaved.devices.profile import Block, Decoded, Sentence
    from heaved.pipeline import Pipeline
    from heaved.recorder.tables import FrameRows, SampleRows

LONGEST_S: Final = 1.0
"""Of the processor, for one input."""
_SCHEMES: Final = ("tcp", "tcp-listen", "udp", "udp-listen", "rtu", "serial")
_MOST_ROWS: Final = 200
"""Of a recording are looked at."""


class Target(NamedTuple):
    """Something that is given bytes."""

    run: Callable[[bytes], None]
    seeds: Callable[[], Sequence[bytes]]
    """Inputs to begin with, each of which is taken."""
    most_bytes: int
    """Longer inputs show nothing more."""
    modules: tuple[str, ...]
    """Whose branches lead the fuzzer."""


class BrokenPropertyError(AssertionError):
    """What must hold does not."""


def run(target: Target, data: bytes) -> None:
    """Give it one input.

    Raises:
        BrokenPropertyError: something does not hold, or it took too long. Whatever else is raised is as bad.
    """
    began_s = time.process_time()
    target.run(data)
    took_s = time.process_time() - began_s
    _hold(took_s < LONGEST_S, f"took {took_s:.1f} s")


def _hold(condition: object, said: str) -> None:
    """As ``assert``, which an optimising interpreter leaves out."""
    if not condition:
        raise BrokenPropertyError(said)


def _plain(text: str) -> None:
    """A terminal shows it as it is."""
    _hold(printable_lines(text) == text, f"text with what a terminal obeys: {text!r}")


def _pieces(data: bytes, size: int) -> list[bytes]:
    return [data[i : i + size] for i in range(0, len(data), size)]


@cache
def _scratch() -> Path:
    """A directory, in memory where there is one there."""
    memory = Path("/dev/shm")  # noqa: S108  # A directory of its own is made in it.
    made = tempfile.mkdtemp(prefix="heaved-fuzz-", dir=memory if memory.is_dir() else None)
    atexit.register(shutil.rmtree, made, ignore_errors=True)
    return Path(made)


def _written(name: str, data: bytes) -> Path:
    path = _scratch() / name
    path.write_bytes(data)
    return path


# ---- configuration ---------------------------------------------------------------------------------------------------


def configuration(data: bytes) -> None:
    """A file is a configuration, which JSON carries, or has faults that can be read."""
    try:
        config = load_to_run(_written("heaved.toml", data))
    except ConfigError as error:
        _hold(all(error.faults), "a fault without words")
        return
    _hold(msgspec.json.decode(msgspec.json.encode(config), type=Config) == config, "JSON says something else")


def _configurations() -> list[bytes]:
    whole = [path.read_bytes() for path in sorted(data_directory().glob("*.toml"))]
    # Without their comments: what is behind "#" is a key as well.
    keys = [b"\n".join(line.split(b"# ", 1)[0] for line in text.split(b"\n")) for text in whole]
    device = b'[[device]]\nname = "imu"\nrole = "imu"\nlink = "%s"\nprofile = "witmotion-wt901c485"\nrate_hz = 100.0\n'
    return [
        *(text for text in keys if len(text) < 8192),
        device % b"tcp://127.0.0.1:502",
        device % b"rtu:///dev/ttyUSB0?baudrate=115200" + b'[stream]\nhost = "0.0.0.0"\nallow = ["10.0.0.0/8"]\n',
        b'[[output]]\nlink = "udp://127.0.0.1:5000"\nformat = "TSS1"\n[heave]\nforecast_horizons_s = [0.1, 2.0]\n',
        b'[mqtt]\nlink = "mqtt://127.0.0.1"\n[influx]\nlink = "http://127.0.0.1"\n[registers]\nlink = "tcp://127.0.0.1:502"\n',
    ]


def links(data: bytes) -> None:
    """Links, networks, hosts and ids: understood, or refused with words."""
    text = data.decode("utf-8", "surrogateescape")
    with suppress(ValueError):
        link = parse_any_link(text, _SCHEMES)
        _hold(isinstance(link, SerialLink) or parse_any_link(str(link), _SCHEMES) == link, f"{link} is another link")
    with suppress(ValueError):
        service = parse_service_link(text, {"mqtt": 1883, "https": 443})
        _hold(parse_service_link(str(service), {"mqtt": 1883, "https": 443}) == service, f"{service} is another link")
    with suppress(ValueError):
        ids = parse_ids(text)
        _hold(set(ids) <= set(range(1, 248)) and len(set(ids)) == len(ids), f"ids {ids}")
    with suppress(ValueError):
        (network,) = parse_networks((text,))
        _hold(is_allowed(str(network.network_address), (network,)), f"{network} is not within itself")
    is_allowed(text, parse_networks(("10.0.0.0/8",)))
    _hold(printable(text).isprintable(), "what is made printable is not")


_LINKS: Final = (
    b"tcp://192.168.1.20:502", b"tcp-listen://[fd00::7]:4001", b"udp://239.1.2.3:5000", b"mqtt://broker", b"https://a:1",
    b"rtu:///dev/ttyUSB0?baudrate=9600&parity=N&stopbits=1&bytesize=8", b"1-16,80", b"::ffff:10.0.0.0/104",
    b"192.168.10.0/24", b"serial:///dev/serial/by-id/usb-a",
)  # fmt: skip


# ---- Modbus ----------------------------------------------------------------------------------------------------------


def modbus_answers(data: bytes) -> None:
    """What a slave says is the answer, or its silence is explained."""
    if len(data) < 5:
        return
    request = frames.Request(device_id=data[0], function=3 + data[1] % 2, count=1 + data[2] % 125)
    transaction, heard = int.from_bytes(data[3:5]), data[5:]
    header = bytes((request.device_id, request.function, 2 * request.count))
    answer = frames.find_rtu_answer(heard, request)
    _hold(answer in heard and (not answer or frames.crc16(answer) == 0), "an answer that nobody gave")
    _hold(not answer or answer[:3] == header or answer[1] & 0x80, "an answer to something else")
    for said in (
        frames.explain_rtu_silence(heard, request, sent=heard[:8]),
        frames.explain_rtu_silence(heard, request, late_s=0.5),
        frames.explain_tcp_silence(heard, transaction, request),
    ):
        _hold(said.fault is not Fault.NONE and said.detail, "a silence without a reason")
        _plain(said.detail)
    reply = frames.find_tcp_answer(heard, transaction, request)
    _hold(not reply or (reply in heard and int.from_bytes(reply[:2]) == transaction), "an answer to something else")
    _hold(not (reply and frames.find_tcp_contradiction(heard, transaction, request)), "both an answer and none")
    if frames.tcp_stream_is_whole(heard):
        _hold(sum(map(len, _tcp_frames(heard))) == len(heard), "a stream that is not whole")
    for sender in (*frames.rtu_senders(heard), *frames.tcp_senders(heard)):
        _hold(0 <= sender.device_id < 256, "a sender without an id")
    # What is encoded is found, whatever stands before it that is no frame.
    body = header + heard.ljust(2 * request.count, b"\0")[: 2 * request.count]
    rtu = body + frames.crc16(body).to_bytes(2, "little")
    _hold(frames.find_rtu_answer(rtu, request) == rtu, "the answer is not found")
    tcp = struct.pack(">HHH", transaction, 0, len(body)) + body
    _hold(frames.find_tcp_answer(tcp, transaction, request) == tcp, "the answer is not found")


def _tcp_frames(heard: bytes) -> list[bytes]:
    """Cut by the lengths alone."""
    found, at = [], 0
    while at < len(heard):
        end = at + 6 + int.from_bytes(heard[at + 4 : at + 6])
        found.append(heard[at:end])
        at = end
    return found


def _modbus_answers() -> list[bytes]:
    asked = bytes((80, 0, 1, 0, 7))
    body = bytes((80, 3, 4, 1, 2, 3, 4))
    refusal = bytes((80, 0x83, 2))
    rtu = [one + frames.crc16(one).to_bytes(2, "little") for one in (body, refusal)]
    tcp = [struct.pack(">HHH", 7, 0, len(one)) + one for one in (body, refusal)]
    return [asked + one for one in (*rtu, *tcp, b"\0" + rtu[0], tcp[0] + tcp[1], rtu[0][:5])]


@cache
def _blocks() -> tuple[Block, ...]:
    return tuple(block for profile in packaged_profiles() for block in profile.blocks)


def registers(data: bytes) -> None:
    """Registers are values within their limits, or a fault and no value; what is encoded is decoded again."""
    if not data:
        return
    blocks = _blocks()
    block = blocks[data[0] % len(blocks)]
    count = block_registers(block)
    words = struct.unpack(f">{count}H", data[1:].ljust(2 * count, b"\0")[: 2 * count])
    found = decode(block, words)
    _judge(found)
    if found.fault is Fault.NONE:
        again = decode(block, encode(block, found.values))
        _hold(again.values.keys() == found.values.keys(), f"encoded, it is {again}")
        for name, value in found.values.items():
            # Where a register scales it, the scale that is encoded may be another one.
            (field,) = (one for one in block.fields if one.quantity == name)
            count_is = 0.0 if field.scale_from is None else abs(field.scale * SI[field.unit][0])
            rel_tol = 1e-6 if field.scale_from is None else 1e-4
            near = isclose(value, again.values[name], rel_tol=rel_tol, abs_tol=1e-9 + count_is)
            _hold(near, f"{name} {value}: {again.values}")
    short = decode(block, words[: data[0] % count])
    _hold(short.fault is Fault.LENGTH and not short.values, "too few registers are values")


def _judge(found: Decoded) -> None:
    if found.fault is Fault.NONE:
        _hold(found.values and all(map(isfinite, found.values.values())), f"values {found.values}")
    else:
        _hold(not found.values and found.detail, "a fault with values, or without a reason")
        _plain(found.detail)


def _registers() -> list[bytes]:
    zeros = [bytes((i,)) + bytes(2 * block_registers(block)) for i, block in enumerate(_blocks())]
    return [*zeros, b"\0" + b"\x08\x00" * 20, b"\1" + b"\x7f\xc0\x00\x00" * 10]


def modbus_requests(data: bytes) -> None:
    """What a master asks is answered within the length of a frame, in whatever pieces it comes."""
    if len(data) < 2:
        return
    size, device_id, heard = 1 + data[0] % 32, data[1], data[2:]
    found = [_asked_on_tcp([heard]), _asked_on_tcp(_pieces(heard, size))]
    _hold(found[0] == found[1], "what is asked depends on the pieces")
    for pdu in found[0]:
        if isinstance(pdu, bytes):
            _hold(len(modbus_frames.tcp_frame(1, 1, _answer(pdu))) <= modbus_frames.LONGEST_TCP_BYTES, "a long answer")
    line = modbus_frames.RtuRequests(device_id)
    for piece in _pieces(heard, size):
        request = line.feed(piece, 1.0)
        if request:
            frame = modbus_frames.rtu_frame(device_id, _answer(request))
            _hold(len(frame) <= modbus_frames.LONGEST_RTU_BYTES, "a long answer")
            line.said(frame)
    words = heard[: 2 * (len(heard) // 2)][:246]
    if words:
        whole = modbus_frames.rtu_frame(device_id, modbus_frames.write_request(5, words))
        _hold(modbus_frames.RtuRequests(device_id).feed(whole, 1.0) == whole[1:-2], "a request that is not heard")
    result = modbus_frames.find_write_result(heard, device_id, 5, words)
    _hold(result is None or 0 <= result < 256, "no such result")
    _plain(modbus_frames.explain_refusal(result or 0))


def _asked_on_tcp(pieces: Sequence[bytes]) -> list[object]:
    """Requests, and at the end what came instead of one."""
    frames_, found = modbus_frames.TcpFrames(), list[object]()
    for piece in pieces:
        frames_.feed(piece)
        try:
            while (frame := frames_.next()) is not None:
                found.append(frame.pdu)
        except modbus_frames.NotModbusError as error:
            _plain(str(error))
            return [*found, NotImplemented]
    return found


def _answer(pdu: bytes) -> bytes:
    code, wanted = modbus_frames.asked(pdu, 100, 130)
    return modbus_frames.refusal(pdu, code) if code else modbus_frames.read_answer(pdu, bytes(260), wanted)


def _modbus_requests() -> list[bytes]:
    read, write = b"\x03\x00\x64\x00\x02", modbus_frames.write_request(5, b"\0\1\0\2")
    tcp = [modbus_frames.tcp_frame(3, 1, one) for one in (read, write, b"\x11")]
    rtu = [modbus_frames.rtu_frame(1, one) for one in (read, write, b"\x11", b"\x90\x02", b"\x10\0\5\0\2")]
    return [b"\x05\x01" + one for one in (*tcp, *rtu, b"".join(tcp), b"GET / HTTP/1.1\r\n\r\n")]


# ---- what devices say by themselves ----------------------------------------------------------------------------------


@cache
def _sentences() -> tuple[tuple[Sentence, ...], ...]:
    return tuple(profile.sentences for profile in packaged_sentences())


def sentences(data: bytes) -> None:
    """Sentences are values or faults, in whatever pieces they come, and what waits for its end is bounded."""
    if len(data) < 2:
        return
    profiles = _sentences()
    wanted, heard = profiles[data[0] % len(profiles)], data[2:]
    whole, cut = SentenceReader(wanted), SentenceReader(wanted)
    found = whole.feed(heard)
    parts = [decoded for piece in _pieces(heard, 1 + data[1] % 64) for decoded in cut.feed(piece)]
    _hold(found == parts, "what is heard depends on the pieces")
    for decoded in (*found, *SentenceReader(wanted).datagram(heard)):
        _judge(decoded)
    _hold(len(cut._rest) <= 512, "an endless line is kept")
    _hold(len(whole.others) <= 8, "every header is remembered")
    _plain(whole.heard())


def _spoken() -> list[bytes]:
    lines = (
        b"$PASHR,085335.000,224.19,T,-01.26,+00.83,+00.10,0.101,0.113,0.267,1,0*06\r\n",
        b"$PRDID,-001.50,+002.25,123.45*6B\r\n",
        b"$PSXN,23,-1.26,0.83,224.19,0.10*1D\r\n",
        b":00FFFF 0012U-0125 0083\r\n",
        b"$PNORSUB2,101,1,-0.10,0.02,1.5,-0.5*33\r\n",
    )
    return [bytes((i, 9)) + line for i in range(len(_sentences())) for line in lines]


def stream_lines(data: bytes) -> None:
    """Whoever reads the stream takes a line as a record, passes it over, or says why it is none."""
    with suppress(UnreachableError):
        decode_record(data, "here:1")
    with suppress(UnreachableError):
        _follower()._decoded(data)


@cache
def _follower() -> Follower:
    return Follower("127.0.0.1", 1, None)  # type: ignore[arg-type]  # Nobody is told anything.


def _stream_lines() -> list[bytes]:
    return [
        wire.encode_record(VersionRecord(release="1")),
        wire.encode_record(ErrorRecord(message="no")),
        b'{"class":"MOTION","mono_s":1.0,"quality":{"heave":"valid"}}',
        b'{"class":"STATUS"}', b'{"class":["SEA"]}', b'{"class":"SEA","spectrum":[[0.1,2.0]]}', b"[" * 40,
    ]  # fmt: skip


# ---- what clients ask ------------------------------------------------------------------------------------------------


def client_requests(data: bytes) -> None:
    """A client of the stream is understood or told why not, in whatever pieces its lines come."""
    if not data:
        return
    whole, cut, said = LineSplitter(), LineSplitter(), data[1:]
    lines = whole.feed(said)
    parts = [line for piece in _pieces(said, 1 + data[0] % 64) for line in cut.feed(piece)]
    _hold(lines == parts and whole.overflow == cut.overflow, "what is asked depends on the pieces")
    _hold(len(cut._rest) < MAX_REQUEST_BYTES, "an endless line is kept")
    for line in (*lines, said):
        request = parse_request(line)
        if isinstance(request, BadRequest):
            _plain(request.message)
            told = wire.encode_record(ErrorRecord(message=request.message))
            _hold(told.count(b"\n") == 1 and len(told) < 4 * MAX_REQUEST_BYTES, "a long answer to a short request")


_REQUESTS: Final = (
    b'\x05?WATCH={"classes":["MOTION","SEA"],"rate_hz":10}\n?STATUS\r\n?VERSION\n', b"\x07?WATCH={}\n",
    b"\x00GET / HTTP/1.1\r\n",
    b'\x05?WATCH={"rate_hz":1e-300}\n', b'\x05?WATCH={"\\u001b[2J":1}\n', b"\x05" + b"x" * 600,
)  # fmt: skip


def http(data: bytes) -> None:
    """Whatever is asked of metrics and page has an answer that can be read and sets nothing."""
    method, path, host, *_ = (data.decode("utf-8", "surrogateescape") + "\n\n").split("\n")
    if path == "/events":
        return  # Has no end.
    own = is_own_host(host, ("crane",))
    plain = host.lower()
    _hold(not own or plain.startswith(("crane", "localhost")) or ":" in plain or "." in plain, f"{host} is not ours")
    request: Any = SimpleNamespace(method=method, path=path, host=host, headers={"Host": host})
    for server in (_http_server(), _page_server()):
        answering = server._answer(request).__await__()
        response: Any = None
        try:
            next(answering)
        except StopIteration as end:
            response = end.value
        _hold(response is not None and response.status in (200, 404, 405, 421, 503), "no answer")
        _hold(response.status != 200 or (method in ("GET", "HEAD") and len(path) < 40), f"{method} {path} is served")
        if response.status >= 400:
            _plain(response.text)
        _hold(all(value.isprintable() for value in response.headers.values()), "a header in two lines")


@cache
def _http_server() -> HttpServer:
    return HttpServer(
        host="127.0.0.1", port=0, allow=(), metrics=lambda: b"", alive=Verdict, ready=Verdict,
        count_client_error=lambda _: None,
    )  # fmt: skip


@cache
def _page_server() -> PageServer:
    return PageServer(host="127.0.0.1", port=0, allow=(), stream_host="127.0.0.1", stream_port=1)


_HTTP: Final = (
    b"GET\n/metrics\nlocalhost:8571", b"HEAD\n/\n[::1]:8570", b"POST\n/clock\n10.0.0.1", b"GET\n/app.js\ncrane.",
    b"G\x1bET\n/\xe2\x80\xae<script>\n[::1]]:x", b"GET\n/healthz\n127.0.0.1:99999",
)  # fmt: skip


class _Wire(asyncio.Transport):
    """Takes what is sent."""

    def __init__(self) -> None:
        super().__init__()
        self.sent = b""
        self.is_over = False

    def write(self, data: Any) -> None:
        self.sent += bytes(data)

    def write_eof(self) -> None:
        """Nothing more is sent."""

    def close(self) -> None:
        self.is_over = True

    abort = close

    def is_closing(self) -> bool:
        return self.is_over


class _Ear(asyncio.Protocol):
    """Hears, answers each piece, and goes on when the other side has ended."""

    def __init__(self) -> None:
        self.heard, self.ends = b"", 0

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        self.heard += data
        self._transport.write(data)

    def eof_received(self) -> bool:
        self.ends += 1
        return True


def tls(data: bytes) -> None:
    """With TLS what is said is heard, in whatever pieces it comes, and nothing else is; a handshake is over once."""
    if len(data) > 2:
        _loop().run_until_complete(_spoken_tls(data[0], 1 + data[1] % 128, data[2:]))


async def _spoken_tls(kind: int, size: int, said: bytes) -> None:
    ear, overs = _Ear(), list[str]()
    wire_ = _Wire()
    server = TlsConnection(_anonymous(ssl.PROTOCOL_TLS_SERVER), lambda: ear, overs.append)
    server.connection_made(wire_)
    client, incoming, outgoing = _client()
    is_agreed, expected = bool(kind & 1), b""
    if is_agreed:
        for _ in range(3):
            with suppress(ssl.SSLWantReadError):
                client.do_handshake()
            for piece in _pieces(outgoing.read(), size):
                server.data_received(piece)
            incoming.write(wire_.sent)
            wire_.sent = b""
        _hold(overs == [""], f"no agreement: {overs}")
        expected = said[: len(said) // 2] if kind & 2 else said
        if expected:
            client.write(expected)
        if kind & 4:
            with suppress(ssl.SSLWantReadError):
                client.unwrap()
    rest = said[len(expected) :]
    for piece in _pieces(outgoing.read() + rest, size):
        server.data_received(piece)
    _hold(ear.heard == expected, "what is heard is not what is said")
    _hold(ear.ends <= 1, "the end is heard twice")
    if is_agreed and not rest and not kind & 4:
        incoming.write(wire_.sent)
        echoed = b""
        with suppress(ssl.SSLWantReadError):
            while True:
                echoed += client.read(65536)
        _hold(echoed == expected, "what is answered is not what is heard")
    _hold(len(wire_.sent) < 1024 + 40 * len(said), "a long answer to a short word")
    server.eof_received()
    server.connection_lost(None)
    _hold(len(overs) == 1, f"the handshake is over {len(overs)} times")
    _plain(overs[0])


def _client() -> tuple[ssl.SSLObject, ssl.MemoryBIO, ssl.MemoryBIO]:
    incoming, outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
    return _anonymous(ssl.PROTOCOL_TLS_CLIENT).wrap_bio(incoming, outgoing), incoming, outgoing


@cache
def _anonymous(side: Any) -> ssl.SSLContext:
    """Without certificates, which no bytes of a client could lead through: all else is as it is."""
    context = ssl.SSLContext(side)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    context.minimum_version = context.maximum_version = ssl.TLSVersion.TLSv1_2
    context.set_ciphers("aNULL:@SECLEVEL=0")
    return context


@cache
def _loop() -> asyncio.AbstractEventLoop:
    loop = asyncio.new_event_loop()
    atexit.register(loop.close)
    return loop


_TLS: Final = (
    b"\x01\x05?STATUS\n", b"\x05\x7f?VERSION\n" * 3, b"\x03\x00?STATUS\n\x17\x03\x03\x00\x04\0\0\0\0",
    b"\x00\x10GET / HTTP/1.1\r\n\r\n", b"\x00\x03\x16\x03\x01\x00\x05\x01\x00\x00\x01\x03",
    b"\x07\x01a\x15\x03\x03\x00\x02\x02\x28",
)  # fmt: skip


# ---- files -----------------------------------------------------------------------------------------------------------


def recording(data: bytes) -> None:
    """A CSV file is samples in order, or is refused with the place."""
    last_s = -float("inf")
    try:
        with Recording(_written("recording.csv", data)) as opened:
            for found in opened.instants():
                for sample in found:
                    if sample is not None:
                        _hold(sample.t_s >= last_s and isfinite(sample.t_s), "time goes back")
                        last_s = sample.t_s
    except RecordingError as error:
        _hold(error.reason, "refused without a reason")


_RECORDINGS: Final = (
    b"t_s,az_mps2\n0,9.81\n0.1,9.7\n0.2,9.9\n0.3,9.8\n",
    b"t_s,az_mps2,roll_deg,laser_m\n1e9,9.81,,4.2\n1000000000.05,,1.5,\n\n",
    b"t_s,az_mps2,slew_deg,heave_sensor_m,gx2_radps,gy2_radps,gz2_radps\n0,9.8,1,2,3,4,5\n1,9.8,,,,,\n",
    b'\xef\xbb\xbft_s,az_mps2\r\n"0","9.8"\r\n1,nan\r\n', b"t_s;az_mps2\n0;9,81\n", b"time,az_mps2\n0,1_0\n",
)  # fmt: skip


@cache
def _header() -> Header:
    """Of the packaged sensors."""
    config = load(data_directory() / "sensors.toml")
    return Header(
        vessel="A", run="1", release="0", began_utc_s=1.8e9, layout=layout_of(config, FramePacker(config)),
        config=msgspec.Raw(msgspec.json.encode(config)), learned=msgspec.Raw(b"null"),
    )  # fmt: skip


@cache
def _recorder() -> Recorder:
    made = Recorder(lambda _report: None, lambda: None)
    made.take(Kind.HEADER, msgspec.json.encode(_header()), 0.0)
    return made


def recorder_messages(data: bytes) -> None:
    """What the process that records is told is rows, which a table takes, or none of ours."""
    if not data:
        return
    recorder, splitter, told = _recorder(), Splitter(), list[tuple[Kind, bytes]]()
    with suppress(MessageError):
        for piece in _pieces(data[1:], 1 + data[0] % 64):
            told += splitter.push(piece)
    once = list[tuple[Kind, bytes]]()
    with suppress(MessageError):
        once += Splitter().push(data[1:])
    _hold(len(once) <= len(told) or not once, "what is told depends on the pieces")
    samples, rows = recorder._samples, recorder._frames
    assert samples is not None
    assert rows is not None
    samples.clear()
    rows.clear()
    recorder.take(Kind.OFFSET, messages.OFFSET.pack(1.8e9), 0.0)
    for kind, body in told:
        _hold(packed(kind, body) in data, "a message that nobody sent")
        if kind in (Kind.SETTINGS, Kind.HEADER):  # They would have it write where they say.
            with suppress(msgspec.MsgspecError):
                msgspec.json.decode(body, type=Settings if kind is Kind.SETTINGS else Header)
            continue
        with suppress(MessageError):
            recorder.take(kind, body, 0.0)
    for table in (samples, rows):
        if len(table):
            _hold(len(table.batch()) == len(table), "rows that no table takes")


def _told() -> list[bytes]:
    layout = _header().layout
    sample = messages.SAMPLE.pack(0, 7, 0, 5000.0) + bytes(8 * len(layout.devices[0].columns))
    frame = messages.TIME.pack(5000.0) + struct.pack("<d", 0.5) * len(layout.numbers)
    said = [
        packed(Kind.OFFSET, messages.OFFSET.pack(1.8e9)), packed(Kind.OFFSET, messages.OFFSET.pack(nan)),
        packed(Kind.SAMPLE, sample), packed(Kind.TEXT, b"\0valid"), packed(Kind.FRAME, frame),
        *(packed(Kind.CALL, messages.CALL.pack(8, i, nan) + b"{}") for i in range(len(CALLS))),
    ]  # fmt: skip
    return [b"\x3f" + one for one in (*said, b"".join(said))]


def recorded(data: bytes) -> None:
    """A recording of the daemon, Parquet or Arrow, is rows, or is refused with the file."""
    from heaved.recorder.read import frame_values, open_recorded, rows_of

    if not data:
        return
    table, suffix = (SAMPLES, FRAMES)[data[0] % 2], (".arrows", ".parquet")[data[0] // 2 % 2]
    path = _written(f"recorded{suffix}", data[1:])
    try:
        for hour in open_recorded(path, table).hours:
            if table == SAMPLES:
                for row in islice(rows_of(hour), _MOST_ROWS):
                    _hold(row.sample is None or row.call.value == "poll", "a sample that was not polled")
            else:
                names = [column.name for column in hour.header.layout.numbers[:4]]
                for batch in islice(hour.batches(), 2):
                    frame_values(hour, names, batch)
    except RecordedError as error:
        _hold(str(path) in str(error), "refused without its name")


def _recorded() -> list[bytes]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    recorder_messages(b"\x3f" + b"".join(one[1:] for one in _told()[:6]))
    tables: list[tuple[int, SampleRows | FrameRows | None]] = list(
        enumerate((_recorder()._samples, _recorder()._frames))
    )
    made = []
    for number, rows in tables:
        assert rows is not None
        batch = rows.batch()
        stream, parquet = io.BytesIO(), io.BytesIO()
        with pa.ipc.new_stream(stream, rows.schema) as writer:
            writer.write_batch(batch)
        pq.write_table(pa.Table.from_batches([batch]), parquet, write_page_checksum=True)
        made += [bytes((number,)) + stream.getvalue(), bytes((2 + number,)) + parquet.getvalue()]
    return made


def torn_stream(data: bytes) -> None:
    """What a crash leaves of a growing recording becomes Parquet with every batch that is whole, or is kept."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    from heaved.recorder.files import to_parquet, whole_batches

    if not data:
        return
    whole = _streams()[data[0] % 2]
    at = int.from_bytes(data[1:4], "big") % (len(whole) + 1)
    directory = _scratch() / "torn"
    shutil.rmtree(directory, ignore_errors=True)
    directory.mkdir()
    source = directory / "heaved-20260101T000000Z.samples.arrows"
    source.write_bytes(whole[:at] + data[4:])
    size = source.stat().st_size
    try:
        made = to_parquet(source, table_rows=2)
    except (OSError, pa.ArrowException):  # What the recorder says of it.
        _hold([path.name for path in directory.iterdir()] == [source.name], "what cannot be read is not as it was")
        return
    left = {path.suffix for path in directory.iterdir()}
    _hold(left <= {".parquet", ".damaged"} and not source.exists(), f"{left} is left")
    _hold(0 <= made.torn_bytes <= size, "more is torn than there was")
    target = source.with_suffix(".parquet")
    rows = pq.read_metadata(target).num_rows if target.exists() else 0
    _hold(rows == made.rows, "rows are lost")
    _hold(rows > 0 or not target.exists() or at < len(whole), "an empty file of nothing")
    if made.kept:
        _hold(sum(len(batch) for batch, _ in whole_batches(directory / made.kept)) == rows, "what is kept says other")


@cache
def _streams() -> list[bytes]:
    """Of three batches of each table."""
    import pyarrow as pa

    made = []
    for seed in _recorded()[::2]:
        stream = io.BytesIO()
        (batch,) = pa.ipc.open_stream(seed[1:])
        with pa.ipc.new_stream(stream, batch.schema, options=pa.ipc.IpcWriteOptions(compression="zstd")) as writer:
            for _ in range(3):
                writer.write_batch(batch)
        made.append(stream.getvalue())
    return made


def _torn_streams() -> list[bytes]:
    ends = [[len(whole), len(whole) - 8, len(whole) - 20, len(whole) // 2, 8, 0] for whole in _streams()]
    cut = [bytes((table,)) + at.to_bytes(3, "big") for table in (0, 1) for at in ends[table]]
    return [*cut, cut[1] + bytes(64), cut[3] + b"\xff" * 512, cut[5] + _streams()[0][:300]]


@cache
def _pipeline() -> Pipeline:
    config = load(data_directory() / "sensors.toml")
    return make_pipeline(msgspec.structs.replace(config, hull=msgspec.structs.replace(config.hull, enabled=True)))


def state(data: bytes) -> None:
    """What was remembered is taken over by the estimators, or refused; also when its checksum is right."""
    file = StateFile(_scratch(), SavedState, saved_state.check)
    if data[:1] == b"{":
        content = data
    else:
        with suppress(msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
            data = msgspec.json.encode(msgspec.json.decode(data[1:]))
        body = msgspec.Raw(data)
        content = b'{"version":3,"sha256":"%b","state":%b}' % (_sha256(bytes(body)), bytes(body))
    file.path.write_bytes(content)
    try:
        saved = file.read()
    except StateError as error:
        _hold(str(error), "refused without a reason")
        return
    assert saved is not None
    try:
        _pipeline().restore(saved.state, 60.0)
    except ValueError:
        _pipeline.cache_clear()
    else:
        _hold(isfinite(_pipeline().heave.observer.bias_mps2), "a bias that is none")
        learned = _pipeline().state()
        StateFile.encode(learned)
        saved_state.check(msgspec.json.decode(msgspec.json.encode(learned), type=SavedState))


def _sha256(body: bytes) -> bytes:
    import hashlib

    return hashlib.sha256(body).hexdigest().encode()


def _states() -> list[bytes]:
    sea = SeaModel(
        frequency_hz=(0.1, 0.2),
        damping=(0.1, 0.2),
        level_m2phz=(4.0, 1.0),
        noise_psd=1e-6,
        bias_walk_psd=1e-9,
        stages=4,
    )
    learned = SavedState(sea=sea, bias_mps2=0.02, bias_std_mps2=0.01, lead_learned_s=0.1, gain_learned=1.01)
    harmonic = SavedState(frequencies_hz=(0.08, 0.11, 0.2))
    known = [1e-6 if i == j else 1e-8 for i in range(6) for j in range(i, 6)]
    flexure = SavedFlexure(
        std_rad=(1e-4, 1e-4, 2e-4), mu_radps=(0.1, 0.2, 0.3), lambda_radps=(1.0, 2.0, 3.0), noise_radps=(1e-5,) * 3
    )
    bent = SavedHull(
        rotation_rad=(0.01, -0.02, 0.003), scale=(1e-3, 0.0, -1e-3), covariance=tuple(known), flexure=flexure,
        unconfirmed_s=30.0,
    )  # fmt: skip
    leaning = SavedAttitudeError(lean_per_s=0.05, late_s=0.02, covariance=(1e-4, 1e-6, 1e-4), unconfirmed_s=10.0)
    found = LaserPlace(is_elsewhere=True, ahead_m=3.0, ahead_std_m=0.2, port_m=-1.0, port_std_m=0.3)
    elsewhere = SavedPlace(configured=Geometry(), geometry=Geometry(forward_m=3.0, port_m=-1.0), place=found)
    stages = (
        SavedState(hull=bent), SavedState(attitude_error=leaning), SavedState(laser_place=elsewhere),
        msgspec.structs.replace(learned, hull=bent, attitude_error=leaning, laser_place=elsewhere),
    )  # fmt: skip
    return [
        *(b"." + msgspec.json.encode(one) for one in (learned, harmonic, *stages, SavedState())),
        StateFile.encode(learned, 1.8e9), b'{"version":9}', b'{"version":2,"sha256":"","state":null}',
    ]  # fmt: skip


TARGETS: Final[dict[str, Target]] = {
    "client-requests": Target(
        client_requests, partial(list, _REQUESTS), 600, ("heaved.outputs.requests", "heaved.text")
    ),
    "modbus-answers": Target(modbus_answers, _modbus_answers, 160, ("heaved.devices.frames",)),
    "modbus-requests": Target(modbus_requests, _modbus_requests, 300, ("heaved.outputs.modbus_frames",)),
    "registers": Target(registers, _registers, 64, ("heaved.devices.profile",)),
    "sentences": Target(sentences, _spoken, 600, ("heaved.devices.sentences", "heaved.text")),
    "links": Target(
        links, partial(list, _LINKS), 96, ("heaved.links", "heaved.networks", "heaved.text", "heaved.devices.probe")
    ),
    "tls": Target(tls, partial(list, _TLS), 1024, ("heaved.outputs.tls_connection",)),
    "http": Target(http, partial(list, _HTTP), 96, ("heaved.page.server", "heaved.outputs.http", "heaved.text")),
    "stream-lines": Target(stream_lines, _stream_lines, 512, ("heaved.outputs", "heaved.client", "heaved.page")),
    "recording": Target(recording, partial(list, _RECORDINGS), 512, ("heaved.devices.recording",)),
    "recorder-messages": Target(recorder_messages, _told, 4096, ("heaved.recorder",)),
    "recorded": Target(recorded, _recorded, 1 << 17, ("heaved.recorder",)),
    "torn-stream": Target(torn_stream, _torn_streams, 2048, ("heaved.recorder.files",)),
    "state": Target(
        state, _states, 4096, ("heaved.daemon.state", "heaved.estimation.heave", "heaved.estimation.hull.remembered")
    ),
    "configuration": Target(
        configuration, _configurations, 2048, ("heaved.config", "heaved.devices.profile", "heaved.links")
    ),
}

"""What must hold of whatever meets bytes from outside, with what hypothesis makes of bytes that are taken, with what
the fuzzer has found once, and that the properties see what they are there for.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import fuzz
import pytest
from evidence import fuzz_targets
from evidence.fuzz_targets import TARGETS, BrokenPropertyError, Target, run
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from heaved.devices.sentences import SentenceReader

if TYPE_CHECKING:
    from hypothesis.strategies import DrawFn

    from heaved.devices.profile import Decoded

EXAMPLES = {"configuration": 20, "recorded": 20, "state": 60, "recorder-messages": 60, "torn-stream": 20, "tls": 60}
"""Of those that take longer; the others have 150."""

FOUND: dict[str, list[bytes]] = {
    "client-requests": [b'\x05?WATCH={"\\u001b[2J":1}\n'],
    "recorder-messages": [
        # An offset that is no number, then a call.
        b"\x3f" + b"\x08\0\0\0\2" + b"\0\0\0\0\0\0\xf8\x7f" + b"\x11\0\0\0\4" + bytes(17),
    ],
    "registers": [bytes.fromhex("f6ff0000fafff70010000000 00")],
    "recording": [b't_s,\xef\xbb\xbft_s,az_mps2\r\n"0","9.8"\r\n'],
}
"""What broke a property once."""


@st.composite
def altered(draw: DrawFn, seeds: list[bytes], most_bytes: int) -> bytes:
    """An input that is taken, with some of its bytes replaced, left out or said twice; or any bytes."""
    data = bytearray(draw(st.sampled_from(seeds)))
    for _ in range(draw(st.integers(0, 4))):
        at = draw(st.integers(0, len(data)))
        length = draw(st.integers(0, 8))
        put = draw(
            st.one_of(st.binary(max_size=8), st.just(bytes(data[at : at + 40])), st.just(b"\x1b[2J"), st.just(b"\n"))
        )
        data[at : at + length] = put
    return bytes(data[:most_bytes])


@pytest.mark.parametrize("name", TARGETS)
def test_it_holds_of_what_is_taken_and_of_what_comes_near_it(name: str) -> None:
    target = TARGETS[name]
    seeds = list(target.seeds())
    for seed in seeds:
        run(target, seed)
        target.run(seed[: len(seed) // 2])
    target.run(b"")

    @settings(max_examples=EXAMPLES.get(name, 150), suppress_health_check=list(HealthCheck), database=None)
    @given(data=st.one_of(altered(seeds, target.most_bytes), st.binary(max_size=80)))
    def holds(data: bytes) -> None:
        target.run(data)

    holds()


@pytest.mark.parametrize(("name", "data"), [(name, data) for name, all_ in FOUND.items() for data in all_])
def test_what_broke_it_once(name: str, data: bytes) -> None:
    run(TARGETS[name], data)


# ---- that a fault is seen --------------------------------------------------------------------------------------------


def test_an_exception_that_is_not_documented_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    def parse(_line: bytes) -> None:
        raise KeyError("no")

    monkeypatch.setattr(fuzz_targets, "parse_request", parse)
    with pytest.raises(KeyError):
        run(TARGETS["client-requests"], b"\x05?STATUS\n")


def test_what_a_terminal_obeys_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heaved.outputs.requests.printable", str)
    with pytest.raises(BrokenPropertyError, match="terminal obeys"):
        run(TARGETS["client-requests"], FOUND["client-requests"][0])


def test_an_answer_that_is_another_in_pieces_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    class Whole(SentenceReader):
        """Takes no line that does not come at once."""

        def feed(self, data: bytes) -> list[Decoded]:
            self.reset()
            return super().feed(data)

    monkeypatch.setattr(fuzz_targets, "SentenceReader", Whole)
    seed = next(seed for seed in TARGETS["sentences"].seeds() if seed.startswith(b"\0") and b"PASHR" in seed)
    with pytest.raises(BrokenPropertyError, match="pieces"):
        run(TARGETS["sentences"], seed)


def test_what_takes_too_long_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    times_s = iter((0.0, 1.5))
    monkeypatch.setattr("time.process_time", lambda: next(times_s))
    with pytest.raises(BrokenPropertyError, match=r"took 1\.5 s"):
        run(Target(lambda _data: None, list, 1, ()), b"")


# ---- the tool --------------------------------------------------------------------------------------------------------

SAID = """\
#2\tINITED cov: 30 ft: 31 corp: 6/143b exec/s: 0 rss: 139Mb
#8192\tpulse  cov: 33 ft: 60 corp: 20/1Kb lim: 80 exec/s: 4096 rss: 140Mb

 === Uncaught Python exception: ===
BrokenPropertyError: text with what a terminal obeys
Traceback (most recent call last):
  File "fuzz_targets.py", line 99, in _hold
evidence.fuzz_targets.BrokenPropertyError: text
==12== ERROR: libFuzzer: fuzz target exited
artifact_prefix='x-'; Test unit written to x-crash-d95a
stat::number_of_executed_units: 8195
stat::peak_rss_mb:              141
"""


def test_what_the_fuzzer_says_is_read(monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    import subprocess
    from pathlib import Path

    def ran(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        return subprocess.CompletedProcess(command, 77, "", SAID)

    monkeypatch.setattr(subprocess, "run", ran)
    found = fuzz.fuzz("client-requests", Path(str(tmp_path)), 1.0, 0)
    assert (found.inputs, found.edges, found.memory_mb, found.broken) == (8195, 33, 141, "crash")
    assert found.said.endswith("BrokenPropertyError: text\nx-crash-d95a")
    table = fuzz.report([found]).text
    assert re.search(r"^\| client-requests \| 8195 \| \d+ \| 33 \| 1 \| 0 \| 141 \|$", table, re.MULTILINE)
    assert "| **all** | **8195** | | | **1** | **0** | |" in table


def test_without_the_fuzzer_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("sys.argv", ["tools/fuzz.py", "links"])
    monkeypatch.setattr("importlib.util.find_spec", lambda _name: None)
    assert fuzz.main() == 2
    assert "pip install 'heaved[fuzz]'" in capsys.readouterr().out

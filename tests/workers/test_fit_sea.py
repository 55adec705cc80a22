"""The real process that fits the sea: same answer as in-process, bit for bit, and a clear word about garbage."""

from __future__ import annotations

import io
import subprocess

import numpy as np

from heaved.estimation.heave.sea.refit import SeaFit, SeaWindow, look
from heaved.simulate.seaway import seaway
from heaved.workers import protocol
from heaved.workers.jobs import SEA_FIT
from heaved.workers.process import _environment


def window(number: int, a: np.ndarray, **changes: object) -> SeaWindow:
    asked: dict[str, object] = {
        "number": number,
        "t_s": (0.05 * np.arange(len(a))).tobytes(),
        "a_mps2": a.tobytes(),
        "stages": 6,
        "components": 2,
        "windows_s": (60.0, 120.0),
        "bias_walk_psd": 9e-10,
        "delay_s": 20.0,
        "looked_s": float("nan"),
    }
    return SeaWindow(**(asked | changes))  # type: ignore[arg-type]


def sea(seconds: float) -> np.ndarray:
    t = 0.05 * np.arange(round(seconds / 0.05), dtype=np.float64)
    noise = 3e-3 * np.random.default_rng(1).standard_normal(len(t))
    return np.ascontiguousarray(seaway("S5", 1).motion(t).heave_acceleration_mps2 + noise)


def run(frames: bytes) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        SEA_FIT.command, input=frames, capture_output=True, timeout=60, env=_environment(), check=False
    )


def test_the_process_answers_as_we_do_bit_for_bit_and_ends_with_its_input() -> None:
    """With one thread on either side; the second look judges the models of the first."""
    first = look(window(7, sea(100.0)))
    asked = [
        window(7, sea(100.0)),
        window(8, sea(120.0), candidates=first.candidates, looked_s=first.t_s),
        window(9, np.zeros(3000)),
        window(10, np.full(3000, np.nan)),
    ]
    done = run(b"".join(map(protocol.encode, asked)))
    assert (done.returncode, done.stderr) == (0, b"")
    stream = io.BytesIO(done.stdout)
    for each in asked:
        answer = protocol.read(stream, SeaFit)
        assert answer is not None
        assert protocol.encode(answer) == protocol.encode(look(each))
        assert answer.number == each.number
        assert bool(answer.message) == (each.number >= 9)
    assert protocol.read(stream, SeaFit) is None


def test_a_malformed_frame_ends_it_with_a_word_after_the_good_answers() -> None:
    done = run(protocol.encode(window(4, sea(40.0))) + b"\x00\x00\x00\x01\xc1")
    assert done.returncode == 1
    assert b"fitter: a frame holds no SeaWindow" in done.stderr
    stream = io.BytesIO(done.stdout)
    answer = protocol.read(stream, SeaFit)
    assert answer is not None
    assert answer.number == 4
    assert protocol.read(stream, SeaFit) is None


def test_a_frame_of_nonsense_length_is_refused() -> None:
    done = run(b"GET / HTTP/1.1\r\n\r\n")
    assert done.returncode == 1
    assert b"not a frame" in done.stderr
    assert done.stdout == b""

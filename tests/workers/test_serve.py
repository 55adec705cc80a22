"""The real trainer process: same weights as in-process, an end that follows its stdin, a clear word about garbage."""

from __future__ import annotations

import io
import subprocess
import sys

import pytest
from training_windows import RAMP, delayed_residual, window

from heaved.samples import TrainedNetwork
from heaved.workers import protocol
from heaved.workers.jobs import TRAINING
from heaved.workers.train_correction import fit


def test_the_worker_trains_as_we_do_and_ends_with_its_input() -> None:
    windows = [
        window(*delayed_residual(500), number=4, epochs=60),
        window(RAMP, RAMP[:, 0] * 0.0, number=5),
        window(*delayed_residual(500), number=6, epochs=60, output="sigmoid"),
    ]
    done = subprocess.run(
        TRAINING.command, input=b"".join(map(protocol.encode, windows)), capture_output=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
    stream = io.BytesIO(done.stdout)
    for asked in windows:
        answer, expected = protocol.read(stream, TrainedNetwork), fit(asked)
        assert answer is not None
        assert answer.number == asked.number
        assert answer.weights == expected.weights
        assert answer.message == expected.message
    assert protocol.read(stream, TrainedNetwork) is None


def test_a_malformed_frame_ends_the_worker_with_a_word_after_the_good_answers() -> None:
    good = window(*delayed_residual(100), number=4, epochs=2)
    done = subprocess.run(
        TRAINING.command,
        input=protocol.encode(good) + b"\x00\x00\x00\x01\xc1",
        capture_output=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 1
    assert b"trainer: a frame holds no TrainingWindow" in done.stderr
    stream = io.BytesIO(done.stdout)
    answer = protocol.read(stream, TrainedNetwork)
    assert answer is not None
    assert answer.number == 4
    assert protocol.read(stream, TrainedNetwork) is None


@pytest.mark.parametrize(
    "module", ["heaved.workers.process", "heaved.estimation.heave.laser.network", "heaved.daemon.daemon"]
)
def test_the_daemon_side_imports_nothing_that_only_workers_need(module: str) -> None:
    """Torch, and what scipy has beside its linear algebra: that alone is 20 MB."""
    heavy = {"torch", "scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.sparse", "scipy.spatial"}
    code = f"import sys, {module}; sys.exit(', '.join({heavy} & set(sys.modules)) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr

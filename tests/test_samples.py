"""What shakes the hull, in words. Oracle: the table, written out."""

import pytest

from heaved.samples import Vibration, vibration_in_words


def line(frequency_hz: float, rms_mps2: float, width_hz: float = 0.02) -> Vibration:
    return Vibration(frequency_hz=frequency_hz, width_hz=width_hz, rms_mps2=rms_mps2)


TABLE: dict[str, tuple[tuple[Vibration, ...], str]] = {
    "a quiet hull": ((), ""),
    "a line": ((line(3.1, 0.2121),), "vibration: seen at 3.1 Hz, 0.21 m/s2"),
    "an engine that wanders": ((line(12.34, 0.3, 1.2),), "vibration: seen at 12.3 Hz, 0.30 m/s2"),
    "a band": ((line(5.5, 0.3, 9.0),), "vibration: seen from 1.0 to 10.0 Hz, 0.30 m/s2"),
    "a band down to nothing": ((line(2.0, 0.3, 6.0),), "vibration: seen from 0.0 to 5.0 Hz, 0.30 m/s2"),
    "both": (
        (line(1.5, 0.5), line(6.0, 0.08, 4.0)),
        "vibration: seen at 1.5 Hz, 0.50 m/s2; from 4.0 to 8.0 Hz, 0.08 m/s2",
    ),
    "what nobody feels": ((line(3.1, 0.019),), ""),
    "more than anybody reads": (
        (line(1.0, 0.4), line(2.0, 0.3), line(3.0, 0.2), line(4.0, 0.1)),
        "vibration: seen at 1.0 Hz, 0.40 m/s2; at 2.0 Hz, 0.30 m/s2; at 3.0 Hz, 0.20 m/s2",
    ),
}


@pytest.mark.parametrize("name", TABLE)
def test_vibration_in_words(name: str) -> None:
    vibration, words = TABLE[name]
    assert vibration_in_words(vibration) == words

"""The tables of the direct predictor: the seas are what they are said to be, and the order of the methods holds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evidence.rock.direct import HORIZONS_S, Row, direct, figure, real, report, scene
from evidence.rock.seas import F_HZ, RATE_HZ, SHIPS, motion, spectrum
from scipy.signal import welch

SHIP = {ship.name: ship for ship in SHIPS}
RECORD = Path(__file__).parents[3] / "shared" / "data" / "palmer" / "NBP1406_2014-08-01_seapath330.csv"


def test_motion_has_its_spectrum() -> None:
    ship = SHIP["confused sea, roll"]
    assert np.trapezoid(spectrum(ship, F_HZ), F_HZ) == pytest.approx(ship.std**2, rel=1e-6)
    x = motion(ship, 20_000.0, np.random.default_rng(1))
    f, found = welch(x, RATE_HZ, nperseg=4000)
    band = (f > 0.05) & (f < 0.25)
    np.testing.assert_allclose(found[band].mean(), np.interp(f[band], F_HZ, spectrum(ship, F_HZ)).mean(), rtol=0.1)


def test_the_nonlinear_ship_is_one() -> None:
    """Softening restoring and quadratic damping: three times the sea gives less than three times the roll."""
    ship = SHIP["nonlinear roll"]
    x = motion(ship, 3000.0, np.random.default_rng(2))
    assert 0.3 * ship.std < x.std() < 1.5 * ship.std
    small = motion(type(ship)(**{f: getattr(ship, f) for f in ship.__struct_fields__} | {"std": ship.std / 3}),
                   3000.0, np.random.default_rng(2))  # fmt: skip
    assert x.std() < 2.9 * small.std()


def test_the_order_of_the_methods() -> None:
    rows = {row.method: np.array(row.ratio) for row in scene(SHIP["under way, roll"], (1,), 260.0)}
    assert np.all(rows["direct"] < rows["hold"])
    assert rows["direct"][2] < 0.8 * rows["paper, endpoint/67"][2]
    assert rows["direct"][2] < 0.8 * rows["paper, zero/210"][2]
    assert np.all(rows["direct"] > 0.8)


def test_report_and_figure(tmp_path: Path) -> None:
    row = Row(scene="x", method="direct", ratio=(1.0,) * len(HORIZONS_S), coverage=(0.95,) * len(HORIZONS_S))
    text = report([row], [], [], [])
    assert "| x | direct | 1.00" in text
    assert "| x | coverage | 0.950" in text
    figure(tmp_path / "f.png", [row], duration_s=60.0)
    assert (tmp_path / "f.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.skipif(not RECORD.exists(), reason=f"no real record at {RECORD}")
def test_a_real_ship() -> None:
    """Roll and pitch at 1 Hz: at least half of hold's error is gone 1, 2 and 5 s ahead."""
    for row in real(RECORD):
        assert np.all(np.array(row.ratio) < 0.65), row
        assert all(0.88 < c < 0.99 for c in row.coverage), row


def test_the_same_input_gives_the_same_output() -> None:
    t = np.arange(1200) / 20
    x = np.sin(t)[:, None] + 1e-3 * np.random.default_rng(1).standard_normal((1200, 1))
    np.testing.assert_array_equal(direct(t, x)[0], direct(t, x)[0])

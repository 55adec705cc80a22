"""Whether a soak says rightly that nothing grows."""

from __future__ import annotations

from math import inf, isnan, nan
from typing import TYPE_CHECKING

import numpy as np
import pytest
from evidence.soak import load
from evidence.soak.judge import Sample, Slope, Verdict, is_flat, judge, slope, table, verdict
from evidence.soak.use import grown, percentile_s

from heaved.config.read import data_directory
from heaved.config.read import load as read_configuration

if TYPE_CHECKING:
    from pathlib import Path


def samples(*, growing_mb_per_h: float = 0.0, hours: float = 2.0, noise_mb: float = 0.3) -> list[Sample]:
    rng = np.random.default_rng(1)
    return [
        Sample(
            t_s=t_s,
            rss_mb=120.0 + growing_mb_per_h * t_s / 3600.0 + noise_mb * rng.standard_normal(),
            workers_pss_mb={"fitter": 35.0},
            descriptors=45,
            threads=8,
            cpu_percent=15.0,
            workers_cpu_percent=nan,
            ages_ms=(1.0, 3.0, 9.0),
            lateness_ms=(0.1, 2.0, inf),
            frames_per_s=100.0,
            lost=0,
            valid=1.0,
            missed_polls=0.0,
            output_lost=0.0,
        )
        for t_s in np.arange(10.0, 3600.0 * hours, 10.0).tolist()
    ]


@pytest.mark.parametrize(
    ("growing_mb_per_h", "hours", "noise_mb", "wanted"),
    [
        (0.0, 2.0, 0.3, Verdict.FLAT),
        (0.5, 2.0, 0.3, Verdict.FLAT),  # Below what matters.
        (5.0, 2.0, 0.3, Verdict.GROWS),
        (-5.0, 2.0, 0.3, Verdict.FALLS),
        (0.0, 0.3, 5.0, Verdict.OPEN),  # Too short for so much noise.
    ],
)
def test_a_soak_is_judged_by_the_slope_and_how_well_it_is_known(
    growing_mb_per_h: float, hours: float, noise_mb: float, wanted: Verdict
) -> None:
    taken = samples(growing_mb_per_h=growing_mb_per_h, hours=hours, noise_mb=noise_mb)
    found = judge(taken)
    by_name = {one.quantity.name: one for one in found}
    assert by_name["memory of the daemon, resident (MB)"].verdict is wanted
    assert by_name["memory of its fitter, PSS (MB)"].verdict is Verdict.FLAT
    assert by_name["age at the client, p99 (ms)"].verdict is None
    assert is_flat(found) is (wanted is Verdict.FLAT)
    assert f"**{wanted.value}**" in table(found, taken[-1].t_s)


def test_the_standard_error_of_a_slope_is_what_slopes_scatter_by() -> None:
    # Noise that lasts: each value is 0.8 of the one before. Taken for white, slopes would scatter by three times more
    # than is said.
    rng = np.random.default_rng(2)
    t_s = np.arange(0.0, 7200.0, 10.0)
    slopes, said = [], []
    for _ in range(200):
        noise = np.zeros(len(t_s))
        for i, kick in enumerate(rng.standard_normal(len(t_s) - 1)):
            noise[i + 1] = 0.8 * noise[i] + kick
        found = slope(t_s.tolist(), noise.tolist())
        slopes.append(found.per_h)
        said.append(found.std_per_h)
    assert np.std(slopes) == pytest.approx(np.mean(said), rel=0.2)


def test_too_few_samples_have_no_slope() -> None:
    assert isnan(slope([1.0, 2.0], [1.0, nan]).per_h)
    assert verdict(Slope(nan, nan), 1.0) is Verdict.OPEN


def test_percentiles_of_a_histogram_are_those_of_what_came_between() -> None:
    before = {'lag_bucket{le="0.001"}': 100.0, 'lag_bucket{le="0.01"}': 100.0, 'lag_bucket{le="+Inf"}': 100.0}
    after = {'lag_bucket{le="0.001"}': 150.0, 'lag_bucket{le="0.01"}': 190.0, 'lag_bucket{le="+Inf"}': 200.0}
    assert percentile_s(before, after, "lag", 0.5) == pytest.approx(0.001)
    assert percentile_s(before, after, "lag", 0.7) == pytest.approx(0.001 + 0.009 * 20.0 / 40.0)
    assert percentile_s(before, after, "lag", 0.95) == inf
    assert isnan(percentile_s(after, after, "lag", 0.5))
    assert grown(before, after, "lag_bucket", "0.01") == 90.0


def test_the_load_is_a_configuration_that_the_daemon_takes(tmp_path: Path) -> None:
    path = tmp_path / "heaved.toml"
    sensors = (data_directory() / "sensors.toml").read_text(encoding="utf-8")
    path.write_text(sensors + load.tables(1, 2, 3, broker=4), encoding="utf-8")
    config = read_configuration(path)
    assert {str(spec.telegram) for spec in config.output} == set(load.TELEGRAMS)
    assert config.recording.enabled
    assert config.mqtt.enabled

"""The results of a backtest as one Parquet table: a row for each recording and configuration; not known is null."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq

from heaved.samples import HeaveState

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heaved.backtest.compare import Row
    from heaved.backtest.task import Accuracy, Ahead


def _errors(unit: str) -> list[Any]:
    return [
        pa.field("count", pa.int64()),
        pa.field(f"rms_{unit}", pa.float64()),
        pa.field(f"claimed_rms_{unit}", pa.float64()),
        *(pa.field(name, pa.float64()) for name in ("nees", "within_1std", "within_2std", "within_3std")),
    ]


def _horizons(unit: str) -> Any:
    return pa.list_(pa.struct([pa.field("horizon_s", pa.float64()), *_errors(unit)]))


SCHEMA = pa.schema(
    [
        pa.field("source", pa.string()),
        pa.field("source_sha256", pa.string()),
        pa.field("configuration", pa.string()),
        pa.field("configuration_sha256", pa.string()),
        pa.field("release", pa.string()),
        pa.field("failure", pa.string()),
        pa.field("rows", pa.int64()),
        pa.field("frames", pa.int64()),
        pa.field("duration_s", pa.float64()),
        pa.field("told_s", pa.float64()),
        pa.field("significant_height_m", pa.float64()),
        pa.field("peak_period_s", pa.float64()),
        pa.field("delayed_height_m", pa.float64()),
        *(pa.field(f"realtime_{field.name}", field.type) for field in _errors("m")),
        pa.field("expected_nees", pa.float64()),
        *(pa.field(f"laser_{field.name}", field.type) for field in _errors("m")),
        pa.field("forecasts", _horizons("m")),
        pa.field("roll", _horizons("deg")),
        pa.field("pitch", _horizons("deg")),
        *(pa.field(f"share_{state.value}", pa.float64()) for state in HeaveState),
        pa.field("first_valid_s", pa.float64()),
        pa.field("resets", pa.int64()),
        pa.field("remarks", pa.list_(pa.string())),
        pa.field("run_s", pa.float64()),
        pa.field("memory_bytes", pa.int64()),
    ]
)
"""What is not stated of a row that failed is null, but for who it is of and why."""


def parquet(rows: Sequence[Row]) -> bytes:
    """The whole file."""
    table = pa.Table.from_pylist([_flat(row) for row in rows], schema=SCHEMA)
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd")
    return sink.getvalue()


def _flat(row: Row) -> dict[str, object]:
    result = row.result
    flat: dict[str, object] = {
        "source": row.source,
        "configuration": row.configuration,
        "configuration_sha256": row.configuration_sha256,
        "release": row.release,
    }
    if result.failure:
        return {**flat, "failure": result.failure}
    same = (
        "source_sha256", "rows", "frames", "duration_s", "told_s", "significant_height_m", "peak_period_s",
        "delayed_height_m", "expected_nees", "first_valid_s", "resets", "run_s", "memory_bytes",
    )  # fmt: skip
    flat |= {name: getattr(result, name) for name in same}
    for name, errors in (("realtime", result.realtime), ("laser", result.laser)):
        if errors is not None:
            flat |= {f"{name}_{key}": value for key, value in _named(errors, "m").items()}
    flat |= {
        "forecasts": _ahead(result.forecasts, "m"),
        "roll": _ahead(result.roll, "deg"),
        "pitch": _ahead(result.pitch, "deg"),
        "remarks": list(result.remarks),
    }
    return flat | {f"share_{state.value}": result.shares.get(state.value) for state in HeaveState}


def _ahead(ahead: Sequence[Ahead], unit: str) -> list[dict[str, object]]:
    return [{"horizon_s": one.horizon_s, **_named(one.errors, unit)} for one in ahead]


def _named(errors: Accuracy, unit: str) -> dict[str, object]:
    named: dict[str, object] = msgspec.structs.asdict(errors)
    for name in ("rms", "claimed_rms"):
        named[f"{name}_{unit}"] = named.pop(name)
    return named

"""Rows of both tables from messages, and batches of Arrow from the rows. pyarrow lives in this and the next modules."""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING, Any, Final

import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from heaved.recorder import messages
from heaved.recorder.layout import CALLS, FRAMES, SAMPLES, Column, Header, Stored, exact_name, table_columns
from heaved.samples import Fault

if TYPE_CHECKING:
    from collections.abc import Sequence

Doubles = NDArray[np.float64]
Flags = NDArray[np.bool_]

HEADER_KEY: Final = b"heaved"
"""Of the metadata of a file: its :class:`heaved.recorder.layout.Header`, JSON."""
TABLE_KEY: Final = b"heaved.table"
COLUMN_KEY: Final = b"heaved.column"

_TYPES: Final[dict[Stored, Any]] = {
    Stored.INT8: pa.int8(),
    Stored.INT16: pa.int16(),
    Stored.UINT16: pa.uint16(),
    Stored.INT32: pa.int32(),
    Stored.UINT32: pa.uint32(),
    Stored.INT64: pa.int64(),
    Stored.FLOAT32: pa.float32(),
    Stored.FLOAT64: pa.float64(),
    Stored.FLOAT64_BITS: pa.int64(),
    Stored.TEXT: pa.string(),
    Stored.BYTES: pa.binary(),
}
_FAULTS: Final = tuple(Fault)


KEYS: Final = {SAMPLES: "seq", FRAMES: "t_us"}
"""By which the rows of a table are in order, and known again."""


def schema_of(header: Header, table: str) -> Any:
    """The Arrow schema of a table of that file."""
    fields = [
        pa.field(column.name, _TYPES[column.stored], metadata={COLUMN_KEY: msgspec.json.encode(column)})
        for column in table_columns(header.layout, table)
    ]
    return pa.schema(fields, metadata={HEADER_KEY: msgspec.json.encode(header), TABLE_KEY: table.encode()})


# ---- numbers ---------------------------------------------------------------------------------------------------------


def stored(column: Column, values: Doubles) -> tuple[NDArray[Any], Flags]:
    """Numbers (n,) as the column stores them, and where there is one.

    None: the value is not known (nan), or no number of the column says it: of an exact column, not to the last bit.
    """
    if column.stored is Stored.FLOAT64_BITS:
        return values.view(np.int64), np.ones(len(values), dtype=np.bool_)
    with np.errstate(invalid="ignore", over="ignore"):
        raw = (values / column.factor - column.offset) / column.scale
        if column.stored in (Stored.FLOAT32, Stored.FLOAT64):
            numbers: NDArray[Any] = raw.astype(column.stored.value)
            is_there = np.isfinite(raw)
        else:
            limits = np.iinfo(column.stored.value)
            raw = np.rint(raw)
            is_there = (raw >= limits.min) & (raw <= limits.max)
            numbers = np.where(is_there, raw, 0.0).astype(column.stored.value)
    if column.is_exact:
        is_there &= restored(column, numbers).view(np.int64) == values.view(np.int64)
    return numbers, is_there


def restored(column: Column, numbers: NDArray[Any]) -> Doubles:
    """Values (n,) of the numbers of a column: the operations of the register codec, in its order, so to the last
    bit.
    """
    if column.stored is Stored.FLOAT64_BITS:
        return numbers.astype(np.int64).view(np.float64)
    values: Doubles = (numbers.astype(np.float64) * column.scale + column.offset) * column.factor
    return values


def _array(column: Column, numbers: NDArray[Any], is_there: Flags) -> Any:
    return pa.array(numbers, type=_TYPES[column.stored], mask=~is_there)


# ---- rows ------------------------------------------------------------------------------------------------------------


class SampleRows:
    """Rows of ``samples`` that wait to be written."""

    def __init__(self, header: Header) -> None:
        self.schema = schema_of(header, SAMPLES)
        self._layout = header.layout
        self.clear()

    def clear(self) -> None:
        """Forget them: they are written, or lost."""
        self._calls: list[str] = []
        self._seqs: list[int] = []
        self._offsets_us: list[int] = []
        self._devices: list[str | None] = []
        self._times_s: list[float] = []
        self._faults: list[str | None] = []
        self._records: list[bytes | None] = []
        self._places: list[list[int]] = [[] for _ in self._layout.devices]
        self._values: list[list[bytes]] = [[] for _ in self._layout.devices]

    def __len__(self) -> int:
        return len(self._calls)

    def push_sample(self, body: bytes, offset_s: float) -> None:
        """A poll.

        Raises:
            messages.MessageError: it is of a device that the header does not have.
        """
        number, seq, fault, t_s = messages.SAMPLE.unpack_from(body)
        values = body[messages.SAMPLE.size :]
        devices = self._layout.devices
        if number >= len(devices) or len(values) != 8 * len(devices[number].columns) or fault >= len(_FAULTS):
            raise messages.MessageError(f"a sample of device {number}, {len(values)} bytes: not of this header")
        self._places[number].append(len(self._calls))
        self._values[number].append(values)
        name = _FAULTS[fault].value if fault else None
        self._push("poll", seq, offset_s, devices[number].name, t_s, name, None)

    def push_call(self, body: bytes, offset_s: float) -> None:
        """Any other call.

        Raises:
            messages.MessageError: there is none such.
        """
        seq, number, t_s = messages.CALL.unpack_from(body)
        if number >= len(CALLS):
            raise messages.MessageError(f"a call of number {number}: not from this daemon")
        record = body[messages.CALL.size :]
        self._push(CALLS[number].value, seq, offset_s, None, t_s, None, record or None)

    def _push(
        self,
        call: str,
        seq: int,
        offset_s: float,
        device: str | None,
        t_s: float,
        fault: str | None,
        record: bytes | None,
    ) -> None:
        self._calls.append(call)
        self._seqs.append(seq)
        self._offsets_us.append(round(1e6 * offset_s))
        self._devices.append(device)
        self._times_s.append(t_s)
        self._faults.append(fault)
        self._records.append(record)

    def batch(self) -> Any:
        """All of them as a batch of Arrow."""
        n = len(self)
        times = np.array(self._times_s)
        arrays = [
            pa.array(self._calls, pa.string()),
            pa.array(self._seqs, pa.int64()),
            pa.array(self._offsets_us, pa.int64()),
            pa.array(self._devices, pa.string()),
            pa.array(times.view(np.int64), mask=np.isnan(times)),
            pa.array(self._faults, pa.string()),
        ]
        for device, places, values in zip(self._layout.devices, self._places, self._values, strict=True):
            found = np.frombuffer(b"".join(values)).reshape(len(places), len(device.columns))
            for column, one in zip(device.columns, found.T, strict=True):
                whole = np.full(n, np.nan)
                whole[places] = one
                numbers, is_there = stored(column, whole)
                arrays.append(_array(column, numbers, is_there))
                if column.is_exact:
                    arrays.append(pa.array(whole, mask=is_there | np.isnan(whole)))
        arrays.append(pa.array(self._records, pa.binary()))
        return pa.RecordBatch.from_arrays(arrays, schema=self.schema)


class FrameRows:
    """Rows of ``frames`` that wait to be written."""

    def __init__(self, header: Header) -> None:
        self.schema = schema_of(header, FRAMES)
        self._layout = header.layout
        self._columns = table_columns(header.layout, FRAMES)
        self._lasting = {i for i, column in enumerate(header.layout.texts) if column.name in header.layout.lasting}
        self._said: list[str | None] = [None] * len(header.layout.texts)
        """Of the next frame."""
        self.clear()

    def clear(self) -> None:
        """Forget them: they are written, or lost."""
        self._rows: list[bytes] = []
        self._offsets_us: list[int] = []
        self._texts: list[list[str | None]] = [[] for _ in self._layout.texts]

    def __len__(self) -> int:
        return len(self._rows)

    def push_text(self, body: bytes) -> None:
        """What is said of the next frame.

        Raises:
            messages.MessageError: of a column that the header does not have.
        """
        if body[0] >= len(self._said):
            raise messages.MessageError(f"a text of column {body[0]}: not of this header")
        self._said[body[0]] = body[1:].decode("utf-8", "replace")

    def push(self, body: bytes, offset_s: float) -> None:
        """A frame.

        Raises:
            messages.MessageError: it has other numbers than the header says.
        """
        if len(body) != 8 * (1 + len(self._layout.numbers)):
            raise messages.MessageError(f"a frame of {len(body)} bytes: not of this header")
        self._rows.append(body)
        self._offsets_us.append(round(1e6 * offset_s))
        for i, text in enumerate(self._said):
            self._texts[i].append(text)
            if i not in self._lasting:
                self._said[i] = None

    def batch(self) -> Any:
        """All of them as a batch of Arrow."""
        found = np.frombuffer(b"".join(self._rows)).reshape(len(self._rows), -1)
        time, _, *rest = self._columns
        arrays = [_array(time, *stored(time, found[:, 0])), pa.array(self._offsets_us, pa.int64())]
        for column, one in zip(rest, found.T[1:], strict=False):
            arrays.append(_array(column, *stored(column, one)))
        arrays += [pa.array(texts, pa.string()) for texts in self._texts]
        return pa.RecordBatch.from_arrays(arrays, schema=self.schema)


# ---- and back --------------------------------------------------------------------------------------------------------


def header_of(schema: Any, table: str) -> Header | None:
    """Who a file is of; None: it is no such table of ours.

    Raises:
        ValueError: it is of a later format, or its columns are not those that it says.
    """
    metadata = schema.metadata or {}
    if metadata.get(TABLE_KEY) != table.encode() or HEADER_KEY not in metadata:
        return None
    try:
        version = msgspec.json.decode(metadata[HEADER_KEY], type=_Version).format
        if version != 1:
            raise ValueError(f"is of format {version}, this release reads 1: use a newer heaved")
        header = msgspec.json.decode(metadata[HEADER_KEY], type=Header)
    except msgspec.MsgspecError as error:
        raise ValueError(f"says wrongly who it is of ({error}): it was written by something else") from error
    expected = schema_of(header, table)
    if schema.names != expected.names or schema.types != expected.types:
        raise ValueError("has other columns than it says: it was changed by something else")
    return header


class _Version(msgspec.Struct, frozen=True):
    format: int


def numbers_to_values(column: Column, array: Any) -> Doubles:
    """Values (n,) of an array of Arrow that is a column of numbers; nan where there is none."""
    is_null = array.is_null().to_numpy(zero_copy_only=False)
    filled = array.fill_null(0) if array.null_count else array
    values = restored(column, filled.to_numpy(zero_copy_only=False))
    if is_null.any():
        values = np.where(is_null, np.nan, values)
    return values


def samples_of(device_columns: Sequence[Column], prefix: str, batch: Any) -> list[Doubles]:
    """Values (n,) of each column of a device, to the last bit; nan where there is none."""
    found = []
    for column in device_columns:
        values = numbers_to_values(column, batch.column(f"{prefix}.{column.name}"))
        if column.is_exact:
            exact = batch.column(exact_name(f"{prefix}.{column.name}"))
            if exact.null_count < len(exact):
                beside = exact.fill_null(nan).to_numpy(zero_copy_only=False)
                values = np.where(exact.is_null().to_numpy(zero_copy_only=False), values, beside)
        found.append(values)
    return found

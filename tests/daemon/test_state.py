"""The state file: whole or not at all, and never a reason not to start."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import hashlib
import json
import math
import os
import socket
import stat
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from heaved.daemon.state import Memory, Saved, StateError, StateFile, state_directory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


class Learned(msgspec.Struct, frozen=True):
    lead_s: float
    weights: bytes
    periods_s: tuple[float, ...] = ()


LEARNED = Learned(lead_s=0.11, weights=bytes(range(256)) * 4, periods_s=(8.2, 5.5))
NEWER = Learned(lead_s=-0.2, weights=b"\0\xff", periods_s=(6.0,))


@pytest.fixture
def file(tmp_path: Path) -> StateFile[Learned]:
    return StateFile(tmp_path / "state" / "heaved", Learned)


@pytest.fixture
def full_disk(monkeypatch: pytest.MonkeyPatch) -> list[bool]:
    """fsync is where a full disk shows at the latest. Returns a switch."""
    is_full = [True]
    fsync = os.fsync

    def full(fd: int) -> None:
        if is_full[0]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(fd)

    monkeypatch.setattr("heaved.daemon.state.os.fsync", full)
    return is_full


def read(file: StateFile[Learned]) -> Saved[Learned]:
    saved = file.read()
    assert saved is not None
    return saved


# ---- file ------------------------------------------------------------------------------------------------------------


def test_round_trip(file: StateFile[Learned]) -> None:
    assert file.read() is None
    file.write(file.encode(LEARNED))
    assert read(file).state == LEARNED
    file.write(file.encode(NEWER))
    assert read(file).state == NEWER
    assert [path.name for path in file.path.parent.iterdir()] == ["state.json"]


def test_it_is_json_for_people(file: StateFile[Learned]) -> None:
    file.write(file.encode(LEARNED))
    content = json.loads(file.path.read_text())
    assert content["version"] == 3
    assert content["state"]["lead_s"] == 0.11


def test_a_full_disk_leaves_the_old_file_and_nothing_else(file: StateFile[Learned], full_disk: list[bool]) -> None:
    full_disk[0] = False
    file.write(file.encode(LEARNED))
    full_disk[0] = True
    with pytest.raises(OSError, match="No space left"):
        file.write(file.encode(NEWER))
    assert read(file).state == LEARNED
    assert [path.name for path in file.path.parent.iterdir()] == ["state.json"]


def flipped(content: bytes, place: int, value: int) -> bytes:
    damaged = bytearray(content)
    damaged[place % len(damaged)] ^= value
    return bytes(damaged)


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda _content: b"", "damaged"),
        (lambda content: content[:-20], "damaged"),
        (lambda content: content[: len(content) // 2], "damaged"),
        (lambda _content: bytes(4096), "damaged"),
        (lambda content: content.replace(b'"version":3', b'"version":1'), "version 1"),
        (lambda content: content.replace(b'"version":3', b'"version":4'), "version 4"),
        (lambda content: content.replace(b"0.11", b"0.12"), "checksum"),
        (lambda content: content.replace(b"0.11", b"1e999"), "checksum"),
        (lambda content: content.replace(b"0.11", b"NaN"), "damaged"),
        (lambda _content: b"[]", "damaged"),
        (lambda content: b"\xff\xfe" + content, "damaged"),
        (lambda _content: b"[" * 100_000, "damaged"),
    ],
)
def test_damage_is_seen(file: StateFile[Learned], damage: Callable[[bytes], bytes], reason: str) -> None:
    file.write(file.encode(LEARNED))
    file.path.write_bytes(damage(file.path.read_bytes()))
    with pytest.raises(StateError, match=reason):
        file.read()


def as_fifo(path: Path) -> None:
    os.mkfifo(path)


def as_directory(path: Path) -> None:
    path.mkdir()


def as_link(path: Path) -> None:
    other = path.with_name("other")
    other.write_bytes(StateFile.encode(LEARNED))
    path.symlink_to(other)


def as_link_to_zeros(path: Path) -> None:
    path.symlink_to("/dev/zero")


def as_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made, contextlib.chdir(path.parent):
        made.bind(path.name)


def as_endless(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(1 << 40)


ODD_FILES: dict[Callable[[Path], None], str] = {
    as_fifo: "no regular file",
    as_directory: "no regular file",
    as_link: "no regular file",
    as_link_to_zeros: "no regular file",
    as_socket: "no regular file",
    as_endless: "longer than 4 MiB",
}


@pytest.mark.parametrize("make", ODD_FILES)
async def test_what_is_no_file_of_ours_is_set_aside_at_once(
    memory: Memory[Learned], counted: list[str], make: Callable[[Path], None]
) -> None:
    """Nothing of it is waited for, and the next save is as always."""
    memory.file.prepare()
    make(memory.file.path)
    with capture_logs() as logs:
        await memory.restore(never_taken)
        await memory.save()
    assert counted == ["refused", "saved"]
    (line,) = logs
    assert ODD_FILES[make] in line["reason"]
    assert (memory.file.path.parent / Path(line["kept"]).name).exists()
    assert read(memory.file).state == LEARNED


def never_taken(state: Learned, age_s: float) -> None:
    raise AssertionError("there is nothing to take")


def test_only_its_owner_reads_it_whatever_the_umask(file: StateFile[Learned]) -> None:
    before = os.umask(0)
    try:
        file.write(file.encode(LEARNED))
    finally:
        os.umask(before)
    assert stat.S_IMODE(file.path.stat().st_mode) == 0o600


@pytest.mark.parametrize("make", [as_fifo, as_link])
def test_nothing_is_written_through_what_stands_at_the_temporary_name(
    file: StateFile[Learned], make: Callable[[Path], None]
) -> None:
    file.prepare()
    make(file.path.with_suffix(".tmp"))
    before = {path.name: path.read_bytes() for path in file.path.parent.iterdir() if path.is_file()}
    file.write(file.encode(NEWER))
    assert read(file).state == NEWER
    assert not os.path.lexists(file.path.with_suffix(".tmp"))
    for name, content in before.items():
        if name == "other":
            assert (file.path.parent / name).read_bytes() == content


def test_it_says_when_it_was_saved(file: StateFile[Learned]) -> None:
    file.write(file.encode(LEARNED, 1_767_225_600.25))
    assert json.loads(file.path.read_text())["saved"] == "2026-01-01T00:00:00.250+00:00"
    assert read(file).saved_s == 1_767_225_600.25
    file.path.write_bytes(file.path.read_bytes().replace(b"2026-01-01", b"2026-01-02"))
    with pytest.raises(StateError, match="checksum"):
        file.read()


def test_a_file_of_version_2_is_read_and_its_age_is_not_known(file: StateFile[Learned]) -> None:
    """As release 0.1.0 wrote it."""
    body = msgspec.json.encode(LEARNED)
    old = {"version": 2, "sha256": hashlib.sha256(body).hexdigest(), "state": msgspec.Raw(body)}
    file.prepare()
    file.path.write_bytes(msgspec.json.encode(old) + b"\n")
    assert read(file).state == LEARNED
    assert math.isnan(read(file).saved_s)


@given(place=st.integers(0, 10_000), value=st.integers(1, 255))
def test_one_wrong_byte_never_gives_another_state(
    tmp_path_factory: pytest.TempPathFactory, place: int, value: int
) -> None:
    file = StateFile(tmp_path_factory.getbasetemp(), Learned)
    file.path.write_bytes(flipped(file.encode(NEWER), place, value))
    with contextlib.suppress(StateError):
        assert read(file).state == NEWER  # White space at the end.


def test_a_state_of_another_release_is_damage_not_an_exception(file: StateFile[Learned]) -> None:
    class Older(msgspec.Struct):
        something: int

    file.write(file.encode(Older(3)))
    with pytest.raises(StateError, match="lead_s"):
        file.read()


@pytest.mark.parametrize(
    ("configured", "environment", "expected"),
    [
        ("/srv/heaved", {"STATE_DIRECTORY": "/var/lib/heaved"}, "/srv/heaved"),
        ("", {"STATE_DIRECTORY": "/var/lib/heaved"}, "/var/lib/heaved"),
        ("", {"STATE_DIRECTORY": "/var/lib/heaved:/var/lib/other"}, "/var/lib/heaved"),
        ("", {}, "/home/mate/.local/state/heaved"),
        ("~/state", {}, "/home/mate/state"),
    ],
)
def test_directory(
    monkeypatch: pytest.MonkeyPatch, configured: str, environment: dict[str, str], expected: str
) -> None:
    monkeypatch.setenv("HOME", "/home/mate")
    assert str(state_directory(configured, environment)) == expected


# ---- memory ----------------------------------------------------------------------------------------------------------


@pytest.fixture
def counted() -> list[str]:
    return []


@pytest.fixture
def memory(file: StateFile[Learned], counted: list[str]) -> Iterator[Memory[Learned]]:
    memory = Memory(file, lambda: LEARNED, count_save=counted.append, count_load=counted.append)
    yield memory
    memory.close()


async def test_saved_and_restored(memory: Memory[Learned], counted: list[str]) -> None:
    taken = []
    await memory.restore(lambda state, _age_s: taken.append(state))
    assert taken == []
    await memory.save()
    await memory.restore(lambda state, _age_s: taken.append(state))
    assert taken == [LEARNED]
    assert counted == ["absent", "saved", "restored"]


@pytest.mark.parametrize("content", [b"{", b'{"version":7}', b"\0" * 50])
async def test_a_useless_file_is_set_aside_counted_and_named(
    memory: Memory[Learned], counted: list[str], content: bytes
) -> None:
    memory.file.prepare()
    memory.file.path.write_bytes(content)
    taken = []
    with capture_logs() as logs:
        await memory.restore(lambda state, _age_s: taken.append(state))
    assert taken == []
    (line,) = logs
    assert line["log_level"] == "warning"
    assert line["file"] == str(memory.file.path)
    kept = memory.file.path.with_suffix(".corrupt")
    assert line["kept"] == str(kept)
    assert kept.read_bytes() == content
    assert counted == ["refused"]
    assert memory.file.read() is None


async def test_a_state_that_does_not_fit_is_set_aside(memory: Memory[Learned], counted: list[str]) -> None:
    memory.file.write(memory.file.encode(NEWER))

    def refuse(state: Learned, age_s: float) -> None:
        raise ValueError("20 weights, this network has 511")

    with capture_logs() as logs:
        await memory.restore(refuse)
    assert "this network has 511" in logs[0]["reason"]
    assert counted == ["refused"]
    assert memory.file.path.with_suffix(".corrupt").is_file()


async def test_a_full_disk_is_said_once_and_again_when_it_is_well(
    memory: Memory[Learned], counted: list[str], full_disk: list[bool]
) -> None:
    with capture_logs() as logs:
        for _ in range(100):
            await memory.save()
        full_disk[0] = False
        await memory.save()
        await memory.save()
    assert counted == ["failed"] * 100 + ["saved"] * 2
    assert [(line["log_level"], line["event"]) for line in logs] == [
        ("warning", "the state cannot be saved"),
        ("info", "the state is saved again"),
    ]
    assert logs[0]["reason"] == "No space left on device"
    assert logs[0]["file"] == str(memory.file.path)


async def test_a_directory_that_cannot_be_is_said_at_the_start(tmp_path: Path, counted: list[str]) -> None:
    (tmp_path / "a_file").write_text("")
    file = StateFile(tmp_path / "a_file" / "heaved", Learned)
    memory = Memory(file, lambda: LEARNED, count_save=counted.append, count_load=counted.append)
    with capture_logs() as logs:
        await memory.restore(lambda _state, _age_s: None)
        await memory.save()
        await memory.save()
    memory.close()
    assert [line["event"] for line in logs if line["log_level"] == "warning"].count("the state cannot be saved") == 1
    assert counted == ["refused", "failed", "failed"]


async def test_a_slow_disk_does_not_hold_the_loop(memory: Memory[Learned], monkeypatch: pytest.MonkeyPatch) -> None:
    disk = threading.Event()
    monkeypatch.setattr(memory.file, "write", lambda _content: disk.wait())
    saving = asyncio.create_task(memory.save())
    for _ in range(10):
        await asyncio.sleep(0)  # The loop turns while the disk does not.
    assert not saving.done()
    disk.set()
    await saving


NOW_S = 1_767_225_600.0


@pytest.mark.parametrize(
    ("saved_s", "age_s"),
    [(NOW_S - 12.5, 12.5), (NOW_S - 3e7, 3e7), (NOW_S + 3600.0, 0.0), (math.nan, math.nan)],
)
async def test_the_age_of_what_is_restored(
    file: StateFile[Learned], counted: list[str], saved_s: float, age_s: float
) -> None:
    file.write(file.encode(LEARNED, saved_s))
    memory = Memory(file, never_asked, count_save=counted.append, count_load=counted.append, realtime=lambda: NOW_S)
    taken = []
    await memory.restore(lambda state, age_s: taken.append((state, age_s)))
    memory.close()
    assert counted == ["restored"]
    ((state, found_s),) = taken
    assert state == LEARNED
    assert found_s == pytest.approx(age_s, nan_ok=True)


def never_asked() -> Learned:
    raise AssertionError("nothing is saved")


async def test_a_state_from_the_future_is_set_aside(file: StateFile[Learned], counted: list[str]) -> None:
    file.write(file.encode(LEARNED, NOW_S + 10 * 86400.0))
    memory = Memory(file, never_asked, count_save=counted.append, count_load=counted.append, realtime=lambda: NOW_S)
    with capture_logs() as logs:
        await memory.restore(never_taken)
    memory.close()
    assert counted == ["refused"]
    assert "10 days ahead of this machine's clock" in logs[0]["reason"]
    assert file.path.with_suffix(".corrupt").is_file()


async def test_numbers_that_cannot_be_are_set_aside(tmp_path: Path, counted: list[str]) -> None:
    def check(state: Learned) -> None:
        if not 0.0 < state.lead_s < 1.0:
            raise ValueError(f"lead {state.lead_s} s")

    file = StateFile(tmp_path, Learned, check)
    file.write(file.encode(NEWER))
    memory = Memory(file, never_asked, count_save=counted.append, count_load=counted.append)
    with capture_logs() as logs:
        await memory.restore(never_taken)
    memory.close()
    assert counted == ["refused"]
    assert logs[0]["reason"] == "holds nonsense: lead -0.2 s"
    assert logs[0]["kept"] == str(tmp_path / "state.corrupt")


async def test_nonsense_does_not_replace_what_is_there(tmp_path: Path, counted: list[str]) -> None:
    def check(state: Learned) -> None:
        if not math.isfinite(state.lead_s):
            raise ValueError(f"lead {state.lead_s} s")

    file = StateFile(tmp_path, Learned, check)
    file.write(file.encode(LEARNED))
    broken = msgspec.structs.replace(LEARNED, lead_s=math.nan)
    memory = Memory(file, lambda: broken, count_save=counted.append, count_load=counted.append)
    with capture_logs() as logs:
        await memory.save()
    memory.close()
    assert counted == ["failed"]
    assert logs[0]["reason"] == "lead nan s"
    assert read(file).state == LEARNED


@pytest.mark.parametrize("call", ["prepare", "read"])
async def test_a_disk_that_hangs_at_the_start_is_not_waited_for(
    file: StateFile[Learned], counted: list[str], monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    file.write(file.encode(LEARNED))
    disk = threading.Event()
    monkeypatch.setattr(file, call, disk.wait)
    memory = Memory(file, lambda: LEARNED, count_save=counted.append, count_load=counted.append, load_s=0.01)
    with capture_logs() as logs:
        await memory.restore(never_taken)
    disk.set()
    memory.close()
    assert counted == ["refused"]
    assert [line["event"] for line in logs] == ["saved state cannot be read: starting cold"]
    assert "has not answered" in logs[0]["reason"]


async def test_a_disk_that_hangs_later_is_said_once_and_saves_go_on_after_it(
    file: StateFile[Learned], counted: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    disk, written = threading.Event(), []

    def write(content: bytes) -> None:
        disk.wait()
        written.append(content)

    monkeypatch.setattr(file, "write", write)
    memory = Memory(file, lambda: LEARNED, count_save=counted.append, count_load=counted.append, save_s=0.01)
    with capture_logs() as logs:
        for _ in range(3):
            await memory.save()
        disk.set()
        assert memory._saving is not None
        await memory._saving
        await memory.save()
    memory.close()
    assert counted == ["failed"] * 3 + ["saved"]
    assert len(written) == 2  # The one that hung, and the last: none has piled up.
    assert [line["event"] for line in logs] == ["the state cannot be saved", "the state is saved again"]

"""A table at the end of a configuration: all else stays to the byte, and what would be refused is not written."""

from __future__ import annotations

import shutil
from typing import TYPE_CHECKING

import pytest

from heaved.cli import main
from heaved.config.read import data_directory, load
from heaved.setup.config_file import Addition, RefusedError, taken_names

if TYPE_CHECKING:
    from pathlib import Path

LASER = """\
# Found by heaved probe
[[device]]
name = "laser"
role = "laser"
link = "rtu:///dev/ttyUSB1?baudrate=57600&parity=E"
device_id = 1
profile = "baumer-om20"
rate_hz = 20.0  # the line carries 40
"""
IMU = """\
# The sensor on the pedestal; don't touch.

[[device]]
name = "imu"
role = "imu"
link = "tcp://127.0.0.1:502"
profile = "heaved-sim-imu"
rate_hz = 100.0

[stream]   # as ever
port = 5570
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "heaved.toml"
    file.write_text(IMU)
    return file


def test_it_is_put_at_the_end_and_all_else_stays(path: Path) -> None:
    path.chmod(0o640)
    with Addition(path, LASER) as addition:
        assert path.read_text() == IMU
        added = [line[1:] for line in addition.diff.splitlines()[2:] if line.startswith("+")]
        assert added == ["", *LASER.splitlines()]
        assert not [line for line in addition.diff.splitlines()[2:] if line.startswith("-")]
        addition.keep()
    assert path.read_text() == IMU + "\n" + LASER
    assert path.stat().st_mode & 0o777 == 0o640
    assert [device.name for device in load(path).device] == ["imu", "laser"]
    assert list(path.parent.iterdir()) == [path]


def test_what_is_not_kept_leaves_nothing_behind(path: Path) -> None:
    with Addition(path, LASER):
        pass
    assert path.read_text() == IMU
    assert list(path.parent.iterdir()) == [path]


def test_the_packaged_configuration_takes_one_more(tmp_path: Path) -> None:
    path = tmp_path / "heaved.toml"
    shutil.copy(data_directory() / "heaved.toml", path)
    assert taken_names(path) == {"imu", "laser"}
    more = LASER.replace('"laser"', '"imu2"').replace("ttyUSB1", "ttyUSB7").replace("baumer-om20", "heaved-sim-imu2")
    with Addition(path, more) as addition:
        addition.keep()
    assert len(load(path).device) == 3


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b"", LASER.encode()),
        (b"# no end", b"# no end\n\n" + LASER.encode()),
        (b"# dos\r\n", b"# dos\r\n\r\n" + LASER.encode().replace(b"\n", b"\r\n")),
        (b"\xef\xbb\xbf# mark\n", b"\xef\xbb\xbf# mark\n\n" + LASER.encode()),
    ],
)
def test_line_ends_and_marks_stay_as_they_are(tmp_path: Path, before: bytes, after: bytes) -> None:
    path = tmp_path / "it.toml"
    path.write_bytes(before)
    with Addition(path, LASER) as addition:
        addition.keep()
    assert path.read_bytes() == after


def test_a_file_that_is_not_there_is_begun(tmp_path: Path) -> None:
    path = tmp_path / "new.toml"
    assert taken_names(path) == ()
    with Addition(path, LASER) as addition:
        assert any("no heave" in remark for remark in addition.remarks)
        addition.keep()
    assert path.read_text() == LASER
    assert path.stat().st_mode & 0o777 == 0o644


def test_a_link_stays_a_link(path: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "etc"
    elsewhere.mkdir()
    link = elsewhere / "heaved.toml"
    link.symlink_to(path)
    with Addition(link, LASER) as addition:
        addition.keep()
    assert link.is_symlink()
    assert path.read_text().endswith(LASER)
    assert list(elsewhere.iterdir()) == [link]


def test_somebody_else_who_changes_the_file_meanwhile_is_heard(path: Path) -> None:
    with Addition(path, LASER) as addition:
        path.write_text(IMU + "# mine\n")
        with pytest.raises(RefusedError, match="has been changed meanwhile"):
            addition.keep()
    assert path.read_text() == IMU + "# mine\n"
    assert list(path.parent.iterdir()) == [path]


REFUSED = {
    "another of that name": LASER.replace('name = "laser"', 'name = "imu"'),
    "a second imu": LASER.replace('role = "laser"', 'role = "imu"').replace("baumer-om20", "heaved-sim-imu"),
    "a rate beyond the line": LASER.replace("20.0", "200.0").replace("57600", "9600"),
    "a key that is none": LASER + "colour = 3\n",
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_check_config_refuses_is_refused_in_its_words(
    name: str, path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(RefusedError) as refused:
        Addition(path, REFUSED[name])
    assert path.read_text() == IMU
    assert list(path.parent.iterdir()) == [path]
    path.write_text(IMU + "\n" + REFUSED[name])
    assert main(["check-config", str(path)]) == 78
    words = capsys.readouterr().err.strip()
    assert str(refused.value) == f"{words}\n{path}: was left alone"


@pytest.mark.parametrize("faulty", [IMU + "[[[\n", IMU.replace("5570", "99999"), IMU.replace("[[device]]", "[device]")])
def test_a_file_with_faults_of_its_own_is_left_alone(path: Path, faulty: str) -> None:
    path.write_text(faulty)
    with pytest.raises(RefusedError, match="has faults of its own and was left alone: mend them first"):
        Addition(path, LASER)
    assert path.read_text() == faulty
    assert taken_names(path) == ()


def test_places_where_nothing_can_be_written(tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match="nothing can be written into its directory"):
        Addition(tmp_path / "none" / "heaved.toml", LASER)
    with pytest.raises(RefusedError, match="cannot be read: Is a directory"):
        Addition(tmp_path, LASER)

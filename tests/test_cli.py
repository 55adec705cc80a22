"""The command line: what is printed where, exit codes, and that nothing a user can do wrong ends in a traceback."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from recorded_hours import Scribe, write_recording

from heaved import __version__
from heaved.cli import daemon as daemon_commands
from heaved.cli import main
from heaved.config.read import data_directory

if TYPE_CHECKING:
    from collections.abc import Iterator

COMMANDS = (
    "run",
    "demo",
    "status",
    "watch",
    "page",
    "wait",
    "check-config",
    "probe",
    "install-service",
    "manual",
    "replay",
    "export",
    "report",
    "sim",
)


@pytest.fixture
def closed_port() -> str:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return str(listener.getsockname()[1])


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "rec.csv"
    path.write_text("t_s,az_mps2\n" + "".join(f"{k / 20},9.8\n" for k in range(40)))
    return path


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A command as a process of its own; whatever happens, it is gone at the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "heaved", *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def lines_until(process: subprocess.Popen[str], start: str) -> list[str]:
    """Standard output up to the line that begins with ``start``."""
    assert process.stdout is not None
    lines: list[str] = []
    for line in process.stdout:
        lines.append(line.rstrip("\n"))
        if line.startswith(start):
            return lines
    raise AssertionError(f"ended without {start!r}: {lines} {process.communicate()[1]}")


# ---- in general ------------------------------------------------------------------------------------------------------


def test_version_and_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"heaved {__version__}\n"
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    assert all(re.search(rf"(?m)^  {command} ", out) for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--help"]) == 0
    assert f"Usage: heaved {command}" in capsys.readouterr().out


@pytest.mark.parametrize(
    "arguments",
    [
        ["nonsense"],
        ["status", "--nonsense"],
        ["status", "--json", "--check"],
        ["status", "--port", "0"],
        ["wait", "--timeout", "soon"],
        ["run", "--log-format", "xml"],
        ["demo", "--link", "carrier-pigeon"],
        ["replay"],
    ],
    ids=" ".join,
)
def test_a_wrong_command_line_is_no_monitoring_state(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 1
    assert "Error: " in capsys.readouterr().err


def test_light_commands_import_nothing_heavy(closed_port: str) -> None:
    script = (
        "import sys\nfrom heaved.cli import main\n"
        f"assert main(['status', '--port', '{closed_port}']) == 69\n"
        "heavy = {'numpy', 'scipy', 'aiohttp', 'pymodbus', 'torch', 'rich', 'asyncio'}\n"
        "sys.exit(', '.join(heavy & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert "Connection refused" in done.stderr
    assert done.returncode == 0, done.stderr


# ---- configuration ---------------------------------------------------------------------------------------------------


def test_check_config_says_what_it_found(capsys: pytest.CaptureFixture[str]) -> None:
    file = data_directory() / "sensors.toml"
    assert main(["check-config", str(file)]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0] == f"{file}: well"
    assert out[1] == "  imu (imu): tcp://127.0.0.1:15020 id 1, heaved-sim-imu at 100 Hz"
    assert len(out) == 3


def test_check_config_says_how_wide_a_sensor_is(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check-config", str(data_directory() / "heaved.toml")]) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[1].endswith("witmotion-wt901c485 at 100 Hz, bandwidth 20 Hz (a lag of about 10 ms)")
    assert len(out) == 3


@pytest.mark.parametrize(
    ("arguments", "gone", "code", "said"),
    [
        (["check-config", "heaved.toml"], "full stdout", 74, "standard output: cannot be written: No space left"),
        (["check-config", "heaved.toml"], "left stdout", 74, ""),
        (["status", "--check", "--port", "1"], "full stdout", 74, "standard output: cannot be written"),
        (["check-config", "absent.toml"], "full stderr", 78, ""),
        (["status", "--port", "1"], "left stderr", 69, ""),
    ],
)
def test_output_that_nobody_takes_is_no_traceback(
    tmp_path: Path, arguments: list[str], gone: str, code: int, said: str
) -> None:
    (tmp_path / "heaved.toml").write_text("")
    how, stream = gone.split()
    reading, left = os.pipe()
    os.close(reading)
    with Path("/dev/full").open("wb") as full:
        streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, stream: full if how == "full" else left}
        command = [sys.executable, "-m", "heaved", *arguments]
        done = subprocess.run(command, cwd=tmp_path, check=False, **streams)  # type: ignore[call-overload]
    os.close(left)
    assert done.returncode == code
    assert "Traceback" not in (done.stderr or b"").decode()
    assert said in (done.stderr or b"").decode()


def test_check_config_without_devices_says_what_is_missing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty.toml").touch()
    assert main(["check-config", str(tmp_path / "empty.toml")]) == 0
    assert 'no device of role "imu"' in capsys.readouterr().out


@pytest.mark.parametrize("command", [["check-config"], ["run", "--config"], ["replay", "x.csv", "--config"]])
def test_every_fault_of_a_configuration_is_named(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "bad.toml"
    file.write_text('[stream]\nport = "x"\n[heave]\nwindow = 3\n')
    assert main([*command, str(file)]) == 78
    shown = capsys.readouterr()
    lines = shown.err.splitlines()
    assert len(lines) == 2
    assert any(line.startswith(f"{file}: stream.port: Expected `int`") for line in lines)
    assert any(line.startswith(f"{file}: heave.window: unknown key") for line in lines)
    assert shown.out == ""


def test_check_config_refuses_rates_that_the_line_cannot_carry(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (data_directory() / "sensors.toml").read_text().replace("tcp://127.0.0.1:15020", "rtu:///dev/ttyUSB0")
    (tmp_path / "slow.toml").write_text(text)
    assert main(["check-config", str(tmp_path / "slow.toml")]) == 78
    assert "slow.toml: line /dev/ttyUSB0 (9600 8N1): imu at 100 Hz needs" in capsys.readouterr().err


def test_run_without_configuration_says_where_to_get_one(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(daemon_commands, "SYSTEM_CONFIG", tmp_path / "absent.toml")
    assert main(["run"]) == 78
    assert str(data_directory() / "heaved.toml") in capsys.readouterr().err


# ---- asking a daemon -------------------------------------------------------------------------------------------------


def test_without_a_daemon(closed_port: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", "--port", closed_port]) == 69
    shown = capsys.readouterr()
    assert shown.out == ""
    assert f"127.0.0.1:{closed_port}: Connection refused" in shown.err

    assert main(["status", "--check", "--port", closed_port]) == 2
    shown = capsys.readouterr()
    assert shown.err == ""
    assert re.fullmatch(r"CRITICAL - .*Connection refused.*\n", shown.out)

    assert main(["status", "--json", "--port", closed_port]) == 69
    assert json.loads(capsys.readouterr().out)["trouble"] == "refused"

    assert main(["wait", "--timeout", "0", "--port", closed_port]) == 69
    assert "Connection refused" in capsys.readouterr().err


def test_check_with_an_address_that_there_is_not_is_unknown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["status", "--check", "--host", "no-such-host.invalid"]) == 3
    assert capsys.readouterr().out.startswith("UNKNOWN - ")


def test_watch_needs_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch"]) == 1
    assert "nc 127.0.0.1 5570" in capsys.readouterr().err


def test_demo_tells_what_can_shake_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demo", "--shake", "quake", "--duration", "1"]) == 1
    assert "unknown shake 'quake': choose one of" in capsys.readouterr().err


@pytest.mark.parametrize("link", ["tcp", "rtu"])
def test_demo_is_the_whole_chain(link: str, capsys: pytest.CaptureFixture[str]) -> None:
    with running("demo", "--sea", "T3", "--link", link) as demo:
        lines = lines_until(demo, "http ")
        assert sum("simulated imu (imu): " + link in line for line in lines) == 1
        stream = next(line for line in lines if line.startswith("stream "))
        port = stream.rpartition(":")[2]
        with (
            socket.create_connection(("127.0.0.1", int(port)), timeout=10.0) as connection,
            connection.makefile() as file,
        ):
            records = [json.loads(file.readline()) for _ in range(200)]
        assert records[0]["class"] == "VERSION"
        assert any("roll_deg" in record for record in records), "no measurement reached the stream"
        assert main(["status", "--port", port]) == 0
        assert "imu" in capsys.readouterr().out
        assert main(["wait", "--timeout", "0.1", "--port", port]) == 1
        assert "heave settling" in capsys.readouterr().err
        assert main(["status", "--check", "--port", port]) == 1
        if link == "tcp":  # The winch knows nothing of the link, and says something every five seconds only.
            assert lines_until(demo, "hook motion")[-1] == "hook motion: settling"
        demo.send_signal(signal.SIGTERM)
        _, errors = demo.communicate(timeout=30)
        assert demo.returncode == 0, errors
        assert "Traceback" not in errors


# ---- recordings ------------------------------------------------------------------------------------------------------


def test_replay_writes_beside_the_recording(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(recording)]) == 0
    out = recording.with_name("rec.heaved.csv")
    assert out.read_text().startswith("t_s,heave_m,")
    assert len(out.read_text().splitlines()) == 41
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("40 rows, 1.9 s of motion in ")
    assert shown.err.endswith(f"written to {out}\n")


def test_replay_to_standard_output_and_until(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(recording), "-o", "-", "--until", "1"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 1 + 21
    assert list(recording.parent.iterdir()) == [recording]


@pytest.mark.parametrize("rows", [40, 4000], ids=["less than a buffer", "more"])
def test_replay_to_a_reader_that_goes_away_is_said_in_one_line(tmp_path: Path, rows: int) -> None:
    path = tmp_path / "rec.csv"
    path.write_text("t_s,az_mps2\n" + "".join(f"{k / 20},9.8\n" for k in range(rows)))
    command = [sys.executable, "-m", "heaved", "replay", str(path), "-o", "-"]
    ours, theirs = os.pipe()
    os.close(ours)
    result = subprocess.run(command, stdout=theirs, stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    os.close(theirs)
    assert (result.returncode, result.stderr) == (1, "standard output: cannot be written: Broken pipe\n")


def test_a_recording_of_a_daemon_is_replayed_and_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    directory = tmp_path / "recordings"
    write_recording(directory, Scribe(tmp_path), 3)
    assert main(["replay", str(directory)]) == 0
    said = capsys.readouterr().err
    assert "300 frames" in said
    assert f"written to {tmp_path / 'recordings.heaved.csv'}" in said
    assert main(["export", str(directory), "-o", str(tmp_path / "out.nc"), "--every", "1", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert (told["vessel"], told["rows"], told["out"]) == ("Test", 3, str(tmp_path / "out.nc"))
    assert main(["export", str(directory), "-o", "-", "--columns", "heave_m"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert (lines[0], len(lines)) == ("t_s,time,heave_m", 301)
    assert main(["export", str(tmp_path / "nowhere"), "-o", str(tmp_path / "out.csv")]) == 1
    assert "there is no such file or directory" in capsys.readouterr().err
    (tmp_path / "some.csv").write_text("t_s,az_mps2\n")
    assert main(["export", str(tmp_path / "some.csv"), "-o", str(tmp_path / "out.csv")]) == 1
    assert "made by heaved replay" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    for command in (["replay", str(tmp_path / "empty")], ["export", str(tmp_path / "empty"), "-o", "x.csv"]):
        assert main(command) == 1
        assert "holds no recording" in capsys.readouterr().err


def test_replay_of_what_is_no_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(tmp_path / "absent.csv")]) == 1
    assert "absent.csv: cannot be read: No such file or directory" in capsys.readouterr().err
    (tmp_path / "bad.csv").write_text("t_s,az_g\n")
    assert main(["replay", str(tmp_path / "bad.csv")]) == 1
    assert "bad.csv, line 1, column az_g: unknown column; did you mean az_mps2?" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["bad.csv"]


# ---- simulation ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--sea", "S9"], "unknown sea 'S9': choose one of"),
        (["--sensor", "Z"], "unknown sensor 'Z': choose one of"),
        (["--shake", "quake"], "unknown shake 'quake': choose one of line-1.3, line-3.1,"),
        (["--fault", "laser:boom@1+1"], "unknown kind 'boom'; choose one of"),
        (["--fault", "sonar:dropout@1+1"], "there is no device 'sonar'; there are crane, imu, laser"),
        (["--play", "/nonexistent.csv"], "/nonexistent.csv: No such file or directory"),
    ],
    ids=lambda value: "".join(value)[:20],
)
def test_what_cannot_be_simulated(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sim", *arguments]) == 1
    assert message in capsys.readouterr().err


def test_sim_on_a_port_that_is_taken_says_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        config = tmp_path / "sim.toml"
        demo = (data_directory() / "sensors.toml").read_text()
        config.write_text(demo.replace(":15020", f":{taken.getsockname()[1]}"))
        assert main(["sim", "--config", str(config)]) == 1
    error = capsys.readouterr().err
    assert "address already in use; stop what serves there" in error


def test_sim_serves_until_it_is_told_to_stop() -> None:
    with running("sim", "--link", "rtu", "--fault", "imu:dropout@1+1", "--fault", "laser:late@2+1=50") as sim:
        line = lines_until(sim, "laser ")[-1]
        path = line.split("rtu://")[1].split("?")[0]
        assert Path(path).is_symlink()
        sim.send_signal(signal.SIGINT)
        _, errors = sim.communicate(timeout=30)
    assert sim.returncode == 0, errors
    assert errors == ""
    assert not os.path.lexists(path)


@pytest.mark.parametrize("term", ["dumb", "unknown"])
def test_watch_says_that_a_terminal_cannot_draw(
    term: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TERM", term)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    assert main(["watch"]) == 1
    assert "read the stream: nc 127.0.0.1 5570" in capsys.readouterr().err


# ---- the page --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--host", "0.0.0.0"], "--host 0.0.0.0 can be reached from other machines: name the networks"),
        (["--allow", "everybody"], "--allow: 'everybody' is not a network such as 192.168.10.0/24"),
        (["--host", "192.0.2.1", "--allow", "192.0.2.0/24"], "cannot listen on 192.0.2.1:8570: "),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_page_that_cannot_be_served_says_why(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["page", *arguments]) == 1
    assert capsys.readouterr().err.startswith(said)


def test_a_page_is_served_until_it_is_ended(closed_port: str) -> None:
    with running("page", "--port", closed_port) as process:
        assert lines_until(process, "page ") == [f"page http://127.0.0.1:{closed_port}/"]
        process.send_signal(signal.SIGTERM)
        out, err = process.communicate()
        assert (process.returncode, out) == (0, "")
        assert "Traceback" not in err

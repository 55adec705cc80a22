"""The whole calibration, with a person that is a list of answers and a sensor that is a list of records."""

from __future__ import annotations

import io
import json
import socket
import threading
import tomllib
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
from askew import lifted, off_deg, read, without_angles, without_rates

from heaved.cli import main
from heaved.config.read import load
from heaved.setup import calibrate_state, edit
from heaved.setup.calibrate import Calibration, CalibrationError, Guide, Outcome, from_recording, parse_list
from heaved.setup.calibrate_live import DeviceError, busy
from heaved.setup.calibrate_signs import Lift
from heaved.setup.console import Console, QuitError
from heaved.simulate.gauge import Gauge
from heaved.simulate.play import write_recording
from heaved.simulate.seaway import seaway
from heaved.simulate.sensors import record as recorded

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from heaved.setup.calibrate_record import Record

MOUNT = (170.0, 10.0, 40.0)
TEXT = """# The vessel
[[device]]
name = "imu"
role = "imu"
link = "tcp://127.0.0.1:15020"
profile = "heaved-sim-imu"
rate_hz = 20.0   # as the maker says
#rotation_deg = [0.0, 0.0, 0.0]        # degrees

# the gauge
[[device]]
name = "laser"
role = "laser"
link = "tcp://127.0.0.1:15021"
profile = "heaved-sim-laser"
rate_hz = 20.0

# ---- estimation
[laser]
sign = 1   # looks down
"""


def at_rest() -> Record:
    return read(MOUNT, sea="S0", seconds=20.0, model="AHRS")


def bow_up() -> Record:
    return read(MOUNT, sea="S0", seconds=20.0, model="AHRS", tilt=(0.0, 8.0))


def at_sea() -> Record:
    return read(MOUNT, model="AHRS", seed=2, gauge=Gauge(beam=(0.0, 0.0, 1.0)))


class Person:
    """Types one answer after the other, then nothing more."""

    def __init__(self, *answers: str) -> None:
        self._answers = list(answers)
        self.lines: list[str] = []

    def console(self) -> Console:
        return Console(self.lines.append, self.ask)

    def ask(self, prompt: str) -> str:
        self.lines.append(prompt)
        if not self._answers:
            raise EOFError
        return self._answers.pop(0)

    @property
    def heard(self) -> str:
        return " ".join("\n".join(self.lines).split())


class Sensor:
    """Gives its records one after the other; an exception among them is raised."""

    def __init__(self, *records: Record | Exception) -> None:
        self._records = list(records)
        self.asked_s: list[float] = []

    def __call__(
        self, devices: object, seconds: float, progress: Callable[[float], None], waiting: Callable[[str], None]
    ) -> Record:
        self.asked_s.append(seconds)
        progress(seconds)
        made = self._records.pop(0)
        if isinstance(made, Exception):
            raise made
        return made


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "heaved.toml"
    file.write_text(TEXT)
    return file


def calibration(path: Path, person: Person) -> Calibration:
    return Calibration(path, load(path), person.console(), text=edit.read_text(path))


def guided(path: Path, person: Person, sensor: Sensor) -> Outcome:
    return Guide(calibration(path, person), sensor).run()


def test_a_new_user_goes_through_all_of_it(path: Path) -> None:
    person = Person("", "", "s", "1", "", "", "", "", "y")
    sensor = Sensor(at_rest(), bow_up(), at_sea())
    outcome = guided(path, person, sensor)
    assert sensor.asked_s == [20.0, 20.0, 300.0]
    assert outcome.written
    imu, _ = tomllib.loads(path.read_text())["device"]
    assert off_deg(tuple(imu["rotation_deg"]), MOUNT) < 0.05
    assert imu["attitude_latency_ms"] == pytest.approx(40.0, abs=12.0)
    assert max(map(abs, imu["bias_mps2"])) == pytest.approx(0.04, abs=0.02)
    assert load(path).laser.sign == -1
    text = path.read_text()
    for kept in (
        "# The vessel",
        "# as the maker says",
        "# degrees",
        "# the gauge",
        "# ---- estimation",
        "# looks down",
    ):
        assert kept in text
    assert not calibrate_state.state_path(path).exists()
    assert "+sign = -1 # looks down" in person.heard
    assert all(len(line) < 80 for line in person.lines if not line.startswith(("+", "-", "@", "[")))
    assert "\x1b" not in "".join(person.lines)


def test_an_interrupted_calibration_goes_on_where_it_was(path: Path) -> None:
    with pytest.raises(QuitError):
        guided(path, Person("", "", "s", "1", "q"), Sensor(at_rest(), bow_up()))
    assert path.read_text() == TEXT
    person = Person("", "", "1", "", "s", "s", "n")
    outcome = guided(path, person, Sensor(bow_up()))
    assert "has kept a moment ago: rest, signs (skipped)" in person.heard
    assert not outcome.written
    assert path.read_text() == TEXT
    again = Person("", "", "", "", "", "y")
    assert guided(path, again, Sensor()).written
    assert off_deg(tuple(tomllib.loads(path.read_text())["device"][0]["rotation_deg"]), MOUNT) < 0.05


def test_wrong_keys_failures_and_repeats_lose_nothing(path: Path) -> None:
    rough = read(MOUNT, sea="S6S", seconds=60.0)
    person = Person(
        "what", "99,0", "x,y", "",  # no list, too much list, no list, begin
        "", "",  # unplugged: repeat, begin
        "", "0.0,0.0",  # shaken: repeat, begin
        "r", "",  # kept not yet: repeat, begin
        "zzz", "",  # no such key, keep
        "s", "s", "s", "s", "y",
    )  # fmt: skip
    sensor = Sensor(DeviceError("imu: unplugged"), rough, rough, at_rest(), at_rest())
    outcome = guided(path, person, sensor)
    assert outcome.written
    for said in (
        "'what' is not understood", "no vessel is calibrated at more than 20 degrees", "Nothing came of it: imu: un",
        "It moves: 300 s are averaged", "make a longer record", "'zzz' is none of these",
    ):  # fmt: skip
        assert said in person.heard
    found = tomllib.loads(path.read_text())["device"][0]["rotation_deg"]
    assert found == pytest.approx([170.0, 10.0, 0.0], abs=0.02)


def test_more_of_a_record_is_added_to_it(path: Path) -> None:
    short = at_sea()
    later = read(MOUNT, model="AHRS", seed=3)
    later = msgspec.structs.replace(later, t_s=later.t_s + 400.0, laser_t_s=later.laser_t_s + 400.0)
    person = Person("s", "s", "", "m", "", "", "s", "n")
    outcome = guided(path, person, Sensor(short, later))
    assert outcome.found.latency is not None
    assert outcome.found.latency.seconds > 590.0


def test_two_tilts_that_are_too_alike_can_be_done_again(path: Path) -> None:
    person = Person("", "", "s", "1", "", "1", "", "s", "s", "n")
    outcome = guided(path, person, Sensor(at_rest(), at_rest(), bow_up()))
    assert "too alike to show how far it is turned about the vertical" in person.heard
    assert outcome.found.turned is not None
    assert off_deg(outcome.found.turned.rotation_deg, MOUNT) < 0.05


def test_a_wrong_sign_ends_it_with_what_to_correct(path: Path) -> None:
    wrong = lifted(Lift.PORT_UP)
    wrong = msgspec.structs.replace(wrong, angles_rad=-wrong.angles_rad)
    person = Person("s", "", "", "", "")
    with pytest.raises(QuitError):
        guided(path, person, Sensor(wrong, lifted(Lift.BOW_UP)))
    assert "Correct roll_rad in the profile heaved-sim-imu (sign = -1" in person.heard


def test_a_sensor_without_angles_is_told_what_stays_unknown(path: Path) -> None:
    person = Person("", "", "s", "s", "", "s", "s", "n")
    outcome = guided(path, person, Sensor(without_angles(at_rest()), without_angles(at_sea())))
    assert "0.18 degrees in either direction" in person.heard
    assert "Nothing came of it: the sensor has no roll and pitch" in person.heard
    assert outcome.found.latency is None
    assert any("only the bias along the vertical" in note for note in outcome.notes)


def test_a_record_that_shows_nothing_of_the_angles_still_shows_the_laser(path: Path) -> None:
    person = Person("", "", "s", "s", "", "s", "", "n")
    outcome = guided(path, person, Sensor(at_rest(), without_rates(at_sea())))
    assert "gyroscopes" in person.heard
    assert "The record of the latency serves for it" in person.heard
    assert outcome.found.latency is None
    assert outcome.found.laser is not None
    assert outcome.found.laser.geometry.sign == -1
    assert "the place is wrong by metres" in person.heard


def test_nobody_at_the_keyboard_ends_it(path: Path) -> None:
    with pytest.raises(QuitError):
        guided(path, Person(), Sensor())
    assert path.read_text() == TEXT


SPOILED: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "no progress": (lambda _: b"\xc1", "is no progress of a calibration"),
    "cut off": (lambda data: data[:40], "is no progress of a calibration"),
}


@pytest.mark.parametrize(("spoil", "reason"), list(SPOILED.values()), ids=list(SPOILED))
def test_progress_that_cannot_be_read_is_begun_anew(path: Path, spoil: Callable[[bytes], bytes], reason: str) -> None:
    with pytest.raises(QuitError):
        guided(path, Person("", "", "q"), Sensor(at_rest()))
    state = calibrate_state.state_path(path)
    state.write_bytes(spoil(state.read_bytes()))
    person = Person("q")
    with pytest.raises(QuitError):
        guided(path, person, Sensor())
    assert reason in person.heard
    assert "beginning anew" in person.heard


def test_progress_of_a_sensor_that_is_read_otherwise_now_is_not_used(path: Path) -> None:
    with pytest.raises(QuitError):
        guided(path, Person("", "", "q"), Sensor(at_rest()))
    path.write_text(TEXT.replace('"heaved-sim-imu"', '"witmotion-hwt905-485"'))
    person = Person("q")
    with pytest.raises(QuitError):
        guided(path, person, Sensor())
    assert "name or profile have changed since" in person.heard


def test_a_file_that_somebody_edits_meanwhile_is_left_alone(path: Path) -> None:
    class Editor(Person):
        def ask(self, prompt: str) -> str:
            if "write it" in prompt:
                path.write_text(TEXT + "# mine\n")
            return super().ask(prompt)

    with pytest.raises(CalibrationError, match="changed by somebody else meanwhile"):
        guided(path, Editor("", "", "s", "s", "s", "s", "y"), Sensor(at_rest()))
    assert path.read_text() == TEXT + "# mine\n"
    assert calibrate_state.state_path(path).exists()


def test_a_bias_that_is_none_is_not_written(path: Path) -> None:
    record = at_rest()
    record = msgspec.structs.replace(record, force_mps2=record.force_mps2 * 1.08)
    person = Person("", "", "s", "s", "s", "s", "y")
    guided(path, person, Sensor(record))
    assert "that is no bias: a sign, a unit or the scale" in person.heard
    assert "bias_mps2" not in path.read_text()


def test_lists_are_read() -> None:
    assert parse_list("0.5,-0.25") == (0.5, -0.25)
    for text in ("1", "a,b", "1,2,3", "30,0", "nan,0"):
        with pytest.raises(ValueError, match=text.split(",", maxsplit=1)[0]):
            parse_list(text)


# ---- from a recording, on the command line ---------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("recording") / "sea.csv"
    write_recording(file, recorded(seaway("S4", 2), 300.0, sensor="A", laser="on", seed=2))
    return file


def test_a_recording_is_enough_for_what_needs_nobody_on_board(
    path: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "--config", str(path), "--recording", str(recording), "--yes", "--json"]) == 0
    printed = capsys.readouterr()
    outcome: dict[str, Any] = json.loads(printed.out)
    assert outcome["written"]
    assert outcome["found"]["latency"]["late_s"] == pytest.approx(0.0, abs=0.003)
    assert max(abs(angle) for angle in tomllib.loads(path.read_text())["device"][0].get("rotation_deg", [0])) <= 0.02
    assert [round(abs(part), 2) for part in load(path).device[0].bias_mps2] == [0.03, 0.03, 0.03]
    assert "how far it is turned about the vertical" in printed.err
    assert load(path).laser.sign == 1


def test_what_was_recorded_with_a_mounting_gives_that_mounting_again(path: Path, recording: Path) -> None:
    path.write_text(TEXT.replace("#rotation_deg = [0.0, 0.0, 0.0] ", "rotation_deg = [170.0, 10.0, 40.0]"))
    assert main(["calibrate", "--config", str(path), "--recording", str(recording), "--yes"]) == 0
    assert off_deg(load(path).device[0].rotation_deg, MOUNT) < 0.05


def test_without_yes_a_person_is_asked(path: Path, recording: Path) -> None:
    from heaved.setup.calibrate_record import read_record

    made = read_record(recording, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert not from_recording(calibration(path, Person("n")), made, (0.0, 0.0), is_sure=False).written
    assert path.read_text() == TEXT


WRONG: list[tuple[str, list[str], int, str]] = [
    ("yes alone", ["--yes"], 1, "--yes: without a recording"),
    ("no such recording", ["--recording", "nowhere.csv", "--yes"], 1, "nowhere.csv"),
    ("no list", ["--recording", "{recording}", "--yes", "--list", "five"], 1, "'five' is not understood"),
]


@pytest.mark.parametrize(("options", "code", "said"), [row[1:] for row in WRONG], ids=[row[0] for row in WRONG])
def test_what_cannot_be_done_is_said(
    path: Path, recording: Path, options: list[str], code: int, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [option.format(recording=recording) for option in options]
    assert main(["calibrate", "--config", str(path), *options]) == code
    assert said in capsys.readouterr().err
    assert path.read_text() == TEXT


def test_a_configuration_without_an_imu_has_nothing_to_calibrate(
    path: Path, recording: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path.write_text("[laser]\nsign = 1\n")
    assert main(["calibrate", "--config", str(path), "--recording", str(recording), "--yes"]) == 78
    assert 'no device of role "imu"' in capsys.readouterr().err


def test_a_daemon_that_runs_has_the_devices(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        path.write_text(TEXT + f"[stream]\nport = {server.getsockname()[1]}\n")

        def greet() -> None:
            connection, _ = server.accept()
            with connection:
                connection.sendall(b'{"class":"VERSION","release":"0.1.0"}\n')

        thread = threading.Thread(target=greet)
        thread.start()
        assert main(["calibrate", "--config", str(path)]) == 69
        thread.join()
    assert "systemctl stop heaved" in capsys.readouterr().err
    assert busy(load(path)) == ""


class Keyboard(io.StringIO):
    """What is typed; then Ctrl-C."""

    def readline(self, *size: int) -> str:  # type: ignore[override]
        line = super().readline()
        if not line:
            raise KeyboardInterrupt
        return line


def test_quit_and_control_c_say_what_is_kept(
    path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path.write_text(TEXT + "[stream]\nport = 1\n")
    monkeypatch.setattr("sys.stdin", Keyboard("q\n"))
    assert main(["calibrate", "--config", str(path)]) == 0
    printed = capsys.readouterr()
    assert "Step 1 of 5: rest" in printed.out
    assert "stopped; nothing was kept yet; the configuration is as it was" in printed.err
    monkeypatch.setattr("sys.stdin", Keyboard("s\n"))
    assert main(["calibrate", "--config", str(path)]) == 130
    assert f"kept in {path}.calibration: run the command again" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin", Keyboard("s\n" * 4 + "s\n"))
    assert main(["calibrate", "--config", str(path), "--anew", "--json"]) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["changes"] == {}
    assert "Nothing in the configuration changes" in printed.err
    assert not calibrate_state.state_path(path).exists()


def test_what_could_not_be_written_in_the_end_is_said_at_once(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    person = Person()
    with monkeypatch.context() as patched:
        patched.setattr("os.access", lambda *_: False)
        with pytest.raises(CalibrationError, match="you may not write there"):
            guided(path, person, Sensor())
    device = 'name = "imu", role = "imu", link = "tcp://h:1", profile = "heaved-sim-imu", rate_hz = 20'
    path.write_text(f"device = [{{ {device} }}]\n")
    with pytest.raises(CalibrationError, match="as a table of its own"):
        calibration(path, person)


def test_how_old_is_what_was_kept(path: Path) -> None:
    kept_s = path.stat().st_mtime
    for seconds, words in ((5.0, "a moment ago"), (600.0, "10 minutes ago"), (1e4, "3 hours ago"), (3e5, "3 days ago")):
        assert calibrate_state.age(path, kept_s + seconds) == words

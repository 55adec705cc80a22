"""heaved install-service: what is put where, what is left alone, and what systemd and udev make of it."""

from __future__ import annotations

import re
import shutil
import subprocess
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from heaved.cli import main
from heaved.config.read import data_directory, load
from heaved.setup import service, udev, unit
from heaved.setup.adapters import Adapter

if TYPE_CHECKING:
    from collections.abc import Sequence

PROGRAM = Path("/opt/heaved/bin/heaved")
SHIPPED = Path(__file__).resolve().parents[2] / "systemd" / "heaved.service"
IMU = """
[[device]]
name = "imu"
role = "imu"
link = "{link}"
profile = "witmotion-wt901c485"
rate_hz = 20.0
"""
TLS = '[tls]\ncertificate_file = "/c"\nkey_file = "/etc/heaved/server.key"\nclient_ca_file = "/a"'
USB = "rtu:///dev/ttyUSB0?baudrate=115200"
FTDI = Adapter(
    path="/dev/ttyUSB0",
    stable_path="/dev/ttyUSB0",
    name="USB RS485",
    serial_number="A50285BI",
    usb_id="0403:6001",
    socket="1-1.2",
)


def written(directory: Path, text: str) -> Path:
    path = directory / "mine.toml"
    path.write_text(text)
    return path


@pytest.fixture
def root(tmp_path: Path) -> Path:
    path = tmp_path / "root"
    path.mkdir()
    return path


def install(root: Path, source: Path | None = None, plugged: Sequence[Adapter] = ()) -> tuple[service.Plan, list[str]]:
    wanted = service.plan(source=source, root=root, program=PROGRAM, plugged=plugged)
    return wanted, service.write(wanted, root, lambda _: None)


def files(root: Path) -> dict[str, str]:
    return {f"/{path.relative_to(root)}": path.read_text() for path in root.rglob("*") if path.is_file()}


# ---- the files -------------------------------------------------------------------------------------------------------


def test_what_ships_is_installed_with_its_program(root: Path) -> None:
    install(root)
    made = files(root)
    assert made[str(service.CONFIG)] == (data_directory() / "heaved.toml").read_text()
    assert made[str(service.UNIT)].endswith(SHIPPED.read_text())
    assert set(made) == {str(service.CONFIG), str(service.UNIT), str(service.DROP_IN)}
    assert all(path.stat().st_mode & 0o777 == 0o644 for path in root.rglob("*") if path.is_file())


def test_the_program_that_is_named_is_run(root: Path) -> None:
    wanted = service.plan(source=None, root=root, program=Path("/srv/heaved/bin/heaved"), plugged=())
    service.write(wanted, root, lambda _: None)
    text = service.below(root, service.UNIT).read_text()
    assert "ExecStart=/srv/heaved/bin/heaved run --config /etc/heaved/heaved.toml\n" in text


def test_twice_is_once(root: Path, tmp_path: Path) -> None:
    source = written(tmp_path, IMU.format(link=USB))
    first, _ = install(root, source, [FTDI])
    before = files(root)
    again, done = install(root, source, [FTDI])
    assert files(root) == before
    assert all(line.endswith(": as it should be") for line in done)
    assert len(done) == len(first.files) - 1  # The configuration is not asked for again.
    assert not [note for note in again.notes if "differs" in note]


def test_a_configuration_that_is_there_is_never_overwritten(root: Path, tmp_path: Path) -> None:
    there = service.below(root, service.CONFIG)
    there.parent.mkdir(parents=True)
    there.write_text(text := IMU.format(link="tcp://10.0.0.1:502"))
    wanted, _ = install(root, written(tmp_path, IMU.format(link="tcp://10.0.0.2:502")))
    assert there.read_text() == text
    assert any("differs from" in note for note in wanted.notes)
    # It is the one that will run, so it is the one whose network is permitted.
    drop_in = service.below(root, service.DROP_IN).read_text()
    assert "IPAddressAllow=10.0.0.1\n" in drop_in
    assert "10.0.0.2" not in drop_in


def test_files_of_others_are_left_alone(root: Path) -> None:
    theirs = service.below(root, service.UNIT)
    theirs.parent.mkdir(parents=True)
    theirs.write_text("[Service]\nExecStart=/bin/true\n")
    wanted, _ = install(root)
    assert theirs.read_text() == "[Service]\nExecStart=/bin/true\n"
    assert f"{service.UNIT}: is there, and not made by this command: left as it is" in wanted.notes
    done = service.remove(root, lambda _: None)
    assert theirs.exists()
    assert f"{service.UNIT}: not made by this command: left as it is" in done


def test_a_package_has_brought_the_unit(root: Path) -> None:
    packaged = service.below(root, service.PACKAGED_UNITS[0])
    packaged.parent.mkdir(parents=True)
    packaged.write_text(SHIPPED.read_text())
    install(root)
    assert not service.below(root, service.UNIT).exists()
    assert service.below(root, service.DROP_IN).exists()


def test_a_profile_of_ones_own_goes_along(root: Path, tmp_path: Path) -> None:
    shutil.copy(data_directory() / "devices" / "baumer-om20.toml", tmp_path / "ours.toml")
    laser = IMU.format(link="tcp://127.0.0.1:15020").replace("imu", "laser").replace("witmotion-wt901c485", "ours.toml")
    install(root, written(tmp_path, laser))
    assert files(root)["/etc/heaved/ours.toml"] == (tmp_path / "ours.toml").read_text()
    load(service.below(root, service.CONFIG))


def test_a_profile_elsewhere_is_refused(root: Path, tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    shutil.copy(data_directory() / "devices" / "witmotion-wt901c485.toml", tmp_path / "ours.toml")
    source = written(tmp_path / "here", IMU.format(link=USB).replace("witmotion-wt901c485", "../ours.toml"))
    with pytest.raises(service.ServiceError, match="put it there"):
        install(root, source)


def test_removal_leaves_nothing_but_what_is_the_users(root: Path, tmp_path: Path) -> None:
    install(root, written(tmp_path, IMU.format(link=USB)), [FTDI])
    override = service.below(root, service.DROP_IN).with_name("override.conf")
    override.write_text("[Service]\n")
    asked: list[Sequence[str]] = []
    service.remove(root, asked.append)
    assert set(files(root)) == {str(service.CONFIG), f"/{override.relative_to(root)}"}
    assert asked[0] == ["systemctl", "disable", "--now", "heaved"]  # Before its unit is gone.
    override.unlink()
    assert "nothing of it is here" in service.remove(root, asked.append)
    assert not override.parent.exists()


def test_systemd_and_udev_are_told_only_of_what_is_new(root: Path, tmp_path: Path) -> None:
    source = written(tmp_path, IMU.format(link=USB))
    asked: list[Sequence[str]] = []
    wanted = service.plan(source=source, root=root, program=PROGRAM, plugged=[FTDI])
    service.write(wanted, root, asked.append)
    assert [command[:2] for command in asked] == [
        ["systemctl", "daemon-reload"],
        ["udevadm", "control"],
        ["udevadm", "trigger"],
    ]
    service.write(wanted, root, asked.append)
    assert len(asked) == 3


# ---- what the configuration needs ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "settings"),
    [
        ("", []),
        ('[stream]\nhost = "0.0.0.0"\nallow = ["192.168.10.0/24"]', ["IPAddressAllow=192.168.10.0/24"]),
        ('[http]\nenabled = false\nallow = ["192.168.11.0/24"]', []),
        ('[http]\nhost = "::"\nallow = ["fd00::/64"]', ["IPAddressAllow=fd00::/64"]),
        ('[stream]\nhost = "0.0.0.0"\ntls = true\n' + TLS, ["IPAddressAllow=any"]),
        ('[stream]\nhost = "::"\ntls = true\nallow = ["fd00::/64"]\n' + TLS, ["IPAddressAllow=fd00::/64"]),
        ("[http]\ntls = true\n" + TLS, []),
        ('[registers]\nenabled = true\nmode = "push"\nlink = "tcp://10.1.1.1:502"', ["IPAddressAllow=10.1.1.1"]),
        ('[registers]\nlink = "tcp://10.1.1.1:502"\nmode = "push"', []),
        (
            '[registers]\nenabled = true\nlink = "tcp://127.0.0.1:502"',
            [
                "AmbientCapabilities=CAP_NET_BIND_SERVICE",
                "CapabilityBoundingSet=CAP_NET_BIND_SERVICE",
                "PrivateUsers=no",
            ],
        ),
        ('[mqtt]\nenabled = true\nlink = "mqtts://[fd00::9]:8883"', ["IPAddressAllow=fd00::9"]),
        ('[influx]\nenabled = true\nlink = "udp://10.0.0.9:8089"', ["IPAddressAllow=10.0.0.9"]),
        ('[influx]\nenabled = true\nlink = "http://127.0.0.1:8086"', []),
        (
            '[[output]]\nname = "a"\ntelegram = "pashr"\nlink = "udp://224.0.0.5:9000"\n'
            '[[output]]\nname = "b"\ntelegram = "pashr"\nlink = "udp://224.0.0.5:9001"',
            ["IPAddressAllow=224.0.0.5"],
        ),
        (
            '[[output]]\nname = "a"\ntelegram = "pashr"\nlink = "tcp-listen://0.0.0.0:9000"\nallow = ["10.2.0.0/16"]',
            ["IPAddressAllow=10.2.0.0/16"],
        ),
        (
            '[[output]]\nname = "a"\ntelegram = "pashr"\nlink = "serial:///dev/ttymxc1?baudrate=19200"',
            ["DeviceAllow=/dev/ttymxc1 rw"],
        ),
        (
            "[runtime]\nfifo_priority = 20",
            ["RestrictRealtime=no", "LimitRTPRIO=20", "SystemCallFilter=sched_setscheduler"],
        ),
        ('[state]\ndirectory = "/data/state"', ["ReadWritePaths=-/data/state"]),
    ],
)
def test_what_is_permitted_beyond_the_unit(more: str, settings: list[str], root: Path, tmp_path: Path) -> None:
    install(root, written(tmp_path, IMU.format(link="tcp://127.0.0.1:15020") + more))
    lines = service.below(root, service.DROP_IN).read_text().splitlines()
    assert [line for line in lines if "=" in line and not line.startswith("#")] == settings


def test_a_network_that_is_not_wanted_any_more_is_taken_back(root: Path, tmp_path: Path) -> None:
    install(root, written(tmp_path, IMU.format(link="tcp://10.0.0.1:502")))
    service.below(root, service.CONFIG).write_text(IMU.format(link="tcp://10.0.0.7:502"))
    wanted, _ = install(root)
    assert "10.0.0.1" not in service.below(root, service.DROP_IN).read_text()
    assert "device[0].link: 10.0.0.7 may be talked to (IPAddressAllow=10.0.0.7)" in wanted.notes


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ('[mqtt]\nenabled = true\nlink = "mqtt://broker.ship:1883"', "mqtt.link: broker.ship is a name"),
        ('[recording]\nenabled = true\ndirectory = "/data/rec"', "install -d -o heaved -g heaved -m 0750 /data/rec"),
        (
            '[mqtt]\nenabled = true\nusername = "us"\npassword_file = "/etc/heaved/secret"',
            "LoadCredential=mqtt:/etc/heaved/secret",
        ),
        ("[http]\ntls = true\n" + TLS, "LoadCredential=tls:/etc/heaved/server.key"),
    ],
)
def test_what_no_drop_in_can_do_is_said(more: str, said: str, root: Path, tmp_path: Path) -> None:
    wanted, _ = install(root, written(tmp_path, IMU.format(link="tcp://127.0.0.1:15020") + more))
    assert any(said in note for note in wanted.notes)


def test_a_program_that_the_unit_hides() -> None:
    (said,) = service.program_faults(Path("/home/mate/heaved/bin/heaved"))
    assert said.startswith("the program /home/mate/heaved/bin/heaved is below /home, where the service cannot see it")
    assert not service.program_faults(PROGRAM)


def test_a_system_without_the_group_of_serial_ports(root: Path) -> None:
    (root / "etc").mkdir()
    groups = root / "etc" / "group"
    groups.write_text("root:x:0:\ntty:x:5:\n")
    wanted, _ = install(root)
    assert any(note.startswith("there is no group dialout here") for note in wanted.notes)
    groups.write_text("root:x:0:\ndialout:x:20:mate\n")
    wanted, _ = install(root)
    assert not any("dialout" in note for note in wanted.notes)


# ---- adapters --------------------------------------------------------------------------------------------------------

TOKEN = re.compile(r'([A-Z]+)(?:\{([^}]+)\})?(==|\+=|=)"([^"]*)"')


def links_made(rules: str, port: dict[str, str], parents: list[dict[str, str]]) -> list[str]:
    """Names that udev would give a tty, as udev(7) says: ATTRS and KERNELS of one rule all hold of one parent.

    port: SUBSYSTEM, and what ENV it has. parents: KERNELS and attributes of each device above it.
    """
    made = []
    for line in rules.splitlines():
        tokens = [match.groups() for match in TOKEN.finditer(line)]
        if line.startswith("#") or not tokens:
            continue
        own = [
            (attribute or key, value)
            for key, attribute, op, value in tokens
            if op == "==" and key in ("SUBSYSTEM", "ENV")
        ]
        above = [
            (attribute or key, value)
            for key, attribute, op, value in tokens
            if op == "==" and key in ("ATTRS", "KERNELS")
        ]
        if all(fnmatchcase(port.get(key, ""), value) for key, value in own) and any(
            all(fnmatchcase(parent.get(key, ""), value) for key, value in above) for parent in parents
        ):
            made += [name for key, _, op, value in tokens if (key, op) == ("SYMLINK", "+=") for name in value.split()]
    return made


def usb(adapter: Adapter) -> tuple[dict[str, str], list[dict[str, str]]]:
    """The port of an adapter, and the devices above it, as the kernel shows them."""
    socket, _, interface = adapter.socket.partition(":")
    attributes = dict(zip(("idVendor", "idProduct"), adapter.usb_id.split(":"), strict=True))
    if adapter.serial_number:
        attributes["serial"] = adapter.serial_number
    hub = {"KERNELS": "1-1", "idVendor": "1d6b", "idProduct": "0002", "serial": "0000:00:14.0"}
    port = {"SUBSYSTEM": "tty", "ID_USB_INTERFACE_NUM": f"{int((interface or '1.0').split('.')[1]):02x}"}
    return port, [{"KERNELS": adapter.socket}, {"KERNELS": socket, **attributes}, hub]


CASES = {
    "by serial number": (FTDI, replace(FTDI, path="/dev/ttyUSB1", serial_number="A50285BJ", socket="1-1.3")),
    "no serial number": (
        replace(FTDI, serial_number=""),
        replace(FTDI, path="/dev/ttyUSB1", serial_number="", socket="1-1.3"),
    ),
    "the same serial number": (
        replace(FTDI, serial_number="0001"),
        replace(FTDI, serial_number="0001", path="/dev/ttyUSB1", socket="1-1.3"),
    ),
    "ports of one adapter": (
        replace(FTDI, socket="1-1.2:1.0"),
        replace(FTDI, path="/dev/ttyUSB1", socket="1-1.2:1.10"),
    ),
    "an odd serial number": (
        replace(FTDI, serial_number='A"*B, C'),
        replace(FTDI, path="/dev/ttyUSB1", serial_number="AxxxB, D", socket="1-1.3"),
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_each_adapter_gets_its_own_name_and_no_other(case: str) -> None:
    first, second = CASES[case]
    found = udev.rules({"/dev/ttyUSB0": ("imu", "gyro"), "/dev/ttyUSB1": ("laser",)}, [first, second])
    text = "\n".join(rule.text for rule in found)
    assert links_made(text, *usb(first)) == ["heaved-imu", "heaved-gyro"]
    assert links_made(text, *usb(second)) == ["heaved-laser"]
    assert [rule.path for rule in found] == ["/dev/heaved-imu", "/dev/heaved-laser"]
    assert bool(found[0].caution) == (case in ("no serial number", "the same serial number"))


def test_a_known_adapter_keeps_its_name_in_another_socket() -> None:
    (rule,) = udev.rules({"/dev/ttyUSB0": ("imu",)}, [FTDI])
    assert links_made(rule.text, *usb(replace(FTDI, path="/dev/ttyUSB7", socket="3-4.1"))) == ["heaved-imu"]


def test_only_ftdi_has_a_latency_timer() -> None:
    (rule,) = udev.rules({"/dev/ttyUSB0": ("imu",)}, [FTDI])
    assert 'DRIVER=="ftdi_sio"' in rule.text
    assert 'ATTR{latency_timer}="1"' in rule.text
    other = Adapter(path="/dev/ttyUSB0", stable_path="/dev/ttyUSB0", usb_id="1a86:7523", socket="1-2")
    (rule,) = udev.rules({"/dev/ttyUSB0": ("imu",)}, [other])
    assert "latency_timer" not in rule.text


def test_links_are_renamed_in_the_copy_and_nowhere_else(root: Path, tmp_path: Path) -> None:
    text = (
        f'# link = "{USB}"\n'
        + IMU.format(link=USB)
        + IMU.format(link="rtu:///dev/ttyUSB01").replace('"imu"', '"laser"')
    )
    renamed = service.renamed(text, {"/dev/ttyUSB0": "/dev/heaved-imu"})
    before, after = text.splitlines(), renamed.splitlines()
    assert [(a, b) for a, b in zip(before, after, strict=True) if a != b] == [
        (f'link = "{USB}"', 'link = "rtu:///dev/heaved-imu?baudrate=115200"')
    ]
    source = written(tmp_path, IMU.format(link=USB))
    install(root, source, [FTDI])
    assert load(service.below(root, service.CONFIG)).device[0].link == "rtu:///dev/heaved-imu?baudrate=115200"
    assert source.read_text() == IMU.format(link=USB)


def test_the_rule_of_an_unplugged_adapter_stays(root: Path, tmp_path: Path) -> None:
    source = written(tmp_path, IMU.format(link=USB))
    install(root, source, [FTDI])
    rules = service.below(root, service.RULES).read_text()
    wanted, _ = install(root)
    assert service.below(root, service.RULES).read_text() == rules
    assert any(note.startswith("imu: /dev/heaved-imu is not plugged in just now") for note in wanted.notes)


def test_an_unknown_adapter_is_asked_for(root: Path, tmp_path: Path) -> None:
    wanted, _ = install(root, written(tmp_path, IMU.format(link=USB)))
    assert not service.below(root, service.RULES).exists()
    assert any("plug it in and run this again" in note for note in wanted.notes)


# ---- the command -----------------------------------------------------------------------------------------------------


def test_it_shows_before_it_writes(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["install-service", "--root", str(root), "--program", str(PROGRAM)]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"# {service.CONFIG}: ")
    assert "ExecStart=/opt/heaved/bin/heaved run" in out
    assert not files(root)
    assert main(["install-service", "--root", str(root), "--program", str(PROGRAM), "--write"]) == 0
    assert "systemctl enable --now heaved" in capsys.readouterr().out
    assert files(root)
    assert main(["install-service", "--root", str(root), "--remove"]) == 0
    assert "removed" in capsys.readouterr().out


def test_a_faulty_configuration_is_not_installed(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = written(tmp_path, IMU.format(link="rtu://ttyUSB0"))
    assert main(["install-service", "--root", str(root), "--config", str(source), "--write"]) == 78
    assert "device[0].link" in capsys.readouterr().err
    assert not files(root)


def test_without_the_right_to_it_nothing_is_done(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    for option in ("--write", "--remove"):
        assert main(["install-service", option]) == 77
        assert "this needs root: sudo " in capsys.readouterr().err


# ---- as systemd sees it ----------------------------------------------------------------------------------------------

needs_systemd = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is not installed")
EVERYTHING = """
[stream]
host = "0.0.0.0"
allow = ["192.168.10.0/24", "fd00::/64"]
[registers]
enabled = true
link = "tcp://127.0.0.1:502"
[state]
directory = "/data/state"
[runtime]
fifo_priority = 80
[[output]]
name = "dp"
telegram = "em3000"
link = "serial:///dev/ttymxc1?baudrate=19200"
"""


@needs_systemd
@pytest.mark.parametrize(("more", "exposure"), [("", 1.2), (EVERYTHING, 2.0)], ids=["least", "most"])
def test_systemd_takes_the_unit_with_its_drop_in(more: str, exposure: float, root: Path, tmp_path: Path) -> None:
    program = tmp_path / "heaved"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    source = written(tmp_path, IMU.format(link="tcp://127.0.0.1:15020") + more)
    wanted = service.plan(source=source, root=root, program=program, plugged=())
    service.write(wanted, root, lambda _: None)
    made = str(service.below(root, service.UNIT))

    def analyze(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(["systemd-analyze", *words], capture_output=True, text=True, check=False, timeout=60)

    verified = analyze("verify", made)
    assert (verified.returncode, verified.stdout, verified.stderr) == (0, "", "")
    (level,) = re.findall(
        r"Overall exposure level for \S+: (\d+\.\d)", analyze("security", "--offline=true", made).stdout
    )
    assert float(level) <= exposure
    # A wrong line in the drop-in would have been seen.
    service.below(root, service.DROP_IN).write_text("[Service]\nIPAddressAllow=nonsense\n")
    assert "nonsense" in analyze("verify", made).stderr


def test_the_unit_allows_what_needs_no_drop_in() -> None:
    allowed = set(re.findall(r"DeviceAllow=char-(tty[A-Z]+) rw", SHIPPED.read_text()))
    for kind in allowed:
        assert unit.USUAL_PORTS.fullmatch(f"/dev/{kind}0")
    assert not unit.USUAL_PORTS.fullmatch("/dev/ttymxc0")
    assert unit.unit_text() == SHIPPED.read_text()

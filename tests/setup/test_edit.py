"""Changing a configuration in its text. The oracle is tomllib, and the lines that must not change."""

import stat
import tomllib
from pathlib import Path
from typing import Any

import pytest

from heaved.config.read import ConfigError, data_directory
from heaved.setup import edit

PLAIN = """# top
[[device]]
name = "imu"   # shown
role = "imu"
link = "tcp://127.0.0.1:1502"
profile = "witmotion-wt901c485"
rate_hz = 20.0
# When it samples.
#latency_ms = 0.0                      # ms, -1000..1000

# ---- the laser ----
[[device]]
name = "laser"
role = "laser"
link = "tcp://127.0.0.1:1503"
profile = "witmotion-wt53r-485"
rate_hz = 20.0

# ---- estimation ----
[laser]
sign = 1  # looks down
"""


def changed(before: str, after: str) -> list[str]:
    return [line for line in edit.difference(before, after, "x")[2:] if line[0] in "+-"]


def test_a_key_that_is_there_gets_another_value_and_keeps_its_comment() -> None:
    after = edit.with_keys(PLAIN, "laser", {"sign": -1})
    assert changed(PLAIN, after) == ["-sign = 1  # looks down", "+sign = -1  # looks down"]


def test_a_default_is_taken_out_of_its_comment_where_it_stands() -> None:
    after = edit.with_keys(PLAIN, "device", {"latency_ms": -12.5}, index=0)
    assert changed(PLAIN, after) == [
        "-#latency_ms = 0.0                      # ms, -1000..1000",
        "+latency_ms = -12.5                     # ms, -1000..1000",
    ]


def test_a_new_key_goes_below_the_keys_of_its_own_table() -> None:
    after = edit.with_keys(PLAIN, "device", {"timeout_ms": 80.0}, index=1)
    lines = after.splitlines()
    assert lines[lines.index("timeout_ms = 80.0") - 1] == "rate_hz = 20.0"
    assert lines[lines.index("timeout_ms = 80.0") + 1] == ""
    first = edit.with_keys(PLAIN, "device", {"timeout_ms": 80.0}, index=0).splitlines()
    assert first.index("timeout_ms = 80.0") < first.index("# ---- the laser ----")


def test_a_table_that_is_missing_is_added() -> None:
    after = edit.with_keys("[heave]\nstages = 1", "laser", {"sign": -1})
    assert after == "[heave]\nstages = 1\n\n[laser]\nsign = -1\n"
    assert edit.with_keys("", "laser", {"sign": -1}) == "[laser]\nsign = -1\n"


AWKWARD: list[tuple[str, str]] = [
    ("values over lines", "[laser]\nbeam = [ # down\n  0.0, # ]\n  0.0,\n  -1.0,\n] # end\n# after\n"),
    ("strings with brackets", "[laser]\nname = \"a # ] \\\" [\"\nother = '''\n[laser]\nbeam = 3\n'''\nbeam = 1\n"),
    ("long strings with quotes", '[laser]\nt = """x\\""" [device]\n#"""\nbeam = 2\n'),
    ("quoted and spaced names", '[ "laser" ]\n  "beam"  =  4   # four\n'),
    ("no last line end", "[laser]\nsign = 1"),
    ("carriage returns", "[laser]\r\n# beam\r\n#beam = [0.0]   # unit\r\nsign = 1\r\n\r\n[heave]\r\n"),
    ("tables within tables", "[laser]\nsign = 1\n[laser.more]\nbeam = 3\n[heave]\n"),
    ("inline tables", "[laser]\nx = { beam = 1, y = [1, 2] }\n"),
    ("only a header", "[laser]\n"),
    ("a default of another table behind a header in a comment", "[laser]\nsign = 1\n\n# [other]\n#beam = 3\n"),
    ("a default that is no TOML", "[laser]\n#beam = unit vector, see below\nsign = 1\n"),
    ("tabs", "[laser]\n\tsign\t=\t1\t# c\n"),
    ("spelt with dots", "[laser]\nsub.beam = 1\n"),
]


@pytest.mark.parametrize("text", [text for _, text in AWKWARD], ids=[name for name, _ in AWKWARD])
def test_nothing_but_the_key_changes_in_any_text(text: str) -> None:
    after = edit.with_keys(text, "laser", {"beam": [0.0, 0.5, -1.0]})
    meant: dict[str, Any] = tomllib.loads(text)
    meant["laser"]["beam"] = [0.0, 0.5, -1.0]
    assert tomllib.loads(after) == meant
    again = edit.with_keys(after, "laser", {"beam": [0.0, 0.5, -1.0]})
    assert again == after
    assert ("\r\n" in text) == ("\r\n" in after)
    if "\r\n" in text:
        assert "\n" not in after.replace("\r\n", "")
    comments = [line.strip() for line in text.splitlines() if line.strip().startswith("#") and "beam" not in line]
    assert all(comment in after for comment in comments)


REFUSED: list[tuple[str, str, str]] = [
    ("inline devices", 'device = [{ name = "a" }, { name = "b" }]\n', "as a table of its own"),
    ("no such device", '[[device]]\nname = "a"\n', "no [[device]] number 2"),
    ("no TOML", "[device\n", "not valid TOML"),
]


@pytest.mark.parametrize(("text", "reason"), [row[1:] for row in REFUSED], ids=[row[0] for row in REFUSED])
def test_what_is_not_understood_is_refused(text: str, reason: str) -> None:
    with pytest.raises(edit.EditError) as caught:
        edit.with_keys(text, "device", {"latency_ms": 1.0}, index=1)
    assert reason in str(caught.value)


def test_a_table_in_dots_is_refused_rather_than_spoiled() -> None:
    with pytest.raises(edit.EditError):
        edit.with_keys("laser.sign = 1\n", "laser", {"sign": -1})


def test_every_kind_of_value_is_read_back() -> None:
    values: dict[str, edit.Value] = {
        "a": True, "b": -3, "c": 1e-7, "d": 'tab\t"quote" \x7f ü \\', "e": (1.0, [2.0, "x"]),
    }  # fmt: skip
    found = tomllib.loads(edit.with_keys("", "laser", values))["laser"]
    assert found == {"a": True, "b": -3, "c": 1e-7, "d": 'tab\t"quote" \x7f ü \\', "e": [1.0, [2.0, "x"]]}
    with pytest.raises(ValueError, match="nan"):
        edit.with_keys("", "laser", {"a": float("nan")})


def test_the_packaged_configuration_keeps_every_other_line() -> None:
    text = (data_directory() / "heaved.toml").read_text()
    after = edit.with_keys(text, "device", {"latency_ms": 4.0}, index=0)
    after = edit.with_keys(after, "device", {"latency_ms": 5.0}, index=1)
    after = edit.with_keys(after, "laser", {"sign": -1})
    assert len(changed(text, after)) == 5
    assert [line[:18] for line in changed(text, after) if line[0] == "+"] == [
        "+latency_ms = 4.0 ", "+latency_ms = 5.0", "+sign = -1        ",
    ]  # fmt: skip


def test_a_file_is_replaced_whole_with_its_mode_and_its_mark(tmp_path: Path) -> None:
    real, path = tmp_path / "real.toml", tmp_path / "heaved.toml"
    real.write_bytes(b"\xef\xbb\xbf" + PLAIN.encode())
    real.chmod(0o640)
    path.symlink_to(real)
    before = edit.read_text(path)
    edit.write(path, edit.with_keys(before, "laser", {"sign": -1}), before=before)
    assert path.is_symlink()
    assert real.read_bytes().startswith(b"\xef\xbb\xbf# top")
    assert stat.S_IMODE(real.stat().st_mode) == 0o640
    assert edit.validated(path, edit.read_text(path)).laser.sign == -1
    assert sorted(one.name for one in tmp_path.iterdir()) == ["heaved.toml", "real.toml"]


def test_faults_and_changes_by_others_leave_the_file_alone(tmp_path: Path) -> None:
    path = tmp_path / "heaved.toml"
    path.write_text(PLAIN)
    with pytest.raises(ConfigError, match="sign"):
        edit.write(path, edit.with_keys(PLAIN, "laser", {"sign": 3}), before=PLAIN)
    with pytest.raises(edit.EditError, match="somebody else"):
        edit.write(path, PLAIN, before=PLAIN + "# mine\n")
    with pytest.raises(edit.EditError, match="there already"):
        edit.write(path, PLAIN, before=None)
    assert path.read_text() == PLAIN
    with pytest.raises(edit.EditError, match="cannot be written"):
        edit.write(tmp_path / "nowhere" / "x.toml", PLAIN, before=None)
    assert [one.name for one in tmp_path.iterdir()] == ["heaved.toml"]


def test_a_new_file_is_written(tmp_path: Path) -> None:
    edit.write(tmp_path / "new.toml", PLAIN, before=None)
    assert (tmp_path / "new.toml").read_text() == PLAIN
    assert stat.S_IMODE((tmp_path / "new.toml").stat().st_mode) == 0o644

"""How the manual is shown: in a terminal, piped, searched, and as pages of man."""

from __future__ import annotations

import io
import re
import runpy
import shutil
import subprocess
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

from heaved.cli import main
from heaved.cli.described import tables
from heaved.manual import screen
from heaved.manual.man_page import man_page, page_name
from heaved.manual.topics import Topic, filled, topics

ROOT = Path(__file__).resolve().parents[2]
TOPICS = topics()


# ---- the command -----------------------------------------------------------------------------------------------------


def test_without_a_topic_it_is_the_index(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["manual"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("THE MANUAL OF HEAVED\n")
    assert "First hour (heaved manual first-hour)" in out


def test_what_is_piped_is_plain_text(capsys: pytest.CaptureFixture[str]) -> None:
    for name in TOPICS:
        assert main(["manual", name]) == 0
        out = capsys.readouterr().out
        assert "\x1b" not in out
        assert not [line for line in out.splitlines() if line != line.rstrip()]
        assert max(map(len, out.splitlines())) <= screen.PIPED_WIDTH


@pytest.mark.parametrize(("word", "code", "said"), [
    ("first", 0, "THE FIRST HOUR"),
    ("onfig", 0, "CONFIGURATION"),
    ("re", 1, "no topic 're'; topics: reasons, recordings, registers"),
    ("nonsense", 1, "no topic 'nonsense'; topics: index, first-hour"),
])  # fmt: skip
def test_a_part_of_a_name_will_do(word: str, code: int, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["manual", word]) == code
    out, err = capsys.readouterr()
    assert (err if code else out).startswith(said)


def test_search(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["manual", "--search", "LATENCY_MS"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "configuration: [[device]]: latency_ms: default 0.0; ms, -1000..1000" in lines
    assert {line.partition(":")[0] for line in lines} > {"bandwidth", "reasons"}
    assert main(["manual", "wiring", "--search", "latency_ms"]) == 1
    assert "nothing about 'latency_ms'" in capsys.readouterr().err


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_a_terminal_gets_colours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    out = Terminal()
    screen.show("# Title\n\nText with **weight**.\n", out)
    assert "\x1b[1m" in out.getvalue()
    assert "TITLE" in out.getvalue()


def test_what_is_long_goes_through_a_pager(monkeypatch: pytest.MonkeyPatch) -> None:
    paged: list[str] = []
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("LINES", "10")
    monkeypatch.setattr("pydoc.pager", paged.append)
    out = Terminal()
    monkeypatch.setattr("sys.stdout", out)
    screen.show("# Title\n\n" + "Line.\n\n" * 20, out)
    assert paged[0].count("Line.") == 20
    assert not out.getvalue()
    screen.show("# Title\n\nLine.\n", out)
    assert len(paged) == 1
    assert "Line." in out.getvalue()


# ---- pages of man ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """What the tool makes, by topic."""
    directory = tmp_path_factory.mktemp("man")
    made = runpy.run_path(str(ROOT / "tools" / "man_pages.py"))
    assert made["main"]([str(directory)]) == 0
    found = {}
    for topic in TOPICS:
        name, section = page_name(topic)
        found[topic] = directory / f"man{section}" / f"{name}.{section}"
    assert set(directory.rglob("*.?")) == set(found.values())
    return found


def words(text: str) -> list[str]:
    """Letters and digits alone, as hyphenation and tables leave them."""
    return re.findall(r"\w+", text)


def plain(markdown: str) -> str:
    """The text of Markdown, without its marks."""
    parts = []
    for token in MarkdownIt("commonmark", {"html": False}).enable("table").parse(markdown):
        if token.type in ("fence", "code_block"):
            parts.append(token.content)
        for part in token.children or []:
            if part.type in ("text", "code_inline"):
                parts.append(part.content)
            elif part.type in ("softbreak", "hardbreak"):
                parts.append("\n")
        parts.append("\n")
    return "".join(parts)


@pytest.mark.skipif(shutil.which("mandoc") is None, reason="mandoc is not installed")
@pytest.mark.parametrize("topic", TOPICS)
def test_mandoc_finds_nothing_wrong_and_nothing_is_lost(topic: str, pages: dict[str, Path]) -> None:
    linted = subprocess.run(
        ["mandoc", "-Tlint", "-W", "warning", pages[topic]], capture_output=True, text=True, check=False
    )
    assert (linted.stdout, linted.stderr) == ("", "")
    # Wide: nothing is hyphenated, and no cell of a table is broken within a word.
    shown = subprocess.run(
        ["mandoc", "-Tutf8", "-O", "width=1000", pages[topic]], capture_output=True, text=True, check=True
    ).stdout
    shown = re.sub(r".\x08", "", shown)
    there = set(words(shown.casefold()))
    # A page's name stands for the title.
    _, _, body = filled(TOPICS[topic], tables()).partition("\n")
    assert not set(words(plain(body).casefold())) - there


@pytest.mark.skipif(
    shutil.which("man") is None or shutil.which("groff") is None, reason="man or groff is not installed"
)
@pytest.mark.parametrize("topic", ["configuration", "registers", "wiring"])
def test_man_shows_it_without_a_word_of_warning(topic: str, pages: dict[str, Path]) -> None:
    shown = subprocess.run(
        ["man", "--warnings", "-E", "UTF-8", "-l", "-Tutf8", "-Z", pages[topic]],
        capture_output=True, text=True, check=False, env={"LC_ALL": "C.UTF-8", "PATH": "/usr/bin:/bin"},
    )  # fmt: skip
    assert shown.returncode == 0, shown.stderr
    assert "warning" not in shown.stderr


def test_a_page_says_what_it_is(pages: dict[str, Path]) -> None:
    lines = pages["configuration"].read_text().splitlines()
    assert lines[0] == "'\\\" t"
    assert re.match(r'\.TH "HEAVED.TOML" 5 \d{4}-\d\d-\d\d "heaved ', lines[1])
    assert lines[3:5] == [".SH NAME", "heaved.toml \\- Every key of heaved.toml, with unit, range and default"]


def page_of(text: str) -> list[str]:
    topic = Topic(name="t", title="T", summary="Of t", source=text)
    lines = man_page(topic, text, "1.0", "2026-01-01", {"t": topic}).splitlines()
    return lines[lines.index(".SH DESCRIPTION") + 1 : lines.index(".SH SEE ALSO")]


@pytest.mark.parametrize(("text", "expected"), [
    ("a -- b\\\\c", ["a \\-\\- b\\ec"]),
    (".SH is no request", ["\\&.SH is no request"]),
    ("'quoted'\n'twice'", ["\\&'quoted'", "\\&'twice'"]),
    ("`a-b` and **c**", ["\\fBa\\-b\\fR and \\fBc\\fR"]),
    ("see [the reasons](reasons.md)", ["see the reasons (\\fBheaved\\-reasons\\fR(7))"]),
    ("see [keys](configuration.md)", ["see keys (\\fBheaved.toml\\fR(5))"]),
    ("<topic>/motion", ["<topic>/motion"]),
    ("a\n\nb", ["a", ".PP", "b"]),
    ("## Head-line\n\na", ['.SH "HEAD\\-LINE"', "a"]),
    ("- a\n\n  b\n- c", [".IP \\(bu 4", "a", ".IP", "b", ".IP \\(bu 4", "c"]),
    ("- a\n  - b", [".IP \\(bu 4", "a", ".RS 4", ".IP \\(bu 4", "b", ".RE"]),
    ("1. a", ['.IP "1." 4', "a"]),
    ("x\n```\n.a \\n\n\n-b\n```", ["x", ".PP", ".in +4n", ".EX", "\\&.a \\en", "", "\\-b", ".EE", ".in"]),
    ("|a|b|\n|-|-|\n|1|2|", [".TS", "tab(\t);", "lb lb", "l l.", "a\tb", "1\t2", ".TE"]),
    ("a\\\nb", ["a", ".br", "b"]),
])  # fmt: skip
def test_markdown_as_man_has_it(text: str, expected: list[str]) -> None:
    assert page_of(f"# T\n{text}\n") == expected


@pytest.mark.parametrize("text", ["> quoted", "![image](x.png)", "a\n\n---\n\nb"])
def test_what_it_does_not_know_it_refuses(text: str) -> None:
    with pytest.raises(ValueError, match="no page of man can be made of"):
        page_of(f"# T\n{text}\n")

"""What watches the daemon: alerts and dashboard name metrics that there are, and the real tools read them."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from far_ends import PROMTOOL, needs_openssl, needs_promtool
from prometheus_client.parser import text_string_to_metric_families
from tls_keys import make_keys

from heaved.config.read import data_directory
from heaved.daemon.metrics import Metrics
from heaved.manual.topics import topics
from heaved.outputs.output import OutputHealth
from heaved.outputs.tls import Span
from heaved.samples import RockScore

if TYPE_CHECKING:
    from collections.abc import Iterator

RULES = data_directory() / "prometheus" / "heaved.rules.yml"
DASHBOARD = data_directory() / "grafana" / "heaved.json"
ALERTS = Path(__file__).parent / "alerts.yml"


def metrics() -> bytes:
    """/metrics of a daemon in which everything has happened that makes a series."""
    made = Metrics("1.2.3")
    made.device("imu").set_up(True)
    made.filter_resets.labels("heave", "gap").inc()
    made.record_rock((RockScore(axis="roll", horizon_s=1.0, error_rad=0.001, coverage=0.95),))
    winch = OutputHealth("winch", "TSS1", "udp://127.0.0.1:5000")
    winch.lost["not known"] += 1
    made.have_outputs(lambda: [winch])
    made.show_certificates([Span("certificate_file", 1.7e9, 1.8e9), Span("client_ca_file", 1.7e9, 1.9e9)])
    return made.render()


def published() -> dict[str, set[str]]:
    """Series by name, as Prometheus stores them: their labels."""
    found: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(metrics().decode()):
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    return found


def rule_expressions() -> list[str]:
    text = RULES.read_text(encoding="utf-8")
    return [
        found.replace("\n", " ") for found in re.findall(r"(?ms)^        expr: (.*?)\n        (?:for|labels):", text)
    ]


def dashboard() -> dict[str, Any]:
    return dict(json.loads(DASHBOARD.read_text(encoding="utf-8")))


def panels() -> Iterator[dict[str, Any]]:
    yield from (panel for panel in dashboard()["panels"] if panel["type"] != "row")


def panel_expressions() -> list[str]:
    return [target["expr"] for panel in panels() for target in panel["targets"]]


def alerts() -> list[str]:
    return re.findall(r"(?m)^      - alert: (\w+)$", RULES.read_text(encoding="utf-8"))


def promtool(*arguments: str, given: bytes = b"") -> str:
    """What it says; it must find nothing wrong."""
    assert PROMTOOL is not None
    done = subprocess.run([PROMTOOL, *arguments], input=given, capture_output=True, check=False, timeout=60)
    said = (done.stdout + done.stderr).decode()
    assert done.returncode == 0, said
    return said


# ---- names -----------------------------------------------------------------------------------------------------------


def test_each_alert_and_each_panel_has_an_expression() -> None:
    assert len(rule_expressions()) == len(alerts()) > 20
    assert all(panel["targets"] for panel in panels())
    assert len(panel_expressions()) > 40


@pytest.mark.parametrize("expression", sorted({*rule_expressions(), *panel_expressions()}))
def test_what_is_asked_for_is_published(expression: str) -> None:
    known = published()
    names = re.findall(r"\b(heaved_\w+)(?:\{([^}]*)\})?", expression)
    assert names or expression.startswith("up{")
    for name, selector in names:
        assert name in known, f"there is no metric {name}"
        labels = set(re.findall(r"(\w+)\s*(?:=~|!~|!=|=)", selector))
        assert labels <= known[name] | {"job", "instance"}, f"{name} has no labels {labels}"
    grouped = {label.strip() for group in re.findall(r"\bby \(([^)]*)\)", expression) for label in group.split(",")}
    of_all = set[str]().union(*(known[name] for name, _ in names)) if names else set[str]()
    assert grouped <= of_all | {"job", "instance"}


def test_every_metric_is_on_the_dashboard() -> None:
    shown = set(re.findall(r"\bheaved_\w+", " ".join(panel_expressions())))
    of_histograms = {name.removesuffix("_bucket") for name in published() if name.endswith("_bucket")}
    families = {
        name
        for name in published()
        if not any(name == f"{family}_{part}" for family in of_histograms for part in ("sum", "count"))
    }
    assert families - shown == set()


# ---- the real tools --------------------------------------------------------------------------------------------------


@needs_promtool
def test_the_metrics_are_as_prometheus_wants_them() -> None:
    assert promtool("check", "metrics", given=metrics()) == ""


@needs_promtool
def test_prometheus_takes_the_rules() -> None:
    assert f"SUCCESS: {len(alerts())} rules found" in promtool("check", "rules", str(RULES))


@needs_promtool
def test_alerts_come_when_they_should_and_not_when_all_is_well() -> None:
    assert "SUCCESS" in promtool("test", "rules", str(ALERTS))


def test_each_alert_is_seen_to_come() -> None:
    assert set(re.findall(r'alertname="(\w+)"', ALERTS.read_text(encoding="utf-8"))) == set(alerts())


@needs_promtool
def test_prometheus_understands_each_panel(tmp_path: Path) -> None:
    rules = [
        {
            "record": f"panel_{i}",
            "expr": expression.replace("$__rate_interval", "1m").replace("$instance", "ship:9570"),
        }
        for i, expression in enumerate(panel_expressions())
    ]
    file = tmp_path / "panels.yml"
    file.write_text(json.dumps({"groups": [{"name": "panels", "rules": rules}]}))  # JSON is YAML.
    assert f"SUCCESS: {len(rules)} rules found" in promtool("check", "rules", str(file))


@needs_promtool
@needs_openssl
def test_prometheus_takes_the_manuals_lines_for_tls(tmp_path: Path) -> None:
    (text,) = re.findall(r"(?ms)^```text\n(scrape_configs:.*?)^```$", topics()["security"].source)
    make_keys(tmp_path)
    file = tmp_path / "prometheus.yml"
    file.write_text(text.replace("/etc/prometheus", str(tmp_path)))
    assert "SUCCESS" in promtool("check", "config", str(file))


# ---- for people ------------------------------------------------------------------------------------------------------


def test_each_alert_says_how_bad_it_is_what_it_is_and_what_to_do() -> None:
    entries = RULES.read_text(encoding="utf-8").split("      - alert: ")[1:]
    assert len({*alerts()}) == len(entries)
    for entry in entries:
        assert re.search(r"labels: \{ severity: (critical|warning) \}", entry), entry
        assert re.search(r'(?m)^          summary: ".{10,}"$', entry), entry
        assert re.search(r'(?m)^          description: ".{30,}\."$', entry), entry


def test_panels_do_not_overlap_and_each_has_a_unit() -> None:
    taken: set[tuple[int, int]] = set()
    ids = [panel["id"] for panel in dashboard()["panels"]]
    assert len(set(ids)) == len(ids)
    for panel in dashboard()["panels"]:
        place = panel["gridPos"]
        cells = {
            (x, y)
            for x in range(place["x"], place["x"] + place["w"])
            for y in range(place["y"], place["y"] + place["h"])
        }
        assert max(x for x, _ in cells) < 24
        assert not cells & taken, panel["title"]
        taken |= cells
        assert panel["type"] == "row" or panel["fieldConfig"]["defaults"]["unit"]

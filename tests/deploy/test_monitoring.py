"""A real Prometheus scrapes a station with a key; alert rules and dashboard ask for metrics that exist."""

from __future__ import annotations

import json
import re
import socket
import subprocess
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.needs import need, program
from tests.peers.certificates import make_certificate
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile

MONITORING = Path(__file__).resolve().parents[2] / "deploy" / "monitoring"
METRIC = re.compile(r"vaoi_[a-z_]+")


class Scraped(NamedTuple):
    """A Prometheus that scrapes a station by TLS with a key, and the metrics that the station has."""

    address: str
    metrics: frozenset[str]

    def query(self, expression: str) -> Any:
        text = urllib.parse.urlencode({"query": expression})
        with urllib.request.urlopen(f"{self.address}/api/v1/query?{text}", timeout=30) as reply:
            return json.load(reply)


@pytest.fixture(scope="module")
def scraped(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scraped]:
    need("prometheus")
    folder = tmp_path_factory.mktemp("prometheus")
    keys, audit = KeyFile(folder / "keys.json"), AuditLog(folder / "audit.jsonl")
    access = AccessControl(keys, audit, open_loopback=False)
    made = make_certificate(folder)
    station = HeldStation()
    station.film()
    served = Served(station, access=access, certificate=made)
    secret = keys.create("prometheus", ["read"]).secret
    text = served.client.get("/metrics", headers={"authorization": f"Bearer {secret}"}).text
    served.client.close()
    (folder / "prometheus.key").write_text(secret)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    # The settings that are delivered, with what their comments name for another machine.
    settings = (MONITORING / "prometheus.yml").read_text(encoding="utf-8").replace("# scheme", "scheme")
    for old, new in (
        ("# tls_config: {ca_file: ca.pem}", f"tls_config: {{ca_file: {made.certificate}}}"),
        ("# authorization", "authorization"),
        ("127.0.0.1:8350", f"127.0.0.1:{served.port}"),
        ("15s", "1s"),
        ("[alerts.yml]", f"[{MONITORING}/alerts.yml]"),
    ):
        assert old in settings
        settings = settings.replace(old, new)
    (folder / "prometheus.yml").write_text(settings)
    options = [f"--config.file={folder}/prometheus.yml", f"--storage.tsdb.path={folder}/data"]
    listen = f"--web.listen-address=127.0.0.1:{port}"
    log = (folder / "log").open("w")
    server = subprocess.Popen([str(program("prometheus")), *options, listen], stderr=log)
    found = Scraped(f"http://127.0.0.1:{port}", frozenset(re.findall(r"^# TYPE (\S+)", text, re.MULTILINE)))
    try:
        while True:
            assert server.poll() is None, (folder / "log").read_text()
            try:
                if found.query("up")["data"]["result"]:
                    break
            except OSError:
                continue
        yield found
    finally:
        server.terminate()
        server.wait()
        log.close()
        served.stop()
        audit.close()


def dashboard() -> list[tuple[str, str]]:
    """Return title and expression of every curve, with the variables of the dashboard replaced."""
    document = json.loads((MONITORING / "dashboard.json").read_text(encoding="utf-8"))
    return [
        (panel["title"], target["expr"].replace("$station", ".*"))
        for panel in document["panels"]
        for target in panel["targets"]
    ]


def rules() -> list[str]:
    return re.findall(r"expr: (.*)", (MONITORING / "alerts.yml").read_text(encoding="utf-8"))


def test_prometheus_scrapes_a_station_by_tls_with_a_key(scraped: Scraped) -> None:
    (up,) = scraped.query('up{job="vaoi"}')["data"]["result"]
    assert up["value"][1] == "1"
    (state,) = scraped.query("vaoi_state == 1")["data"]["result"]
    assert state["metric"]["state"] == "idle"
    known = {series["metric"]["__name__"] for series in scraped.query('{job="vaoi"}')["data"]["result"]}
    assert {re.sub("_(bucket|sum|count)$", "", name) for name in known if name.startswith("vaoi_")} <= scraped.metrics
    assert len(known) > 20


def test_rules_and_dashboard_are_accepted_and_name_metrics_that_exist(scraped: Scraped) -> None:
    asked = [*dashboard(), *(("rule", text) for text in rules())]
    assert len(asked) > 20
    for title, expression in asked:
        assert scraped.query(expression)["status"] == "success", (title, expression)
        named = {re.sub("_(bucket|sum|count)$", "", name) for name in METRIC.findall(expression)}
        assert named <= scraped.metrics, (title, expression)


def test_the_dashboard_shows_what_the_station_states(scraped: Scraped) -> None:
    """Gauges have a value at once; curves of rates need two scrapes."""
    empty = [(t, e) for t, e in dashboard() if "rate(" not in e and "increase(" not in e]
    # The held station has no thermometers.
    assert [t for t, e in empty if not scraped.query(e)["data"]["result"] and "temperature" not in e] == []


def test_alerts_fire_when_they_should(tmp_path: Path) -> None:
    need("promtool")
    text = (Path(__file__).parent / "alerts_test.yml").read_text(encoding="utf-8")
    path = tmp_path / "alerts_test.yml"
    path.write_text(text.replace("[RULES]", f"[{MONITORING}/alerts.yml]"))
    for command in (["check", "rules", str(MONITORING / "alerts.yml")], ["test", "rules", str(path)]):
        done = subprocess.run([str(program("promtool")), *command], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr

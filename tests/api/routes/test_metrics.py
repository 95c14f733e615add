"""`/metrics` in the text format of Prometheus."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path
from typing import Any

from tests.needs import need

DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "reference" / "metrics.md"
SAMPLE = re.compile(r"^([a-z_:][a-z0-9_:]*)(?:\{(.*)\})? (\S+)$")


def samples(text: str) -> dict[tuple[str, str], float]:
    found = (SAMPLE.match(line) for line in text.splitlines() if not line.startswith("#"))
    return {(m[1], m[2] or ""): float(m[3]) for m in found if m is not None}


def test_metrics_show_state_runs_cameras_and_processes(client: Any) -> None:
    answer = client.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    shown = samples(answer.text)
    assert len(shown) == sum(not line.startswith("#") for line in answer.text.splitlines()), "every line is a sample"
    assert shown["vaoi_state", 'state="idle"'] == 1
    assert sum(value for (name, _), value in shown.items() if name == "vaoi_state") == 1
    assert shown["vaoi_runs_total", 'verdict="degraded"'] == 1
    assert shown["vaoi_result_latency_seconds_bucket", 'le="0.1"'] == 2
    assert shown["vaoi_result_latency_seconds_bucket", 'le="+Inf"'] == shown["vaoi_result_latency_seconds_count", ""]
    assert shown["vaoi_process_resident_bytes", 'process="station"'] > 10e6
    assert shown["vaoi_process_open_fds", 'process="station"'] >= 3
    assert 0 < shown["vaoi_process_age_seconds", 'process="station"'] < 86400
    assert shown["vaoi_data_free_bytes", ""] > 0
    assert shown["vaoi_database_bytes", ""] > 0
    assert shown["vaoi_storage_trouble", 'code="storage-full"'] == 0
    assert sum(name == "vaoi_camera_connected" for name, _ in shown) == 3


def test_every_metric_is_documented(client: Any) -> None:
    named = set(re.findall(r"^\| `(vaoi_[a-z_]+)", DOCUMENT.read_text(encoding="utf-8"), re.MULTILINE))
    lines = client.get("/metrics").text.splitlines()
    assert {line.split()[2] for line in lines if line.startswith("# TYPE")} == named


def test_prometheus_accepts_the_text(client: Any) -> None:
    need("promtool")
    text = client.get("/metrics").text
    done = subprocess.run(["promtool", "check", "metrics"], input=text, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), os.linesep.join([done.stdout, done.stderr])

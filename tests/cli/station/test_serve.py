"""`vaoi serve` reads and checks its configuration, then runs the station."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.cli.conftest import Result
from vaoi_station import station
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.simulation import scenario_path


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Arguments with which the station was started."""
    calls: list[tuple[Any, ...]] = []
    monkeypatch.setattr(station, "serve", lambda *arguments: calls.append(arguments))
    monkeypatch.setattr("vaoi_station.runs.host.logs.configure_logging", lambda as_json: calls.append((as_json,)))
    return calls


def test_station_runs_with_configuration_port_and_log(
    vaoi: Callable[..., Result], served: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path)
    assert vaoi("serve", "--config", path, "--port", "0", "--log-json").code == 0
    (as_json,), (config, port, given) = served
    assert (as_json, port, config.name[:5], given) == (True, 0, "demo-", path)


def test_unsuitable_configuration_is_refused_before_the_start(
    vaoi: Callable[..., Result], served: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path)
    path.write_text(path.read_text().replace("trigger_period_s = ", "trigger_period_s = 1"))
    done = vaoi("serve", "--config", path)
    assert done.code == 2
    assert "period_s is 10.11, but must be 0.11" in done.err
    assert served == []

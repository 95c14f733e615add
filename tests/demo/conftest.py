"""The small twin, once."""

from __future__ import annotations

import pytest

from vaoi_station.simulation import Twin, read_scenario, scenario_path


@pytest.fixture(scope="session")
def twin() -> Twin:
    return Twin(read_scenario(scenario_path("small")))

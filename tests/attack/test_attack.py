"""The short form of `python -m tests.attack`: each attack for a moment; the honest caller is always served."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.attack import attacks
from tests.attack.attacks import ATTACKS, Target
from tests.attack.measuring import as_table, attacked, experience
from vaoi_station.demo.client import Client


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    service = Served(HeldStation())
    service.station.film()
    yield service
    service.stop()


@pytest.mark.parametrize("name", ATTACKS)
def test_an_honest_caller_is_served_during_an_attack(
    served: Served, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of the full size one takes a second of computing, which would go on after the end of the test.
    monkeypatch.setattr(attacks, "CORNERS", 500)
    monkeypatch.setattr(attacks, "GROWN", 1_000_000)
    with attacked(Target(served.port, "r000001"), ATTACKS[name]):
        noted = experience(Client(served.url), 0.3, pause_s=0.02)
        if not noted.waits_s and not noted.refused:  # on a busy computer the first request may take longer than that
            noted = experience(Client(served.url), 10.0, pause_s=10.0)
    assert noted.refused == []
    assert noted.waits_s
    assert f"| {name.replace('_', ' ')} | 1, 0 |" in as_table([(name, noted)])

"""The short form of `python -m tests.attack`: each attack for a moment; the honest caller is always served.

Without a proxy, and behind nginx with the site of the package.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from typing import NamedTuple

import pytest

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.api.proxy.nginx import before
from tests.attack import attacks
from tests.attack.attacks import ATTACKS, Target
from tests.attack.measuring import as_table, attacked, experience
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.demo.client import Client
from vaoi_station.files.access_keys import KeyFile
from vaoi_station.files.caller_credentials import CallerCredentials


class Attacked(NamedTuple):
    """A station under attack, and its honest caller."""

    target: Target
    client: Client
    station: str


@pytest.fixture(scope="module", params=["alone", "behind nginx"])
def station(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Attacked]:
    held = HeldStation()
    run = held.film()
    with ExitStack() as parts:
        if request.param == "alone":
            service = Served(held)
            parts.callback(service.stop)
            yield Attacked(Target(service.port, run), Client(service.url), service.url)
        else:
            folder = tmp_path_factory.mktemp("nginx")
            keys, audit = KeyFile(folder / "keys.json"), AuditLog(folder / "audit.jsonl")
            parts.callback(audit.close)
            service = Served(held, access=AccessControl(keys, audit))
            parts.callback(service.stop)
            honest, attacker = (keys.create(n, ["read", "operate", "teach"]).secret for n in ("honest", "attacker"))
            front = parts.enter_context(before(service.port, None, folder)).base_url
            client = Client(f"{front}".rstrip("/"), CallerCredentials(key=honest))
            yield Attacked(Target(front.port or 0, run, attacker), client, service.url)


@pytest.mark.parametrize("name", ATTACKS)
def test_an_honest_caller_is_served_during_an_attack(
    station: Attacked, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Of the full size one takes a second of computing, which would go on after the end of the test.
    monkeypatch.setattr(attacks, "CORNERS", 500)
    monkeypatch.setattr(attacks, "GROWN", 1_000_000)
    with attacked(station.target, ATTACKS[name]):
        noted = experience(station.client, 0.3, pause_s=0.02, station=station.station)
        if not noted.waits_s and not noted.refused:  # on a busy computer the first request may take longer than that
            noted = experience(station.client, 10.0, pause_s=10.0, station=station.station)
    assert noted.refused == []
    assert noted.waits_s
    assert f"| {name.replace('_', ' ')} | 1, 0 |" in as_table([(name, noted)])

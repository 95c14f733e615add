"""Random requests over the whole document, through a socket: every answer is one that the document states.

None is an internal error. The event stream is read up to its first line.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import httpx2
import pytest

from tests.api.conftest import Served
from tests.api.generated_requests import Requests, answer_to, wrong_with
from tests.api.held.setup_files import setup_files
from tests.api.held_station import HeldStation
from tests.needs import LONG
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile

COUNT = 20_000 if LONG else 250
"""Number of requests; at full length by VAOI_LONG=1."""
SEED = int(os.environ.get("VAOI_SEED", "14"))
"""Other requests by another number."""


@pytest.fixture
def service(tmp_path: Path) -> Iterator[tuple[Served, str]]:
    audit, keys = AuditLog(tmp_path / "audit.jsonl"), KeyFile(tmp_path / "keys")
    served = Served(HeldStation(), access=AccessControl(keys, audit), files=setup_files(tmp_path))
    served.client.timeout = httpx2.Timeout(600)  # the first heights wait for the compiler
    yield served, keys.create("chief", ["admin", "teach", "operate"]).secret
    served.stop()
    audit.close()


@pytest.mark.timeout(7200 if LONG else 300)  # 20,000 requests take longer than the suite's limit
def test_every_answer_is_one_that_the_document_states(service: tuple[Served, str]) -> None:
    (served, secret), client, station = service, service[0].client, service[0].station
    document = client.get("/api/v1/openapi.json").json()
    requests, types = Requests(document, SEED), dict(station.types)
    faults: dict[str, str] = {}  # one example of each kind
    station.film()
    station.film()
    for count in range(COUNT):
        # Results of a held station need its board type, which a real one keeps with them.
        station.types.setdefault("demo-board", types["demo-board"])
        operation, asked = requests.next()
        if count % 3 == 0:
            asked.headers["Authorization"] = f"Bearer {secret}"
        elif count % 7 == 0:
            asked.headers.setdefault("Origin", served.url)
        answer = answer_to(client, asked)
        if fault := wrong_with(answer, operation, document, exact=asked.exact):
            kind = f"{operation['operationId']}: {answer.status_code} {fault}"
            faults.setdefault(kind, f"request {count}: {asked}: {answer.text[:300]}")
    assert not faults, "\n".join(f"{kind}, {example}" for kind, example in faults.items())

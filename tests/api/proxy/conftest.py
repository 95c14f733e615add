"""Stations behind a real nginx, under a path."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import httpx2
import pytest

from tests.api.conftest import Served
from tests.api.held.setup_files import setup_files
from tests.api.held_station import HeldStation
from tests.api.proxy.nginx import before, documented
from tests.api.web.conftest import browser, page  # noqa: F401  (fixtures)
from tests.peers.certificates import make_certificate
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile


class SetUp(NamedTuple):
    """How the path is stated to nginx and to the station."""

    prefix: str
    location: str
    root_path: str = ""
    tls: bool = False


class Prefixed(NamedTuple):
    """A station behind nginx, under a path."""

    prefix: str
    station: HeldStation
    served: Served
    client: httpx2.Client
    """Its requests have the key of an administrator."""
    secret: str
    audit: AuditLog
    keys: Path
    ca: Path | None

    @property
    def url(self) -> str:
        """Address of the station as its callers know it."""
        return f"{self.client.base_url}".rstrip("/") + self.prefix


STRIPPED, UNCHANGED = documented("administrator.md")
SET_UPS = {
    "stripped, TLS": SetUp("/aoi", STRIPPED, tls=True),
    "stripped, several names": SetUp("/plant_1/line-3.a", STRIPPED.replace("/aoi", "/plant_1/line-3.a")),
    "unchanged": SetUp("/aoi", UNCHANGED, "/aoi"),
}


@pytest.fixture(scope="module")
def start(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[[str], Prefixed]]:
    """A function that returns the station of one of the `SET_UPS`."""
    known: dict[str, Prefixed] = {}
    with ExitStack() as parts:

        def started(name: str) -> Prefixed:
            if name not in known:
                known[name] = _started(SET_UPS[name], tmp_path_factory.mktemp("nginx"), parts)
            return known[name]

        yield started


@pytest.fixture(params=SET_UPS)
def prefixed(request: pytest.FixtureRequest, start: Callable[[str], Prefixed]) -> Prefixed:
    return start(request.param)


def _started(wanted: SetUp, folder: Path, parts: ExitStack) -> Prefixed:
    keys, audit = KeyFile(folder / "keys.json"), AuditLog(folder / "audit.jsonl")
    parts.callback(audit.close)
    station = HeldStation()
    station.film()
    access = AccessControl(keys, audit)
    files = setup_files(folder)
    served = Served(station, access=access, files=files, root_path=wanted.root_path)
    parts.callback(served.stop)
    certificate = make_certificate(folder) if wanted.tls else None
    client = parts.enter_context(before(served.port, wanted.location, folder, certificate))
    ca = None if certificate is None else certificate.certificate
    secret = keys.create("engineer", ["operate", "teach", "admin"]).secret
    client.headers["authorization"] = f"Bearer {secret}"
    return Prefixed(wanted.prefix, station, served, client, secret, audit, keys.path, ca)

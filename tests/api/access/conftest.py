"""A service with keys, called from loopback or from elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from vaoi_station.api import create_app
from vaoi_station.api.access.access_control import AccessControl
from vaoi_station.api.access.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile

MakeClient = Callable[..., TestClient]


@pytest.fixture
def keys(tmp_path: Path) -> KeyFile:
    return KeyFile(tmp_path / "keys.json")


@pytest.fixture
def audit(tmp_path: Path) -> Iterator[AuditLog]:
    log = AuditLog(tmp_path / "audit.jsonl")
    yield log
    log.close()


@pytest.fixture
def call_from(station: Any, keys: KeyFile, audit: AuditLog) -> Iterator[MakeClient]:
    """Return a function that makes a client with an address, and perhaps a key."""
    access = AccessControl(keys, audit)
    app = create_app(station, ["testserver"], access)
    with ExitStack() as opened:
        opened.enter_context(TestClient(app))

        def made(address: str, secret: str | None = None, open_loopback: bool = True) -> TestClient:
            access._open_loopback = open_loopback
            headers = {} if secret is None else {"authorization": f"Bearer {secret}"}
            return TestClient(app, client=(address, 5000), headers=headers, raise_server_exceptions=False)

        yield made

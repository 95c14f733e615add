"""The samples of the guide for tester authors work as described."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.clients import guide_sample
from tests.needs import need
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile
from vaoi_station.files.images import read_image


class Keyed(Served):
    """A station, and the key with which the samples call it; empty if they need none."""

    key = ""


@pytest.fixture(params=["open", "guarded"])
def served(request: pytest.FixtureRequest, station: HeldStation, tmp_path: Path) -> Iterator[Keyed]:
    """A station that callers on its own machine reach without a key, and one that needs one."""
    keys, audit = KeyFile(tmp_path / "keys.json"), AuditLog(tmp_path / "audit.jsonl")
    guarded = request.param == "guarded"
    served = Keyed(station, access=AccessControl(keys, audit, open_loopback=not guarded))
    served.key = keys.create("guide", ["operate"]).secret if guarded else ""
    yield served
    served.stop()
    audit.close()


@contextmanager
def boards_pass(served: Any, count: int) -> Iterator[None]:
    """Let boards pass whenever a request waits for one."""

    over = threading.Event()

    def pass_by() -> None:
        for _ in range(count):
            seen = len(served.station.filmed)
            while served.app.state.hub.waiting == 0:
                if over.is_set():
                    return
                served.client.get("/healthz")
            served.station.film()
            assert len(served.station.filmed) == seen + 1

    with ThreadPoolExecutor(1) as pool:
        passing = pool.submit(pass_by)
        try:
            yield
            passing.result()
        finally:
            over.set()


def run(command: list[str], served: Any, directory: Path) -> str:
    environment = {**os.environ, "VAOI_STATION": served.url, "VAOI_KEY": served.key, "PYTHONWARNINGS": "error"}
    done = subprocess.run(
        command, cwd=directory, env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_python(served: Any, tmp_path: Path) -> None:
    (tmp_path / "tester.py").write_text(guide_sample("python"))
    with boards_pass(served, 1):
        found = run([sys.executable, "tester.py", "demo-board", "2/R1"], served, tmp_path)
    assert "run r000001: ok\n  camera 0 row 3: 16 x 10, mean " in found
    assert [r.state for r in served.station.filmed.values()] == ["released"]
    assert served.station.state == "idle"


def test_python_shows_refusals(served: Any, tmp_path: Path) -> None:
    (tmp_path / "tester.py").write_text(guide_sample("python"))
    with pytest.raises(AssertionError, match="There is no board type 'unheard'"):
        run([sys.executable, "tester.py", "unheard", "U1"], served, tmp_path)


def test_curl(served: Any, tmp_path: Path) -> None:
    need("curl")
    with boards_pass(served, 1):
        run(["sh", "-eu", "-c", guide_sample("sh")], served, tmp_path)
    assert read_image(tmp_path / "U1.png").shape == (64, 80)
    assert cv2.imdecode(np.fromfile(tmp_path / "U1.jpg", np.uint8), cv2.IMREAD_UNCHANGED) is not None
    assert "released" in (tmp_path / "released.json").read_text()


def test_c(served: Any, tmp_path: Path) -> None:
    need("cc", "curl/curl.h")
    (tmp_path / "tester.c").write_text(guide_sample("c"))
    run(["cc", "-Wall", "-Wextra", "-Werror", "tester.c", "-o", "tester", "-lcurl"], served, tmp_path)
    found = run([str(tmp_path / "tester"), served.station.film(), "U1"], served, tmp_path)
    assert found == "80 x 64, 80 bytes per line, 5120 bytes\n"

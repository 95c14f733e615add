"""Start and end a process that stands in for the service."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from vaoi_station.demo import service as service_module
from vaoi_station.demo.service import Service
from vaoi_station.errors import DeviceError

PYTHON = sys.executable
LISTENING = """
import signal, sys
signal.pthread_sigmask(signal.SIG_BLOCK, {{signal.SIGTERM}})
print("listening on http://127.0.0.1:1", flush=True)
signal.sigwait({{signal.SIGTERM}})
sys.exit({code!r})
"""
"""A program that waits with `sigwait`: `pause` would wait for ever after a signal that comes just before it."""


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A program that is started in place of Python; the test writes its text."""
    path = tmp_path / "program"
    monkeypatch.setattr(sys, "executable", str(path))
    return path


def write(script: Path, text: str) -> Path:
    """Make the script an executable Python program."""
    script.write_text(f"#!{PYTHON}\n{text}\n")
    script.chmod(0o755)
    return script


def test_address_comes_from_the_log_and_the_process_ends_with_the_block(script: Path) -> None:
    write(script, LISTENING.format(code=0))
    with Service(script.with_name("station.toml")) as running:
        assert running.address == "http://127.0.0.1:1"
        pid = running.pid
        assert Path(f"/proc/{pid}").exists()
    assert not Path(f"/proc/{pid}").exists()
    assert "listening on" in running.log


def test_service_that_ends_before_it_listens_is_an_error(script: Path) -> None:
    write(script, "raise SystemExit('no such file')")
    started = Service(script.with_name("station.toml"))
    with pytest.raises(DeviceError, match="did not start; its last log line: no such file"), started:
        pass
    assert not Path(f"/proc/{started.pid}").exists()


def test_service_that_does_not_listen_in_time_is_killed(script: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(service_module, "START_S", 0.05)
    monkeypatch.setattr(service_module, "END_S", 0.05)
    write(script, "import signal; signal.signal(15, signal.SIG_IGN); signal.pause()")
    started = Service(script.with_name("station.toml"))
    with pytest.raises(DeviceError, match="does not listen after 0 s"), started:
        pass
    assert not Path(f"/proc/{started.pid}").exists()


def test_a_configuration_that_the_service_refuses_is_the_last_log_line(tmp_path: Path) -> None:
    service = Service(tmp_path / "station.toml")
    with pytest.raises(DeviceError, match=r"did not start; .*station.toml: there is no such file"), service:
        pass
    assert not Path(f"/proc/{service.pid}").exists()


def test_the_demo_imports_nothing_that_only_its_service_needs() -> None:
    program = """
import sys
import vaoi_station.demo.boards
print(*{"fastapi", "numba", "vaoi_station.station"} & sys.modules.keys())
"""
    done = subprocess.run([PYTHON, "-c", program], stdout=subprocess.PIPE, text=True, check=True)
    assert done.stdout == "\n"

"""Check interpreter, libraries and the cache for compiled code."""

from __future__ import annotations

import os
import pwd
import re
import sys
from pathlib import Path

import pytest

from tests.doctor.conftest import assert_problem, only, without_privileges
from vaoi_station.doctor.checks import software
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine


@pytest.mark.parametrize(
    ("version", "bits", "level"),
    [((3, 10), 64, Level.FAULT), ((3, 11), 64, Level.OK), ((3, 13), 64, Level.OK), ((3, 14), 64, Level.FAULT),
     ((3, 12), 32, Level.FAULT)],
)  # fmt: skip
def test_supported_interpreters(version: tuple[int, int], bits: int, level: Level) -> None:
    assert software.judge_python(version, bits, "x", "/usr/bin/python3").level is level


def test_this_interpreter_is_ok() -> None:
    assert only(software.python(Machine())).level is Level.OK


def test_supported_range_is_that_of_the_package() -> None:
    project = (Path(__file__).parents[3] / "pyproject.toml").read_text()
    oldest, untried = (".".join(map(str, v)) for v in (software.OLDEST, software.FIRST_UNTRIED))
    assert f'requires-python = ">={oldest},<{untried}"' in project


def test_present_libraries_are_reported_with_their_versions() -> None:
    finding = only(software.libraries(Machine()))
    assert finding.level is Level.OK
    assert set(finding.figures) == set(software.LIBRARIES)


def test_absent_library_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)  # an entry of None makes the import fail
    assert_problem(only(software.libraries(Machine())), Level.FAULT, "numba cannot be imported")


def test_no_writable_cache_for_compiled_code_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    assert software.judge_cache(str(tmp_path), locked, locked).level is Level.OK
    for given in (str(locked / "cache"), None):
        with without_privileges():
            finding = software.judge_cache(given, locked / "package", locked / "home")
        assert_problem(finding, Level.WARNING, "every start compiles")


def test_cache_beside_the_package_comes_first(tmp_path: Path) -> None:
    finding = software.judge_cache(None, tmp_path / "package", tmp_path / "home")
    assert finding.message == f"is stored in {tmp_path / 'package' / '__pycache__'}"


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A machine whose unit runs this environment as this user; its cache is `cache` in the folder returned."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    units = tmp_path / "usr/lib/systemd/system"
    units.mkdir(parents=True)
    unit = (Path(__file__).parents[3] / "deploy/vaoi-station.service").read_text()
    user = pwd.getpwuid(os.getuid()).pw_name
    for old, new in (
        ("/opt/vaoi-station/venv", sys.prefix),
        ("User=vaoi", f"User={user}"),
        ("/var/cache/vaoi-station", f"{tmp_path}/cache"),
    ):
        assert old in unit
        unit = unit.replace(old, new)
    (units / software.UNIT).write_text(unit)
    return tmp_path


def test_the_cache_is_that_of_the_service_whoever_runs_the_doctor(installed: Path) -> None:
    finding = only(software.compiled_code_cache(Machine(installed)))
    assert (finding.level, finding.message) == (Level.OK, f"will be stored in {installed}/cache by the service")
    (installed / "cache").mkdir()
    assert (
        only(software.compiled_code_cache(Machine(installed))).message
        == f"is stored in {installed}/cache by the service"
    )


def test_a_cache_that_the_user_of_the_service_cannot_write_is_a_warning_for_root_too(installed: Path) -> None:
    (installed / "cache").mkdir(mode=0o755)
    unit = installed / "usr/lib/systemd/system" / software.UNIT
    unit.write_text(re.sub(r"(?m)^User=.*$", "User=daemon", unit.read_text()))
    finding = only(software.compiled_code_cache(Machine(installed)))
    assert_problem(finding, Level.WARNING, "cannot be written to by daemon")
    assert finding.action == f"install -d -o daemon -g daemon -m 750 {installed}/cache"


def test_the_unit_of_another_installation_does_not_count(installed: Path) -> None:
    unit = installed / "usr/lib/systemd/system" / software.UNIT
    unit.write_text(unit.read_text().replace(f"ExecStart={sys.prefix}", "ExecStart=/opt/other"))
    assert "by the service" not in only(software.compiled_code_cache(Machine(installed))).message


def test_a_user_of_the_service_that_does_not_exist_is_a_fault() -> None:
    finding = software.judge_cache_of_service(software.ServiceUnit("no-such-user", Path("/")))
    assert_problem(finding, Level.FAULT, "no-such-user of the service does not exist")

"""Check interpreter, libraries and the cache for compiled code."""

from __future__ import annotations

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

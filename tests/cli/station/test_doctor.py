"""`vaoi doctor` as text and as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import Result
from vaoi_station import doctor
from vaoi_station.doctor.finding import Finding, Report, fault, ok, warning


@pytest.mark.parametrize(
    ("finding", "code"),
    [(ok("fine"), 0), (warning("slow", "Hurry.", code="x"), 1), (fault("broken", "Repair it.", code="x"), 2)],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_exit_code_and_output(
    vaoi: Callable[..., Result], monkeypatch: pytest.MonkeyPatch, finding: Finding, code: int, as_json: bool
) -> None:
    report = Report("s", "station.toml", "2026-01-01T00:00:00+00:00", "host", "1.0", None, (finding,))
    monkeypatch.setattr(doctor, "run_checks", lambda *_, **__: report)
    done = vaoi("doctor", *(["--json"] if as_json else []))
    assert (done.code, done.err) == (code, "")
    assert finding.message in done.out
    if as_json:
        assert json.loads(done.out) == report.document()


def test_machine_is_checked_without_a_configuration(vaoi: Callable[..., Result], tmp_path: Path) -> None:
    done = vaoi("doctor", "--config", tmp_path / "none.toml")
    assert done.code == 2
    assert "none.toml: there is no such file" in done.out
    assert " compiled code " in done.out

"""Check the station's own certificate; every fault is made for real."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.doctor.conftest import assert_problem, only, with_config, without_privileges
from tests.peers.certificates import Certificate, make_certificate
from vaoi_station.config import ApiConfig
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks.station_certificate import station_certificate
from vaoi_station.doctor.finding import Level


def with_certificate(context: CheckContext, made: Certificate) -> CheckContext:
    api = ApiConfig(certificate=made.certificate, private_key=made.private_key)
    return with_config(context, context.config.model_copy(update={"api": api}))


def test_a_station_without_tls_needs_no_check(context: CheckContext) -> None:
    assert only(station_certificate(context)).level is Level.NOT_APPLICABLE


@pytest.mark.parametrize(("days", "level", "word"), [(400, Level.OK, "valid until"), (20, Level.WARNING, "refuse it")])
def test_the_end_of_a_certificate_is_announced(
    context: CheckContext, tmp_path: Path, days: int, level: Level, word: str
) -> None:
    finding = only(station_certificate(with_certificate(context, make_certificate(tmp_path, days=days))))
    assert finding.level is level
    assert word in finding.message
    assert finding.code == ("certificate-expires" if level is Level.WARNING else "")
    assert finding.figures["days"] == pytest.approx(days, abs=1)


def test_files_that_are_absent_or_do_not_fit_each_other_are_a_fault(context: CheckContext, tmp_path: Path) -> None:
    made = make_certificate(tmp_path)
    other = make_certificate(tmp_path, "other")
    for wrong in (
        Certificate(made.certificate, tmp_path / "absent.key"),
        Certificate(made.certificate, other.private_key),
        Certificate(made.private_key, made.private_key),
    ):
        finding = only(station_certificate(with_certificate(context, wrong)))
        assert_problem(finding, Level.FAULT, "[api] certificate", "cannot be used")
        assert finding.code == "certificate-unusable"


def test_a_key_that_the_service_cannot_read_is_a_fault(context: CheckContext, tmp_path: Path) -> None:
    made = make_certificate(tmp_path)
    made.private_key.chmod(0)
    with without_privileges():
        finding = only(station_certificate(with_certificate(context, made)))
    assert_problem(finding, Level.FAULT, "Permission denied")


def test_a_key_that_every_user_can_read_is_named(context: CheckContext, tmp_path: Path) -> None:
    made = make_certificate(tmp_path, days=400)
    made.private_key.chmod(0o644)
    private, valid = station_certificate(with_certificate(context, made))
    assert_problem(private, Level.WARNING, "private key", "every user")
    assert valid.level is Level.OK

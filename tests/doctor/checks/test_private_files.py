"""Who may read a file with a secret."""

from __future__ import annotations

from pathlib import Path

from tests.doctor.conftest import assert_problem, only
from vaoi_station.doctor.checks.private_files import readable_by_others
from vaoi_station.doctor.finding import Level


def test_only_a_file_that_every_user_can_read_is_named(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.touch(0o600)
    secret.chmod(0o640)
    assert list(readable_by_others(secret, "the secret", "mes")) == []
    secret.chmod(0o644)
    finding = only(readable_by_others(secret, "the secret", "mes"))
    assert_problem(finding, Level.WARNING, "the secret", str(secret))
    assert finding.action == f"chmod o= {secret}"
    assert finding.code == "secret-not-private"

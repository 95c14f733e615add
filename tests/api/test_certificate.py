"""The certificate files: read at the start, read again when they change, and kept when the new ones cannot be used."""

from __future__ import annotations

import logging
import shutil
import subprocess
from datetime import UTC, datetime
from pathlib import Path

import pytest

from tests.peers.certificates import Certificate, make_certificate
from vaoi_station.api.certificate import CertificateFiles, valid_until
from vaoi_station.errors import InputError


@pytest.fixture
def certificate(tmp_path: Path) -> Certificate:
    return make_certificate(tmp_path)


def test_a_pair_that_does_not_fit_yet_leaves_the_present_one_in_use(
    certificate: Certificate, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    files, renewed = CertificateFiles(*certificate), make_certificate(tmp_path, "renewed")
    before = files._current
    shutil.copy(renewed.certificate, certificate.certificate)
    files.refresh()
    assert files._current is before
    assert "stays as it was" in caplog.text
    with caplog.at_level(logging.INFO):
        shutil.copy(renewed.private_key, certificate.private_key)
        files.refresh()
    assert files._current is not before
    assert "read again" in caplog.text


def test_an_encrypted_key_is_refused_without_asking_for_its_password(certificate: Certificate, tmp_path: Path) -> None:
    locked = tmp_path / "locked.key"
    command = [
        "openssl",
        "ec",
        "-aes256",
        "-passout",
        "pass:x",
        "-in",
        str(certificate.private_key),
        "-out",
        str(locked),
    ]
    subprocess.run(command, check=True, capture_output=True)
    with pytest.raises(InputError, match="not encrypted"):
        CertificateFiles(certificate.certificate, locked)


@pytest.mark.parametrize("days", [1, 20000])
def test_the_end_of_a_certificate_is_that_which_openssl_states(tmp_path: Path, days: int) -> None:
    """Up to 2049 the year has two digits in a certificate, later four. Of a chain, the first certificate counts."""
    path, chain = make_certificate(tmp_path, days=days).certificate, tmp_path / "chain.pem"
    authority = make_certificate(tmp_path, "authority").certificate
    chain.write_text(f"# the station's\n{path.read_text()}{authority.read_text()}")
    asked = ["openssl", "x509", "-in", str(path), "-noout", "-enddate"]
    stated = subprocess.run(asked, check=True, capture_output=True, text=True).stdout.strip()
    assert valid_until(chain) == datetime.strptime(stated, "notAfter=%b %d %H:%M:%S %Y GMT").replace(tzinfo=UTC)

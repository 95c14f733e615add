"""Certificates for tests: an authority, and stations whose certificates it has signed."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import NamedTuple

_NEW_KEY = "openssl req -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes"

# Python 3.13 refuses certificates without this extension (VERIFY_X509_STRICT).
_USAGE = ["-addext", "keyUsage=critical,digitalSignature,keyCertSign,cRLSign"]


class Certificate(NamedTuple):
    """A certificate and its private key, as PEM files."""

    certificate: Path
    private_key: Path


def make_certificate(
    folder: Path, name: str = "station", authority: Certificate | None = None, *, days: int = 2
) -> Certificate:
    """Make a certificate for localhost and 127.0.0.1, signed by the authority or by itself."""
    made = Certificate(folder / f"{name}.pem", folder / f"{name}.key")
    names = ["-addext", "subjectAltName=IP:127.0.0.1,DNS:localhost"]
    files = ["-keyout", str(made.private_key), "-out", str(made.certificate)]
    signed = ["-days", str(days), "-x509", *_USAGE]
    if authority is not None:
        signed += ["-CA", str(authority.certificate), "-CAkey", str(authority.private_key)]
    _run([*_NEW_KEY.split(), "-subj", f"/CN={name}", *names, *signed, *files])
    return made


def make_authority(folder: Path, name: str = "authority") -> Certificate:
    """Make the certificate of an authority."""
    made = Certificate(folder / f"{name}.pem", folder / f"{name}.key")
    files = ["-keyout", str(made.private_key), "-out", str(made.certificate)]
    _run([*_NEW_KEY.split(), "-x509", "-days", "2", "-subj", f"/CN={name}", *_USAGE, *files])
    return made


def _run(command: list[str]) -> None:
    subprocess.run(command, check=True, capture_output=True)

"""The credentials of a program for a station: the caller's key, and the certificates that the program trusts.

A key is never an argument of a command: every user of the machine can read the arguments of all processes. It comes
from a file, or from the environment, which only the same user can read.
"""

from __future__ import annotations

import os
import ssl
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from vaoi_station.errors import InputError
from vaoi_station.files.documents import text_of

KEY_VARIABLE, KEY_FILE_VARIABLE, CA_VARIABLE = "VAOI_KEY", "VAOI_KEY_FILE", "VAOI_CA"
_LONGEST = 200
"""Longest accepted key in characters; those of a station have 61."""
_MOST_BYTES = 1024
"""How much of a key file is read, bytes: more than the longest key in UTF-16."""


@dataclass(frozen=True)
class CallerCredentials:
    """A key, and the certificates that are trusted."""

    key: str | None = field(default=None, repr=False)
    ca: Path | None = None
    """PEM file with the certificate of the authority, or of the station itself; None: those of the system are
    trusted."""

    def headers(self) -> dict[str, str]:
        """Return the HTTP headers by which a request states the caller's key."""
        return {} if self.key is None else {"Authorization": f"Bearer {self.key}"}

    def tls_context(self) -> ssl.SSLContext:
        """Return the TLS settings that check the certificate of a station; raise InputError if `ca` cannot be used."""
        try:
            context = ssl.create_default_context(cafile=None if self.ca is None else str(self.ca))
        except (OSError, ssl.SSLError) as error:
            raise InputError(
                f"{self.ca}: cannot be used as a trusted certificate ({error}).",
                action="Give a PEM file with the certificate of the authority, or of the station itself.",
            ) from error
        # Trusts the certificate of a station that no authority has signed, as Python 3.13 does by default.
        context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
        return context


def caller_credentials(
    key_file: Path | None = None,
    ca: Path | None = None,
    *,
    key: str | None = None,
    environment: Mapping[str, str] = os.environ,
) -> CallerCredentials:
    """Return the credentials from arguments or, for those that are not given, from the environment.

    Args:
        key_file: file that holds the key and nothing else.
        ca: PEM file with the trusted certificates.
        key: the key itself; has precedence over `key_file`.
        environment: its `VAOI_KEY`, `VAOI_KEY_FILE` and `VAOI_CA` are used.

    Raises:
        InputError: the file cannot be read, or what it holds cannot be a key. The message does not show it.
    """
    if ca is None and environment.get(CA_VARIABLE):
        ca = Path(environment[CA_VARIABLE])
    if key is not None:
        return CallerCredentials(_checked(key, "key"), ca)
    if key_file is not None:
        return CallerCredentials(_read(key_file, "key file"), ca)
    if environment.get(KEY_VARIABLE):
        return CallerCredentials(_checked(environment[KEY_VARIABLE], KEY_VARIABLE), ca)
    if environment.get(KEY_FILE_VARIABLE):
        return CallerCredentials(_read(Path(environment[KEY_FILE_VARIABLE]), KEY_FILE_VARIABLE), ca)
    return CallerCredentials(None, ca)


def _read(path: Path, where: str) -> str:
    try:
        with path.open("rb") as file:
            content = file.read(_MOST_BYTES)
    except OSError as error:
        raise InputError(
            f"{where} {path}: cannot be read ({error.strerror}).",
            action="Write the key that vaoi keys create has printed to a file that only you can read.",
        ) from error
    return _checked(text_of(content, f"{where} {path}", "replace"), f"{where} {path}")


def _checked(text: str, where: str) -> str:
    key = text.strip()
    # Other characters would end the header of the request, and with it begin another one.
    if not key or len(key) > _LONGEST or not key.isascii() or not key.isprintable() or " " in key:
        raise InputError(
            f"{where}: holds {len(key)} characters that are not one key (one word, at most {_LONGEST} characters).",
            action="Give the key as vaoi keys create has printed it.",
        )
    return key

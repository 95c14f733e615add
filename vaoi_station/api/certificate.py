"""The certificate of the station and its private key, read again when their files change."""

from __future__ import annotations

import logging
import ssl
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from vaoi_station.errors import InputError

_log = logging.getLogger(__name__)
RENEW_S = 5.0
"""Time between two checks whether the certificate's files have changed, s."""
_VERSION, _SHORT_TIME = 0xA0, 0x17
"""Tags of ASN.1: the version of a certificate; a time with two digits for its year."""


class CertificateFiles:
    """The certificate of new connections. Connections that are open keep the one they began with."""

    def __init__(self, certificate: Path, private_key: Path | None) -> None:
        """Read both files. If they cannot be used, raise an InputError that names them."""
        self._certificate, self._private_key = certificate, private_key
        self._state = self._present()
        self._current = self.context = self._read()
        """`context` is the one that a server is given; every handshake continues with the current one."""
        self.context.sni_callback = self._use_current

    def _use_current(self, connection: ssl.SSLObject, _name: str | None, _context: ssl.SSLContext) -> None:
        connection.context = self._current

    def refresh(self) -> None:
        """Read the files again if they have changed. If they cannot be used, the present certificate stays in use.

        It may wait for the disk, so the event loop calls it in another thread.
        """
        state = self._present()
        if state == self._state:
            return
        # Recorded before the files are read: what is written meanwhile is read the next time.
        self._state = state
        try:
            # A new context: of a pair that does not fit, the old one would take the certificate and then fail.
            self._current = self._read()
        except InputError as error:
            _log.warning("the certificate has changed but stays as it was: %s", error)
        else:
            _log.info("the certificate was read again from %s", self._certificate)

    def _present(self) -> tuple[tuple[int, ...], ...]:
        return tuple(_state(path) for path in (self._certificate, self._private_key) if path is not None)

    def _read(self) -> ssl.SSLContext:
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        try:
            # Without this, OpenSSL asks on the terminal for the password of an encrypted key, and the service hangs.
            context.load_cert_chain(self._certificate, self._private_key, password=_no_password)
        except (OSError, ssl.SSLError, ValueError) as error:
            raise InputError(
                f"[api] certificate {self._certificate}, private_key {self._private_key}: cannot be used ({error}).",
                action="Give a certificate and its private key, not encrypted, as PEM files that the service can read.",
            ) from error
        return context


def valid_until(certificate: Path) -> datetime | None:
    """Return the end of the validity of the first certificate in a PEM file; None if the file has none that is plain.

    Python reads this date only from the certificate of a connection that it trusts, so it is read here (RFC 5280, 4.1).
    """
    text = certificate.read_text("utf-8", errors="replace")
    begin, end = text.find(ssl.PEM_HEADER), text.find(ssl.PEM_FOOTER)
    if not 0 <= begin < end:
        return None
    ((_, whole),) = _members(ssl.PEM_cert_to_DER_cert(text[begin : end + len(ssl.PEM_FOOTER)]))
    (_, signed), *_ = _members(whole)
    # The version stands first, with a tag of its own, and is left out in certificates of version 1.
    _number, _algorithm, _issuer, (_, validity), *_ = (member for member in _members(signed) if member[0] != _VERSION)
    _, (tag, time) = _members(validity)
    digits = time.decode("ascii")
    if tag == _SHORT_TIME:
        digits = ("19" if digits[:2] >= "50" else "20") + digits
    return datetime.strptime(digits, "%Y%m%d%H%M%SZ").replace(tzinfo=UTC)


def _members(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield tag and content of all members of a sequence in DER."""
    at = 0
    while at < len(content):
        tag, length, at = content[at], content[at + 1], at + 2
        if length & 0x80:  # the number of bytes that state the length
            at, length = at + (length & 0x7F), int.from_bytes(content[at : at + (length & 0x7F)])
        yield tag, content[at : at + length]
        at += length


def _no_password() -> bytes:
    return b""


def _state(path: Path) -> tuple[int, ...]:
    try:
        status = path.stat()
    except OSError:
        return ()
    return (status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino)

"""The certificate of the station and its private key, read again when their files change."""

from __future__ import annotations

import logging
import ssl
from pathlib import Path

from vaoi_station.errors import InputError

_log = logging.getLogger(__name__)
RENEW_S = 5.0
"""Time between two checks whether the certificate's files have changed, s."""


class CertificateFiles:
    """The TLS settings for new connections. Connections that are open keep the certificate they began with."""

    def __init__(self, certificate: Path, private_key: Path | None) -> None:
        """Read both files. If they cannot be used, raise an InputError that names them."""
        self._certificate, self._private_key = certificate, private_key
        self._state = self._present()
        self.context = self._read()

    def refresh(self) -> None:
        """Read the files again if they have changed. If they cannot be used, the present certificate stays in use.

        May wait for the disk, so the event loop calls it in another thread.
        """
        state = self._present()
        if state == self._state:
            return
        # Recorded before the files are read: what is written meanwhile is read the next time.
        self._state = state
        try:
            # A new context: of a pair that does not fit, the old one would take the certificate and then fail.
            self.context = self._read()
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


def _no_password() -> bytes:
    return b""


def _state(path: Path) -> tuple[int, ...]:
    try:
        status = path.stat()
    except OSError:
        return ()
    return (status.st_mtime_ns, status.st_ctime_ns, status.st_size, status.st_ino)

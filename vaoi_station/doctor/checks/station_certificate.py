"""Check the certificate with which the station speaks TLS: the service refuses to start with one that cannot be used.

Callers refuse one that has expired, so the check warns before.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

from vaoi_station.api.certificate import CertificateFiles, valid_until
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks.private_files import readable_by_others
from vaoi_station.doctor.finding import Figures, Finding, fault, not_applicable, ok, warning
from vaoi_station.errors import InputError

EARLY = timedelta(days=30)
"""Time before the end of a certificate from which on the check warns."""


def station_certificate(context: CheckContext) -> Iterator[Finding]:
    """Check that certificate and private key fit each other, who may read the key, and how long both are valid."""
    api = context.config.api
    if api.certificate is None or api.private_key is None:
        yield not_applicable("no certificate is configured: the station speaks HTTP without TLS")
        return
    try:
        CertificateFiles(api.certificate, api.private_key)
        end = valid_until(api.certificate)
    except InputError as error:
        yield fault(error.message, error.action, code="certificate-unusable")
        return
    yield from readable_by_others(api.private_key, "the private key of the station", "")
    if end is None:
        yield ok(f"{api.certificate} and its private key fit each other", figures={"path": str(api.certificate)})
        return
    left = end - datetime.now(UTC)
    date = f"{end:%Y-%m-%d %H:%M} UTC"
    figures: Figures = {"path": str(api.certificate), "days": left.days}
    if left < EARLY:
        yield warning(
            f"{api.certificate} is valid until {date} only: callers refuse it then.",
            "Replace certificate and private key; the station reads them again without a restart.",
            code="certificate-expires",
            figures=figures,
        )
    else:
        yield ok(f"{api.certificate} is valid until {date}", figures=figures)

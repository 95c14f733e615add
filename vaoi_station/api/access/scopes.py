"""The scope that each request needs."""

from __future__ import annotations

import re

from vaoi_station.files.access_keys import Scope

PUBLIC = re.compile(
    r"/?|/docs|/favicon\.ico|/(web|problems)/.*|/healthz|/readyz|/api/v1/(openapi(-3\.0|-c)?\.json|session)"
)
"""Addresses that need no key: the page itself, documentation, health for process supervisors, and the login."""
_ADMIN = re.compile(r"/api/v1/(keys|audit|settings|calibration/(artwork|layout|trial))(/.*)?")
_COMMANDS: tuple[tuple[re.Pattern[str], Scope], ...] = (
    (re.compile(r"/api/v1/station/(arm|disarm)"), "operate"),
    (re.compile(r"/api/v1/runs/[^/]+/(release|hold|pin|decision|identity/next-machine)"), "operate"),
    (re.compile(r"/api/v1/board-(types|data)/.+"), "teach"),
    (re.compile(r"/api/v1/cameras/[^/]+/trial"), "teach"),
)


def scope_needed(method: str, path: str) -> Scope | None:
    """Return the scope that a request needs; None if it needs no key."""
    if PUBLIC.fullmatch(path):
        return None
    if _ADMIN.fullmatch(path):
        return "admin"
    if method in ("GET", "HEAD", "OPTIONS"):
        return "read"
    # A command that is not listed needs the highest scope, so that a new command is not open by mistake.
    return next((scope for pattern, scope in _COMMANDS if pattern.fullmatch(path)), "admin")

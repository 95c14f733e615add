"""The webhooks that were made over REST, with their secrets, in one file that only the service can read.

A signing secret cannot be stored as a hash, as a key of a caller is: the station itself signs with it.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from vaoi_station.errors import NotFoundError, StateError, VaoiError
from vaoi_station.files.documents import check_format, parse, read_json, write_json
from vaoi_station.model.receivers import WebhookName, WebhookSettings
from vaoi_station.push.signing import MOST_SECRETS, new_secret
from vaoi_station.runs.states.schemas import Reason

_log = logging.getLogger(__name__)
FORMAT, VERSION = "vaoi-webhooks", 1


class Secret(BaseModel):
    """One signing secret, and until when it signs."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    secret: Annotated[str, Field(pattern=r"^whsec_[A-Za-z0-9+/=]{32,88}$", repr=False)]
    until_s: float | None = None
    """Time, s since 1970, from which it does not sign any more; None: no end."""


class StoredWebhook(BaseModel):
    """One webhook as stored; the newest secret is the first."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: WebhookName
    settings: WebhookSettings
    secrets: Annotated[tuple[Secret, ...], Field(min_length=1, max_length=MOST_SECRETS)]

    def valid_secrets(self) -> tuple[str, ...]:
        """Return the secrets that sign now."""
        now = time.time()
        return tuple(s.secret for s in self.secrets if s.until_s is None or s.until_s > now)

    def rotated(self, overlap_s: float) -> StoredWebhook:
        """Return the webhook with a new secret; those before sign for `overlap_s` more."""
        end, valid = time.time() + overlap_s, self.valid_secrets()
        old = [s for s in self.secrets if s.secret in valid][: MOST_SECRETS - 1]
        ended = [s.model_copy(update={"until_s": end if s.until_s is None else min(end, s.until_s)}) for s in old]
        return self.model_copy(update={"secrets": (Secret(secret=new_secret()), *ended)})


class _Stored(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    format: str = FORMAT
    version: int = VERSION
    webhooks: tuple[StoredWebhook, ...] = ()


class WebhookFile:
    """The file. Its methods may be called from any thread of the station."""

    def __init__(self, path: Path) -> None:
        """Read the file, if there is one.

        One that is damaged or cannot be read is not overwritten: `fault` states it, and the line goes on.
        """
        self._path, self._lock = path, threading.Lock()
        self._webhooks: dict[str, StoredWebhook] = {}
        self.fault: Reason | None = None
        """Why the webhooks of the file are not known; None if they are."""
        try:
            data = read_json(path)
            check_format(data, path, FORMAT, VERSION)
            self._webhooks = {w.name: w for w in parse(_Stored, data, path).webhooks}
        except NotFoundError:
            return
        except VaoiError as error:
            self.fault = _fault(path, error)
            _log.error("%s (%s)", self.fault.message, type(error).__name__)

    def all(self) -> tuple[StoredWebhook, ...]:
        """Return all webhooks, sorted by name."""
        return tuple(sorted(self._webhooks.values(), key=lambda w: w.name))

    def get(self, name: str) -> StoredWebhook | None:
        """Return a webhook; None if there is none."""
        return self._webhooks.get(name)

    def put(self, webhook: StoredWebhook) -> None:
        """Store a webhook, or replace the one of its name."""
        with self._lock:
            self._write({**self._webhooks, webhook.name: webhook})

    def delete(self, name: str) -> None:
        """Delete a webhook, if there is one."""
        with self._lock:
            self._write({n: w for n, w in self._webhooks.items() if n != name})

    def _write(self, webhooks: dict[str, StoredWebhook]) -> None:
        if self.fault is not None:
            raise StateError(self.fault.message, action=self.fault.action, code=self.fault.code)
        content = _Stored(webhooks=tuple(sorted(webhooks.values(), key=lambda w: w.name)))
        write_json(self._path, content.model_dump(mode="json"), mode=0o600)
        self._webhooks = webhooks


def _fault(path: Path, error: VaoiError) -> Reason:
    """Return why the webhooks of a file are not known."""
    refused = error.__cause__
    if isinstance(refused, OSError):
        return Reason(
            code="webhooks-unreadable",
            message=f"{path}: cannot be read by the user with uid {os.geteuid()} ({refused.strerror}); none of its "
            "webhooks is served.",
            action="Give it to the user of the service (chown, mode 0600) and restart the station; run vaoi doctor as "
            "this user or as root. It need not be restored.",
        )
    # What the file holds is secret, and a message about a wrong value shows the value.
    return Reason(
        code="webhooks-damaged",
        message=f"{path}: is damaged; none of its webhooks is served.",
        action="Restore it from a backup, or delete it and make the webhooks again; then restart the station.",
    )

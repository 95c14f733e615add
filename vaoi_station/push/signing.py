"""Signatures of webhooks by the Standard Webhooks specification: HMAC-SHA256, secrets `whsec_…`."""

from __future__ import annotations

import base64
import binascii
import hashlib
import hmac
import secrets
from collections.abc import Sequence
from pathlib import Path

from vaoi_station.errors import InputError
from vaoi_station.files.text_files import text_of

PREFIX = "whsec_"
SHORTEST, LONGEST = 24, 64
"""Limits of the specification for the size of a secret, bytes."""
MOST_SECRETS = 4
"""Largest number of secrets that sign one message."""
_MADE = 32
_LARGEST_FILE = 4096


def new_secret() -> str:
    """Return a new secret with 256 random bits."""
    return PREFIX + base64.b64encode(secrets.token_bytes(_MADE)).decode()


def secret_bytes(secret: str, where: str | Path) -> bytes:
    """Return the bytes of a secret.

    Raises:
        InputError: it is not one; the message does not show it.
    """
    try:
        if not secret.startswith(PREFIX):
            raise ValueError
        key = base64.b64decode(secret.removeprefix(PREFIX), validate=True)
    except (ValueError, binascii.Error):
        key = b""
    if not SHORTEST <= len(key) <= LONGEST:
        raise InputError(
            f"{where}: holds no signing secret; it must be {PREFIX} and {SHORTEST} to {LONGEST} bytes in base64.",
            action='Make one: printf "whsec_%s\\n" "$(openssl rand -base64 32)"',
        )
    return key


def read_secrets(path: Path) -> tuple[str, ...]:
    """Read the secrets of a file, one in each line.

    Raises:
        InputError: the file cannot be read, or holds something else.
    """
    try:
        with path.open("rb") as file:
            content = file.read(_LARGEST_FILE)
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}).", action="Make it readable to the service."
        ) from error
    lines = text_of(content, path, "replace").split()
    if not 1 <= len(lines) <= MOST_SECRETS:
        raise InputError(f"{path}: holds {len(lines)} secrets, but must hold 1 to {MOST_SECRETS}, one in each line.")
    for line in lines:
        secret_bytes(line, path)
    return tuple(lines)


def signatures(keys: Sequence[str], message_id: str, timestamp: int, body: bytes) -> str:
    """Return the value of the header `webhook-signature`: one signature for each secret."""
    content = f"{message_id}.{timestamp}.".encode() + body
    made = (hmac.new(secret_bytes(key, "secret"), content, hashlib.sha256).digest() for key in keys)
    return " ".join(f"v1,{base64.b64encode(digest).decode()}" for digest in made)

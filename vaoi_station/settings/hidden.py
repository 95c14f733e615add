"""Values of station.toml that may be secrets: they never leave the station.

The address of a receiver often is the secret by which it knows the sender, from its path on; that of an archive may
name a user and a password. Everything else that is secret lies in files of its own, which station.toml names.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

from vaoi_station.settings.edits import Edit, edit_toml
from vaoi_station.settings.statements import Path

MARK = "…"
"""Stands where something is hidden. No address of a receiver may hold it."""


def hidden_edits(data: dict[str, Any]) -> Iterator[Edit]:
    """Yield an edit for every value that must be hidden, with what is shown instead."""
    for path, url in _addresses(data):
        if (shown := _shown(url)) != url:
            yield Edit(path, shown)


def without_secrets(text: str, data: dict[str, Any]) -> str:
    """Return the text of a file with all secrets hidden; `data` is what the text says."""
    return edit_toml(text, list(hidden_edits(data)))


def _addresses(data: dict[str, Any]) -> Iterator[tuple[Path, str]]:
    push, archive = data.get("push"), data.get("archive")
    webhooks = push.get("webhooks") if isinstance(push, dict) else None
    for number, webhook in enumerate(webhooks if isinstance(webhooks, list) else ()):
        if isinstance(webhook, dict) and isinstance(webhook.get("url"), str):
            yield ("push", "webhooks", number, "url"), webhook["url"]
    if isinstance(archive, dict) and isinstance(archive.get("url"), str):
        yield ("archive", "url"), archive["url"]


def _shown(url: str) -> str:
    try:
        parts = urlsplit(url)
    except ValueError:
        return MARK
    host = parts.netloc.rpartition("@")[2]
    if parts.scheme in ("http", "https"):
        rest = url.split(parts.netloc, 1)[1] if parts.netloc else url
        return f"{parts.scheme}://{host}/{MARK}" if rest.strip("/") or "@" in parts.netloc else url
    if "@" in parts.netloc or parts.query:
        before = url.split("?", 1)[0].replace(parts.netloc, f"{MARK}@{host}" if "@" in parts.netloc else host, 1)
        return before + (f"?{MARK}" if parts.query else "")
    return url

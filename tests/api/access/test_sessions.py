"""Logins of pages: they end with time, with their key, and when there are too many."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.api.access import sessions as module
from vaoi_station.api.access.sessions import SESSION_S, Sessions
from vaoi_station.files.access_keys import KeyFile


def test_a_login_ends_after_its_time_and_with_its_key(tmp_path: Path) -> None:
    keys, now = KeyFile(tmp_path / "keys.json"), [0.0]
    key = keys.create("operator", ["operate"]).key
    sessions = Sessions(lambda: now[0])
    token = sessions.begin(key)
    assert sessions.key_of(token, keys.entries()) == key
    assert sessions.key_of(token + "x", keys.entries()) is None
    now[0] = SESSION_S
    assert sessions.key_of(token, keys.entries()) is None
    token = sessions.begin(key)
    keys.rotate("operator")
    assert sessions.key_of(token, keys.entries()) is None


def test_a_login_ends_when_the_page_logs_out_or_too_many_follow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST_SESSIONS", 2)
    keys = KeyFile(tmp_path / "keys.json")
    key = keys.create("operator", ["operate"]).key
    sessions = Sessions()
    first, second, third = (sessions.begin(key) for _ in range(3))
    sessions.end(third)
    assert [sessions.key_of(t, (key,)) is None for t in (first, second, third)] == [True, False, True]

from __future__ import annotations

import tomllib

import pytest

from vaoi_station.settings.hidden import hidden_edits, without_secrets

TEXT = """
[[push.webhooks]]
name = "chat"
url = "https://chat.example/hooks/T0/secret?key=1" # the chat
secret_file = "chat.secret"
[archive]
url = "sftp://user:word@store.example/runs"
"""


def test_addresses_show_their_hosts_only() -> None:
    shown = without_secrets(TEXT, tomllib.loads(TEXT))
    assert 'url = "https://chat.example/…" # the chat' in shown
    assert 'url = "sftp://…@store.example/runs"' in shown
    assert not any(word in shown for word in ("T0", "secret?", "key=1", "word"))


@pytest.mark.parametrize("url", ["/mnt/archive", "s3://bucket/runs", "http://127.0.0.1:9/"])
def test_what_holds_no_secret_stays(url: str) -> None:
    assert list(hidden_edits({"archive": {"url": url}})) == []


def test_values_of_another_type_are_left_to_the_check() -> None:
    assert list(hidden_edits({"push": {"webhooks": "no", "x": 1}, "archive": {"url": 3}})) == []
    assert [edit.value for edit in hidden_edits({"archive": {"url": "s3://b/?secret=1"}})] == ["s3://b/?…"]
    assert [edit.value for edit in hidden_edits({"archive": {"url": "http://[x"}})] == ["…"]

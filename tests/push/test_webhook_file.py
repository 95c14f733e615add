"""Webhooks that were made over REST are stored so that only the service reads them; secrets rotate."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from vaoi_station.errors import StateError
from vaoi_station.model.receivers import WebhookSettings
from vaoi_station.push.signing import MOST_SECRETS, new_secret
from vaoi_station.push.webhook_file import Secret, StoredWebhook, WebhookFile


def webhook(name: str = "mes") -> StoredWebhook:
    settings = WebhookSettings(url="http://127.0.0.1/hook", events=("run",))
    return StoredWebhook(name=name, settings=settings, secrets=(Secret(secret=new_secret()),))


def test_what_was_stored_is_read_again_and_only_the_service_may_read_it(tmp_path: Path) -> None:
    path, made = tmp_path / "push" / "webhooks.json", [webhook("b"), webhook("a")]
    file = WebhookFile(path)
    for each in made:
        file.put(each)
    again = WebhookFile(path)
    assert again.all() == (made[1], made[0])
    assert again.get("a") == made[1]
    assert path.stat().st_mode & 0o777 == 0o600
    file.delete("a")
    file.delete("a")
    assert [w.name for w in WebhookFile(path).all()] == ["b"]


def test_a_rotated_secret_signs_beside_the_one_before_for_a_while() -> None:
    first = webhook()
    second = first.rotated(3600.0)
    assert second.valid_secrets() == (second.secrets[0].secret, first.secrets[0].secret)
    assert second.rotated(0.0).valid_secrets()[1:] == ()
    often = second
    for _ in range(MOST_SECRETS):
        often = often.rotated(1e6)
    assert len(often.valid_secrets()) == MOST_SECRETS
    # A later rotation does not extend the time of a secret that ends.
    end = second.rotated(1e6).secrets[2].until_s
    assert end is not None
    assert end < time.time() + 3601


def test_a_damaged_file_is_kept_and_stated_without_its_content(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "webhooks.json"
    WebhookFile(path).put(webhook())
    document = json.loads(path.read_text())
    secret = document["webhooks"][0]["secrets"][0]["secret"]
    document["webhooks"][0]["secrets"][0]["secret"] = f"{secret} "
    path.write_text(damaged := json.dumps(document))
    file = WebhookFile(path)
    assert file.fault is not None
    assert file.fault.code == "webhooks-damaged"
    assert file.all() == ()
    with pytest.raises(StateError, match="is damaged"):
        file.put(webhook())
    assert path.read_text() == damaged
    assert secret not in caplog.text
    assert secret not in file.fault.message


def test_a_file_that_cannot_be_read_is_not_called_damaged(tmp_path: Path) -> None:
    path = tmp_path / "webhooks.json"
    path.mkdir()
    file = WebhookFile(path)
    assert file.fault is not None
    assert file.fault.code == "webhooks-unreadable"
    assert "cannot be read by the user with uid" in file.fault.message
    assert "(Is a directory)" in file.fault.message
    assert "backup" not in file.fault.action
    with pytest.raises(StateError, match="cannot be read"):
        file.put(webhook())


def test_a_secret_is_not_shown() -> None:
    made = webhook()
    assert made.secrets[0].secret not in repr(made)

"""docs/api/push.md: its receivers verify what the station sends, as printed; its settings and addresses exist."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.push.event_list import EventList
from vaoi_station.model.receivers import PushConfig
from vaoi_station.push import http_post
from vaoi_station.push.http_post import Route
from vaoi_station.push.messages import message_of
from vaoi_station.push.signing import new_secret, signatures
from vaoi_station.push.webhook_transport import WebhookTransport

GUIDE = Path(__file__).resolve().parents[3] / "docs" / "api" / "push.md"
SECRET = new_secret()
MESSAGE = message_of(EventList().add("run", "x", state="ready", run="01m7ykwxtb-52y1hr"), "line-3")


def sample(language: str) -> str:
    """Return the one block of a language."""
    [found] = re.findall(rf"^```{language}\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return str(found)


@pytest.fixture
def receiver(tmp_path: Path) -> Iterator[tuple[str, Any]]:
    """The printed receiver, as a program of its own."""
    (tmp_path / "receiver.py").write_text(sample("python"))
    environment = {**os.environ, "WEBHOOK_SECRET": SECRET}
    command = [sys.executable, "receiver.py", "0"]
    with subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        yield f"http://127.0.0.1:{program.stdout.readline().split()[1]}/", program.stdout
        program.terminate()


def test_the_printed_receiver_takes_signed_messages_once_and_no_others(receiver: tuple[str, Any]) -> None:
    url, printed = receiver
    other = new_secret()
    assert WebhookTransport(url, lambda: [SECRET]).send(MESSAGE).delivered
    assert WebhookTransport(url, lambda: [other, SECRET]).send(MESSAGE).delivered, "the second signature fits"
    assert "status 401" in WebhookTransport(url, lambda: [other]).send(MESSAGE).detail
    second = MESSAGE._replace(id="evt_2")
    assert WebhookTransport(url, lambda: [SECRET]).send(second).delivered
    old = int(time.time()) - 600
    headers = {"webhook-id": "evt_3", "webhook-timestamp": str(old)}
    headers["webhook-signature"] = signatures([SECRET], "evt_3", old, MESSAGE.body)
    for given in (headers, {}, {"webhook-id": "evt_3", "webhook-timestamp": "x", "webhook-signature": "v1,"}):
        assert http_post.post(url, given, MESSAGE.body, Route(None, (), 30.0)).status == 401
    assert [printed.readline() for _ in range(2)] == ["run.ready 01m7ykwxtb-52y1hr\n"] * 2


def test_the_printed_settings_are_valid() -> None:
    tables = tomllib.loads(sample("toml"))["push"]
    assert PushConfig.model_validate(tables).webhooks[0].name == "mes"

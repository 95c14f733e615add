"""Webhooks are signed by all valid secrets; refusals are worded without content of the receiver's answer."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.push.event_list import EventList
from tests.push.receiving import Receiver
from vaoi_station.errors import InputError
from vaoi_station.push.messages import message_of
from vaoi_station.push.signing import new_secret, signatures
from vaoi_station.push.webhook_transport import WebhookTransport

MESSAGE = message_of(EventList().add("run", "x", state="ready", run="r1"), "line-3")


def test_a_message_arrives_signed(target: Receiver) -> None:
    keys = [new_secret(), new_secret()]
    outcome = WebhookTransport(target.url, lambda: keys).send(MESSAGE)
    assert outcome.delivered
    headers, body = target.next()
    assert body == MESSAGE.body
    assert headers["webhook-id"] == MESSAGE.id
    assert headers["content-type"] == "application/json"
    timestamp = int(headers["webhook-timestamp"])
    assert headers["webhook-signature"] == signatures(keys, MESSAGE.id, timestamp, body)
    assert len(headers["webhook-signature"].split(" ")) == 2


@pytest.mark.parametrize(
    ("status", "headers", "words", "pause", "gone"),
    [
        (301, {"Location": "/"}, "redirects are not followed", 0.0, False),
        (410, {}, "status 410", 0.0, True),
        (429, {"Retry-After": "60"}, "status 429", 60.0, False),
        (500, {"Retry-After": "soon"}, "status 500", 0.0, False),
    ],
)
def test_other_answers_are_failures(
    target: Receiver, status: int, headers: dict[str, str], words: str, pause: float, gone: bool
) -> None:
    target.status, target.headers = status, headers
    outcome = WebhookTransport(target.url, lambda: [new_secret()]).send(MESSAGE)
    assert not outcome.delivered
    assert words in outcome.detail
    assert (outcome.retry_after_s, outcome.gone) == (pause, gone)


def test_faults_of_secrets_authorities_and_networks_are_failures(target: Receiver, tmp_path: Path) -> None:
    def no_secret() -> tuple[str, ...]:
        raise InputError("mes.secret: cannot be read.", action="Make it readable.")

    assert "mes.secret: cannot be read" in WebhookTransport(target.url, no_secret).send(MESSAGE).detail
    secure = target.url.replace("http:", "https:")
    (tmp_path / "ca.pem").write_text("no certificate")
    outcome = WebhookTransport(secure, lambda: [new_secret()], ca=tmp_path / "ca.pem").send(MESSAGE)
    assert "ca.pem: cannot be read as PEM certificates" in outcome.detail
    elsewhere = WebhookTransport(target.url, lambda: [new_secret()], ["192.0.2.0/24"])
    assert "push.networks" in elsewhere.send(MESSAGE).detail
    assert target.got.empty()

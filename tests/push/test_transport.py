"""Transports are what the delivery loop expects of them."""

from __future__ import annotations

from vaoi_station.push.transport import Outcome, Transport
from vaoi_station.push.webhook_transport import WebhookTransport


def test_a_webhook_needs_no_connection_between_messages() -> None:
    transport: Transport = WebhookTransport("http://127.0.0.1:9/", tuple)
    assert transport.idle() is None
    transport.close()


def test_an_outcome_asks_for_no_pause_unless_the_receiver_does() -> None:
    assert Outcome(False, "status 500") == Outcome(False, "status 500", retry_after_s=0.0, gone=False)

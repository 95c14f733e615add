"""Documents about webhooks show everything but secrets."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.api.receivers.models import WebhookRequest, entry_of, letters_of
from vaoi_station.model.receivers import RETRY_AFTER_S, WebhookSettings
from vaoi_station.push.delivery_state import DeadLetter, DeliveryState
from vaoi_station.runs.states.schemas import EventRecord


def test_a_request_gives_the_settings_of_a_webhook() -> None:
    request = WebhookRequest.model_validate({"url": "http://mes/hook", "events": ["run"]})
    assert request.settings() == WebhookSettings(url="http://mes/hook", events=("run",), retry_after_s=RETRY_AFTER_S)
    with pytest.raises(ValidationError, match="no user, no password"):
        WebhookRequest.model_validate({"url": "http://a:b@mes/"})


def test_an_entry_has_the_state_and_no_secret(push: Any) -> None:
    secret = push.put("mes", WebhookSettings(url="http://mes/hook"))
    delivery = push.webhook("mes").delivery
    entry = entry_of(push.webhook("mes"))
    assert (entry.state, entry.source, entry.secrets, entry.next_try) == ("delivering", "rest", 1, None)
    assert secret not in entry.model_dump_json()
    delivery._state = DeliveryState(last=3).failed("status 500", 0.0, 1e9).failed("status 500", 0.0, 1e9)
    entry = entry_of(push.webhook("mes"))
    assert (entry.state, entry.fault, entry.attempts) == ("failing", "status 500", 2)
    assert entry.next_try == "2001-09-09T01:46:40.000Z"
    delivery._state = delivery.state.model_copy(update={"disabled": "It is gone."})
    entry = entry_of(push.webhook("mes"))
    assert (entry.state, entry.fault, entry.next_try) == ("disabled", "It is gone.", None)


def test_dead_letters_have_their_event_and_its_type() -> None:
    event = EventRecord(number=7, time="2026-01-01T12:00:00.000Z", kind="run", state="ready")
    letter = DeadLetter(event=event, given_up="2026-01-04T12:00:00.000Z", attempts=10, fault="status 500")
    [entry] = letters_of(DeliveryState(last=7, letters=(letter,))).dead_letters
    assert (entry.number, entry.type, entry.fault) == (7, "run.ready", "status 500")

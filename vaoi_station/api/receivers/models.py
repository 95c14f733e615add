"""Documents about webhooks, and how they are made of the deliveries."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Literal

from pydantic import BaseModel, Field

from vaoi_station.model import Strict
from vaoi_station.model.receivers import RETRY_AFTER_S, EventType, Pause, Url, WebhookSettings
from vaoi_station.push.delivery_state import DeadLetter, DeliveryState
from vaoi_station.push.messages import type_of
from vaoi_station.push.push_service import Webhook
from vaoi_station.push.transport import Outcome
from vaoi_station.runs.states.schemas import EventRecord


class WebhookRequest(Strict):
    """Where the events go, and which events."""

    url: Url = Field(description="Address of the receiver, http or https.", max_length=2000)
    events: list[EventType] = Field(
        default=[], max_length=50, description="Types of events, as `run` or `run.ready`; empty for all."
    )
    retry_after_s: list[Pause] = Field(
        default=list(RETRY_AFTER_S),
        min_length=1,
        max_length=20,
        description="Pause before each further attempt; after the last one the message becomes a dead letter.",
    )

    def settings(self) -> WebhookSettings:
        """Return the settings that are asked for."""
        return WebhookSettings(url=self.url, events=tuple(self.events), retry_after_s=tuple(self.retry_after_s))


class WebhookEntry(BaseModel):
    """One webhook and how its deliveries do. Secrets are not shown."""

    name: str
    url: str
    events: list[str]
    retry_after_s: list[float]
    source: Literal["rest", "station.toml"] = Field(description="Where it is configured, and can be changed.")
    secrets: int = Field(description="Number of secrets that sign at present.")
    state: Literal["delivering", "failing", "disabled"]
    fault: str = Field(default="", description="Why the last attempt failed, or why the webhook is disabled.")
    last_event: int = Field(description="Number of the last event that had its turn.")
    waiting: int = Field(description="Number of events that have not had their turn.")
    delivered: int = Field(description="Number of messages that the receiver has accepted.")
    failures: int = Field(description="Number of attempts that failed.")
    skipped: int = Field(description="Number of events that were not sent because too many waited.")
    attempts: int = Field(description="Attempts that failed for the event whose turn it is.")
    last_success: str | None = None
    next_try: str | None = Field(default=None, description="Time of the next attempt after a failure.")
    dead_letters: int
    secret: str | None = Field(
        default=None, description="A secret that was just made. This reply is the only place where it can be read."
    )


class WebhookList(BaseModel):
    """All webhooks."""

    webhooks: list[WebhookEntry]


class SecretReply(BaseModel):
    """A new secret of a webhook."""

    name: str
    secret: str = Field(description="It signs from now on. This reply is the only place where it can be read.")


class DeliveryResult(BaseModel):
    """What became of one message that was sent on request."""

    delivered: bool
    detail: str = Field(description="The receiver's status, or why there was none.")


class DeadLetterEntry(BaseModel):
    """An event that was given up, because all attempts to deliver it failed."""

    number: int
    type: str
    given_up: str
    attempts: int
    fault: str
    event: EventRecord


class DeadLetterList(BaseModel):
    """The dead letters of a webhook, oldest first."""

    dead_letters: list[DeadLetterEntry]
    dropped: int = Field(description="Number of older dead letters that were dropped, because there were too many.")


def entry_of(webhook: Webhook, secret: str | None = None) -> WebhookEntry:
    """Return the document of a webhook."""
    delivery, settings = webhook.delivery, webhook.settings
    state = delivery.state
    return WebhookEntry(
        name=webhook.name,
        url=settings.url,
        events=list(settings.events),
        retry_after_s=list(settings.retry_after_s),
        source="station.toml" if webhook.from_file else "rest",
        secrets=webhook.secrets,
        state="disabled" if state.disabled else "failing" if delivery.is_failing else "delivering",
        fault=state.disabled or state.fault,
        last_event=state.last,
        waiting=delivery.waiting,
        delivered=state.delivered,
        failures=state.failures,
        skipped=state.skipped,
        attempts=state.attempts,
        last_success=state.last_success,
        next_try=_time(state.due_s) if state.due_s and not state.disabled else None,
        dead_letters=len(state.letters),
        secret=secret,
    )


def result_of(outcome: Outcome) -> DeliveryResult:
    """Return the document of an attempt."""
    return DeliveryResult(delivered=outcome.delivered, detail=outcome.detail)


def letters_of(state: DeliveryState) -> DeadLetterList:
    """Return the document of all dead letters of a receiver."""
    return DeadLetterList(dead_letters=[_letter(letter) for letter in state.letters], dropped=state.letters_dropped)


def _letter(letter: DeadLetter) -> DeadLetterEntry:
    return DeadLetterEntry(
        number=letter.event.number,
        type=type_of(letter.event),
        given_up=letter.given_up,
        attempts=letter.attempts,
        fault=letter.fault,
        event=letter.event,
    )


def _time(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")

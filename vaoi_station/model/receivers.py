"""The tables of `station.toml` on receivers to which the station sends its events by itself."""

from __future__ import annotations

import ipaddress
from pathlib import Path
from typing import Annotated, Self
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, model_validator

from vaoi_station.model.frozen_model import Finite, Strict, Whole

RETRY_AFTER_S = (5.0, 300.0, 1800.0, 7200.0, 18000.0, 36000.0, 50400.0, 72000.0, 86400.0)
"""Pauses between the attempts to deliver one message, s: the schedule of the Standard Webhooks specification."""
MOST_WEBHOOKS = 16
_LONGEST_URL = 2000


def checked_url(url: str) -> str:
    """Return the URL of a receiver; raise ValueError if no request can be sent to it."""
    if not (url.isascii() and url.isprintable()) or " " in url or len(url) > _LONGEST_URL:
        raise ValueError(f"must be at most {_LONGEST_URL} printable ASCII characters without spaces")
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise ValueError("must begin with http:// or https:// and a host")
    if "@" in parts.netloc or parts.fragment:
        raise ValueError("must have no user, no password and no fragment")
    if parts.port == 0:  # `port` itself raises ValueError beyond 65535
        raise ValueError("must have a port between 1 and 65535")
    return url


def checked_network(text: str) -> str:
    """Return an IP network as it was given; raise ValueError if it is none."""
    ipaddress.ip_network(text)
    return text


Url = Annotated[str, AfterValidator(checked_url)]
Network = Annotated[str, AfterValidator(checked_network)]
WebhookName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$")]
EventType = Annotated[str, Field(pattern=r"^[a-z0-9]+([_.-][a-z0-9]+)*$", max_length=64)]
Pause = Annotated[Finite, Field(ge=1, le=86400)]


class WebhookSettings(Strict):
    """Where the events go, which events, and when a failed delivery is tried again."""

    url: Url
    """Address of the receiver; no more than its host is shown again."""
    events: Annotated[tuple[EventType, ...], Field(max_length=50)] = ()
    """Types of events: a kind (`run`) or kind and state (`run.ready`); empty for all."""
    retry_after_s: Annotated[tuple[Pause, ...], Field(min_length=1, max_length=20)] = RETRY_AFTER_S
    """Pause before each further attempt; after the last one the message becomes a dead letter."""


class WebhookConfig(WebhookSettings):
    """One webhook of the file."""

    name: WebhookName
    """Name by which the webhook is addressed over REST."""
    secret_file: Path
    """File with the signing secrets, `whsec_…`, one in each line; each of them signs."""


class MqttConfig(Strict):
    """An MQTT broker to which the events are published."""

    host: Annotated[str, Field(pattern=r"^[A-Za-z0-9._:-]{1,253}$")]
    """Name or address of the broker."""
    port: Annotated[Whole, Field(ge=1, le=65535)] | None = None
    """None: 8883 with TLS, 1883 without."""
    prefix: Annotated[str, Field(pattern=r"^[^+#/\x00-\x1f]+(/[^+#/\x00-\x1f]+)*$", max_length=200)] | None = None
    """First part of all topics; None: `vaoi/` and the name of the station."""
    events: Annotated[tuple[EventType, ...], Field(max_length=50)] = ()
    """Types of events; empty for all."""
    user: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """Name with which the station logs in."""
    password_file: Path | None = None
    """File with the password."""
    tls: bool = False
    """Whether the connection is encrypted by TLS."""
    ca: Path | None = None
    """PEM file with the authorities that are trusted; None: those of the system."""
    certificate: Path | None = None
    """Certificate by which the broker knows the station (PEM)."""
    private_key: Path | None = None
    """Private key of the certificate (PEM)."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.certificate is None) != (self.private_key is None):
            raise ValueError("certificate and private_key belong together; give both or none")
        if not self.tls and (self.ca is not None or self.certificate is not None):
            raise ValueError("ca and certificate need tls = true")
        if self.password_file is not None and self.user is None:
            raise ValueError("password_file needs a user")
        return self


class PushConfig(Strict):
    """Receivers to which the station sends its events."""

    webhooks: Annotated[tuple[WebhookConfig, ...], Field(max_length=MOST_WEBHOOKS)] = ()
    mqtt: MqttConfig | None = None
    networks: tuple[Network, ...] = ()
    """Networks in which receivers may be; empty: everywhere except link-local and multicast addresses."""
    ca: Path | None = None
    """PEM file with authorities that are trusted for receivers, besides those of the system."""

    @model_validator(mode="after")
    def _different_names(self) -> Self:
        names = [webhook.name for webhook in self.webhooks]
        if len(set(names)) != len(names):
            raise ValueError(f"webhooks have the names {names}; they must differ")
        return self

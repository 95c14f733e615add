"""The tables of `station.toml` on the brokers to which the station publishes: MQTT, and AMQP 1.0 for IPC-CFX."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Self

from pydantic import Field, model_validator

from vaoi_station.model.frozen_model import Strict, Whole

EventType = Annotated[str, Field(pattern=r"^[a-z0-9]+([_.-][a-z0-9]+)*$", max_length=64)]
AmqpAddress = Annotated[str, Field(pattern=r"^[^\s\x00-\x1f]+$", max_length=400)]


class BrokerConfig(Strict):
    """A broker, and how the station logs in."""

    ports: ClassVar[tuple[int, int]]
    """Its usual ports, without and with TLS."""
    host: Annotated[str, Field(pattern=r"^[A-Za-z0-9._:-]{1,253}$")]
    """Name or address of the broker."""
    port: Annotated[Whole, Field(ge=1, le=65535)] | None = None
    """None: 8883 with TLS, 1883 without."""
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

    @property
    def place(self) -> tuple[str, int]:
        """Host and port."""
        return self.host, self.port or self.ports[self.tls]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.certificate is None) != (self.private_key is None):
            raise ValueError("certificate and private_key belong together; give both or none")
        if not self.tls and (self.ca is not None or self.certificate is not None):
            raise ValueError("ca and certificate need tls = true")
        if self.password_file is not None and self.user is None:
            raise ValueError("password_file needs a user")
        return self


class MqttConfig(BrokerConfig):
    """An MQTT broker to which the events are published."""

    ports = (1883, 8883)
    prefix: Annotated[str, Field(pattern=r"^[^+#/\x00-\x1f]+(/[^+#/\x00-\x1f]+)*$", max_length=200)] | None = None
    """First part of all topics; None: `vaoi/` and the name of the station."""
    events: Annotated[tuple[EventType, ...], Field(max_length=50)] = ()
    """Types of events: a kind (`run`) or kind and state (`run.ready`); empty for all."""


class CfxConfig(BrokerConfig):
    """A broker of AMQP 1.0 to which the messages of IPC-CFX are published."""

    ports = (5672, 5671)
    port: Annotated[Whole, Field(ge=1, le=65535)] | None = None
    """None: 5671 with TLS, 5672 without."""
    address: AmqpAddress
    """Address of the broker to which the messages are sent, as the broker writes it (`/exchange/cfx`)."""
    requests: AmqpAddress | None = None
    """Address of the broker from which requests come; None: the station answers none."""
    handle: Annotated[str, Field(pattern=r"^[^.\s]+\.[^.\s]+\.[^.\s]+$", max_length=200)] | None = None
    """CFX handle, vendor.model.serial; None: `vaoi_station.VideoAOI.` and the name of the station."""
    heartbeat_s: Annotated[Whole, Field(ge=1, le=300)] = 60
    """Time between two heartbeats, s."""


class PushConfig(Strict):
    """To whom the station sends its events by itself."""

    mqtt: MqttConfig | None = None
    cfx: CfxConfig | None = None

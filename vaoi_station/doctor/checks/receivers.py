"""Check the MQTT broker: certificates and password can be read, and what MQTT needs is installed.

A fault here is a warning: the station films without its broker. Nothing is sent.
"""

from __future__ import annotations

import importlib.util
import ssl
from collections.abc import Iterator
from pathlib import Path

from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks.private_files import readable_by_others
from vaoi_station.doctor.finding import Finding, not_applicable, ok, warning
from vaoi_station.errors import VaoiError
from vaoi_station.files.text_files import read_text
from vaoi_station.model.receivers import MqttConfig


def receivers(context: CheckContext) -> Iterator[Finding]:
    """Check the broker of station.toml."""
    broker = context.config.push.mqtt
    if broker is None:
        yield not_applicable("no MQTT broker is configured")
        return
    found = list(_broker(broker))
    yield from found
    if not found:
        yield ok(f"the MQTT broker {broker.host} can be used")


def _broker(broker: MqttConfig) -> Iterator[Finding]:
    if importlib.util.find_spec("paho") is None:
        yield warning(
            f"push.mqtt: {broker.host} is configured, but the package paho-mqtt is absent.",
            "pip install 'vaoi-station[mqtt]'",
            subject="mqtt",
            code="mqtt-package-absent",
        )
    if broker.password_file is not None:
        try:
            empty = not read_text(broker.password_file).strip()
        except VaoiError as error:
            yield warning(
                f"push.mqtt.password_file: {error.message}",
                error.action or "Write the password to it, and make it readable to the service.",
                subject="mqtt",
                code="mqtt-password-unusable",
                figures={"path": str(broker.password_file)},
            )
        else:
            if empty:
                yield warning(
                    f"push.mqtt.password_file: {broker.password_file} is empty.",
                    "Write the password.",
                    subject="mqtt",
                    code="mqtt-password-unusable",
                    figures={"path": str(broker.password_file)},
                )
            yield from readable_by_others(broker.password_file, "push.mqtt: the password", "mqtt")
    if broker.ca is not None:
        yield from _authorities(broker.ca, "push.mqtt.ca")
    if broker.certificate is not None and broker.private_key is not None:
        try:
            # Without a password here, an encrypted key would be asked for at the terminal.
            ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_cert_chain(broker.certificate, broker.private_key, lambda: "")
        except (OSError, ValueError) as error:
            yield warning(
                f"push.mqtt: {broker.certificate} and {broker.private_key} cannot be used ({error}).",
                "Give a certificate and its private key as PEM files without a password.",
                subject="mqtt",
                code="certificate-unusable",
            )


def _authorities(path: Path, key: str) -> Iterator[Finding]:
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations(path)
    except OSError as error:
        yield warning(
            f"{key}: {path} cannot be read as PEM certificates ({error}).",
            "Give a PEM file.",
            subject=key,
            code="certificate-unusable",
            figures={"path": str(path)},
        )

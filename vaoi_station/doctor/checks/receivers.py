"""Check the receivers of events: secrets, certificates and passwords can be read, and what MQTT needs is installed.

A fault here is a warning: the station films without its receivers. Nothing is sent.
"""

from __future__ import annotations

import importlib.util
import ssl
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks.private_files import readable_by_others
from vaoi_station.doctor.finding import Finding, not_applicable, ok, warning
from vaoi_station.errors import VaoiError
from vaoi_station.files.text_files import read_text
from vaoi_station.model.receivers import MqttConfig, WebhookConfig
from vaoi_station.push.push_service import FOLDER, WEBHOOKS
from vaoi_station.push.signing import read_secrets
from vaoi_station.push.webhook_file import WebhookFile


def receivers(context: CheckContext) -> Iterator[Finding]:
    """Check webhooks and broker of station.toml, and the webhooks that were made over REST."""
    push, stored = context.config.push, context.config.data / FOLDER / WEBHOOKS
    made = WebhookFile(stored)
    if not push.webhooks and push.mqtt is None and made.fault is None and not made.all():
        yield not_applicable("no receivers of events are configured")
        return
    found = [finding for webhook in push.webhooks for finding in _webhook(webhook)]
    if push.ca is not None:
        found += _authorities(push.ca, "push.ca")
    if made.fault is not None:
        found.append(warning(made.fault.message, made.fault.action, subject=stored.name, code=made.fault.code))
    if push.mqtt is not None:
        found += _broker(push.mqtt)
    yield from found
    if not found:
        webhooks = len(push.webhooks) + len(made.all())
        broker = "no broker" if push.mqtt is None else f"the broker {push.mqtt.host}"
        yield ok(f"{webhooks} webhooks and {broker} can be used", figures={"webhooks": webhooks})


def _webhook(webhook: WebhookConfig) -> Iterator[Finding]:
    try:
        read_secrets(webhook.secret_file)
    except VaoiError as error:
        action = error.action or "Correct the file; docs/api/push.md describes it."
        yield warning(
            f"webhook {webhook.name!r}: {error.message}", action, subject=webhook.name, code="webhook-secret-unusable"
        )
    else:
        yield from readable_by_others(webhook.secret_file, f"webhook {webhook.name!r}: the secrets", webhook.name)
    parts = urlsplit(webhook.url)
    if parts.scheme == "http" and parts.query:
        yield warning(
            f"webhook {webhook.name!r}: its URL begins with http:// and has a query, which everyone on the way can "
            f"read; {parts.hostname} gets it with each message.",
            "Use https://, or a receiver that needs no token: messages are signed.",
            subject=webhook.name,
            code="webhook-token-open",
        )


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

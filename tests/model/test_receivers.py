"""The tables of station.toml on receivers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.model.receivers import RETRY_AFTER_S, MqttConfig, PushConfig, WebhookConfig


def webhook(**more: Any) -> WebhookConfig:
    given = {"name": "mes", "url": "https://mes.plant:8443/hook?line=3", "secret_file": Path("mes.secret")}
    return WebhookConfig(**given | more)


def test_the_schedule_is_that_of_the_specification_unless_another_is_given() -> None:
    assert webhook().retry_after_s == RETRY_AFTER_S
    assert sum(RETRY_AFTER_S) / 3600 == pytest.approx(75.6, abs=0.1)
    assert webhook(retry_after_s=[1, 60]).retry_after_s == (1.0, 60.0)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"url": "ftp://mes/hook"}, "must begin with http:// or https://"),
        ({"url": "mes.plant/hook"}, "must begin with http:// or https://"),
        ({"url": "http:///hook"}, "and a host"),
        ({"url": "http://user:word@mes/hook"}, "no user, no password and no fragment"),
        ({"url": "http://mes/hook#part"}, "no user, no password and no fragment"),
        ({"url": "http://mes/a b"}, "printable ASCII characters without spaces"),
        ({"url": "http://mes/\r\nX: y"}, "printable ASCII characters without spaces"),
        ({"url": "http://mäs/"}, "printable ASCII characters without spaces"),
        ({"url": "http://mes/" + "a" * 2000}, "at most 2000"),
        ({"url": "http://mes:99999/"}, "Port out of range"),
        ({"url": "http://mes:0/"}, "port between 1 and 65535"),
        ({"name": "../mes"}, "should match pattern"),
        ({"events": ["Run"]}, "should match pattern"),
        ({"retry_after_s": []}, "at least 1 item"),
        ({"retry_after_s": [0.5]}, "greater than or equal to 1"),
        ({"retry_after_s": [1.0] * 21}, "at most 20 items"),
        ({"secret": "whsec_x"}, "Extra inputs are not permitted"),
    ],
)
def test_what_cannot_work_is_refused(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        webhook(**fields)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"host": "a b"}, "should match pattern"),
        ({"port": 0}, "greater than or equal to 1"),
        ({"prefix": "plant/#"}, "should match pattern"),
        ({"prefix": "plant/"}, "should match pattern"),
        ({"ca": "ca.pem"}, "need tls = true"),
        ({"tls": True, "certificate": "a.pem"}, "belong together"),
        ({"password_file": "p"}, "needs a user"),
    ],
)
def test_a_broker_that_cannot_be_reached_is_refused(fields: dict[str, Any], words: str) -> None:
    assert MqttConfig(host="broker.plant", prefix="plant/line-3").port is None
    with pytest.raises(ValidationError, match=words):
        MqttConfig.model_validate({"host": "broker.plant"} | fields)


def test_names_differ_and_networks_are_networks() -> None:
    with pytest.raises(ValidationError, match="they must differ"):
        PushConfig(webhooks=(webhook(), webhook()))
    assert PushConfig(networks=("10.0.0.0/8", "fd00::/8")).networks
    with pytest.raises(ValidationError, match="does not appear to be an IPv4 or IPv6 network"):
        PushConfig(networks=("10.0.0.0/99",))

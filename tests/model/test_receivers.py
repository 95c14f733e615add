"""The table of station.toml on the MQTT broker."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.model.receivers import MqttConfig


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
        ({"events": ["Run"]}, "should match pattern"),
    ],
)
def test_a_broker_that_cannot_be_reached_is_refused(fields: dict[str, Any], words: str) -> None:
    assert MqttConfig(host="broker.plant", prefix="plant/line-3").port is None
    with pytest.raises(ValidationError, match=words):
        MqttConfig.model_validate({"host": "broker.plant"} | fields)

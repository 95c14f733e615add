"""Check the MQTT broker of a station; every fault is made for real."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from tests.doctor.conftest import only, with_config
from tests.peers.certificates import make_authority, make_certificate
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks.receivers import receivers
from vaoi_station.doctor.finding import Level
from vaoi_station.model.receivers import MqttConfig, PushConfig


def with_push(context: CheckContext, **fields: object) -> CheckContext:
    push = PushConfig.model_validate(fields)
    return with_config(context, context.config.model_copy(update={"push": push}))


def private(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text)
    path.chmod(mode)
    return path


def test_a_station_without_a_broker_needs_no_check(context: CheckContext) -> None:
    assert only(receivers(context)).level is Level.NOT_APPLICABLE


def test_a_sound_broker_is_ok(context: CheckContext, tmp_path: Path) -> None:
    if importlib.util.find_spec("paho") is None:
        pytest.fail("pip install paho-mqtt, as tests/run does")
    authority = make_authority(tmp_path)
    client = make_certificate(tmp_path, "client", authority)
    broker = MqttConfig(
        host="broker",
        tls=True,
        user="vaoi",
        password_file=private(tmp_path / "password", "pass"),
        ca=authority.certificate,
        certificate=client.certificate,
        private_key=client.private_key,
    )
    finding = only(receivers(with_push(context, mqtt=broker)))
    assert finding.level is Level.OK
    assert "the MQTT broker broker" in finding.message


def test_certificates_and_passwords_of_a_broker(context: CheckContext, tmp_path: Path) -> None:
    broken = private(tmp_path / "broken.pem", "no certificate")
    broker = {"host": "b", "tls": True, "ca": broken, "certificate": broken, "private_key": broken}
    push = with_push(context, mqtt={**broker, "user": "u", "password_file": tmp_path / "absent"})
    found = list(receivers(push))
    assert {f.level for f in found} == {Level.WARNING}
    for word in ("password_file", "push.mqtt.ca", "cannot be used"):
        assert any(word in f.message for f in found), word


@pytest.mark.parametrize(("encoding", "sound"), [("utf-8-sig", True), ("utf-16", True), ("utf-16-le", False)])
def test_a_password_may_have_a_byte_order_mark(
    context: CheckContext, tmp_path: Path, encoding: str, sound: bool
) -> None:
    path = private(tmp_path / "password", "")
    path.write_bytes("pass".encode(encoding))
    found = list(receivers(with_push(context, mqtt={"host": "b", "user": "u", "password_file": path})))
    faults = [f for f in found if "password_file" in f.message]
    assert (faults == []) == sound
    assert all("not UTF-8 text" in f.message and "Save it as UTF-8" in f.action for f in faults)

"""Check webhooks and broker of a station; every fault is made for real."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

from tests.doctor.conftest import assert_problem, only, with_config, without_privileges
from tests.peers.certificates import make_authority, make_certificate
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks.receivers import receivers
from vaoi_station.doctor.finding import Level
from vaoi_station.model.receivers import MqttConfig, PushConfig, WebhookConfig, WebhookSettings
from vaoi_station.push.push_service import FOLDER, WEBHOOKS
from vaoi_station.push.signing import new_secret
from vaoi_station.push.webhook_file import Secret, StoredWebhook, WebhookFile

SETTINGS = WebhookSettings(url="https://mes.example/vaoi", events=("run",))


def with_push(context: CheckContext, **fields: object) -> CheckContext:
    push = PushConfig.model_validate(fields)
    return with_config(context, context.config.model_copy(update={"push": push}))


def private(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text)
    path.chmod(mode)
    return path


def webhook(secret_file: Path, url: str = "https://mes.example/vaoi") -> WebhookConfig:
    return WebhookConfig(name="mes", url=url, secret_file=secret_file)


def test_a_station_without_receivers_needs_no_check(context: CheckContext) -> None:
    assert only(receivers(context)).level is Level.NOT_APPLICABLE


def test_sound_receivers_are_ok(context: CheckContext, tmp_path: Path) -> None:
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
    hook = webhook(private(tmp_path / "secret", new_secret()))
    finding = only(receivers(with_push(context, webhooks=[hook], mqtt=broker, ca=authority.certificate)))
    assert finding.level is Level.OK
    assert "1 webhooks and the broker broker" in finding.message


@pytest.mark.parametrize(("content", "word"), [(None, "cannot be read"), ("", "holds 0 secrets"), ("x", "no signing")])
def test_a_secret_that_cannot_be_used(context: CheckContext, tmp_path: Path, content: str | None, word: str) -> None:
    path = tmp_path / "secret"
    if content is not None:
        private(path, content)
    found = only(receivers(with_push(context, webhooks=[webhook(path)])))
    assert_problem(found, Level.WARNING, "webhook 'mes'", word)


def test_a_secret_that_all_users_can_read(context: CheckContext, tmp_path: Path) -> None:
    hook = webhook(private(tmp_path / "secret", new_secret(), 0o644))
    assert_problem(only(receivers(with_push(context, webhooks=[hook]))), Level.WARNING, "every user")


def test_a_token_without_tls_is_named_without_the_token(context: CheckContext, tmp_path: Path) -> None:
    hook = webhook(private(tmp_path / "secret", new_secret()), "http://mes.example/in?token=abc123")
    finding = only(receivers(with_push(context, webhooks=[hook])))
    assert_problem(finding, Level.WARNING, "http://", "mes.example")
    assert "abc123" not in finding.message


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


def test_damaged_webhooks_of_rest_are_named(context: CheckContext) -> None:
    path = context.config.data / FOLDER / WEBHOOKS
    path.parent.mkdir(parents=True)
    path.write_text('{"format": "vaoi-webhooks", "version": 1, "webhooks": [{"name": "a"}]}')
    assert_problem(only(receivers(context)), Level.WARNING, "webhooks.json", "is damaged")


def test_webhooks_of_rest_that_this_user_may_not_read_are_not_called_damaged(context: CheckContext) -> None:
    path = context.config.data / FOLDER / WEBHOOKS
    WebhookFile(path).put(StoredWebhook(name="mes", settings=SETTINGS, secrets=(Secret(secret=new_secret()),)))
    assert "1 webhooks" in only(receivers(context)).message
    # First the file, then its folder, which hides even whether there is a file.
    for refused in (path, path.parent):
        refused.chmod(0o000)
        with without_privileges():
            found = only(receivers(context))
        assert_problem(found, Level.WARNING, "webhooks.json: cannot be read by the user", "Permission denied")
        assert "as this user or as root" in found.action
    path.parent.chmod(0o700)

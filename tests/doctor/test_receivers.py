"""The doctor finds brokers that are not reached, and passwords that cannot be read."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from tests.doctor.conftest import assert_problem, only, with_config
from tests.hermes.station import free_port
from tests.push.amqp_broker import need_proton
from vaoi_station.doctor import file_checks
from vaoi_station.doctor.finding import Finding, Level
from vaoi_station.doctor.running_station import CheckContext
from vaoi_station.model.receivers import PushConfig


def findings(context: CheckContext, kind: str, **broker: object) -> list[Finding]:
    needed = {"address": "cfx"} if kind == "cfx" else {}
    push = PushConfig.model_validate({kind: {"host": "127.0.0.1", **needed, **broker}})
    return list(file_checks.receivers(with_config(context, context.config.model_copy(update={"push": push}))))


def test_without_brokers_there_is_nothing_to_check(context: CheckContext) -> None:
    assert only(file_checks.receivers(context)).level is Level.NOT_APPLICABLE


@pytest.mark.parametrize("kind", ["mqtt", "cfx"])
def test_a_broker_is_reached_or_not_and_its_password_read_or_not(
    context: CheckContext, kind: str, tmp_path: Path
) -> None:
    need_proton()
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        assert only(findings(context, kind, port=port)).level is Level.OK
        (tmp_path / "password").write_text("")
        (tmp_path / "password").chmod(0o600)
        empty = only(findings(context, kind, port=port, user="u", password_file=tmp_path / "password"))
    assert_problem(empty, Level.WARNING, f"push.{kind}.password_file: ")
    assert empty.code == f"{kind}-password-unusable"
    away = only(findings(context, kind, port=free_port()))
    assert_problem(away, Level.WARNING, "is not reached")
    assert away.code == f"{kind}-lost"

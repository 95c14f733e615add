"""The doctor finds products without a board type, and a machine upstream that is not there."""

from __future__ import annotations

import socket

from tests.doctor.conftest import assert_problem, only
from tests.hermes.station import free_port
from vaoi_station.doctor import file_checks, machine_checks
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.running_station import CheckContext
from vaoi_station.line_config import Hermes


def with_hermes(context: CheckContext, table: Hermes) -> CheckContext:
    config = context.config.model_copy(update={"hermes": table})
    return CheckContext(config, context.machine, None)


def test_without_neighbours_there_is_nothing_to_check(context: CheckContext) -> None:
    for check in (file_checks.neighbours, machine_checks.upstream):
        assert only(check(context)).level is Level.NOT_APPLICABLE


def test_a_product_without_a_board_type_is_named(context: CheckContext) -> None:
    table = Hermes(listen="127.0.0.1", products={"P-1": "absent"})
    finding = only(file_checks.neighbours(with_hermes(context, table)))
    assert_problem(finding, Level.WARNING, "P-1 (absent)")


def test_the_machine_upstream_is_reached_or_not(context: CheckContext) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        there = Hermes(upstream=f"127.0.0.1:{server.getsockname()[1]}")
        assert only(machine_checks.upstream(with_hermes(context, there))).level is Level.OK
    away = Hermes(upstream=f"127.0.0.1:{free_port()}")
    assert_problem(only(machine_checks.upstream(with_hermes(context, away))), Level.WARNING, "is not reached")

"""A restart of the station while the line is armed."""

from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.acquisition.process import messages
from vaoi_station.model import Reason
from vaoi_station.runs.control.core import Core, Parts
from vaoi_station.runs.run.standing_order import Resumed, StandingOrder


class Line:
    """The commands that the acquisition process gets."""

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def send(self, command: messages.Command) -> None:
        self.sent.append(command)

    def forget(self) -> None:
        """Commands are taken at once, so none waits."""


def restarted(rig: Any, resumed: Resumed | None) -> tuple[Core, Line]:
    parts, line = rig.coordinator._parts, Line()
    standing = StandingOrder(rig.store.standing)
    core = Core(
        Parts(
            parts.config, rig.ring.renew, line, parts.workers, parts.archive, parts.events, parts.run_ids, parts.watch,
            standing, resumed,
        )
    )  # fmt: skip
    return core, line


def taken_up(rig: Any) -> Resumed | None:
    rig.store.database.write(lambda _: None).result(10)
    coordinator = rig.coordinator
    return StandingOrder(rig.store.standing).resume(coordinator.board_type, coordinator._make_order)


@pytest.fixture
def armed(rig: Any) -> Any:
    """A rig whose line is armed; its order is stored."""
    rig.coordinator._core.line._standing = StandingOrder(rig.store.standing)
    rig.arm(board_id="b 1", runs=3)
    return rig


def test_what_was_armed_is_armed_again_visibly_and_its_board_id_is_in_doubt(armed: Any) -> None:
    core, line = restarted(armed, taken_up(armed))
    shown = core.line.orders.shown()
    assert shown is not None
    assert (shown.board_type, shown.runs_left, shown.resumed, shown.board_id_certain) == ("small", 3, True, False)
    assert [w.code for w in core.line.warnings()] == ["board-id-uncertain"]
    core.line.on_ready()
    assert [type(command) for command in line.sent] == [messages.Grant, messages.Arm]
    core.line.on_armed()
    assert core.machine.state == "armed"
    assert [e.code for e in armed.coordinator.events() if e.kind == "armed"] == ["", "armed-again"]


def test_boards_that_were_filmed_are_not_filmed_again(armed: Any) -> None:
    core = armed.coordinator._core
    armed.coordinator._inbox.ask(core.line.take_grant, "no run", 1e9)
    resumed = taken_up(armed)
    assert resumed is not None
    assert resumed.runs == 2


def test_a_disarmed_line_stays_disarmed_and_a_stopped_one_does_not(armed: Any) -> None:
    core = armed.coordinator._core
    armed.coordinator._inbox.ask(core.line.disarm_for_stop)
    assert taken_up(armed) is not None
    armed.coordinator._inbox.ask(lambda: core.line.disarm(messages_future()))
    assert taken_up(armed) is None


def messages_future() -> Any:
    from concurrent.futures import Future

    return Future()


def test_a_cause_against_it_stays_a_warning_until_the_line_is_disarmed(armed: Any) -> None:
    fault = Reason(code="not-armed-again", message="No board type.", action="Arm.")
    core, line = restarted(armed, Resumed(None, None, fault))
    core.line.on_ready()
    assert line.sent == []
    assert core.line.warnings() == (fault,)
    core.line.disarm(messages_future())
    assert core.line.warnings() == ()

"""Permits for the output "line ready": a number for each board, renewed, withdrawn at once, published by cause."""

from __future__ import annotations

from typing import Any

from vaoi_station.acquisition.controller.interface import Permit
from vaoi_station.acquisition.process.messages import PermitBoard
from vaoi_station.runs.run.line_permit import RENEW_S, VALID_S, LinePermit
from vaoi_station.runs.states.schemas import Reason

HELD = (Reason(code="camera-lost", message="Camera left is not connected.", action="Check its cable."),)


class Bench:
    """A permit with what it sends and publishes."""

    def __init__(self, *, used: bool = True) -> None:
        self.sent: list[Permit | None] = []
        self.events: list[tuple[str, str]] = []
        self.permit = LinePermit(self._send if used else None, self._publish)

    def _send(self, command: PermitBoard) -> None:
        self.sent.append(command.permit)

    def _publish(self, kind: str, message: str, *, code: str, **_: Any) -> None:
        self.events.append((f"{kind}/{code}", message))


def test_a_permit_is_given_renewed_and_withdrawn() -> None:
    bench = Bench()
    bench.permit.update(HELD, 0, 0.0)
    bench.permit.update((), 0, 1.0)
    bench.permit.update((), 0, 1.0 + RENEW_S / 2)
    bench.permit.update((), 0, 1.0 + RENEW_S)
    bench.permit.update(HELD, 0, 2.0)
    bench.permit.update(HELD, 0, 3.0)
    assert bench.sent == [Permit(1, 1.0 + VALID_S), Permit(1, 1.0 + RENEW_S + VALID_S), None]


def test_each_board_has_another_number() -> None:
    """Also one that was reported as missed while the line stayed ready: it may have used the permit."""
    bench = Bench()
    bench.permit.update((), 0, 0.0)
    bench.permit.update(HELD, 0, 0.1)
    bench.permit.update((), 0, 0.2)
    bench.permit.update((), 1, 0.21)
    assert [permit.number if permit else None for permit in bench.sent] == [1, None, 2, 3]


def test_numbers_begin_again_at_one() -> None:
    """0 is the firmware's test of the output."""
    bench = Bench()
    for reports in range(0x10001):
        bench.permit.update((), reports, 0.0)
    numbers = [permit.number for permit in bench.sent if permit]
    assert (min(numbers), max(numbers), numbers[-2:]) == (1, 0xFFFF, [1, 2])


def test_nothing_is_sent_without_an_interlock() -> None:
    bench = Bench(used=False)
    bench.permit.update((), 0, 0.0)
    bench.permit.update(HELD, 0, 0.1)
    assert bench.sent == []


def test_what_holds_boards_back_is_published_once() -> None:
    bench = Bench()
    for troubles in ((), HELD, HELD, (), ()):
        bench.permit.publish(troubles)
    assert bench.events == [
        ("line/line-held", "Boards are held back: Camera left is not connected."),
        ("line/line-free", "Boards are no longer held back."),
    ]

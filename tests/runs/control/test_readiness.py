"""Whether the next board may come: cameras, the reasons that hold it back, and its permit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from vaoi_station.acquisition.cameras.interface import CameraHealth, CameraPtp
from vaoi_station.acquisition.controller.interface import Permit
from vaoi_station.acquisition.process.messages import Health, PermitBoard
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError
from vaoi_station.model import Reason
from vaoi_station.runs.control import readiness
from vaoi_station.runs.control.readiness import RENEW_S, VALID_S, LinePermit
from vaoi_station.runs.states.tables import StationState


def camera(name: str) -> CameraConfig:
    return CameraConfig(name=name, backend="aravis", address="127.0.0.2", width=64, height=48, exposure_us=100.0)


CAMERAS = [camera("left"), camera("right")]


def health(*connected: bool) -> Health:
    return Health(tuple(CameraHealth(c, "" if c else "cable pulled") for c in connected), "fine", 1.0)


def test_every_disconnected_camera_has_a_reason_with_an_action() -> None:
    assert readiness.disconnected(health(False, True)) == (0,)
    both = readiness.reasons(health(False, False), CAMERAS)
    assert [r.message for r in both] == [f"Camera {n} is not connected. Cable pulled" for n in ("left", "right")]
    assert all(r.code == "camera-lost" and r.action for r in both)


def test_arming_is_refused_with_the_names_and_the_way_to_allow_it() -> None:
    readiness.require(health(True, True), CAMERAS)
    with pytest.raises(DeviceError, match=r"Camera left is not connected.*Camera right is not connected") as refusal:
        readiness.require(health(False, False), CAMERAS)
    assert refusal.value.code == "camera-lost"
    assert "allow_lost_cameras" in refusal.value.action


def test_a_clock_that_follows_no_master_or_differs_from_the_others_is_a_warning_that_holds_no_board_back() -> None:
    seen = [
        CameraHealth(True, ptp=CameraPtp("Listening")),
        CameraHealth(True, ptp=CameraPtp("Slave", apart_s=0.0032)),
        CameraHealth(True, ptp=CameraPtp("Master")),
    ]
    found = readiness.ptp_warnings(Health(tuple(seen), "fine", 1.0), [*CAMERAS, camera("third")])
    assert [(r.code, r.message.split(". ")[0]) for r in found] == [
        ("ptp-not-synchronised", "Camera left: its clock follows no PTP master (state Listening)"),
        ("ptp-clocks-apart", "Camera right: says Slave, but differs by +3.200 ms from others with PTP"),
    ]
    assert not {r.code for r in found} & readiness.NOT_READY
    assert readiness.ptp_warnings(None, CAMERAS) == ()


READY = readiness.LineFacts(StationState.ARMED, True, health(True, True), False, (), 1.5)


def codes(**changes: object) -> list[str]:
    return [reason.code for reason in readiness.held_back(replace(READY, **changes), CAMERAS)]  # type: ignore[arg-type]


def test_a_lost_camera_holds_boards_back_unless_the_order_accepts_it() -> None:
    assert codes(health=health(True, False)) == ["camera-lost"]
    assert codes(health=health(True, False), without_cameras=True) == []


def test_every_present_trouble_of_the_storage_holds_boards_back_and_what_is_over_does_not() -> None:
    newer = Reason(code="database-newer", message="The database is of a later version.")
    assert codes(storage=newer, reasons=(newer,)) == ["database-newer"]
    assert codes(reasons=(Reason(code="database-damaged", message="It was set aside."),)) == []


def test_a_board_in_the_barrier_holds_the_next_one_back_before_its_first_pulse_too() -> None:
    assert codes(health=replace(health(True, True), passing=True)) == ["line-filming"]
    standing = replace(health(True, True), standing=True)
    assert codes(health=standing) == ["board-in-barrier"]
    (reason,) = readiness.held_back(replace(READY, health=standing), CAMERAS)
    assert "it is not filmed" in reason.message
    assert "Take it out" in reason.action
    stopped = replace(health(True, True), passing=True, belt_stopped=True)
    for state in (StationState.ARMED, StationState.FILMING):
        (reason,) = readiness.held_back(replace(READY, state=state, health=stopped), CAMERAS)
        assert (reason.code, "the belt does not move" in reason.message) == ("belt-stopped", True)


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


def test_what_holds_boards_back_is_published_once() -> None:
    bench = Bench()
    for troubles in ((), HELD, HELD, (), ()):
        bench.permit.publish(troubles)
    assert bench.events == [
        ("line/line-held", "Boards are held back: Camera left is not connected."),
        ("line/line-free", "Boards are no longer held back."),
    ]

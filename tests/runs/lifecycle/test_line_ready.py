"""The line is ready exactly while the next board would be filmed, and its permits go to the acquisition process."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.acquisition.cameras.interface import CameraHealth
from vaoi_station.acquisition.controller.interface import Permit
from vaoi_station.acquisition.process import messages

FINE = CameraHealth(True)
PATIENCE_S = 20.0


def devices(*cameras: CameraHealth, **more: Any) -> messages.Health:
    """A heartbeat that does not get old within the test."""
    return messages.Health(cameras or (FINE, FINE), "controller fine", time.monotonic() + 1e3, **more)


@pytest.fixture
def line(make_rig: Callable[..., Any]) -> Any:
    """An armed station with an interlock; the process has reported its devices."""
    rig = make_rig(lock="on")
    rig.ready()
    rig.peer.report(devices())
    rig.wait_for(lambda: rig.coordinator.snapshot().all_cameras_ready, "the devices")
    rig.grant = rig.arm()
    return rig


def permit(rig: Any, *, given: bool = True) -> Permit | None:
    """The next permit that is given, or None once it is withdrawn; renewals of the other kind are skipped."""
    deadline_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline_s:
        assert rig.peer.connection.poll(PATIENCE_S)
        command = rig.peer.connection.recv()
        if isinstance(command, messages.PermitBoard) and (command.permit is not None) == given:
            return command.permit
    raise AssertionError("no such permit")


def held(rig: Any) -> list[str]:
    snapshot = rig.coordinator.snapshot()
    assert snapshot.line_ready == (not snapshot.line_held)
    return [reason.code for reason in snapshot.line_held]


def test_a_database_of_a_later_version_holds_boards_back(line: Any, tmp_path: Path) -> None:
    later = tmp_path / "later.db"
    with closing(sqlite3.connect(later)) as database:
        database.executescript("CREATE TABLE runs (id TEXT); PRAGMA user_version = 999;")
    later.replace(line.store.database.path)
    line.wait_for(lambda: "database-newer" in held(line), "the trouble")
    assert not line.coordinator.snapshot().line_ready


def test_an_armed_line_gives_one_permit_per_board(line: Any) -> None:
    first = permit(line)
    assert first is not None
    assert held(line) == []
    assert first.until_s <= time.monotonic() + 1.0
    line.begin(line.grant)
    assert permit(line, given=False) is None
    line.until("filming")
    assert held(line) == ["line-filming"]
    line.finish(line.grant, line.row(line.grant, 0))
    second = permit(line)
    assert second is not None
    assert second.number == first.number + 1


@pytest.mark.parametrize(
    ("report", "code"),
    [
        (lambda: devices(FINE, CameraHealth(False, "cable pulled")), "camera-lost"),
        (lambda: devices(controller_ready=False), "controller-not-ready"),
    ],
    ids=["camera", "controller"],
)
def test_a_lost_device_withdraws_the_permit_and_is_published(line: Any, report: Any, code: str) -> None:
    first = permit(line)
    line.peer.report(report())
    assert permit(line, given=False) is None
    assert held(line) == [code]
    line.peer.report(devices())
    second = permit(line)
    assert (first.number if first else 0, second.number if second else 0) == (1, 2)
    line.wait_for(
        lambda: [e.code for e in line.coordinator.events() if e.kind == "line"] == ["line-held", "line-free"], "events"
    )


def test_disarming_withdraws_it_before_the_process_confirms(line: Any) -> None:
    permit(line)
    line.coordinator._inbox.post(line.coordinator._core.line.disarm, _Unheard())
    assert permit(line, given=False) is None


class _Unheard:
    """A completion for which no caller waits."""

    def set_result(self, _: None) -> None:
        """Ignore the result."""

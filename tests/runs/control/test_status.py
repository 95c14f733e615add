"""The warning on a status page while workers are starting."""

from __future__ import annotations

from vaoi_station.runs.control.status import worker_warnings
from vaoi_station.runs.states.schemas import STARTING, WAITING, ProcessStatus


def test_workers_that_are_starting_are_a_warning() -> None:
    def process(name: str, doing: str) -> ProcessStatus:
        return ProcessStatus(name=name, pid=1, alive=True, restarts=0, heartbeat_age_s=None, doing=doing)

    assert worker_warnings((process("acquisition", STARTING), process("worker 0", "idle"))) == ()
    [warning] = worker_warnings((process("worker 0", "rows of (0, 0)"), process("worker 1", STARTING)))
    assert warning.code == "workers-starting"
    assert warning.message == "Results of boards that pass meanwhile come late: 1 of 2 workers is still starting."
    [warning] = worker_warnings(
        (process("acquisition", WAITING), process("worker 0", STARTING), process("worker 1", STARTING))
    )
    assert (
        warning.message == "Cameras are not opened yet, and boards are not filmed: 2 of 2 workers are still starting."
    )

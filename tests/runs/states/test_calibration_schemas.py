"""Documents about the calibration: allowed states, and defaults for what is not known yet."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from vaoi_station.runs.states.calibration_schemas import CalibrationStatus, CameraCalibration, CameraDrift, CameraMoment

MOMENT = CameraMoment(
    run="r1", time="2026-01-01T00:00:00Z", x_px=0.1, y_px=-0.2, turn_px=0.0, sigma_px=0.02, links=80, fiducials=2
)


def test_a_new_calibration_has_no_history_and_no_drift() -> None:
    camera = CameraCalibration(camera=0, name="left", state="unknown")
    status = CalibrationStatus(digest="c0ffee", runs=0, cameras=(camera,))
    assert (status.created, camera.drift, camera.history, MOMENT.rms_px) == (None, None, (), None)


@pytest.mark.parametrize("state", ["steady", "drifted", "unseen", "unknown"])
def test_states_are_those_of_the_documentation(state: str) -> None:
    document = {"camera": 0, "name": "left", "state": state, "history": (MOMENT,)}
    assert CameraCalibration.model_validate(document).state == state
    with pytest.raises(ValidationError):
        CameraCalibration.model_validate(document | {"state": "lost"})


def test_a_drift_survives_json() -> None:
    drift = CameraDrift(
        size_px=3.0, x_px=0.0, y_px=3.0, turn_px=0.0, since_run="r1", since="2026-01-01T00:00:00Z", runs=2, instead=(1,)
    )
    assert CameraDrift.model_validate_json(drift.model_dump_json()) == drift

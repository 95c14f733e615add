"""Calibration over REST: artwork, marks in a frame, and a trial with its progress and acceptance."""

from __future__ import annotations

import json
from typing import Any

import pytest

from tests.api.held.setup_files import OPTIONS, PITCH_MM, film_board
from tests.api.held_station import PX_PER_MM, HeldStation
from vaoi_station.api.setup.calibration import TrialRequest, Trials, design_of
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.calibration.artwork import design_board
from vaoi_station.calibration.exchanged_camera import without_place
from vaoi_station.errors import InputError, NotFoundError, StateError
from vaoi_station.files import read_calibration, write_calibration
from vaoi_station.files.calibrations import Layout
from vaoi_station.model import Calibration

TRIAL = "/api/v1/calibration/trial"
QUERY = {"tolerance_mm": 1.5}


@pytest.mark.parametrize("files", [False], indirect=True)
def test_a_trial_without_nominal_values_is_refused_before_it_begins(client: Any, station: HeldStation) -> None:
    stated = {**QUERY, "pitch_mm": PITCH_MM, "px_per_mm": PX_PER_MM}
    layout = client.get("/api/v1/calibration/layout", params=stated).json()
    run = film_board(station, Layout.model_validate(layout))
    refused = client.post(TRIAL, json={"run": run, "row": 0, "layout": layout})
    assert (refused.status_code, refused.json()["code"]) == (422, "nominal-values-missing")
    assert client.get(TRIAL).json()["state"] == "none"


@pytest.fixture
def wanted(station: HeldStation, files: StationFiles) -> TrialRequest:
    layout = design_board(design_of(files, OPTIONS)).layout
    return TrialRequest(run=film_board(station, layout), row=0, layout=layout)


def test_a_refused_trial_shows_why_and_changes_nothing(
    station: HeldStation, files: StationFiles, wanted: TrialRequest
) -> None:
    trials = Trials(station, files)
    empty = wanted.model_copy(update={"row": 3})
    trials.begin(empty)
    trials.perform(empty)
    trial = trials.status()
    assert trial.state == "refused"
    assert "camera 0" in str(trial.message)
    assert trials.picture("marks")
    for call in (trials.document, lambda: trials.picture("difference")):
        with pytest.raises(NotFoundError):
            call()
    lost = wanted.model_copy(update={"run": station.film(), "row": 3})
    station.release(lost.run)
    trials.begin(lost)
    trials.perform(lost)
    assert "were released" in str(trials.status().message)


def test_one_camera_alone_is_calibrated_and_in_force_at_once(
    station: HeldStation, files: StationFiles, wanted: TrialRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = read_calibration(files.config.calibration)
    write_calibration(files.config.calibration, without_place(before, 1))
    used: list[Calibration] = []
    monkeypatch.setattr(station, "require_disarmed", lambda: None)
    monkeypatch.setattr(station, "use_calibration", used.append)
    trials, alone = Trials(station, files), wanted.model_copy(update={"camera": 1})
    trials.begin(alone)
    trials.perform(alone)
    trial = trials.status()
    assert (trial.state, trial.camera) == ("judged", 1), trial.message
    assert [camera.changed_px for camera in trial.cameras][::2] == [0.0, 0.0]
    trials.accept()
    now = read_calibration(files.config.calibration)
    assert now.uncalibrated == ()
    for held in (0, 2):
        assert (now.camera_matrices[held] == before.camera_matrices[held]).all()
    # The board lay displaced by 0.4 mm, which the other cameras show.
    assert now.camera_matrices[1] == pytest.approx(before.camera_matrices[1], rel=2e-3, abs=0.3)
    assert [c.uncalibrated for c in used] == [()]


def test_a_trial_is_not_accepted_once_another_calibration_is_in_force(
    station: HeldStation, files: StationFiles, wanted: TrialRequest
) -> None:
    """A camera may have been exchanged since: the trial does not know that its place is unknown."""
    trials = Trials(station, files)
    trials.begin(wanted)
    trials.perform(wanted)
    exchanged = without_place(read_calibration(files.config.calibration), 1)
    write_calibration(files.config.calibration, exchanged)
    with pytest.raises(StateError, match="was replaced after this trial"):
        trials.accept()
    assert read_calibration(files.config.calibration).uncalibrated == exchanged.uncalibrated != ()


def test_a_run_that_was_filmed_before_a_camera_was_exchanged_is_refused(
    station: HeldStation, files: StationFiles, wanted: TrialRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(station, "camera_serials", lambda _run: ("S0", "OLD", "S2"))
    for camera, serial in enumerate(("S0", "OLD", "S2")):
        files.config = files.config.with_serial(camera, serial)
    trials = Trials(station, files)
    assert trials.begin(wanted).state == "reading"
    trials.perform(wanted)
    files.config = files.config.with_serial(1, "NEW")
    for alone in (None, 1):
        with pytest.raises(StateError, match="filmed with camera OLD at place cam1, where NEW is now") as refused:
            trials.begin(wanted.model_copy(update={"camera": alone}))
        assert refused.value.code == "camera-exchanged"


def test_what_cannot_be_tried_is_refused_at_once(
    station: HeldStation, files: StationFiles, wanted: TrialRequest
) -> None:
    trials = Trials(station, files)
    for changed, message in (
        ({"row": 4}, "row is 4, but must be below 4"),
        ({"flatness_um": 5.0}, "flatness_um is given without working_distance_mm"),
    ):
        with pytest.raises(InputError, match=message):
            trials.begin(wanted.model_copy(update=changed))
    with pytest.raises(NotFoundError):
        trials.begin(wanted.model_copy(update={"run": "unknown"}))
    station.arm("demo-board")
    with pytest.raises(StateError) as refused:
        trials.begin(wanted)
    assert refused.value.code == "line-armed"


def test_a_calibration_in_force_that_cannot_be_read_is_replaced(
    station: HeldStation, files: StationFiles, wanted: TrialRequest
) -> None:
    files.config.calibration.write_text("{")
    trials = Trials(station, files)
    trials.begin(wanted)
    trials.perform(wanted)
    assert trials.status().shift_mm is None
    trials.accept()
    assert json.loads(files.config.calibration.read_text())["format"] == "vaoi-calibration"


MARKS = "/api/v1/calibration/marks"


@pytest.fixture
def in_frame(client: Any, station: HeldStation) -> dict[str, Any]:
    layout = client.get("/api/v1/calibration/layout", params={"tolerance_mm": 1.5}).json()
    return {"run": film_board(station, Layout.model_validate(layout)), "row": 0, "camera": 1, "layout": layout}


def test_marks_are_found_in_the_newest_frame_of_a_trial(
    client: Any, station: HeldStation, in_frame: dict[str, Any]
) -> None:
    """While the board is being laid, before it has passed."""
    run = in_frame.pop("run")
    del in_frame["row"]
    missing = client.post(MARKS, json={**in_frame, "trial": 1})
    assert (missing.status_code, missing.json()["code"]) == (404, "no-trial-frame")
    held: Any = station.lighting
    held.below = lambda camera: station.pixels[run, camera, 0]
    for number in (1, 2):
        assert client.post("/api/v1/cameras/1/trial", json={}).json()["number"] == number
        assert len(client.post(MARKS, json={**in_frame, "trial": number}).json()["found"]) == 20
    assert client.post(MARKS, json={**in_frame, "trial": 1}).status_code == 404, "a later pulse was fired"
    assert client.post(MARKS, json={**in_frame, "camera": 0, "trial": 2}).status_code == 404

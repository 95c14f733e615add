"""Calibration over REST: artwork, marks in a frame, and a trial with its progress and acceptance."""

from __future__ import annotations

import json
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import Any
from unittest.mock import Mock

import pytest
from pydantic import ValidationError

from tests.api.held.setup_files import OPTIONS, PITCH_MM, film_board
from tests.api.held_station import PX_PER_MM, HeldStation
from vaoi_station.api.access import scope_needed
from vaoi_station.api.setup import calibration as setup_trials
from vaoi_station.api.setup.calibration import ArtworkOptions, TrialRequest, Trials, design_of, nominal_heads
from vaoi_station.api.setup.station_files import StationFiles, replace_with_backup
from vaoi_station.calibration.artwork import design_board
from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError
from vaoi_station.files.calibrations import Layout
from vaoi_station.model import CameraHead

TRIAL = "/api/v1/calibration/trial"
QUERY = {"tolerance_mm": 1.5}


def test_the_artwork_has_the_cameras_of_the_station(client: Any) -> None:
    svg = client.get("/api/v1/calibration/artwork/calibration-board.svg", params=QUERY)
    assert svg.headers["content-type"] == "image/svg+xml"
    assert "sandbox" in svg.headers["content-security-policy"]
    assert all(f">camera {n}</text>" in svg.text for n in range(3))
    assert client.get("/api/v1/calibration/artwork/calibration-board.pdf", params=QUERY).content.startswith(b"%PDF")
    crowded = client.get("/api/v1/calibration/artwork/calibration-board.gbr", params={"columns": 30})
    assert (crowded.status_code, "Ask for fewer" in crowded.json()["action"]) == (422, True)
    assert client.get("/api/v1/calibration/artwork/../station.toml").status_code == 404


@pytest.fixture
def ended(monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Provide an event that is set when a trial has been performed."""
    ended, perform = threading.Event(), Trials.perform

    def watched(trials: Trials, wanted: Any) -> None:
        perform(trials, wanted)
        ended.set()

    monkeypatch.setattr(Trials, "perform", watched)
    return ended


def test_a_trial_is_followed_to_its_end_and_accepted(client: Any, station: HeldStation, ended: threading.Event) -> None:
    layout = client.get("/api/v1/calibration/layout", params=QUERY).json()
    run = film_board(station, Layout.model_validate(layout))
    assert client.get(TRIAL).json()["state"] == "none"
    assert client.post(f"{TRIAL}/accept").json()["code"] == "no-trial"
    begun = client.post(TRIAL, json={"run": run, "row": 0, "layout": layout})
    assert (begun.status_code, begun.json()["state"]) == (202, "reading")
    assert ended.wait(120)
    trial = client.get(TRIAL).json()
    assert trial["state"] == "judged", trial
    assert client.get(f"{TRIAL}/calibration").json()["format"] == "vaoi-calibration"
    assert client.get(f"{TRIAL}/pictures/marks").headers["content-type"] == "image/jpeg"
    assert client.post(f"{TRIAL}/accept").json()["state"] == "accepted"


def test_a_trial_is_discarded(client: Any, station: HeldStation, ended: threading.Event) -> None:
    layout = client.get("/api/v1/calibration/layout", params=QUERY).json()
    client.post(TRIAL, json={"run": film_board(station, Layout.model_validate(layout)), "row": 0, "layout": layout})
    assert ended.wait(120)
    assert client.get(TRIAL).json()["state"] == "judged"
    assert client.delete(TRIAL).json()["state"] == "none"
    assert client.get(TRIAL).json()["state"] == "none"
    assert client.post(f"{TRIAL}/accept").json()["code"] == "no-trial"
    assert client.get(f"{TRIAL}/pictures/marks").status_code == 404


@pytest.mark.parametrize("files", [False], indirect=True)
def test_a_trial_without_nominal_values_is_refused_before_it_begins(client: Any, station: HeldStation) -> None:
    stated = {**QUERY, "pitch_mm": PITCH_MM, "px_per_mm": PX_PER_MM}
    layout = client.get("/api/v1/calibration/layout", params=stated).json()
    run = film_board(station, Layout.model_validate(layout))
    refused = client.post(TRIAL, json={"run": run, "row": 0, "layout": layout})
    assert (refused.status_code, refused.json()["code"]) == (422, "nominal-values-missing")
    assert client.get(TRIAL).json()["state"] == "none"


def test_missing_nominal_values_are_named(files: StationFiles) -> None:
    cameras = tuple(
        c.model_copy(update={"nominal_center_mm": None, "nominal_px_per_mm": None}) for c in files.config.cameras
    )
    bare = StationFiles(files.path, files.config.model_copy(update={"cameras": cameras}))
    with pytest.raises(InputError, match="pitch_mm and px_per_mm must be given"):
        design_of(bare, ArtworkOptions())
    assert design_of(bare, ArtworkOptions(pitch_mm=30, px_per_mm=8)).pitch_mm == 30


def test_all_of_it_needs_the_scope_admin() -> None:
    for method, path in (("GET", "/artwork/a.svg"), ("GET", "/layout"), ("GET", "/trial"), ("POST", "/trial/accept")):
        assert scope_needed(method, f"/api/v1/calibration{path}") == "admin"
    assert scope_needed("GET", "/api/v1/calibration") == "read"


@pytest.fixture
def wanted(station: HeldStation, files: StationFiles) -> TrialRequest:
    layout = design_board(design_of(files, OPTIONS)).layout
    return TrialRequest(run=film_board(station, layout), row=0, layout=layout)


def test_a_trial_is_judged_compared_and_accepted(
    station: HeldStation, files: StationFiles, wanted: TrialRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    trials = Trials(station, files)
    before = files.config.calibration.read_bytes()
    assert trials.status().state == "none"
    with pytest.raises(StateError):
        trials.accept()
    assert trials.begin(wanted).state == "reading"
    with pytest.raises(StateError) as refused:
        trials.begin(wanted)
    assert refused.value.code == "trial-running"
    trials.perform(wanted)
    trial = trials.status()
    assert (trial.state, trial.message, trial.frames_read) == ("judged", None, 3)
    assert all(c.used >= 12 and c.residual_px is not None and c.residual_px < 0.1 for c in trial.cameras)
    assert trial.shift_mm == pytest.approx((-0.4, 0.0), abs=0.02)
    assert all(trials.picture(name).startswith(b"\xff\xd8") for name in ("marks", "difference"))
    assert files.config.calibration.read_bytes() == before, "nothing is changed until it is accepted"
    monkeypatch.setattr(setup_trials, "replace_with_backup", Mock(side_effect=DeviceError("the disk is full")))
    with pytest.raises(DeviceError):
        trials.accept()
    assert (trials.status().state, files.config.calibration.read_bytes()) == ("judged", before)
    writing, go_on = Event(), Event()

    def slowly(path: Path, content: bytes) -> str | None:
        writing.set()
        assert go_on.wait(30)
        return replace_with_backup(path, content)

    monkeypatch.setattr(setup_trials, "replace_with_backup", slowly)
    with ThreadPoolExecutor(1) as pool:
        first = pool.submit(trials.accept)
        assert writing.wait(30)
        try:
            for call in (trials.accept, lambda: trials.begin(wanted)):
                with pytest.raises(StateError, match="A trial is being accepted") as refused:
                    call()
                assert refused.value.code == "trial-running"
            assert trials.status().state == "judged"
        finally:
            go_on.set()
        accepted = first.result()
    assert (accepted.state, accepted.accepted_as) == ("accepted", "calibration.json")
    assert files.config.calibration.read_bytes() == trials.document()
    assert accepted.backup is not None
    assert files.config.calibration.with_name(accepted.backup).read_bytes() == before
    assert len(list(files.config.calibration.parent.glob("calibration.before-*"))) == 1
    with pytest.raises(StateError):
        trials.accept()


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


def test_a_fault_of_the_fit_ends_the_trial(
    station: HeldStation, files: StationFiles, wanted: TrialRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: Any) -> None:
        raise ValueError("wrong")

    trials = Trials(station, files)
    monkeypatch.setattr(trials, "_perform", broken)
    trials.begin(wanted)
    trials.perform(wanted)
    assert trials.status().state == "refused"


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


def test_marks_are_found_where_they_are(client: Any, in_frame: dict[str, Any]) -> None:
    found = client.post(MARKS, json=in_frame).json()
    assert (found["width"], found["height"]) == (320, 240)
    assert len(found["found"]) == 20
    assert found["expected"] == 12, "those that are 2 mm further inside"
    elsewhere = client.post(MARKS, json={**in_frame, "row": 1}).json()
    assert (elsewhere["expected"], elsewhere["found"]) == (12, [])


@pytest.mark.parametrize(
    ("change", "status", "detail"),
    [
        ({"camera": 3}, 422, "camera"),
        ({"row": 99}, 404, "never arrived"),
        ({"run": "r9"}, 404, "r9"),
        ({"px_per_mm": -1}, 422, "px_per_mm"),
    ],
)
def test_what_cannot_be_searched_is_refused(
    client: Any, in_frame: dict[str, Any], change: dict[str, Any], status: int, detail: str
) -> None:
    refusal = client.post(MARKS, json={**in_frame, **change})
    assert refusal.status_code == status
    assert detail in refusal.text


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


@pytest.mark.parametrize("place", [{}, {"run": "r000001"}, {"row": 0}, {"run": "r000001", "row": 0, "trial": 1}])
def test_a_frame_is_named_in_one_way(client: Any, in_frame: dict[str, Any], place: dict[str, Any]) -> None:
    unplaced = {"camera": in_frame["camera"], "layout": in_frame["layout"]}
    refusal = client.post(MARKS, json={**unplaced, **place})
    assert refusal.status_code == 422
    assert "either run and row, or trial" in refusal.text


@pytest.mark.parametrize("size", [0.1, 100.0])
def test_marks_too_small_or_too_large_for_the_frame_are_refused(
    client: Any, in_frame: dict[str, Any], size: float
) -> None:
    mark = {**in_frame["layout"]["mark"], "size": size, "width": size / 4}
    refusal = client.post(MARKS, json={**in_frame, "layout": {**in_frame["layout"], "mark": mark}})
    assert refusal.status_code == 422
    assert "mark" in refusal.json()["detail"]


BARE = CameraHead(width=640, height=480, exposure_us=250.0)
STATED = BARE.model_copy(update={"nominal_center_mm": (7.0, 1.0), "nominal_px_per_mm": 18.0})


def test_missing_views_are_those_of_an_evenly_spaced_array() -> None:
    made = nominal_heads([BARE, BARE, BARE], pitch_mm=33.0, px_per_mm=40.0)
    assert [head.nominal_center_mm for head in made] == [(0.0, 0.0), (33.0, 0.0), (66.0, 0.0)]
    assert [head.nominal_px_per_mm for head in made] == [40.0] * 3


def test_what_station_toml_states_holds() -> None:
    assert nominal_heads([STATED, STATED]) == (STATED, STATED)
    assert nominal_heads([STATED], pitch_mm=33.0, px_per_mm=40.0) == (STATED,)


def test_a_single_camera_needs_no_distance() -> None:
    assert nominal_heads([BARE], px_per_mm=40.0)[0].nominal_center_mm == (0.0, 0.0)


def test_what_is_missing_is_named() -> None:
    for heads, given, message in (
        ([BARE, BARE], {}, "pitch_mm and px_per_mm must be given"),
        ([BARE, BARE], {"pitch_mm": 33.0}, "^px_per_mm must be given"),
        ([STATED, BARE], {"px_per_mm": 40.0}, "^pitch_mm must be given"),
    ):
        with pytest.raises(InputError, match=message) as refused:
            nominal_heads(heads, **given)
        assert refused.value.code == "nominal-values-missing"


LAYOUT = {"mark": {"size": 2, "width": 0.5}, "marks": [{"x": x, "y": y} for x in (0, 1) for y in (0, 1)]}


def test_limits_have_their_defaults_and_bounds() -> None:
    wanted = TrialRequest.model_validate({"run": "r", "row": 0, "layout": LAYOUT})
    assert (wanted.residual_limit_px, wanted.center_tolerance_mm, wanted.working_distance_mm) == (0.2, 2.0, None)
    for wrong in ({"row": -1}, {"residual_limit_px": 0}, {"flatness_um": -1}, {"unknown": 1}):
        with pytest.raises(ValidationError):
            TrialRequest.model_validate({"run": "r", "row": 0, "layout": LAYOUT, **wrong})

"""Calibration over REST: artwork, a trial with its progress, acceptance."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from tests.api.held.setup_files import PITCH_MM, film_board
from tests.api.held_station import PX_PER_MM, HeldStation
from vaoi_station.api.access import scope_needed
from vaoi_station.api.setup.calibration_routes import design_of
from vaoi_station.api.setup.models import ArtworkOptions
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.api.setup.trials import Trials
from vaoi_station.errors import InputError
from vaoi_station.files.layouts import Layout

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

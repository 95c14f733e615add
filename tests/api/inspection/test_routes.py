"""The times of a run's steps and what is drawn over its board."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

RUNS = "/api/v1/runs"


def test_the_timeline_has_every_step_since_the_barrier(client: Any, station: Any) -> None:
    answer = client.get(f"{RUNS}/{station.film()}/timeline")
    found = answer.json()
    assert [r["row"] for r in found["rows"]] == [0, 1, 2, 3]
    assert found["rows"][0] == {"row": 0, "pulse_s": 0.05, "light": "", "led_us": 80.0, "exposure_us": 250.0}
    assert found["barrier"] == [{"blocked_s": 0.0, "clear_s": 0.33}]
    assert found["last_frame_s"] < found["ready_s"]
    assert "immutable" in answer.headers["cache-control"]


def test_frames_lie_on_the_board_where_their_matrices_put_them(client: Any, station: Any) -> None:
    run = station.film()
    found = client.get(f"{RUNS}/{run}/overlay").json()
    assert (found["unit"], found["px_per_mm"], len(found["outline"])) == ("mm", 8.0, 4)
    frames = {(f["camera"], f["row"]): f for f in found["frames"]}
    assert (1, 2) not in frames, "its frame was not placed"
    assert not frames[0, 1]["usable"], "it came with holes"
    matrices = client.get(f"{RUNS}/{run}/matrices").json()["image_matrices"]
    x, y, w = np.array(matrices[2][3]) @ (*frames[2, 3]["corners"][0], 1)
    assert (x / w, y / w) == pytest.approx((-0.5, -0.5))


def test_links_and_fiducials_state_their_residuals_on_the_board(client: Any, station: Any) -> None:
    found = client.get(f"{RUNS}/{station.film()}/overlay").json()
    linked, without = ([p for p in found["links"] if bool(p["found"]) is there] for there in (True, False))
    assert {p["why"] for p in without} == {"too dark"}
    assert linked[0]["residual"] == [0.0025, 0.0], "0.02 px at 8 px/mm"
    assert linked[0]["residual_px"] == 0.02
    seen, missed = found["fiducials"]
    assert (seen["residual_px"], seen["residual"]) == (0.05, [0.00375, 0.005])
    assert (missed["sightings"], "residual" in missed) == (0, False)


def test_components_state_their_uncertainty_and_footprint(client: Any, station: Any) -> None:
    first, turned, _ = client.get(f"{RUNS}/{station.film()}/components").json()["components"]
    assert (first["sigma_px"], first["sigma_mm"]) == (0.02, 0.0025)
    assert first["footprint"] == [[15.0, 16.0], [25.0, 16.0], [25.0, 24.0], [15.0, 24.0]]
    assert turned["footprint"][0] == pytest.approx([30.6, 11.0])


def test_a_run_without_a_result_has_no_overlay(client: Any, station: Any) -> None:
    assert client.get(f"{RUNS}/{station.film(finish=False)}/overlay").status_code == 409
    assert client.get(f"{RUNS}/unknown/overlay").status_code == 404

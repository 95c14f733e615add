"""Runs over REST."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.files.images import decode, write_image
from vaoi_station.files.results import stitch_document
from vaoi_station.model import Status, Stitch
from vaoi_station.runs.states.run_ids import RunIds

RUNS = "/api/v1/runs"


@pytest.mark.parametrize("filters", [{}, {"verdict": "ok"}, {"read_id": "A"}])
def test_a_wrong_cursor_is_refused_and_one_of_a_deleted_run_goes_on(
    client: Any, station: Any, filters: dict[str, str]
) -> None:
    station.film()
    for wrong in ("bogus", "99999", "r999999"):
        refused = client.get(RUNS, params={"before": wrong, **filters})
        assert (refused.status_code, refused.json()["code"]) == (404, "unknown-run")
    deleted = RunIds().next()
    older = client.get(RUNS, params={"before": deleted, **filters})
    assert (older.status_code, older.json()) == (200, {"runs": []})


def test_matrices_have_the_file_format(client: Any, station: Any) -> None:
    run = station.film()
    content = client.get(f"{RUNS}/{run}/matrices").json()
    assert content == stitch_document(station.stitch(run))
    assert Stitch.model_validate(content).image_matrices[1][2] is None
    assert content["image_matrices"][1][2] is None


def test_finished_results_are_immutable_and_give_304(client: Any, station: Any) -> None:
    address = f"{RUNS}/{station.film()}/matrices"
    answer = client.get(address)
    assert "immutable" in answer.headers["cache-control"]
    tag = answer.headers["etag"]
    for named in (tag, f"W/{tag}", f'"other", {tag}', "*"):
        again = client.get(address, headers={"if-none-match": named})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert client.get(address, headers={"if-none-match": '"other"'}).status_code == 200


def test_a_result_that_is_not_complete_yet_is_asked_for_again(
    client: Any, station: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(station, "is_complete", lambda run: False)
    assert client.get(f"{RUNS}/{station.film()}/matrices").headers["cache-control"] == "no-cache"


def test_released_frames_are_gone_and_the_result_is_kept(client: Any, station: Any) -> None:
    run = station.film()
    assert client.post(f"{RUNS}/{run}/release").json()["frames_available"] is False
    assert client.get(f"{RUNS}/{run}/frames/0/0").status_code == 410
    assert client.get(f"{RUNS}/{run}/matrices").status_code == 200


def test_a_pin_is_shown_and_removed(client: Any, station: Any) -> None:
    run = station.film()
    assert client.get(f"{RUNS}/{run}").json()["pinned"] is False
    assert client.put(f"{RUNS}/{run}/pin").json()["pinned"] is True
    assert client.get(f"{RUNS}/{run}").json()["pinned"] is True
    assert client.get(RUNS).json()["runs"][0]["pinned"] is True
    assert client.get(f"{RUNS}/latest").json()["pinned"] is True
    assert client.delete(f"{RUNS}/{run}/pin").status_code == 204
    refusal = client.delete(f"{RUNS}/{run}/pin")
    assert (refusal.status_code, refusal.json()["code"]) == (404, "not-pinned")
    assert client.put(f"{RUNS}/unknown/pin").status_code == 404


def test_heights_are_measured_once_and_refused_without_a_working_distance(client: Any, station: Any) -> None:
    run = station.film()
    calibrated = station.cameras
    station.cameras = tuple(replace(camera, working_distance_mm=None) for camera in calibrated)
    refused = client.get(f"{RUNS}/{run}/heights")
    assert refused.status_code == 409
    assert refused.json()["code"] == "no-working-distance"
    station.cameras = calibrated
    answer = client.get(f"{RUNS}/{run}/heights")
    assert answer.status_code == 200
    assert "immutable" in answer.headers["cache-control"]
    found = answer.json()["heights"]
    assert set(found) == {"U1", "R1", "2/R1"}
    assert found["U1"]["views"] >= 2
    assert None not in found["U1"].values()
    assert client.get(f"{RUNS}/{run}/heights").content == answer.content
    assert station.mosaics.jobs.count("table of heights") == 1


def test_limits_mark_parts_and_say_what_they_would_have_marked(client: Any, station: Any) -> None:
    address, type_address = "/api/v1/board-types/demo-board/limits", "/api/v1/board-types/demo-board"
    first, second = station.film(), station.film()
    client.put(f"{RUNS}/{first}/good")
    assert "marked" not in client.get(f"{RUNS}/{second}/parts").json()["parts"]["R1"], "no limit is a default"
    limits = {"every": {"presence": 0.5}, "parts": {"U1": {"presence": 0.0, "alike": 1.0}}}
    known = client.get(type_address).content
    asked = client.post(f"{address}/check", json=limits)
    assert client.get(type_address).content == known
    report = asked.json()
    assert (report["runs"], report["measured"], report["marked_runs"]) == (1, 3, 1)
    assert {"run": second, "part": "R1", "measures": ["presence"]} in report["marked"]
    assert client.put(address, json=limits).json() == report
    assert client.get(address).json() == report["limits"]
    assert client.get(type_address).json()["limits"] == report["limits"]
    third = station.film()
    measured = client.get(f"{RUNS}/{third}/parts").json()["parts"]
    assert (measured["R1"]["marked"], measured["U1"]["marked"]) == (["presence"], ["alike"])
    assert client.put(address, json={}).json()["marked_parts"] == 0
    assert client.get(address).json() == {"packages": {}, "parts": {}}
    refusals: list[Any] = [{"parts": {"R99": {}}}, {"packages": {"0603": {}}}, {"every": {"presence": 2}}, {"evry": {}}]
    for wrong in refusals:
        refused = client.put(address, json=wrong)
        assert refused.status_code == 422, wrong
    assert "evry" in refused.text


def test_a_part_is_shown_beside_that_of_a_good_board(client: Any, station: Any) -> None:
    first, second, third = (station.film() for _ in range(3))
    untaught = client.get(f"{RUNS}/{second}/parts/U1").json()
    assert untaught["views"]
    assert not {"good", "measure"} & untaught.keys()
    assert "good" not in untaught["views"][0]
    client.put(f"{RUNS}/{first}/good")
    client.put(f"{RUNS}/{third}/good")
    client.get(f"{RUNS}/{second}/parts")
    page = client.get(f"{RUNS}/{second}/parts/2/R1").json()
    assert (page["address"], page["good"] in (first, third), page["limits"]) == ("2/R1", True, {})
    measured = client.get(f"{RUNS}/{second}/parts").json()["parts"]["2/R1"]
    assert page["measure"] == {**measured, "marked": []}
    part, good, difference = (
        np.asarray(decode(client.get(page["views"][0][name]).content), np.int_)
        for name in ("part", "good", "difference")
    )
    assert part.shape == good.shape
    assert np.abs(difference - np.clip(128 + part - good, 0, 255)).max() <= 1
    client.post(f"{RUNS}/{second}/release")
    assert client.get(page["views"][0]["part"]).status_code == 200, "it was made already"
    assert client.get(f"{RUNS}/{second}/parts/U1").json()["views"] == []
    refused = client.get(f"{RUNS}/{second}/parts/U1/pictures/0/part")
    assert (refused.status_code, refused.json()["code"]) == (404, "no-such-image")
    client.post(f"{RUNS}/{first}/release")
    kept = client.get(f"{RUNS}/{first}/parts/U1").json()
    assert (len(kept["views"]), kept["good"]) == (1, third), "of a good board its pictures are kept"
    refused = client.get(f"{RUNS}/{first}/parts/U99")
    assert (refused.status_code, refused.json()["code"]) == (404, "unknown-component")


def test_a_board_is_taught_and_measured_from_its_recording(client: Any, station: Any, tmp_path: Path) -> None:
    run, other = station.film(), station.film()
    known = client.put(f"{RUNS}/{other}/good").json()["boards"][0]
    in_memory = client.get(f"{RUNS}/{run}/parts/U1").json()
    for one in (run, other):
        client.post(f"{RUNS}/{one}/release")
    refused = client.put(f"{RUNS}/{run}/good")
    assert (refused.status_code, refused.json()["code"]) == (410, "frames-gone")
    files = {}
    for (name, camera, row), pixels in station.pixels.items():
        files[name, camera, row] = tmp_path / f"{name}-{camera}-{row}.tiff"
        write_image(files[name, camera, row], pixels)
    station.parts.recorded = lambda *key: files.get(key)
    client.delete(f"{RUNS}/{other}/good")
    assert client.put(f"{RUNS}/{other}/good").json()["boards"] == [known]
    assert client.get(f"{RUNS}/{run}/parts").json()["parts"]["U1"]["presence"] > 0.99
    assert client.get(f"{RUNS}/{run}/parts/U1").json()["views"] == in_memory["views"]


def test_a_good_board_of_another_type_is_left_out_and_said(client: Any, station: Any) -> None:
    first, second = station.film(), station.film()
    client.put(f"{RUNS}/{first}/good")
    now = station.types["demo-board"]
    larger = tuple(c.model_copy(update={"width": 2 * c.width}) for c in now.components)
    station.types["demo-board"] = now.model_copy(update={"components": larger})
    found = client.get(f"{RUNS}/{second}/parts").json()
    assert (found["good_boards"], found["remark_codes"]) == ([], ["good-board-of-other-type"])
    assert found["remarks"][0].startswith(f"{first}: most parts are not those of this board type")


def test_parts_are_compared_with_boards_that_were_taught_as_good_until_these_are_removed(
    client: Any, station: Any
) -> None:
    first, second, third, fourth = (station.film() for _ in range(4))
    untaught = client.get(f"{RUNS}/{first}/parts").json()
    assert untaught["parts"]["U1"]["reasons"] == ["untaught", "undecided"]
    assert set(untaught["reason_texts"]) == {"untaught", "undecided"}
    assert client.get(f"{RUNS}/{first}/parts").json() == untaught
    assert station.mosaics.jobs.count("parts") == 1, "measured once"
    assert [b["run"] for b in client.put(f"{RUNS}/{first}/good").json()["boards"]] == [first]
    assert client.put(f"{RUNS}/{second}/good").json()["disagreements"] == [], "two do not show which is right"
    for key in [key for key in station.pixels if key[0] == fourth]:
        station.pixels[key] = 200 - station.pixels[key] // 2
    taught = client.put(f"{RUNS}/{fourth}/good").json()
    assert (fourth, "U1") in {(d["board"], d["part"]) for d in taught["disagreements"]}, "its frames are negatives"
    assert client.get("/api/v1/board-types/demo-board/good").json()["boards"] == taught["boards"]
    answer = client.get(f"{RUNS}/{third}/parts")
    found = answer.json()
    assert found["good_boards"] == [first, second, fourth]
    assert found["parts"]["U1"]["presence"] > 0.99
    assert found["parts"]["R1"]["presence"] < 0.5
    assert client.delete(f"{RUNS}/{first}/good").json()["boards"] == taught["boards"][1:]
    refused = client.delete(f"{RUNS}/{first}/good")
    assert (refused.status_code, refused.json()["code"]) == (404, "not-good")
    assert client.get(f"{RUNS}/{third}/parts").content == answer.content, "measured once"
    assert client.get(f"{RUNS}/{third}/parts", headers={"if-none-match": answer.headers["etag"]}).status_code == 304
    assert [(e.run, e.state) for e in station.log if e.kind == "parts"] == [
        (first, "good"), (second, "good"), (fourth, "good"), (first, "not-good"),
    ]  # fmt: skip
    client.post(f"{RUNS}/{second}/release")
    assert client.put(f"{RUNS}/{second}/good").status_code == 410


def test_a_decision_needs_a_name_and_a_reason_and_is_shown(client: Any, station: Any) -> None:
    run = station.film(verdict=Status.DEGRADED)
    decision = {"choice": "film-again", "name": "Ada", "reason": "Rows are missing."}
    shown = client.put(f"{RUNS}/{run}/decision", json=decision).json()["decision"]
    assert {key: shown[key] for key in decision} == decision
    assert client.get(RUNS).json()["runs"][0]["decision"] == shown
    for wrong in ({"choice": "scrap"}, {"name": ""}, {"reason": ""}):
        assert client.put(f"{RUNS}/{run}/decision", json=decision | wrong).status_code == 422
    assert client.put(f"{RUNS}/r999999/decision", json=decision).status_code == 404


def test_identity_is_waited_for_and_compared(client: Any, station: Any) -> None:
    run = station.film(board_id="SN-1")
    address = f"{RUNS}/{run}/identity"
    assert client.get(address).json()["state"] == "not-read"
    station.kept.identities.pending.add(run)
    assert client.get(address).json()["state"] == "pending"
    refused = client.put(f"{address}/next-machine", json={"board_id": "SN-1"})
    assert (refused.status_code, refused.json()["code"]) == (409, "identity-pending")
    reader = threading.Timer(0.1, station.kept.identities.read, (run, "demo;SN-1"))
    reader.start()
    found = client.get(address, params={"timeout": 30}).json()
    reader.join()
    assert (found["state"], found["board_id"], found["armed_board_id"]) == ("agrees", "SN-1", "SN-1")
    assert found["codes"][0]["text"] == "demo;SN-1"


RUNS = "/api/v1/runs"


def test_the_timeline_has_every_step_since_the_barrier(client: Any, station: Any) -> None:
    answer = client.get(f"{RUNS}/{station.film()}/timeline")
    found = answer.json()
    assert [r["row"] for r in found["rows"]] == [0, 1, 2, 3]
    assert found["rows"][0] == {"row": 0, "pulse_s": 0.05, "light": "", "led_us": 80.0, "exposure_us": 250.0}
    assert found["barrier"] == [{"blocked_s": 0.0, "clear_s": 0.33}]
    assert found["last_frame_s"] < found["ready_s"]
    assert "immutable" in answer.headers["cache-control"]


def test_a_clamped_board_is_placed_by_the_readings_of_the_tester(client: Any, station: Any) -> None:
    address = f"{RUNS}/{station.film()}/clamped"
    # Filmed and clamped coordinates are CAD's here, moved by (100, 200), and F1 was seen off its place.
    readings = [{"fiducial": "F1", "x": 103.0, "y": 203.0}, {"fiducial": "F2", "x": 157.0, "y": 237.0}]
    wanted = {
        "readings": readings,
        "sigma": 0.01,
        "turn_deg": 0.0,
        "points": ["U1", {"x": 30.0, "y": 20.0, "name": "TP1"}],
    }
    found = client.post(address, json=wanted)
    assert found.status_code == 200, found.text
    placed = {point["name"]: point for point in found.json()["points"]}
    assert placed["U1"]["x"] == pytest.approx(120.0, abs=0.02)
    assert placed["TP1"]["y"] == pytest.approx(220.0, abs=0.02)
    assert found.json()["status"] == "ok", found.json()["reasons"]
    refused: list[dict[str, Any]] = [{"sigma": 0}, {"readings": []}, {"points": ["R99"]}, {"unit": "furlong"}]
    for fields in refused:
        assert client.post(address, json={**wanted, **fields}).status_code == 422
    assert client.post(f"{RUNS}/r999999/clamped", json=wanted).status_code == 404

"""Runs over REST."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.files.results import stitch_document
from vaoi_station.model import Status, Stitch
from vaoi_station.runs.states.run_ids import RunIds, utc
from vaoi_station.store.figures import BoardRow

RUNS = "/api/v1/runs"


def test_pages_of_the_list_have_no_gaps_or_repetitions(client: Any, station: Any) -> None:
    made = [station.film() for _ in range(7)]
    seen: list[str] = []
    query: dict[str, Any] = {"limit": 3}
    while True:
        page = client.get(RUNS, params=query).json()
        seen += [r["id"] for r in page["runs"]]
        if "next" not in page:
            break
        query["before"] = page["next"]
    assert seen == made[::-1]


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


def test_a_span_that_ends_before_it_begins_is_refused(client: Any) -> None:
    times = {"since": "2026-07-02T10:00:00+02:00", "until": "2026-07-02T08:00:00Z"}
    assert client.get(RUNS, params=times).status_code == 200  # the same moment
    times["until"] = "2026-07-02T07:59:59Z"
    refused = client.get(RUNS, params=times)
    assert (refused.status_code, refused.json()["code"]) == (422, "invalid-input")
    assert "must be no later than until (2026-07-02T07:59:59.000Z)" in refused.json()["detail"]


def test_a_full_last_page_has_no_next(client: Any, station: Any) -> None:
    for _ in range(3):
        station.film()
    assert "next" not in client.get(RUNS, params={"limit": 3}).json()


def test_the_callers_ids_are_returned(client: Any, station: Any) -> None:
    station.film(board_id="B1")
    assert client.get(f"{RUNS}/latest").json()["board_id"] == "B1"


def test_every_frame_has_a_verdict_and_cause(client: Any, station: Any) -> None:
    frames = client.get(f"{RUNS}/{station.film()}").json()["frames"]
    assert len(frames) == 12
    lost = {(f["camera"], f["row"]): (f["verdict"], f["cause"]) for f in frames if f["verdict"] != "ok"}
    assert lost == {(0, 1): ("incomplete", "cable"), (1, 2): ("missing", "cable")}


def test_matrices_have_the_file_format(client: Any, station: Any) -> None:
    run = station.film()
    content = client.get(f"{RUNS}/{run}/matrices").json()
    assert content == stitch_document(station.stitch(run))
    assert Stitch.model_validate(content).image_matrices[1][2] is None
    assert content["image_matrices"][1][2] is None


def test_matrices_of_an_unfinished_run_are_refused(client: Any, station: Any) -> None:
    run = station.film(finish=False)
    answer = client.get(f"{RUNS}/{run}/matrices")
    assert (answer.status_code, answer.json()["action"]) == (409, "Ask again in a moment.")


def test_finished_results_are_immutable_and_give_304(client: Any, station: Any) -> None:
    address = f"{RUNS}/{station.film()}/matrices"
    answer = client.get(address)
    assert "immutable" in answer.headers["cache-control"]
    tag = answer.headers["etag"]
    for named in (tag, f"W/{tag}", f'"other", {tag}', "*"):
        again = client.get(address, headers={"if-none-match": named})
        assert (again.status_code, again.content, again.headers["etag"]) == (304, b"", tag)
    assert client.get(address, headers={"if-none-match": '"other"'}).status_code == 200


def test_a_run_is_revalidated_because_its_state_may_change(client: Any, station: Any) -> None:
    run = station.film()
    answer = client.get(f"{RUNS}/{run}")
    assert answer.headers["cache-control"] == "no-cache"
    unchanged = {"if-none-match": answer.headers["etag"]}
    assert client.get(f"{RUNS}/{run}", headers=unchanged).status_code == 304
    client.post(f"{RUNS}/{run}/release")
    assert client.get(f"{RUNS}/{run}", headers=unchanged).json()["state"] == "released"


def test_released_frames_are_gone_and_the_result_is_kept(client: Any, station: Any) -> None:
    run = station.film()
    assert client.post(f"{RUNS}/{run}/release").json()["frames_available"] is False
    assert client.get(f"{RUNS}/{run}/frames/0/0").status_code == 410
    assert client.get(f"{RUNS}/{run}/matrices").status_code == 200


def test_a_run_is_held_and_the_hold_ended(client: Any, station: Any) -> None:
    run = station.film()
    hold = client.put(f"{RUNS}/{run}/hold", params={"holder": "tester 1", "purpose": "verdict"})
    assert hold.json() == {"run": run, "holder": "tester 1", "purpose": "verdict", "expires_in_s": 600}
    assert client.delete(f"{RUNS}/{run}/hold", params={"holder": "tester 1"}).status_code == 204
    assert not station.holders


def test_the_end_of_a_hold_may_be_repeated_and_leaves_those_of_others(client: Any, station: Any) -> None:
    """A client without a reply does not know whether its hold has ended: it asks again, and gets 204."""
    address = f"{RUNS}/{station.film()}/hold"
    for holder in ("tester 1", "tester 2"):
        client.put(address, params={"holder": holder})
    for _ in range(2):
        assert client.delete(address, params={"holder": "tester 1"}).status_code == 204
        assert [holder for _, holder in station.holders] == ["tester 2"]


@pytest.mark.parametrize("method", ["PUT", "DELETE"])
def test_a_hold_needs_a_holder(client: Any, station: Any, method: str) -> None:
    assert client.request(method, f"{RUNS}/{station.film()}/hold").status_code == 422


@pytest.mark.parametrize("wrong", [{"holder": "a\0"}, {"holder": "nc", "purpose": "a\nb"}])
def test_a_hold_has_no_control_characters(client: Any, station: Any, wrong: dict[str, str]) -> None:
    refused = client.put(f"{RUNS}/{station.film()}/hold", params=wrong)
    assert (refused.status_code, station.holders) == (422, {})
    assert "must have no control characters" in refused.json()["detail"]


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


def test_frames_that_are_gone_are_refused(client: Any, station: Any) -> None:
    run = station.film()
    client.post(f"{RUNS}/{run}/release")
    assert client.get(f"{RUNS}/{run}/heights").status_code == 410
    assert client.get(f"{RUNS}/none/heights").status_code == 404


def test_the_list_is_filtered_by_the_station(client: Any, station: Any) -> None:
    good = station.film(board_id="SN-1")
    bad = station.film(verdict=Status.FAILED, board_id="SN-2")

    def found(**query: str) -> list[str]:
        return [run["id"] for run in client.get(RUNS, params=query).json()["runs"]]

    assert found(verdict="failed") == [bad]
    assert found(board_id="SN-1", verdict="ok") == [good]
    assert found(until="2000-01-01T00:00:00Z") == []
    for query in ({"verdict": "fine"}, {"since": "yesterday"}, {"until": "2026-01-01T00:00:00"}):
        assert client.get(RUNS, params=query).status_code == 422


@pytest.mark.parametrize("moment", ["0001-01-01T00:00:00+23:00", "9999-12-31T23:59:59-23:00"])
def test_times_that_utc_cannot_express_are_the_first_and_the_last(client: Any, station: Any, moment: str) -> None:
    station.film()
    later = moment.startswith("9")
    for query, count in (({"since": moment}, not later), ({"until": moment}, later)):
        assert len(client.get(RUNS, params=query).json()["runs"]) == count
    counts = client.get(f"{RUNS}/counts", params={"since": moment}).json()
    assert counts["since"][:4] == ("9998" if later else "0002")


def test_boards_are_counted_since_a_time_with_its_zone(client: Any, station: Any) -> None:
    station.film()
    station.film(verdict=Status.DEGRADED)
    counts = client.get(f"{RUNS}/counts", params={"since": "2000-01-01T00:00:00+02:00"}).json()
    assert counts == {
        "since": "1999-12-31T22:00:00.000Z",
        "ok": 1,
        "degraded": 1,
        "failed": 0,
        "missed": 0,
        "complete": True,
    }
    assert client.get(f"{RUNS}/counts", params={"since": "today"}).status_code == 422
    assert client.get(f"{RUNS}/counts").json()["ok"] == 1


def test_a_decision_needs_a_name_and_a_reason_and_is_shown(client: Any, station: Any) -> None:
    run = station.film(verdict=Status.DEGRADED)
    decision = {"choice": "film-again", "name": "Ada", "reason": "Rows are missing."}
    shown = client.put(f"{RUNS}/{run}/decision", json=decision).json()["decision"]
    assert {key: shown[key] for key in decision} == decision
    assert client.get(RUNS).json()["runs"][0]["decision"] == shown
    for wrong in ({"choice": "scrap"}, {"name": ""}, {"reason": ""}):
        assert client.put(f"{RUNS}/{run}/decision", json=decision | wrong).status_code == 422
    assert client.put(f"{RUNS}/r999999/decision", json=decision).status_code == 404


def test_of_two_who_decide_the_second_learns_of_the_first(client: Any, station: Any) -> None:
    run = station.film(verdict=Status.FAILED)
    decision = {"choice": "use", "name": "Ada", "reason": "Only a seam is blurred."}
    read = client.get(f"{RUNS}/{run}").headers["etag"]
    first = client.put(f"{RUNS}/{run}/decision", json=decision, headers={"If-Match": read})
    second = {"headers": {"If-Match": read}, "json": decision | {"choice": "film-again", "name": "Bo"}}
    answer = client.put(f"{RUNS}/{run}/decision", **second)
    assert (first.status_code, answer.status_code, answer.json()["code"]) == (200, 412, "changed")
    assert client.get(f"{RUNS}/{run}").json()["decision"]["name"] == "Ada"
    second["headers"] = {"If-Match": first.headers["etag"]}
    assert client.put(f"{RUNS}/{run}/decision", **second).json()["decision"]["name"] == "Bo"


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


def test_next_machine_reports_its_id(client: Any, station: Any) -> None:
    run = station.film(board_id="SN-1")
    station.kept.identities.read(run, "demo;SN-1")
    report = {"board_id": "SN-2", "machine": "prober"}
    found = client.put(f"{RUNS}/{run}/identity/next-machine", json=report).json()
    assert (found["state"], found["reasons"][0]["code"]) == ("differs", "next-machine-differs")
    assert found["next_machine"].items() >= report.items()
    assert found["next_machine"]["time"].endswith("Z")
    assert client.get(f"{RUNS}/{run}/identity").json() == found
    assert client.put(f"{RUNS}/{run}/identity/next-machine", json={"board_id": ""}).status_code == 422


def test_runs_are_found_by_the_id_that_was_read(client: Any, station: Any) -> None:
    runs = [station.film() for _ in range(3)]
    for run, text in zip(runs, ("demo;A", "demo;B", "demo;A"), strict=True):
        station.kept.identities.read(run, text)
    page = client.get(RUNS, params={"read_id": "A", "limit": 1}).json()
    assert [r["id"] for r in page["runs"]] == [runs[2]]
    rest = client.get(RUNS, params={"read_id": "A", "before": page["next"]}).json()
    assert ([r["id"] for r in rest["runs"]], "next" in rest) == ([runs[0]], False)
    assert client.get(RUNS, params={"read_id": "C"}).json()["runs"] == []


@pytest.mark.parametrize("wanted", [{}, {"verdict": "ok"}])
def test_figures_are_shown_to_those_who_ask(client: Any, station: Any, wanted: dict[str, str]) -> None:
    figures = {"sigma_px": 0.05, "seam_px:0-1": 0.1}
    run = station.film()
    station.kept.trends.rows.append(BoardRow(run, utc(), "demo-board", figures))
    (plain,) = client.get(RUNS, params=wanted).json()["runs"]
    (asked,) = client.get(RUNS, params={**wanted, "figures": True}).json()["runs"]
    assert "figures" not in plain
    assert asked == {**plain, "figures": figures}
    assert client.get(f"{RUNS}/{run}", params={"figures": True}).json()["figures"] == figures


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

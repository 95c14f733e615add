"""Every operation states the status codes with which it is refused."""

from __future__ import annotations

from typing import Any

from vaoi_station.api.description.refusals import NAMES, answers, reference, statuses
from vaoi_station.api.problems import KINDS

JSON: dict[str, Any] = {"responses": {"200": {"content": {"application/json": {}}}}}


def test_every_kind_of_refusal_but_a_wrong_method_or_address_has_a_name_and_an_example() -> None:
    described = answers()
    assert {status for status, _, _ in KINDS.values()} - set(NAMES) == {405}
    for kind, (status, _, action) in KINDS.items():
        if status in NAMES:
            assert reference(status) == {"$ref": f"#/components/responses/{NAMES[status]}"}
            example = described[NAMES[status]]["content"]["application/problem+json"]["examples"][kind]["value"]
            assert (example["status"], example["action"]) == (status, action)


def test_refusals_follow_from_method_path_and_answers() -> None:
    assert statuses("get", "/healthz", JSON) == [400, 421, 422, 500]
    assert statuses("get", "/api/v1/station", JSON) == [400, 401, 403, 421, 422, 500, 503]
    command = statuses("post", "/api/v1/runs/{run}/release", JSON)
    assert {404, 408, 409, 410, 413} <= set(command)
    picture: dict[str, Any] = {"responses": {"200": {"content": {"image/png": {}, "application/x-npy": {}}}}}
    assert 406 in statuses("get", "/api/v1/runs/{run}/frames/{camera}/{row}", picture)
    guarded = {**JSON, "parameters": [{"name": "If-Match"}]}
    assert 412 in statuses("put", "/api/v1/board-types/{name}", guarded)
    assert {404, 409, 410} <= set(statuses("post", "/api/v1/calibration/marks", JSON))  # The run is in the body.

"""Parts of the twin's boards, compared with good boards: what is absent, where parts lie, and what cannot be said."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.parts.conftest import stitched, taught
from vaoi_station.model import BoardLimits, Status
from vaoi_station.parts.document import Remark, changes, dark_lights, disagreement_steps, measure_parts, parts_document
from vaoi_station.parts.learned import TaughtBoard, parts_digest
from vaoi_station.parts.measure import Run, SoFar
from vaoi_station.parts.models import Models
from vaoi_station.runs.archive.measured_parts import event_message
from vaoi_station.steps import completed

ABSENT = ("C2", "C4", "R3", "R7", "R11", "R15", "R17", "R21", "R25", "C11")


def test_absent_parts_are_told_from_present_ones(good_boards: tuple[TaughtBoard, ...]) -> None:
    run = stitched(2, ABSENT)
    parts = measure_parts(run, Models(good_boards))
    low = {a for a, p in parts.items() if p["presence"] is not None and p["presence"] < 0.5}
    assert low == set(ABSENT)
    present = [p for p in parts.values() if p["dx_mm"] is not None]
    assert len(present) >= 30
    # The twin places parts with a spread of a few hundredths of a mm.
    assert np.median([np.hypot(p["dx_mm"], p["dy_mm"]) for p in present]) < 0.08


def test_a_board_without_good_ones_says_what_heights_alone_tell() -> None:
    run = stitched(2, ABSENT)
    parts = measure_parts(run, Models(()))
    said = {a: p["presence"] for a, p in parts.items() if p["presence"] is not None}
    assert sum(a in ABSENT and p < 0.5 for a, p in said.items()) >= 6
    assert sum(a not in ABSENT and p < 0.5 for a, p in said.items()) <= 3
    silent = [p["reasons"] for p in parts.values() if p["presence"] is None]
    assert all(reasons for reasons in silent)


def test_noise_alone_does_not_say_that_parts_are_there() -> None:
    run = stitched(2)

    def noise(camera: int, row: int) -> np.ndarray:
        size = run.head.cameras[camera].height, run.head.cameras[camera].width
        return np.random.default_rng([camera, row]).normal(90, 4, size).clip(0, 255).astype(np.uint8)

    parts = measure_parts(run._replace(frame=noise), Models(()))
    # One part in twenty at most: noise is seldom some standard deviations off.
    assert sum(p["presence"] is not None for p in parts.values()) <= len(parts) // 20


def test_an_absent_part_on_a_good_board_is_shown_with_board_and_part(good_boards: tuple[TaughtBoard, ...]) -> None:
    bad = taught(stitched(2, ("R7",)), "not-good")
    assert ("not-good", "R7") in {(d["board"], d["part"]) for d in completed(disagreement_steps((*good_boards, bad)))}
    assert completed(disagreement_steps((good_boards[0], bad))) == [], "two do not show which of them is right"


def test_a_board_on_which_most_parts_are_unlike_is_called_another_revision(
    good_boards: tuple[TaughtBoard, ...],
) -> None:
    run, models = stitched(0), Models(good_boards)
    parts = measure_parts(run, models)
    assert not parts_document(run, models, parts, ())["remarks"]
    for n, part in enumerate(parts.values()):
        part["alike"] = 0.01 if n % 4 else part["alike"]
    document = parts_document(run, models, parts, ())
    (remark,) = document["remarks"]
    assert document["remark_codes"] == ["other-revision"]
    assert remark.startswith("{unlike} of {said} parts are unlike".format(**document["remark_values"][0]))
    assert event_message(document) == remark, "one statement, and not a fault for each part"


def test_limits_mark_parts_and_the_event_names_them(good_boards: tuple[TaughtBoard, ...]) -> None:
    run, models = stitched(2, ABSENT), Models(good_boards)
    limits = BoardLimits.model_validate({"every": {"presence": 0.5}, "parts": {"C2": {"presence": 0.0}}})
    run = run._replace(board_type=run.board_type.model_copy(update={"limits": limits}))
    document = parts_document(run, models, measure_parts(run, models), changes(run, good_boards, "c"))
    marked = [ref for ref, part in document["parts"].items() if "marked" in part]
    assert set(marked) == set(ABSENT) - {"C2"}
    assert document["parts"]["C4"]["marked"] == ["presence"]
    document["parts"] = {
        ref: {key: value for key, value in part.items() if value is not None} for ref, part in document["parts"].items()
    }
    shown = f"9 of them are beyond limits: {', '.join(marked[:5])} …."
    assert event_message(document).endswith(shown), "that two good boards are few is no part of every message"


def codes(remarks: list[Remark]) -> list[str]:
    """Return the codes of remarks except that two boards are few."""
    return [remark.code for remark in remarks if remark.code != "few-good-boards"]


def test_what_changed_since_teaching_is_said(good_boards: tuple[TaughtBoard, ...]) -> None:
    run = stitched(0)
    (few,) = changes(run, good_boards, "c")
    assert str(few).startswith("good boards: 2. How far good parts differ is hardly known from fewer than 3")
    assert codes(changes(run, good_boards, "other")) == ["calibration-differs"]
    moved = run.board_type.components[0].model_copy(update={"rotation": 90.0})
    other = run.board_type.model_copy(update={"components": (moved, *run.board_type.components[1:])})
    (remark,) = [r for r in changes(run._replace(board_type=other), good_boards, "c") if r.code == "board-type-changed"]
    assert "since good-0, good-1 became" in str(remark)
    dark = tuple(replace(b, classes=tuple(c._replace(light="uv") for c in b.classes)) for b in good_boards)
    assert codes(changes(run, dark, "c")) == ["other-lights"]
    assert changes(run, (), "c") == []


def test_two_measurements_give_the_same_digits(good_boards: tuple[TaughtBoard, ...]) -> None:
    first, second = (measure_parts(stitched(1), Models(good_boards)) for _ in range(2))
    assert first == second


@pytest.mark.parametrize("parts", [10])
def test_parts_can_be_measured_in_shares(good_boards: tuple[TaughtBoard, ...], parts: int) -> None:
    run = stitched(1)
    some = measure_parts(run, Models(good_boards), run.board_type.components[:parts])
    assert len(some) == parts
    assert all(p["presence"] is None or p["presence"] > 0.5 for p in some.values())


def test_doubts_about_the_run_itself_are_remarks(good_boards: tuple[TaughtBoard, ...]) -> None:
    run = stitched(0)
    degraded = run._replace(stitch=run.stitch.model_copy(update={"status": Status.DEGRADED}))
    assert codes(changes(degraded, good_boards, "c")) == ["run-not-ok"]
    assert codes(changes(run, good_boards, "c", "good-0")) == ["own-board"]
    assert codes(changes(run, good_boards, "c", "another")) == []


def relit(run: Run, *, out: bool = False) -> Run:
    """Return a run whose rows are filmed under two lights in turn; with `out`, the second lamp is out."""
    lights = tuple("left" if row % 2 else "ring" for row in range(run.head.rows))

    def frame(camera: int, row: int) -> Any:
        pixels = run.frame(camera, row)
        return pixels if pixels is None or not (out and row % 2) else np.zeros_like(pixels)

    return run._replace(head=run.head.model_copy(update={"lights": lights}), frame=frame)


def test_a_lamp_that_is_out_is_said_and_makes_no_board_of_another_revision() -> None:
    good = tuple(taught(relit(stitched(n)), f"good-{n}") for n in range(2))
    run, so_far = relit(stitched(2, ABSENT), out=True), SoFar()
    models = Models(good)
    parts = measure_parts(run, models, so_far=so_far)
    document = parts_document(run, models, parts, dark_lights(so_far))
    assert document["remark_codes"] == ["dark-lights"]
    assert document["remark_values"] == [{"lights": ["left"]}]
    low = {a for a, p in parts.items() if p["presence"] is not None and p["presence"] < 0.5}
    assert low <= set(ABSENT)
    assert len(low) > len(ABSENT) / 2
    assert sum(p["dx_mm"] is not None for p in parts.values()) > 25


def test_a_board_equals_itself_where_heights_are_unknown_and_no_two_parts_look_alike() -> None:
    """Each camera sees the tall parts of one kind from another side."""
    run = stitched(0)
    bare = tuple(
        c.model_copy(update={"body_height": None, "package": None, "width": 3.0, "height": 3.0})
        for c in run.board_type.components
    )
    run = run._replace(board_type=run.board_type.model_copy(update={"components": bare}))
    board = TaughtBoard.of_run("good", run.cut_on_tops(bare, {}), parts_digest(run.board_type), "c")
    parts = measure_parts(run, Models((board,)))
    unlike = {a for a, p in parts.items() if p["alike"] is not None and p["alike"] < 0.5}
    assert unlike == set()
    assert sum(p["alike"] is not None for p in parts.values()) > 30

"""Components and frames of which the good frames show too little, and why."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vaoi_station.frame_index import FrameIndex
from vaoi_station.model import BoardType, ReasonCode, Status, Visibility
from vaoi_station.stitching.board.reference import Reference
from vaoi_station.stitching.geometry import ComponentIndex
from vaoi_station.stitching.quality.visibility import (
    FilmedBoard,
    UnseenComponent,
    find_unseen,
    required_visibility,
    unseen_reasons,
)
from vaoi_station.stitching.work import stitch_frames


def with_changes(board_type: BoardType, **keys: Any) -> BoardType:
    return BoardType.model_validate(board_type.model_dump(mode="json", exclude_none=True) | keys)


def asking(board_type: BoardType, refs: set[str], **visibility: Any) -> BoardType:
    parts = board_type.model_dump(mode="json", exclude_none=True)["components"]
    return with_changes(
        board_type, components=[p | ({"visibility": visibility} if p["ref"] in refs else {}) for p in parts]
    )


def truly_unseen(filmed: Any, frames: Any) -> set[str]:
    """Return the components whose centre no frame shows, by the twin's truth."""
    return {
        ref for ref, views in filmed.truth["views"].items() if not any((int(i), int(j)) in frames for i, j, *_ in views)
    }


def test_a_lost_camera_degrades_and_names_its_components(filmed: Any) -> None:
    """Two fiducials lie in the other camera's view, so that everything else is as it should be."""
    frames = {key: pixels for key, pixels in filmed.frames.items() if key[0] == 1}
    result = filmed.stitched(frames=frames)
    unseen = result.quality["unseen"]
    lost = truly_unseen(filmed, frames)
    assert len(lost) > 10
    assert lost <= set(unseen)
    assert {u["cause"] for u in unseen.values()} == {"frames-lost"}
    assert result.status is Status.DEGRADED
    (reason,) = result.reasons
    assert "camera 0 delivered no complete frame" in reason
    assert all(re.search(rf"\b{ref} \d+ %", reason) for ref in unseen)


@pytest.mark.parametrize("kind", ["frozen", "black"])
def test_a_camera_that_sends_other_pictures_than_those_of_the_board_degrades(filmed: Any, kind: str) -> None:
    """All frames are complete, but those of camera 0 repeat the first one, or are black."""
    first = filmed.frames[0, 0]
    other = first if kind == "frozen" else np.zeros_like(first)
    frames = {key: other if key[0] == 0 else pixels for key, pixels in filmed.frames.items()}
    result = filmed.stitched(frames=frames)
    assert result.status is not Status.OK
    if result.cad_matrix is not None:
        # the first frame of a camera that froze is a true one
        lost = truly_unseen(filmed, [key for key in frames if key[0] == 1 or key == (0, 0)])
        assert lost <= set(result.quality["unseen"])


def test_a_single_frame_of_another_moment_degrades(filmed: Any) -> None:
    """Row 3 of camera 0 repeats row 1. Other frames show its components, but a picture from it would be wrong."""
    frames = filmed.frames | {(0, 3): filmed.frames[0, 1]}
    result = filmed.stitched(frames=frames)
    assert result.status is not Status.OK
    assert any("camera 0 row 3" in reason for reason in result.reasons)


@pytest.mark.parametrize("kind", ["frozen", "black", "near-copy"])
def test_the_method_by_reference_checks_every_frame(filmed: Any, kind: str) -> None:
    """A frame that shows nothing of the reference at its place is not confirmed by being there."""
    reference = Reference(filmed.stitch, frozenset(filmed.frames), "taught", filmed.stitch.quality["cad_sigma_px"])
    first = filmed.frames[0, 0]
    noise = np.random.default_rng(0).normal(0, 2, first.shape)
    before = np.clip(filmed.frames[0, 1] + noise, 0, 255).astype(first.dtype)
    spoilt = {
        "frozen": {key: first for key in filmed.frames if key[0] == 0},
        "black": {key: np.zeros_like(first) for key in filmed.frames if key[0] == 0},
        "near-copy": {(0, 2): before},
    }[kind]
    setup = replace(filmed.setup, method="reference", reference=reference)

    def stitched(frames: Any) -> Any:
        return stitch_frames(
            setup, filmed.head, lambda i, j: frames.get((i, j)), lambda i, j: filmed.frames.get((i, j))
        )

    sound = stitched(filmed.frames)
    assert (sound.status, sound.quality["unseen"]) == (Status.OK, {})
    result = stitched(filmed.frames | spoilt)
    assert result.status is not Status.OK
    assert kind != "near-copy" or ReasonCode.FRAMES_UNCONFIRMED.value in (result.reason_codes or ())


def test_the_method_by_fiducials_names_copies(filmed: Any) -> None:
    setup = replace(filmed.setup, method="fiducials")
    frames = filmed.frames | {(0, 3): filmed.frames[0, 2]}
    result = stitch_frames(setup, filmed.head, lambda i, j: frames.get((i, j)))
    assert result.status is Status.DEGRADED
    assert any("camera 0 row 3; 1 of them equal the frame before" in reason for reason in result.reasons)


@pytest.mark.parametrize(
    ("center", "lost", "odd", "cause"),
    [((0, -60), [], [], "filming-ended"), ((0, 30), [], [], "filming-began"), ((60, 0), [], [], "beyond-view"),
     ((0, 0), [(0, 0), (0, 1)], [], "frames-lost"), ((9.5, 0), [], [], "seam"),
     ((0, 0), [], [(0, 0), (0, 1)], "frames-unconfirmed")],
)  # fmt: skip
def test_the_cause_is_the_one_that_was_tested(workshop: Any, center: Any, lost: Any, odd: Any, cause: str) -> None:
    """Two cameras of 20 × 16 mm over two rows, 7 mm apart; a board that moves along y."""
    cameras = [workshop.camera((x, 0.0)) for x in (0.0, 19.0)]
    rows = np.repeat(np.eye(3)[None], 2, 0)
    rows[1, 1, 2] = 7.0
    part = {"ref": "U1", "center": center, "width": 4, "height": 2, "visibility": {"in_one_frame": True}}
    kind = BoardType.model_validate({"name": "b", "y_axis": "down", "components": [part]})
    present = [(i, j) for i in range(2) for j in range(2) if (i, j) not in lost]
    board = FilmedBoard(ComponentIndex.of(kind), FrameIndex(cameras, rows, present))
    confirmed = [key for key in present if key not in odd]
    (unseen,) = find_unseen(board, confirmed, np.array([0.0, 50.0]), required_visibility(kind, Visibility()))
    assert (unseen.address, unseen.cause) == ("U1", cause)
    assert (unseen.coverage == 1) == (cause == "seam")


def test_a_component_that_hangs_over_the_array_is_named_unless_it_is_meant_to(filmed: Any) -> None:
    parts = filmed.board_type.model_dump(mode="json", exclude_none=True)["components"]
    (x0, y0), (x1, _) = filmed.board_type.extent()
    beside = {"ref": "X99", "center": [x1 + (x1 - x0), y0 + 5], "width": 4, "height": 4}
    kind = with_changes(filmed.board_type, components=[*parts, beside])
    result = filmed.stitched(board_type=kind)
    assert result.status is Status.DEGRADED
    assert result.quality["unseen"]["X99"] == {
        "coverage": 0.0, "views": 0, "in_one_frame": False, "cause": "beyond-view",
    }  # fmt: skip
    assert "X99 0 % of 99 %" in result.reasons[0]
    meant = filmed.stitched(board_type=asking(kind, {"X99"}, coverage=0))
    assert (meant.status, meant.reasons) == (Status.OK, ())


@pytest.mark.parametrize(
    ("lost", "unplaced", "words"),
    [
        ({(1, 0), (1, 1)}, (), "camera 1 delivered no complete frame: repair what lost these frames"),
        ({(0, 1), (1, 1)}, (1,), "): other rows are not placed: film the board again"),
        ({(1, 0), (0, 1), (1, 1)}, (1,), "; other rows are not placed: film the board again"),
    ],
)
def test_lost_frames_are_named_beside_rows_that_are_not_placed(lost: Any, unplaced: Any, words: str) -> None:
    unseen = UnseenComponent("U1", 0.5, 0, False, Visibility(), "frames-lost")
    present = {(i, j) for i in range(2) for j in range(2)} - lost
    scene: Any = SimpleNamespace(cameras=(None, None), present=tuple(sorted(present)))
    ((_, text),) = ((r.code, r.message) for r in unseen_reasons((unseen,), 10, scene, 2, unplaced))
    assert words in text

"""Verdicts on a board of the twin when an assumption is wrong: a reason with a number, never a silent ok."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.stitching.quality.test_findings import findings_of
from vaoi_station.model import BoardType, Calibration, ReasonCode, Status
from vaoi_station.stitching.adjustment.problem import Influence
from vaoi_station.stitching.components.places import OwnPlace
from vaoi_station.stitching.matching.evidence import METHODS
from vaoi_station.stitching.quality.verdict import (
    OK_SIGMA_PX,
    disputed_positions,
    judge_result,
    scattered_links,
    sigma_limit_px,
    unusable_local_fiducials,
)


def test_unconnected_rows_are_a_reason(filmed: Any) -> None:
    """Two blank rows: only the belt gives the distance of the second half from the first, and belts stop."""
    frames = {key: np.full_like(p, 20) if key[1] in (2, 3) else p for key, p in filmed.frames.items()}
    result = filmed.stitched(frames=frames)
    assert result.status is not Status.OK
    assert any("no links connect the rows 0–3 with the rows" in r for r in result.reasons), result.reasons
    assert any("other rows are not placed: film the board again" in r for r in result.reasons), result.reasons
    assert result.quality["unplaced_rows"] == [0, 1, 2, 3]
    assert [m is not None for m in result.image_matrices[0]] == [False] * 4 + [True] * 2
    assert result.components is not None
    assert {row for views in result.components.values() for _, row, *_ in views} <= {4, 5}


def test_lost_rows_are_blamed_before_the_fiducials(filmed: Any) -> None:
    """Rows beside the gap do not overlap: only the belt's speed, here wrong by 3 %, places one part by the other."""
    there = {key: p for key, p in filmed.frames.items() if key[1] not in (2, 3)}
    slow = tuple(0.97 * v for v in filmed.setup.conveyor_mm_s)
    reasons = judge_result(findings_of(filmed, there, conveyor_mm_s=slow))[1]
    assert reasons[0].code == "rows-lost", reasons
    assert "of rows 2, 3" in reasons[0].message


@pytest.mark.parametrize(
    ("floor_px", "noise_px", "named"),
    [
        (0.31, 0.3, "not rigid or flat"),
        (0.29, 0.15, ""),  # a dark or blurred picture: σ contains its noise
        (0.18, 0.03, "does not move as one board"),
        (0.14, 0.03, ""),
    ],
)
def test_scatter_of_links_that_noise_does_not_explain_is_a_reason(
    filmed: Any, floor_px: float, noise_px: float, named: str
) -> None:
    found = findings_of(filmed)
    links = found.problem.links
    noise = np.tile(np.eye(2), (len(links), 1, 1)) * (noise_px / links.px_per_mm[:, None, None]) ** 2
    problem = replace(found.problem, links=replace(links, noise_mm2=noise))
    doubtful = SimpleNamespace(problem=problem, adjusted=replace(found.adjusted, floor_px=floor_px))
    reasons = list(scattered_links(doubtful))  # type: ignore[arg-type]
    assert [r.code for r in reasons] == [ReasonCode.LINKS_SCATTER] * bool(named)
    assert all(named in r.message for r in reasons)


@pytest.mark.parametrize(
    ("of_marks", "named"),
    [
        (False, "positions in row 0 follow from few places of the pictures"),
        (True, "without one of the marks that place the board (fiducials, fixture, reference) positions move by"),
    ],
)
def test_what_decides_positions_beyond_noise_widens_sigma_and_is_named(filmed: Any, of_marks: bool, named: str) -> None:
    """Without the links of one place, or one mark, row 0 moves by 0.5 px more than noise explains."""
    found = findings_of(filmed)
    assert judge_result(found)[0] is Status.OK
    assert disputed_positions(found, 0.2) == ""
    m, u = found.adjusted.covariance.shape[:2]
    change = np.zeros((1, m, u))
    # The gauge holds row 0: the other rows and C move against it.
    change[0, 1:, 2] = change[0, :, 6] = 0.5 / found.scene.cameras[0].px_per_mm
    influence = Influence(change, np.zeros((1, m, u, u)), np.full((1, 4), not of_marks), 1)
    assert found.mapping is not None
    disputed = replace(found, found=replace(found.mapping, adjusted=replace(found.adjusted, influence=influence)))
    assert disputed.sigma.rows_px[0] == pytest.approx(0.5, abs=0.03)
    assert disputed.sigma.rows_px[1:] == found.sigma.rows_px[1:]
    status, reasons = judge_result(disputed)
    assert (status, [r.code for r in reasons]) == (Status.DEGRADED, [ReasonCode.POSITIONS_UNCERTAIN])
    assert named in reasons[0].message


def with_changes(board_type: BoardType, **keys: Any) -> BoardType:
    return BoardType.model_validate(board_type.model_dump(mode="json", exclude_none=True) | keys)


def camera_moved(calibration: Calibration, camera: int, x_mm: float, y_mm: float = 0.0) -> Calibration:
    """As if a camera had been pushed since it was calibrated."""
    matrices = list(calibration.camera_matrices)
    matrices[camera] = matrices[camera] @ np.array([[1, 0, x_mm], [0, 1, y_mm], [0, 0, 1]])
    return calibration.model_copy(update={"camera_matrices": tuple(matrices)})


def test_a_sound_run_is_ok_and_right(filmed: Any) -> None:
    result = filmed.stitch
    assert (result.status, result.reasons) == (Status.OK, ())
    assert filmed.error_px(result) <= min(3 * result.quality["cad_sigma_px"], 0.2)
    assert [f["sightings"] > 0 for f in result.quality["fiducials"]] == [True] * 3
    assert result.quality["cad_sigma_px"] < OK_SIGMA_PX
    measured = np.array(result.quality["belt"]["measured_mm_s"])
    last = np.array(filmed.truth["row_motion"][-1])
    middle = np.array([17.0, 0.0, 1.0])
    true = ((last @ middle) - middle)[:2] / (filmed.times_s[-1] - filmed.times_s[0])
    assert measured == pytest.approx(true, abs=0.3)


@pytest.mark.parametrize("push", [(0.05, 0), (0, 0.1), (1.0, 0)])
def test_a_calibration_that_no_longer_holds_is_a_reason(filmed: Any, push: tuple[float, float]) -> None:
    result = filmed.stitched(calibration=camera_moved(filmed.calibration, 1, *push))
    assert result.status is not Status.OK
    assert result.reasons


def test_a_displaced_camera_that_looks_like_a_larger_board_is_named(filmed: Any) -> None:
    """To two cameras, 0.5 px along the array looks like a board that lies higher."""
    result = filmed.stitched(calibration=camera_moved(filmed.calibration, 0, 0.5 / filmed.setup.cameras[0].px_per_mm))
    (reason,) = (r for r in result.reasons if "larger than its CAD data" in r)
    assert "or camera 0 is displaced by (-0.5" in reason
    assert "or camera 1 is displaced by (+0.5" in reason
    assert "which explains it as well" in reason


@pytest.mark.parametrize("camera", [0, 1])
@pytest.mark.parametrize("push", [(2, 0), (0, 3), (-18, 0), (-60, 0)])
def test_a_camera_that_was_pushed_is_never_ok(filmed: Any, camera: int, push: tuple[int, int]) -> None:
    """Its picture moves by whole pixels. Links out of reach must not count as agreement."""

    def pushed(pixels: np.ndarray) -> np.ndarray:
        (h, w), (dx, dy) = pixels.shape, push
        return pixels[np.clip(np.arange(h) - dy, 0, h - 1)][:, np.clip(np.arange(w) - dx, 0, w - 1)]

    frames = {key: pushed(p) if key[0] == camera else p for key, p in filmed.frames.items()}
    result = filmed.stitched(frames=frames)
    assert result.status is not Status.OK
    expected = (
        "is displaced by",
        "disagree by",
        "show different things where they should overlap",
        "larger than its CAD data",
    )
    assert any(word in reason for reason in result.reasons for word in expected), result.reasons


def test_a_calibration_that_does_not_determine_the_lens_is_named(filmed: Any) -> None:
    """Too few marks leave ± 1.5 px of distortion at the corners: the run is not ok, and the cause is named."""
    open_lens = np.zeros((9, 9))
    open_lens[8, 8] = 1.5**2
    covariance = tuple(tuple(tuple(row) for row in open_lens.tolist()) for _ in filmed.calibration.camera_matrices)
    calibration = filmed.calibration.model_copy(update={"covariance": covariance})
    result = filmed.stitched(calibration=calibration)
    assert result.status is Status.DEGRADED
    assert any("calibrate with more marks" in reason for reason in result.reasons)
    assert filmed.error_px(result) < 3 * result.quality["cad_sigma_px"]


@pytest.mark.parametrize("away_mm", [3.0, 60.0])
def test_a_third_fiducial_that_is_not_where_it_should_be_is_a_reason(filmed: Any, away_mm: float) -> None:
    """Two fiducials fit any two marks at the right distance. One that is out of view is no contradiction."""
    first, *others = filmed.board_type.fiducials
    moved = first.model_copy(update={"x": first.x + away_mm})
    board_type = filmed.board_type.model_copy(update={"fiducials": (moved, *others)})
    findings = findings_of(replace(filmed, setup=replace(filmed.setup, board_type=board_type)))
    codes = [reason.code for reason in judge_result(findings)[1]]
    assert (ReasonCode.FIDUCIAL_MISSING in codes) == (away_mm < 10)
    if away_mm < 10:
        assert set(findings.fiducials_in_view) == {0, 1, 2}


def test_local_fiducials_that_no_frame_shows_are_no_reason() -> None:
    """Neither are those of a run that uses no fiducials."""
    lost = OwnPlace((), ("L0",), refusal="L0 was not found")

    def reasons(method: str, *in_view: int) -> list[str]:
        places: Any = SimpleNamespace(
            method=METHODS[method],
            own_places=SimpleNamespace(local={"U1": lost}),
            skipped_parts=frozenset(),
            fiducials_in_view=dict.fromkeys(in_view, (0, 0)),
        )
        marks = SimpleNamespace(fiducials=[SimpleNamespace(name="L0")])
        board: Any = SimpleNamespace(plane=SimpleNamespace(board_type=marks))
        return [reason.message for reason in unusable_local_fiducials(places, board)]

    assert reasons("auto") == reasons("reference", 0) == []
    assert "U1: L0 was not found" in reasons("auto", 0)[0]


def test_a_board_whose_fiducials_no_links_connect_is_not_placed(filmed: Any) -> None:
    """Every fiducial is in rows that only the belt's nominal speed connects to those of the others."""
    lone = [f for f in filmed.board_type.fiducials if f.name in ("FID1", "FID2")]
    frames = {key: np.full_like(p, 20) if key[1] in (2, 3) else p for key, p in filmed.frames.items()}
    result = filmed.stitched(frames=frames, board_type=with_changes(filmed.board_type, fiducials=lone))
    assert result.status is Status.FAILED
    assert result.cad_matrix is None


def test_empty_frames_fail_for_lack_of_texture(filmed: Any) -> None:
    g = np.random.default_rng(0)
    shape = next(iter(filmed.frames.values())).shape
    frames = {key: np.clip(g.normal(15, 1.5, shape), 0, 255).astype(np.uint8) for key in filmed.frames}
    result = filmed.stitched(frames=frames)
    assert result.status is Status.FAILED
    assert "no texture was found in any frame: is there a board?" in result.reasons
    assert result.quality["residual_px"]["median"] is None
    assert len(result.quality["unlinked"]) == sum(t.kind != "marks" for t in filmed.tasks)


@pytest.mark.parametrize(("px_per_mm", "limit_px"), [(2.0, 0.2), (4.0, 0.24), (4.5, 0.23), (5.0, 0.2), (40.0, 0.2)])
def test_the_limit_of_a_coarse_station_is_one_in_mm(px_per_mm: float, limit_px: float) -> None:
    assert sigma_limit_px(px_per_mm) == pytest.approx(limit_px)


def test_stations_of_nearly_the_same_resolution_have_nearly_the_same_limit() -> None:
    limits_px = np.array([sigma_limit_px(px_per_mm) for px_per_mm in np.arange(2.0, 8.0, 0.01)])
    assert np.abs(np.diff(limits_px)).max() < 0.001

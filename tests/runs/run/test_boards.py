"""Boards that interrupt the barrier: how many, which were missed, whose ids are certain, and doubts of their frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from tests.runs.conftest import a_head
from vaoi_station.acquisition.pairing.proof import CameraProof, Kind, TriggerFinding, TriggerProof
from vaoi_station.acquisition.pairing.run_record import Interruption
from vaoi_station.acquisition.process.messages import BoardMissed, RunFinished
from vaoi_station.config import StationConfig
from vaoi_station.line_config import ExpectedBoard, Line
from vaoi_station.model import CameraHead, RecordingHead, Status, Stitch
from vaoi_station.runs.run.boards import BoardAccount, TriggerWatch, measure_passage, way_by_encoder
from vaoi_station.runs.run.orders import Orders
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.run_views import detail_of
from vaoi_station.runs.workers.run_stitcher import RunStitcher

LIMIT_MM = 65.5
"""That of a board of 55 mm."""


def boards(*spans_mm: tuple[float, float | None], end_mm: float = 200.0) -> int:
    return measure_passage(spans_mm, end_mm, lambda s: s, LIMIT_MM).boards


@pytest.mark.parametrize(
    ("spans_mm", "count"),
    [
        ([(0, 55)], 1),
        ([(0, 20), (30, 55)], 1),  # a cut-out
        ([(0, 10), (12, 20), (22, 30), (40, 64)], 1),
        ([(0, 55), (95, 150)], 2),
        ([(0, 55), (56, 111)], 2),  # 1 mm apart
        ([(0, 110)], 2),  # they touch
        ([(0, 20), (30, 110)], 2),  # a board with a cut-out and another that touches it
        ([(0, 165)], 3),
        ([(0, 55), (95, 150), (190, 245)], 3),
        ([(0, 55), (95, 120), (130, 150)], 2),  # the second has a cut-out
        ([(0, 55), (95, None)], 2),  # the run ended while the second was in the barrier
        ([(0, None)], 1),  # stuck for 200 mm, or too long
        ([(0, 20), (30, None)], 1),
    ],
)
def test_boards_of_55_mm(spans_mm: list[tuple[float, float | None]], count: int) -> None:
    assert boards(*spans_mm) == count


def line(**more: Any) -> Line:
    return Line(
        conveyor_mm_s=(0.0, 100.0), barrier_mm=0, start_delay_s=0, trigger_period_s=0.1, tail_s=0.48,
        longest_board_mm=80, **{"expected_board": ExpectedBoard()} | more,
    )  # fmt: skip


def stitch(*ways_mm: float, turned: bool = False) -> Stitch:
    cad = [[0, 1, 0], [1, 0, 0], [0, 0, 1.0]] if turned else [[1, 0, 0], [0, -1, 0], [0, 0, 1.0]]
    return Stitch(
        method="auto",
        image_matrices=(tuple(np.eye(3) for _ in ways_mm),),
        cad_matrix=np.array(cad),
        row_motion=tuple(np.array([[1, 0, 0], [0, 1, way], [0, 0, 1.0]]) for way in ways_mm),
        status=Status.OK,
    )


def test_the_encoder_gives_the_way_of_a_belt_that_stops() -> None:
    """The belt stood for 1 s before row 0 and for 1 s between rows 1 and 2; between them it moved at half its speed."""
    head = RecordingHead(
        format="vaoi-recording", version=1, cameras=(CameraHead(width=64, height=64, exposure_us=100),), rows=3,
        trigger_period_s=0.1, conveyor_mm_s=(0.0, 100.0), trigger_times_s=(0.0, 0.2, 1.3), belt_mm=(0.0, 10.0, 20.0),
    )  # fmt: skip
    delayed = line().model_copy(update={"start_delay_s": 0.3})
    way = way_by_encoder(delayed, head, -1.3)
    assert [way(t) for t in (-1.3, 0.0, 0.1, 0.2, 1.3)] == pytest.approx([-30.0, 0.0, 5.0, 10.0, 20.0])
    assert way(-1.4) == pytest.approx(-40.0)
    assert [way(t) for t in (1.35, 9.0)] == pytest.approx([25.0, 30.0]), "the next row was not due"
    late = way_by_encoder(delayed, head, 0.1)
    assert late(0.1) == pytest.approx(5.0), "the report of the first edge was lost"


TWO: tuple[Interruption, ...] = ((0.0, 0.3), (0.4, 0.7))


@dataclass
class Books:
    """An account, its orders, and what it publishes."""

    account: BoardAccount
    orders: Orders
    progress: Progress
    make_head: Callable[[int], RecordingHead]
    published: list[tuple[str, dict[str, Any]]] = field(default_factory=list)

    def finish(self, interruptions: tuple[Interruption, ...], reason: str = "clear", rows: int = 3) -> None:
        self.progress.recorded = RunFinished(
            "r1", 1, self.make_head(rows), (), 51.0, reason, interruptions=interruptions
        )
        self.account.end(self.progress, 60.0)

    def codes(self) -> list[str]:
        return [fault.code for fault in self.progress.faults]


@pytest.fixture
def books(config: StationConfig, progress: Progress, make_head: Callable[[int], RecordingHead]) -> Books:
    """Return the account of a run that met the barrier at 50 s with the id SN-1, which was armed at 40 s."""
    line = config.line.model_copy(update={"tail_s": 0.3})
    progress.order = replace(progress.order, board_id="SN-1", line=line)
    orders, published = Orders(), []

    def publish(kind: str, message: str, **more: Any) -> None:
        published.append((kind, {"message": message, **more}))

    orders.accept(progress.order, None, 40.0)
    account = BoardAccount(line, orders, publish)
    assert orders.take(50.0) is progress.order
    account.begin(progress)
    return Books(account, orders, progress, make_head, published)


def test_a_second_board_is_named_counted_and_takes_the_id_from_its_run(books: Books) -> None:
    books.finish(TWO)
    assert books.codes() == ["boards-too-close", "board-id-uncertain"]
    [reason] = [fault for fault in books.progress.faults if fault.code == "boards-too-close"]
    assert (
        "2 boards passed in this run: the barrier was interrupted over 30, 30 mm with 10 mm between" in reason.message
    )
    assert "more than 30 mm apart" in reason.action
    assert books.account.missed == 1
    [(kind, event)] = books.published
    assert (kind, event["code"], event["run"]) == ("board-missed", "boards-too-close", "r1")
    assert books.progress.board_id is None
    assert detail_of(books.progress).board_id is None


def test_each_further_board_is_an_event(books: Books) -> None:
    books.finish((*TWO, (2.0, 2.3)))
    assert books.account.missed == len(books.published) == 2


def test_the_next_run_does_not_get_the_id_that_was_armed_before_the_second_board_was_published(books: Books) -> None:
    """SN-2 was armed at 55 s, when the second board, to which it belongs, had passed as part of the first run."""
    books.orders.accept(replace(books.progress.order, board_id="SN-2"), None, 55.0)
    books.finish(TWO)
    assert books.orders.present_doubt is not None
    shown = books.orders.shown()
    assert shown is not None
    assert (shown.board_id, shown.board_id_certain) == ("SN-2", False)
    order = books.orders.take(58.0)
    assert order is not None
    stitcher = RunStitcher(books.progress.stitcher.opening, 58.0)
    third = replace(books.progress, order=order, stitcher=stitcher, faults=[], id_doubted=False)
    books.account.begin(third)
    assert third.board_id is None
    assert third.faults[0].code == "board-id-uncertain"
    assert "'SN-2' was armed, but a board had passed without a run" in third.faults[0].message
    books.orders.accept(replace(third.order, board_id="SN-3"), None, 61.0)
    assert books.orders.doubt_of(61.0, 70.0) is None
    shown = books.orders.shown()
    assert shown is not None
    assert shown.board_id_certain


def test_a_board_that_passed_before_does_not_lose_its_id(books: Books) -> None:
    books.account.board_missed(BoardMissed(50.5, "no memory was free"), "", 50.6)
    books.finish(((0.0, 0.3),))
    assert books.progress.board_id == "SN-1"
    assert books.account.missed == 1


def test_while_the_barrier_is_not_watched_ids_become_uncertain(books: Books) -> None:
    books.account.unwatched(45.0, "the controller did not report all boards for a time")
    books.finish(((0.0, 0.3),))
    assert books.progress.board_id is None
    assert books.account.missed == 0


def test_a_run_whose_edge_was_lost_is_degraded_and_has_no_id(books: Books) -> None:
    books.account.begin(books.progress, edge_known=False)
    books.finish(())
    assert books.codes() == ["edge-lost", "board-id-uncertain"]
    assert books.progress.board_id is None


@pytest.mark.parametrize(
    ("interruptions", "words"),
    [(((0.0, None),), "while the barrier was still interrupted"), (((0.0, 0.1),), "while its tail was not over")],
)
def test_a_run_with_the_most_rows_is_not_as_planned(
    books: Books, interruptions: tuple[Interruption, ...], words: str
) -> None:
    books.finish(interruptions, "max-rows")
    [fault] = [fault for fault in books.progress.faults if fault.code == "run-too-long"]
    assert f"the most that line.longest_board_mm = 50 allows, {words}" in fault.message
    assert "raise line.longest_board_mm" in fault.action
    assert books.account.missed == 0
    assert (books.orders.present_doubt is not None) == (interruptions[-1][1] is None), "another board may have followed"


def finished(run: str, *findings: tuple[int, Kind], frames: int = 3) -> RunFinished:
    found = tuple(TriggerFinding(camera=c, row=None, kind=k, text="its reason") for c, k in findings)
    figures = {"pulses": 3, "frames": frames, "extra": 0, "max_residual_us": 1.0, "latency_us": 7.0}
    cameras = tuple(CameraProof(camera=c, proven=not findings, **figures) for c in (0, 1))
    proof = TriggerProof(proven=not findings, cameras=cameras, findings=found)
    return RunFinished(run, 0, a_head(3), (), 0.0, "clear", proof=proof)


def test_a_doubt_is_a_warning_with_camera_run_and_action_until_a_run_without_it() -> None:
    watch = TriggerWatch(["camera left", "right"])
    begun, ended = watch.add(finished("r1", (0, "runs-freely")))
    assert [(r.code, r.message) for r in begun] == [("trigger-runs-freely", "Camera left, run r1: its reason.")]
    assert begun[0].action
    assert watch.warnings() == tuple(begun)
    assert not ended
    assert watch.add(finished("r2")) == ([], ["camera left"])
    assert watch.warnings() == ()

"""Feed boards in order, each when the station is ready; a scripted line takes them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import cast

import pytest

from tests.rig.known_boards import known_board, passage_of
from vaoi_station.errors import DeviceError
from vaoi_station.rig import line as feeder_module
from vaoi_station.rig.line import READY_TIMEOUT_S, BoardFeeder, BoardPassage, VirtualLine
from vaoi_station.rig.rendering import RenderedBoard

TIMEOUT_S = 20.0


class ScriptedLine:
    """Records what passes; it fails at one board."""

    def __init__(self, fails_at: int | None = None) -> None:
        self.fails_at = fails_at
        self.started: list[int] = []
        self.one_started = threading.Event()

    def start_passage(self, rendered: RenderedBoard) -> BoardPassage:
        if rendered.metadata.board == self.fails_at:
            raise DeviceError("the emulated chip has ended.")
        self.started.append(rendered.metadata.board)
        self.one_started.set()
        return passage_of(rendered)


@pytest.fixture
def short_boards(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[RenderedBoard]:
    """Three boards of a few milliseconds."""
    monkeypatch.setattr(feeder_module, "FEED_MARGIN_S", 0.0)
    times = {"edges": ((0.0, True), (0.001, False)), "pulses_s": (0.001,), "lights": ("ring",)}
    return [known_board(tmp_path / str(k), k, **times) for k in range(3)]


def feeder_of(
    line: ScriptedLine,
    boards: list[RenderedBoard],
    interval_s: float = 0.0,
    wait_ready: Callable[[float], bool] = lambda _: True,
    wait_permitted: Callable[[float], bool] = lambda _: True,
) -> BoardFeeder:
    return BoardFeeder(cast("VirtualLine", line), boards, interval_s, wait_ready, wait_permitted)


def test_all_boards_pass_in_order(short_boards: list[RenderedBoard]) -> None:
    line = ScriptedLine()
    with feeder_of(line, short_boards) as feeder:
        assert feeder.finished.wait(TIMEOUT_S)
    assert line.started == [0, 1, 2]
    assert [passage.board for passage in feeder.passages] == [0, 1, 2]


def test_every_board_waits_until_the_station_is_ready(short_boards: list[RenderedBoard]) -> None:
    line = ScriptedLine()
    waits: list[tuple[float, int]] = []

    def wait_ready(timeout_s: float) -> bool:
        waits.append((timeout_s, len(line.started)))
        return False

    with feeder_of(line, short_boards, wait_ready=wait_ready) as feeder:
        assert feeder.finished.wait(TIMEOUT_S)
    assert waits == [(READY_TIMEOUT_S, 0), (READY_TIMEOUT_S, 1), (READY_TIMEOUT_S, 2)]


def test_a_board_is_held_back_until_the_line_is_ready(short_boards: list[RenderedBoard]) -> None:
    line = ScriptedLine()
    permits, passed = iter((True, False, True)), list[int]()

    def wait_permitted(timeout_s: float) -> bool:
        assert timeout_s == READY_TIMEOUT_S
        passed.append(len(line.started))
        return next(permits)

    with feeder_of(line, short_boards, wait_permitted=wait_permitted) as feeder:
        assert feeder.finished.wait(TIMEOUT_S)
    assert passed == [0, 1, 2], "each board waits before it starts"
    assert [passage.held_s is None for passage in feeder.passages] == [False, True, False]


def test_the_end_of_the_context_stops_the_feeding(short_boards: list[RenderedBoard]) -> None:
    line = ScriptedLine()
    with feeder_of(line, short_boards, interval_s=3600.0) as feeder:
        assert line.one_started.wait(TIMEOUT_S)
    assert line.started == [0]
    assert feeder.finished.is_set()


def test_a_failure_is_raised_where_the_feeder_was_started(short_boards: list[RenderedBoard]) -> None:
    line = ScriptedLine(fails_at=1)
    with pytest.raises(DeviceError, match="has ended"), feeder_of(line, short_boards) as feeder:
        assert feeder.finished.wait(TIMEOUT_S)
    assert line.started == [0]


def test_a_failure_does_not_hide_an_earlier_one(short_boards: list[RenderedBoard]) -> None:
    def fail_outside() -> None:
        with feeder_of(ScriptedLine(fails_at=0), short_boards) as feeder:
            assert feeder.finished.wait(TIMEOUT_S)
            raise KeyError("the caller's own failure")

    with pytest.raises(KeyError, match="the caller's own failure"):
        fail_outside()

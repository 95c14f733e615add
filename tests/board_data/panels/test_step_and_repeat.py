from __future__ import annotations

from dataclasses import replace

import pytest

from vaoi_station.board_data.design import Design, Mark, Part
from vaoi_station.board_data.panels import Repeat, Step, panel_of
from vaoi_station.errors import InputError
from vaoi_station.model.reason import Note

BOARD = Step(Design("pcb", "odb", (Part("R1", "top", (3.0, 2.0), 0.0),)), lambda: (1.0, 1.0))


def grid(step: str, x: float = 0.0, nx: int = 1, ny: int = 1) -> Repeat:
    return Repeat(step, (x, 0.0), (10.0, 20.0), (nx, ny))


def panel(**steps: Step) -> Design:
    """Return the panel of a step `top`, among the steps given and that of the board."""
    return panel_of("top", ({"pcb": BOARD} | steps).__getitem__, "file")


def step(*repeats: Repeat, marks: tuple[Mark, ...] = ()) -> Step:
    return Step(Design("panel", "odb", (), marks=marks), repeats=repeats)


def test_positions_count_along_x_first_and_datums_lie_at_the_places() -> None:
    turned, over = replace(grid("pcb", 50.0), degrees=90.0), replace(grid("pcb", 80.0), mirrored=True)
    made = panel(top=step(grid("pcb", 5.0, 2, 2), turned, over))
    at = {board.position: board.at.apply((3.0, 2.0)) for board in made.boards}
    assert at.pop("5") == pytest.approx((49.0, 2.0))
    assert at == {"1": (7, 1), "2": (17, 1), "3": (7, 21), "4": (17, 21), "6": (78, 1)}
    assert panel(top=step(replace(over, degrees=90.0))).notes[-1].endswith("the boards lie within the panel: 1.")
    assert made.notes == (
        "step top is a panel of 6 boards: 6 of step pcb; their positions count from 1.",
        "1 boards lie upside down, so that their other side is up: positions 6.",
    )


def test_what_is_noted_of_a_step_that_is_repeated_is_noted_of_the_panel() -> None:
    note = Note("pins-unfit", "check R1.", names="R1")
    made = panel(
        top=step(grid("array")),
        array=step(grid("pcb", 0.0, 2)),
        pcb=replace(BOARD, design=BOARD.design.with_notes(note)),
    )
    assert made.notes[-1] == "step pcb: check R1."
    assert (made.notes[-1].code, made.notes[-1].values) == ("pins-unfit", {"names": "R1"})


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ({"top": step(grid("a")), "a": step(grid("top"))}, "file: steps contain one another: top > a > top"),
        ({"top": step(grid("pcb", 0.0, 1001))}, "places of step 'pcb' is '1001 × 1', but must be at most 1000"),
        (
            {"top": step(grid("a", 0.0, 40)), "a": step(grid("pcb", 0.0, 26))},
            "is '1001 or more', but must be at most 1000",
        ),
        ({"top": step(grid("a", 0.0, 40)), "a": step(grid("b", 0.0, 26)), "b": step()}, "is '1001 or more'"),
        ({"top": step(grid("a")), "a": step()}, r"step 'top' repeats no step with components \(a\)"),
        (
            {"top": step(Repeat("pcb", (0, 0), (0, 5), (2, 2)))},
            "the pitch of step 'pcb' along x is 0, but must be above 0",
        ),
    ],
)
def test_wrong_and_too_large_panels_are_refused(steps: dict[str, Step], message: str) -> None:
    with pytest.raises(InputError, match=message):
        panel(**steps)

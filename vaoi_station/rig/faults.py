"""The faults of the rig on the command line: `--fault NAME` or `--fault NAME:KEY=VALUE,…`."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

from vaoi_station.errors import InputError
from vaoi_station.simulation import Scenario
from vaoi_station.simulation.scenario import Bounce, StuckBoard


@dataclass(frozen=True)
class Fault:
    """One fault of the rig. `kind` is a name from `KINDS`, which also lists the fields that this kind uses."""

    kind: str
    board: int = 1
    """Number of the board, counted from 0, at which the fault happens. Rows and cameras count from 0 as well."""
    row: int = 2
    camera: int = 0
    share: float = 0.0
    at_s: float = 0.0
    for_s: float = 0.0
    who: str = "station"
    gap_mm: float = 0.0
    by_s: float = 0.0
    count: int = 1

    def at(self, board: int, row: int) -> bool:
        """Return whether the fault begins at the pulse of this row of this board."""
        return (self.board, self.row) == (board, row)


KINDS: dict[str, tuple[Fault, tuple[str, ...], str]] = {
    "loss": (Fault("loss", share=0.01), ("share",), "share of the frames that packets are missing from"),
    "kill": (
        Fault("kill", for_s=3.0),
        ("camera", "board", "row", "for_s"),
        "a camera's process is killed before this row and starts again after a time",
    ),
    "ignored": (Fault("ignored"), ("camera", "board", "row"), "a camera does not answer a pulse"),
    "noise": (Fault("noise", share=0.002), ("share",), "share of the bytes on the serial line with a bit turned over"),
    "stall": (
        Fault("stall", for_s=1.0),
        ("who", "board", "row", "for_s"),
        "SIGSTOP: station, acquisition, or a worker (worker 0, worker 1, …)",
    ),
    "reset": (Fault("reset", row=5), ("board", "row"), "the controller is reset"),
    "stuck": (Fault("stuck"), ("board", "row"), "the board stops with the pulse of this row and stays"),
    "bounce": (
        Fault("bounce", at_s=0.004, for_s=0.001),
        ("board", "at_s", "for_s"),
        "the barrier shows the opposite for a moment",
    ),
    "follow": (
        Fault("follow", gap_mm=40.0),
        ("board", "gap_mm", "count"),
        "further boards follow this closely; they interrupt the barrier, but no picture shows them",
    ),
    "stamps": (
        Fault("stamps", board=0, by_s=0.02),
        ("camera", "board", "by_s"),
        "from this board on the time stamps of a camera come later after the pulses",
    ),
}
"""Name of a fault → the fault with its default values, the keys that the command line may set, a description."""


def parse_fault(text: str) -> Fault:
    """Parse one fault as written on the command line."""
    name, _, rest = text.partition(":")
    if name not in KINDS:
        raise InputError.field("vaoi rig", "--fault", name, f"one of {', '.join(KINDS)}")
    fault, keys, _ = KINDS[name]
    types = {f.name: type(getattr(fault, f.name)) for f in fields(Fault)}
    changes: dict[str, float | int | str] = {}
    for part in filter(None, rest.split(",")):
        key, _, value = part.partition("=")
        if key not in keys:
            raise InputError.field("vaoi rig", f"--fault {name}", part, f"KEY=VALUE, KEY one of {', '.join(keys)}")
        # Without this check the second value of a key would silently replace the first one.
        if key in changes:
            raise InputError.field("vaoi rig", f"--fault {name}", text, f"written with {key} once; give --fault twice")
        try:
            changes[key] = types[key](value)
        except ValueError:
            limit = "a whole number" if types[key] is int else "a number"
            raise InputError.field("vaoi rig", f"--fault {name}: {key}", value, limit) from None
    fault = replace(fault, **changes)  # type: ignore[arg-type]  # of the fields' own types
    _check(fault)
    return fault


def check_faults(faults: Sequence[Fault], cameras: int, boards: int) -> None:
    """Raise InputError if a fault names a board or a camera that this rig run does not have."""
    for fault in faults:
        _, keys, _ = KINDS[fault.kind]
        for key, count in (("camera", cameras), ("board", boards)):
            if key in keys and not 0 <= getattr(fault, key) < count:
                limit = f"from 0 to {count - 1}"
                raise InputError.field("vaoi rig", f"--fault {fault.kind}: {key}", getattr(fault, key), limit)


def with_belt_faults(scenario: Scenario, faults: Sequence[Fault]) -> Scenario:
    """Return the scenario with the faults of the belt and the light barrier added, which the twin simulates."""
    known = scenario.faults
    stuck = tuple(StuckBoard(board=f.board, row=f.row) for f in faults if f.kind == "stuck")
    bounces = tuple(
        Bounce(board=f.board, at_s=f.at_s, duration_s=f.for_s) for f in faults if f.kind == "bounce"
    ) + tuple(bounce for f in faults if f.kind == "follow" for bounce in _followers(f, scenario))  # fmt: skip
    more = {"stuck": known.stuck + stuck, "bounces": known.bounces + bounces}
    return scenario.model_copy(update={"faults": known.model_copy(update=more)})


def followers(faults: Sequence[Fault]) -> int:
    """Return the number of boards that directly follow another one because of a fault; they have no frames."""
    return sum(f.count for f in faults if f.kind == "follow")


def _followers(fault: Fault, scenario: Scenario) -> list[Bounce]:
    """Return the interruptions of the barrier by boards that directly follow another one, each as long as a board."""
    speed_mm_s, length_mm = scenario.belt.speed_mm_s, scenario.board.length_mm
    pitch_s = (length_mm + fault.gap_mm) / speed_mm_s
    return [
        Bounce(board=fault.board, at_s=n * pitch_s, duration_s=length_mm / speed_mm_s)
        for n in range(1, fault.count + 1)
    ]


_LIMITS: dict[str, tuple[Callable[[Any], bool], str]] = {
    "share": (lambda share: 0 <= share <= 1, "from 0 to 1"),
    "for_s": (lambda for_s: 0 < for_s <= 60, "above 0, at most 60 s"),
    "row": (lambda row: row >= 0, "at least 0"),
    "at_s": (lambda at_s: 0 <= at_s <= 60, "from 0 to 60 s"),
    "gap_mm": (lambda gap_mm: 0 < gap_mm <= 10_000, "above 0, at most 10000 mm"),
    "by_s": (lambda by_s: 0 < by_s <= 60, "above 0, at most 60 s"),
    "count": (lambda count: 1 <= count <= 20, "from 1 to 20"),
    "who": (
        lambda who: re.fullmatch(r"station|acquisition|worker( \d+)?", who) is not None,
        "station, acquisition, or worker N",
    ),
}
"""Key of a fault → whether a value is allowed (nan is not), and the limit in words."""


def _check(fault: Fault) -> None:
    for key in KINDS[fault.kind][1]:
        value = getattr(fault, key)
        if key in _LIMITS and not _LIMITS[key][0](value):
            raise InputError.field("vaoi rig", f"--fault {fault.kind}: {key}", value, _LIMITS[key][1])

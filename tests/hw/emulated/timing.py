"""The timing of the firmware from the pins of the emulated chip, as a table and as a picture.

    python -m tests.hw.emulated.timing --boards 40 --plot docs/pictures/firmware-timing.svg

Boards come at random phases of the chip's timer, with an idle serial line and with one that is full in both directions.
"""

from __future__ import annotations

import argparse
import itertools
import random
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tests.hw.emulated.chip import CYCLES_PER_US, Chip, make
from tests.hw.emulated.line import STEPS, TIMING, Line
from tests.hw.emulated.load import full_line
from tests.hw.emulated.timing_picture import Trace, draw

BOARD_MS = 340
AFTER_MS = 200
ROWS = 18
"""20, 40, … 360 ms after the edge: the last one not later than the tail."""


@dataclass
class Deviations:
    """What was measured minus what was wanted, µs, pulse by pulse."""

    delay: list[float] = field(default_factory=list)
    """From the barrier's edge to the first pulse; one per board."""
    period: list[float] = field(default_factory=list)
    width: list[float] = field(default_factory=list)
    """Of the LED gate."""
    light: list[float] = field(default_factory=list)
    """From the start of the trigger to the start of the gate."""

    def rows(self) -> dict[str, list[float]]:
        """By the words of the table."""
        return {
            "first pulse − configured delay": self.delay,
            "period − configured": self.period,
            "LED on-time − request": self.width,
            "LED start − trigger start": self.light,
        }


def film(chip: Chip, boards: int, *, loaded: bool, seed: int = 1) -> tuple[Deviations, Trace]:
    """Let a number of boards pass; return the trace of the last one."""
    line, dice, found = Line(chip), random.Random(seed), Deviations()
    line.arm()
    edge = 0
    for _ in range(boards):
        chip.edges.clear()
        chip.inputs.clear()
        chip.do(f"run {dice.randrange(1, 2**18)}")
        if loaded:
            chip.do(f"send {full_line(BOARD_MS + AFTER_MS // 2).hex()}")
        edge, _ = line.passage(BOARD_MS)
        line.run(AFTER_MS)
        _measure(chip, edge, found)
    trace = [(cycle - edge, pin, level) for cycle, pin, level in sorted(chip.inputs + chip.edges)]
    return found, Trace(tuple((cycle / CYCLES_PER_US, pin, level) for cycle, pin, level in trace))


def _measure(chip: Chip, edge: int, found: Deviations) -> None:
    triggers, gates = chip.rises("PB1"), chip.rises("PB2")
    if len(triggers) != ROWS or len(gates) != ROWS:
        raise AssertionError(f"{len(triggers)} triggers and {len(gates)} lights, but a board has {ROWS} rows")
    us = [cycle / CYCLES_PER_US for cycle in triggers]
    found.delay.append(us[0] - edge / CYCLES_PER_US - TIMING.start_delay / 2)
    found.period += [b - a - TIMING.period / 2 for a, b in itertools.pairwise(us)]
    found.width += [
        width / CYCLES_PER_US - STEPS[row % len(STEPS)].width / 2 for row, width in enumerate(chip.widths("PB2"))
    ]
    found.light += [(gate - trigger) / CYCLES_PER_US for trigger, gate in zip(triggers, gates, strict=True)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Build, film, print, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--boards", type=int, default=40, help="for each of both serial loads")
    parser.add_argument("--plot", type=Path, help="SVG file to write")
    given = parser.parse_args(arguments)
    series: dict[str, dict[str, list[float]]] = {}
    with tempfile.TemporaryDirectory() as directory:
        build = Path(directory)
        make("all", build)
        make("emulator", build)
        for name, loaded in (("idle line", False), ("line full in both directions", True)):
            chip = Chip(build)
            chip.run_ms(50)
            found, trace = film(chip, given.boards, loaded=loaded)
            chip.close()
            series[name] = found.rows()
    for name, rows in series.items():
        for what, values in rows.items():
            spread = max(values) - min(values)
            print(
                f"{name:30s}{what:34s}{min(values):+7.3f} … {max(values):+.3f} us, {spread:.3f} pp of {len(values):5d}"
            )
    if given.plot is not None:
        given.plot.write_text(draw(trace, series), encoding="utf-8")


if __name__ == "__main__":
    main()

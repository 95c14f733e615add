"""Tests of the comparison of reported pulses with the light program."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from vaoi_station.acquisition.cameras.interface import StatedExposure
from vaoi_station.acquisition.pairing.conclusion import contradicted_frames, contradicted_rows, contradiction
from vaoi_station.acquisition.pairing.run_record import ObservedFrame, ObservedPulse
from vaoi_station.model import ProgramRow, Pulse

LEFT = ProgramRow("left", (200.0, 200.0), (0.0, 6.0), 80.0)
RIGHT = ProgramRow("right", (200.0, 200.0), (0.0, 0.0), 80.0)


def pulse(
    light: str,
    row: int = 0,
    on_us: float | None = None,
    exposures_us: tuple[float, ...] = (),
    gains: tuple[float, ...] = (),
) -> ObservedPulse:
    return ObservedPulse(Pulse(index=row, time_s=float(row), light=light), float(row), exposures_us, 0.0, gains, on_us)


@pytest.mark.parametrize(
    ("reported", "words"),
    [
        (pulse("left"), ""),
        (pulse("left", on_us=80.5, exposures_us=(80.0, 80.0), gains=(1.0, 1.9953)), ""),
        (pulse("right"), "its pulse was fired with light 'right', but the light program has 'left'"),
        (pulse(""), "its pulse was fired with no light, but the light program has 'left'"),
        (pulse("left", on_us=60.0), "light 'left' was on for 60 µs, but the light program has 80 µs"),
        (pulse("left", exposures_us=(80.0, 40.0)), "camera 1 had exposure 40 µs, but the light program has 80 µs"),
        (pulse("left", gains=(1.0, 1.0)), "camera 1 had gain 1, but the light program has 1.99526"),
    ],
)
def test_a_pulse_agrees_with_its_step_or_the_difference_is_stated(reported: ObservedPulse, words: str) -> None:
    assert contradiction(reported, LEFT) == words


def test_the_width_of_the_trigger_is_the_exposure() -> None:
    by_width = ProgramRow("left", (200.0,), (0.0,), 80.0, 200.0)
    assert contradiction(replace(pulse("left"), trigger_us=200.5), by_width) == ""
    assert contradiction(pulse("left"), by_width) == "", "the controller did not report it"
    words = "its trigger was high for 100 µs, but the light program has an exposure of 200 µs"
    assert contradiction(replace(pulse("left"), trigger_us=100.0), by_width) == words


def test_rows_are_compared_with_the_step_of_their_turn() -> None:
    pulses = {0: pulse("left", 0), 1: pulse("left", 1), 3: pulse("right", 3)}
    assert list(contradicted_rows(pulses, (LEFT, RIGHT))) == [1]
    assert contradicted_rows(pulses, ()) == {}


def stating(row: int | None, exposure_us: float, gain_db: float | None = 0.0) -> ObservedFrame:
    return ObservedFrame(row, 1, 0.0, 0.0, 0.0, stated=StatedExposure(exposure_us, gain_db))


def test_frames_state_the_exposure_and_gain_of_their_row() -> None:
    """Sensors expose whole lines: within its tolerance a frame fits, and it fits one step only."""
    program = (ProgramRow("left", (9.0, 100.0), (0.0, 0.0)), ProgramRow("left", (9.0, 140.0), (0.0, 0.6)))
    fitting = [stating(0, 81.0), stating(0, 119.9, 0.2), stating(1, 120.1, 0.4), stating(2, 100.0, None)]
    fitting.append(stating(None, 5.0))
    assert contradicted_frames(1, [*fitting, ObservedFrame(3, 1, 0.0, 0.0, 0.0)], program) == {}
    other = contradicted_frames(1, [stating(4, 120.0), stating(5, 140.0, 0.3)], program)
    assert {row: text.split(":")[0] for row, text in other.items()} == {
        4: "its frame states an exposure of 120 µs, but the light program has 100 µs",
        5: "its frame states a gain of 0.3 dB, but the light program has 0.6 dB",
    }
    assert contradicted_frames(1, [stating(0, 5.0)], ()) == {}
    assert list(contradicted_frames(1, [stating(0, math.nan), stating(2, 100.0, math.nan)], program)) == [0, 2]

"""A plan and lights become what the firmware takes; its refusals are translated into the terms of station.toml."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.hw.emulated.vectors import IDENT
from vaoi_station.acquisition.controller.interface import BeltPacing, TriggerPlan
from vaoi_station.acquisition.controller.protocol import Ident, Nak, Reason, Step, Type
from vaoi_station.acquisition.controller.serial.device_program import explain_refusal, make_program
from vaoi_station.config import ControllerConfig, LightConfig
from vaoi_station.errors import InputError
from vaoi_station.model import ProgramRow

PLAN = TriggerPlan(start_delay_s=0.3, period_s=0.12, tail_s=0.4, max_rows=40, debounce_s=0.005)
LIGHTS = {"top": LightConfig(channels=(0, 1), on_us=300.0), "low": LightConfig(channels=(3,), on_us=61.5)}

SERIAL = ControllerConfig(backend="serial", lights=LIGHTS)


def test_times_are_ticks_and_lights_are_steps_in_turn() -> None:
    config = ControllerConfig(backend="serial", lights=LIGHTS, order=("low", "top", "low"), min_gap_s=0.25)
    program = make_program(PLAN, config, IDENT)
    t = program.timing
    assert (t.start_delay, t.period, t.tail, t.debounce, t.min_gap) == (600_000, 240_000, 800_000, 10_000, 500_000)
    assert (t.max_rows, t.steps, t.trigger_width, t.pacing) == (40, 3, 200, 0)
    assert program.steps == (Step(0b1000, 123), Step(0b0011, 600), Step(0b1000, 123))
    assert [program.light(row) for row in range(4)] == ["low", "top", "low", "low"]


@given(st.floats(0, 1e9), st.floats(1e-9, 1e9), st.integers(1, 10**9))
def test_every_plan_can_be_sent(delay_s: float, period_s: float, rows: int) -> None:
    """Whether it is sensible the firmware decides: what is too large arrives as the largest number."""
    plan = TriggerPlan(delay_s, period_s, delay_s, rows, 0.0)
    program = make_program(plan, ControllerConfig(backend="serial", trigger_us=2000), IDENT)
    assert len(program.timing.pack()) == 30
    assert program.crc >= 0


@pytest.mark.parametrize(
    ("nak", "words"),
    [
        (Nak(Type.COMMIT, Reason.RANGE, 4, 10_000_000), "period_s is 0.12, but must be at least 5"),
        (Nak(Type.COMMIT, Reason.RANGE, 4, 10_000), "period_s is 0.12, but must be at most 0.005"),
        (Nak(Type.COMMIT, Reason.RANGE, 2, 30), "max_rows is 40, but must be at most 30"),
        (Nak(Type.COMMIT, Reason.RANGE, 9, 300), "controller.trigger_us is 100.0, but must be at least 150"),
        (Nak(Type.COMMIT, Reason.LED_LIMIT, 17, 100), "lights.low is 'too much for its LEDs', but must be 50"),
    ],
)  # fmt: skip
def test_a_refusal_in_the_terms_of_the_file(nak: Nak, words: str) -> None:
    error = explain_refusal(nak, make_program(PLAN, ControllerConfig(backend="serial", lights=LIGHTS), IDENT))
    assert error is not None
    assert words in error.message


def test_a_program_beyond_the_firmware_is_refused_with_its_numbers() -> None:
    row = ProgramRow("low", (200.0,), (0.0,), 100.0)
    many = replace(PLAN, program=(row,) * 17, lights=("low",) * 17)
    with pytest.raises(InputError, match="steps of the light program is 17, but must be at most 16, the steps"):
        make_program(many, SERIAL, IDENT)
    long = replace(PLAN, program=(replace(row, on_us=9000.0),), lights=("low",))
    with pytest.raises(InputError, match=r"on_us of light 'low' is 9000\.0, but must be .* … .* \(the longest pulse"):
        make_program(long, SERIAL, IDENT)


def test_rows_by_the_belt_are_counts_and_the_shortest_period_bounds_the_light() -> None:
    belt = BeltPacing(counts_per_mm=20.0, start=640, row=160, tail=960, shortest_s=0.064)
    program = make_program(replace(PLAN, belt=belt), SERIAL, IDENT)
    t = program.timing
    assert (t.pacing, t.start_delay, t.period, t.tail, t.min_period) == (1, 640, 160, 960, 128_000)
    error = explain_refusal(Nak(Type.COMMIT, Reason.RANGE, 4, 100), program)
    assert error is not None
    assert "period_s in counts of the encoder is 160, but must be at most 100" in error.message
    short = replace(PLAN, belt=replace(belt, shortest_s=0.004))
    with pytest.raises(InputError, match=r"lights\.top\.on_us is 300\.0, but must be 50 … 250 \(1/16 of the period"):
        make_program(short, SERIAL, IDENT)


BY_WIDTH = replace(
    PLAN,
    program=tuple(ProgramRow("low", (us,), (0.0,), 60.0, us) for us in (100.0, 400.5)),
    lights=("low", "low"),
    by_trigger=(0,),
)


@pytest.mark.parametrize(
    ("period_s", "us", "ident", "words"),
    [
        (
            0.12,
            20.0,
            IDENT,
            r"program\.0\.exposure_us is 20\.0, but must be 50 … 10000 .* \(the shortest trigger of its",
        ),
        (0.12, 11e3, IDENT, r"program\.0\.exposure_us is 11000\.0, but must be 50 … 10000 .* \(the longest trigger of"),
        (0.01, 8e3, IDENT, r"8000\.0, but must be 50 … 7000 .* \(the period of 0\.01 s less 3 ms\)"),
        (
            0.12,
            80.0,
            replace(IDENT, trigger_longest=0),
            r"is '80 µs', but must be one for all rows: firmware 1\.2\.3 has",
        ),
    ],
)
def test_exposures_that_the_trigger_cannot_make_are_refused(
    period_s: float, us: float, ident: Ident, words: str
) -> None:
    rows = (ProgramRow("low", (us,), (0.0,), 60.0, us),)
    plan = replace(BY_WIDTH, period_s=period_s, program=rows, lights=("low",))
    with pytest.raises(InputError, match=words):
        make_program(plan, SERIAL, ident)

"""The figures of the firmware, in cycles of the emulated chip's clock, from the traces of its pins."""

from __future__ import annotations

import itertools
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from tests.hw.emulated.chip import CYCLES_PER_US, Chip
from tests.hw.emulated.line import STEPS, TIMING, Line, ms, us
from tests.hw.emulated.load import full_line
from tests.hw.emulated.timing import film
from tests.hw.emulated.timing_picture import draw
from vaoi_station.acquisition.controller.interface import BeltPacing
from vaoi_station.acquisition.controller.protocol import (
    Fault,
    Kind,
    Pacing,
    RunEnd,
    Step,
    Suppressed,
    arm,
    config_crc,
    configuration,
)
from vaoi_station.line_config import ENCODER_LATENCY_S
from vaoi_station.line_config import Line as LineConfig

CYCLES_PER_TICK = 8


@pytest.mark.parametrize("loaded", [False, True], ids=["quiet", "full serial load"])
@pytest.mark.parametrize("phase", [0, 5555])
def test_pulses_come_when_they_should(chip: Chip, loaded: bool, phase: int) -> None:
    line = Line(chip)
    line.arm()
    chip.do(f"run {1 + phase}")
    if loaded:
        chip.do(f"send {full_line(400).hex()}")
    edge, _ = line.passage(340)
    line.run(200)
    triggers, gates = chip.rises("PB1"), chip.rises("PB2")
    assert len(triggers) == 18  # 20, 40, … 360 ms: the last one not later than the tail
    assert abs(triggers[0] - edge - 20_000 * CYCLES_PER_US) <= 5 * CYCLES_PER_US
    periods = [b - a for a, b in itertools.pairwise(triggers)]
    assert max(periods) - min(periods) <= 1 * CYCLES_PER_US
    assert all(abs(a - b) <= 2 * CYCLES_PER_US for a, b in zip(triggers, gates, strict=True))
    wanted = [STEPS[k % 3].width * CYCLES_PER_TICK for k in range(18)]
    assert all(abs(a - b) <= CYCLES_PER_US for a, b in zip(chip.widths("PB2"), wanted, strict=True))
    assert all(abs(width - 100 * CYCLES_PER_US) <= CYCLES_PER_US for width in chip.widths("PB1"))


def test_the_table_and_the_picture_of_the_timing(chip: Chip) -> None:
    found, trace = film(chip, 3, loaded=True)
    assert max(map(abs, found.delay)) <= 5
    assert max(found.period) - min(found.period) <= 1
    assert max(map(abs, found.width)) <= 1
    assert max(map(abs, found.light)) <= 2
    svg = ElementTree.fromstring(draw(trace, {"line full in both directions": found.rows()}))
    words = [element.text for element in svg.iter("{http://www.w3.org/2000/svg}text")]
    assert all(word in words for word in ["light barrier, PB0", "LED gate, PB2", *found.rows()])


def test_edges_beside_an_overflow_of_the_timer(chip: Chip) -> None:
    """The period is two ticks longer than a turn of Timer 1, so rise and fall wander across its overflow."""
    line = Line(chip)
    timing = replace(TIMING, steps=1, max_rows=160, period=2**16 + 2, trigger_width=us(60))
    line.arm(timing, [Step(1, us(80))])
    line.passage(1)
    line.run(20)
    bounce = line.events(Kind.SUPPRESSED)[0].tick  # ties ticks to cycles
    seen = next(cycle for cycle, name, level in chip.inputs if name == "PB0" and level)
    now = bounce + (chip.cycle - seen) // CYCLES_PER_TICK
    wanted = -(timing.start_delay + us(80) + 100) % 2**16  # the first light ends 100 ticks before the overflow
    ticks = (wanted - now) % 2**16
    chip.do(f"at {chip.cycle + ticks * CYCLES_PER_TICK} PB0 1")
    edge = chip.cycle + ticks * CYCLES_PER_TICK
    line.run(5400)
    triggers = chip.rises("PB1")
    assert len(triggers) == len(chip.rises("PB2")) == 160
    for row, cycle in enumerate(triggers):
        assert abs(cycle - edge - (timing.start_delay + row * timing.period) * CYCLES_PER_TICK) <= CYCLES_PER_US
    assert all(abs(width - 80 * CYCLES_PER_US) <= CYCLES_PER_US for width in chip.widths("PB2"))
    assert all(abs(width - 60 * CYCLES_PER_US) <= CYCLES_PER_US for width in chip.widths("PB1"))


def test_every_row_has_the_width_of_its_step(chip: Chip) -> None:
    """Wider than the light, and narrower: cameras that expose for it get the exposure of every row."""
    widths = (us(500), us(60.5), TIMING.trigger_width)
    line = Line(chip)
    for request in [*configuration(TIMING, STEPS, widths), arm(7, config_crc(TIMING, STEPS, widths))]:
        assert isinstance(line.request(request), bytes)
    line.passage(150)
    line.run(100)
    seen = chip.widths("PB1")
    assert len(seen) == 9
    assert all(abs(seen[k] - widths[k % 3] * CYCLES_PER_TICK) <= CYCLES_PER_US for k in range(9))
    assert all(abs(chip.widths("PB2")[k] - STEPS[k % 3].width * CYCLES_PER_TICK) <= CYCLES_PER_US for k in range(9))
    pulses = line.events(Kind.PULSE)
    assert [(p.on_ticks, p.width_ticks) for p in pulses] == [
        (STEPS[k % 3].width, (widths[0], widths[1], 0)[k % 3]) for k in range(9)
    ]


def test_events_agree_with_the_pins_and_every_row_has_the_channels_of_its_step(chip: Chip) -> None:
    line = Line(chip)
    line.arm()
    edge, clear = line.passage(150)
    line.run(100)
    pulses = line.events(Kind.PULSE)
    start = line.events(Kind.BARRIER)[0].tick  # ties ticks to cycles
    assert [p.index for p in pulses] == list(range(9))
    for pulse, cycle in zip(pulses, chip.rises("PB1"), strict=True):
        assert abs((pulse.tick - start) * CYCLES_PER_TICK - (cycle - edge)) <= CYCLES_PER_US
    blocked, left = line.events(Kind.BARRIER)
    assert (blocked.detail, left.detail) == (1, 0)
    assert abs((left.tick - blocked.tick) * CYCLES_PER_TICK - (clear - edge)) <= CYCLES_PER_US
    end = line.events(Kind.RUN_END)[0]
    assert (end.detail, end.index, end.value) == (RunEnd.CLEAR, 9, 0)
    assert [e.number for e in line.events()] == list(range(len(line.events())))
    high: set[str] = set()
    lit: list[set[str]] = []
    for _, pin, level in chip.edges:
        if pin.startswith("PD"):
            high = high | {pin} if level else high - {pin}
        elif pin == "PB2" and level:
            lit.append(set(high))
    assert lit == [[{"PD4"}, {"PD5", "PD6"}, {"PD7"}][k % 3] for k in range(9)]
    assert not high


def test_a_bounce_is_no_board_and_two_boards_need_a_gap(chip: Chip) -> None:
    line = Line(chip)
    line.arm(replace(TIMING, min_gap=ms(200)))
    edge, clear = line.passage(1)
    line.run(30)
    assert not chip.rises("PB1")
    line.passage(60)
    line.run(100)
    first = len(chip.rises("PB1"))
    line.passage(60)
    line.run(300)
    assert len(chip.rises("PB1")) == first == 4
    line.passage(60)
    line.run(100)
    assert len(chip.rises("PB1")) == 2 * first
    suppressed = [(e.detail, e.value) for e in line.events(Kind.SUPPRESSED)]
    assert [detail for detail, _ in suppressed] == [Suppressed.BOUNCE, Suppressed.GAP]
    # By the chip's cycles: a turn of a chip that sleeps may end some µs late.
    assert abs(suppressed[0][1] - (clear - edge) / CYCLES_PER_TICK) <= us(1)


def test_an_encoder_paces_rows_by_distance(chip: Chip) -> None:
    """Four times the speed in the middle of the board: rows keep their places, not their times."""
    line = Line(chip)
    timing = replace(TIMING, pacing=Pacing.DISTANCE, start_delay=100, period=200, tail=100, min_period=ms(5))
    line.arm(timing, [Step(1, us(200)), Step(2, us(200)), Step(4, us(200))])
    edge = line.barrier(True)
    slow, fast = 3200, 800
    chip.do(f"encoder 900 {slow}")
    line.run(200)  # 900 counts of 0.2 ms are 180 ms
    middle = chip.cycle
    chip.do(f"encoder 600 {fast}")
    line.run(40)
    line.barrier(False)
    chip.do(f"encoder 300 {slow}")
    line.run(100)
    latency = 1000 * CYCLES_PER_US
    places = [100, 300, 500, 700, 900, 1100, 1300, 1500]
    due = [edge + n * slow if n <= 900 else middle + (n - 900) * fast for n in places]
    triggers = chip.rises("PB1")
    assert len(triggers) == len(places)
    assert all(abs(cycle - at - latency) <= 20 * CYCLES_PER_US for cycle, at in zip(triggers, due, strict=True))


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_rows_lie_at_their_places_at_the_nominal_speed(chip: Chip, share: float) -> None:
    """At another speed they lie beyond them by what it differs in 1 ms: at half the speed 0.05 mm before them."""
    line_mm_s, start_mm, row_mm, per_mm = 100.0, 6.0, 4.0, 20.0
    config = LineConfig(
        conveyor_mm_s=(0.0, line_mm_s), barrier_mm=0.0, start_delay_s=start_mm / line_mm_s,
        trigger_period_s=row_mm / line_mm_s, tail_s=0.02, longest_board_mm=18.0, pacing="encoder",
        encoder={"counts_per_mm": per_mm},
    )  # fmt: skip
    belt = BeltPacing.of(config)
    assert belt is not None
    line = Line(chip)
    line.arm(
        replace(
            TIMING, pacing=Pacing.DISTANCE, steps=1, start_delay=belt.start, period=belt.row, tail=belt.tail,
            min_period=ms(5),
        ),
        [Step(1, us(200))],
    )  # fmt: skip
    per_count = round(1e6 * CYCLES_PER_US / (line_mm_s * share * per_mm))
    edge = line.barrier(True)
    chip.do(f"encoder 500 {per_count}")
    line.run(round(18.0 / (line_mm_s * share) * 1000))
    line.barrier(False)
    line.run(round(7.0 / (line_mm_s * share) * 1000))
    ways_mm = [(cycle - edge) / per_count / per_mm for cycle in chip.rises("PB1")]
    beyond_mm = (share - 1) * line_mm_s * ENCODER_LATENCY_S
    wanted = [start_mm + row * row_mm + beyond_mm for row in range(4)]
    assert ways_mm == pytest.approx(wanted, abs=0.005)


def test_an_encoder_that_is_too_fast_is_reported(chip: Chip) -> None:
    line = Line(chip)
    line.arm(
        replace(TIMING, pacing=Pacing.DISTANCE, steps=1, start_delay=100, period=50, tail=0, min_period=ms(15)),
        [Step(1, us(200))],
    )
    line.barrier(True)
    chip.do("encoder 1000 3200")
    line.run(220)
    triggers = chip.rises("PB1")
    assert len(triggers) >= 9
    assert min(b - a for a, b in itertools.pairwise(triggers)) >= ms(15) * CYCLES_PER_TICK - CYCLES_PER_US
    assert {e.detail for e in line.events(Kind.SUPPRESSED)} == {Suppressed.TOO_FAST}


def test_the_shortest_pulses_under_every_load_at_once(chip: Chip) -> None:
    """Serial line full, an encoder at 20 000 counts/s, a bouncing barrier: no interrupt comes too late to end them."""
    line = Line(chip)
    line.arm(replace(TIMING, steps=1, period=ms(6) + 1, min_period=ms(6), max_rows=500), [Step(1, us(50))])
    chip.do(f"send {full_line(1000).hex()}")
    chip.do("encoder 100000 800")
    line.barrier(True)
    for k in range(400):
        chip.do("run 32000")
        chip.do("pin PB0 0")
        chip.do(f"run {100 + 7 * (k % 300)}")
        chip.do("pin PB0 1")
    widths = chip.widths("PB2")
    assert len(widths) > 120
    assert all(abs(width - 50 * CYCLES_PER_US) <= CYCLES_PER_US for width in widths)
    periods = [b - a for a, b in itertools.pairwise(chip.rises("PB1"))]
    assert max(periods) - min(periods) <= CYCLES_PER_US
    line.run(400)
    assert line.status().fault == Fault.NONE

"""Whatever is sent and whatever fails: no LED beyond its limits, and a controller that goes on."""

from __future__ import annotations

import itertools
import random
from dataclasses import replace

from tests.hw.emulated.chip import CYCLES_PER_US, Chip
from tests.hw.emulated.line import STEPS, TIMING, Line, ms, us
from vaoi_station.acquisition.controller.protocol import (
    Fault,
    Kind,
    Message,
    Nak,
    Pacing,
    Reason,
    Request,
    RunEnd,
    State,
    Step,
    Type,
    arm,
    config_crc,
    configuration,
    encode,
    fire_one,
    set_step,
)

LONGEST_US = (1000, 1000, 500, 500)
BUCKET_US = 4000
DUTY = 16
WATCHDOG_RESET, POWER_ON, EXTERNAL = 8, 1, 2
TIMSK1 = "6f"


def lit(chip: Chip) -> list[list[tuple[int, int]]]:
    """When each channel was lit: its own pin and the gate high; in cycles."""
    level: dict[str, int] = {}
    began: dict[int, int] = {}
    spans: list[list[tuple[int, int]]] = [[], [], [], []]
    for cycle, pin, value in chip.edges:
        level[pin] = value
        for k in range(4):
            on = bool(level.get("PB2", 0) and level.get(f"PD{4 + k}", 0))
            if on and k not in began:
                began[k] = cycle
            elif not on and k in began:
                spans[k].append((began.pop(k), cycle))
    assert not began
    return spans


def check_limits(chip: Chip) -> int:
    """No pulse too long, and no stretch of time with more light than bucket and duty cycle allow; pulses seen."""
    for k, spans in enumerate(lit(chip)):
        excess = lowest = 0.0
        for start, end in spans:
            assert end - start <= (LONGEST_US[k] + 1) * CYCLES_PER_US, (k, start, end)
            lowest = min(lowest, excess - start / DUTY)
            excess += end - start
            # A row is booked up to 2 ms before it is lit.
            assert excess - end / DUTY - lowest <= (BUCKET_US + 2000 / DUTY + 1) * CYCLES_PER_US, (k, start)
    return len(chip.rises("PB2"))


def test_a_host_that_is_silent_for_three_seconds(chip: Chip) -> None:
    line = Line(chip)
    line.arm(replace(TIMING, max_rows=1000))
    line.barrier(True)
    line.run(500)
    silent = chip.cycle
    line.link.heartbeat = False
    line.run(3600)
    assert 2.5 < (chip.rises("PB1")[-1] - silent) / 16e6 < 3.0
    assert line.status().state == State.SAFE
    assert line.status().fault == Fault.HEARTBEAT
    assert [e.detail for e in line.events(Kind.RUN_END)] == [RunEnd.SAFE]
    assert [e.detail for e in line.events(Kind.FAULT)] == [Fault.HEARTBEAT]
    refused = line.request(arm(8, config_crc(replace(TIMING, max_rows=1000), STEPS)))
    assert isinstance(refused, Nak)
    assert (refused.reason, refused.limit) == (Reason.STATE, State.SAFE)
    line.request(Request(Type.DISARM))
    assert line.status().state == State.IDLE


def test_a_host_that_stalls_for_two_seconds_loses_no_row(chip: Chip) -> None:
    line = Line(chip)
    line.arm(replace(TIMING, max_rows=1000, period=ms(100)))
    line.barrier(True)
    line.run(500)
    chip.run_ms(2000)
    line.run(450)
    triggers = chip.rises("PB1")
    assert len(triggers) >= 29
    assert {round((b - a) / 16e3) for a, b in itertools.pairwise(triggers)} == {100}
    assert [e.index for e in line.events(Kind.PULSE)] == list(range(len(triggers)))


def test_safe_puts_the_light_out_at_once(chip: Chip) -> None:
    line = Line(chip)
    line.arm()
    line.barrier(True)
    line.run(45)
    line.request(Request(Type.SAFE))
    pulses = len(chip.rises("PB1"))
    line.run(100)
    assert len(chip.rises("PB1")) == pulses
    assert line.status().fault == Fault.COMMANDED


def test_a_lost_interrupt_is_caught_by_the_guard(chip: Chip) -> None:
    """The compare interrupt that ends the light is switched off behind the firmware's back."""
    line = Line(chip)
    line.arm()
    line.barrier(True)
    while not chip.rises("PB2"):
        chip.do("run 16")
    chip.do(f"poke {TIMSK1} 23")  # all of Timer 1 but OCIE1B
    line.run(20)
    rise = chip.rises("PB2")[0]
    fall = next(cycle for cycle, pin, level in chip.edges if pin == "PB2" and not level and cycle > rise)
    assert fall - rise <= (250 + 3 * 64) * CYCLES_PER_US
    assert line.status().fault == Fault.GUARD
    assert [e.detail for e in line.events(Kind.FAULT)] == [Fault.GUARD]


def test_a_main_loop_that_hangs_is_reset(chip: Chip) -> None:
    line = Line(chip)
    line.arm()
    line.run(300)
    chip.do("hang")
    hung = chip.cycle
    line.run(600)
    assert len(chip.resets) == 1
    assert (chip.resets[0] - hung) / 16e6 < 0.27
    assert line.restarts() == [2]
    status = line.status()
    assert (status.boots, status.reset_cause, status.config_crc) == (2, WATCHDOG_RESET, 0)
    assert [e.value for e in line.events(Kind.BOOT)] == [1, 2]


def test_a_reset_in_the_middle_of_a_run_leaves_all_outputs_low(chip: Chip) -> None:
    line = Line(chip)
    line.arm()
    line.barrier(True)
    while not chip.rises("PB2"):
        chip.do("run 16")
    chip.do("reset external")
    line.run(200)
    assert len(chip.rises("PB1")) == 1
    assert {pin: level for _, pin, level in chip.edges if level or pin != "PB0"} == dict.fromkeys(
        ("PB1", "PB2", "PD4"), 0
    )


def test_one_pulse_on_demand_and_once_only(chip: Chip) -> None:
    line = Line(chip)
    request = fire_one(77, Step(0b0010, us(300)), us(50))
    assert line.request(request) == b""
    assert line.request(request) == b""  # as after a lost reply
    (width,) = chip.widths("PB2")
    assert abs(width - 300 * CYCLES_PER_US) <= CYCLES_PER_US
    assert line.request(fire_one(78, Step(0, 0), us(50))) == b""
    line.run(5)
    assert len(chip.rises("PB1")) == 2
    assert len(chip.rises("PB2")) == 1
    too_long = line.request(fire_one(79, Step(0b0101, us(501)), us(50)))
    assert isinstance(too_long, Nak)
    assert (too_long.reason, too_long.field, too_long.limit) == (Reason.LED_LIMIT, 2, us(500))


def test_flashing_on_demand_is_held_to_the_duty_cycle(chip: Chip) -> None:
    line = Line(chip)
    line.run(200)  # fills the bucket
    answers = [line.request(fire_one(k, Step(1, us(1000)), us(50))) for k in range(40)]
    refused = [a for a in answers if isinstance(a, Nak) and a.reason == Reason.LED_BUDGET]
    assert refused
    assert check_limits(chip) >= 4


def some_frame(dice: random.Random) -> bytes:
    """Requests that make sense, requests that almost do, damage and noise."""
    timing = replace(
        TIMING,
        pacing=int(dice.random() < 0.1),
        start_delay=ms(dice.choice([7, 20])),
        period=dice.choice([ms(5), ms(7), ms(16), ms(40), dice.randrange(2**32)]),
        min_period=ms(dice.choice([5, 16])),
        max_rows=dice.choice([1, 5, 500]),
    )
    steps = [
        Step(dice.randrange(1, 17), dice.choice([us(50), us(300), us(1000), dice.randrange(2**16)])) for _ in range(3)
    ]
    kind = dice.random()
    if kind < 0.3:
        sane = replace(timing, pacing=Pacing.TIME, period=ms(16), min_period=ms(16))
        steps = [Step(1, us(1000)), Step(6, us(500)), Step(15, us(500))]
        requests = [*configuration(sane, steps), arm(1, config_crc(sane, steps))]
    elif kind < 0.4:
        requests = [*configuration(timing, steps), arm(1, config_crc(timing, steps))]
    elif kind < 0.6:
        requests = [fire_one(dice.randrange(2**16), steps[0], dice.randrange(2**13))]
    elif kind < 0.7:
        requests = [Request(dice.choice([Type.DISARM, Type.DISARM, Type.DISARM, Type.BEAT, Type.STATUS, Type.SAFE]))]
    elif kind < 0.8:
        requests = [set_step(dice.randrange(256), steps[1])]
    else:
        return dice.randbytes(dice.randrange(1, 90)) + b"\0"
    frames = bytearray(b"".join(encode(Message(r.type, dice.randrange(256), r.payload)) for r in requests))
    if dice.random() < 0.15:
        frames[dice.randrange(len(frames))] = dice.randrange(256)
    return bytes(frames)


def test_no_stream_of_bytes_drives_an_led_beyond_its_limits(chip: Chip) -> None:
    dice = random.Random(20)
    frames = 0
    for _ in range(300):
        data = b"".join(some_frame(dice) for _ in range(10))
        frames += data.count(0)
        chip.do(f"send {data.hex()}")
        for _ in range(6):
            chip.do(f"pin PB0 {dice.randrange(2)}")
            chip.run_ms(len(data) * 0.044 / 6)
    chip.do("send 00")
    chip.run_ms(5000)  # longer than the heartbeat: whatever ran has ended
    assert frames > 5000
    assert check_limits(chip) > 100
    assert not chip.resets
    chip.take()
    line = Line(chip)
    assert line.status().boots == 1

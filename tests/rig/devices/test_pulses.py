"""Shots from edges: which light came with a trigger, and for how long."""

from __future__ import annotations

from vaoi_station.rig.chip import Edge, Pulse, PulseDecoder


def play(*edges: tuple[float, str, int]) -> list[Pulse]:
    """Edges at µs."""
    decoder = PulseDecoder()
    pulses = [decoder.process(Edge(round(us * 16), pin, bool(level), round(us * 1000))) for us, pin, level in edges]
    return [pulse for pulse in pulses if pulse is not None]


def test_a_shot_is_known_when_its_light_is_out() -> None:
    edges = [(0, "PD5", 1), (2000, "PB1", 1), (2000, "PB2", 1), (2100, "PB1", 0), (2250, "PB2", 0), (2300, "PD5", 0)]
    assert play(*edges) == [Pulse(32000, 2_000_000, (1,), 250.0, 100.0)]
    assert play(*edges[:4]) == []


def test_a_flash_may_end_before_the_trigger() -> None:
    [pulse] = play((0, "PD4", 1), (10, "PB2", 1), (10, "PB1", 1), (60, "PB2", 0), (410, "PB1", 0))
    assert (pulse.channels, pulse.on_us, pulse.width_us) == ((0,), 50.0, 400.0)


def test_a_trigger_without_light_is_a_dark_shot() -> None:
    [pulse] = play((10, "PB1", 1), (110, "PB1", 0))
    assert (pulse.channels, pulse.on_us) == ((), 0.0)


def test_channels_without_their_gate_light_nothing() -> None:
    [pulse] = play((0, "PD4", 1), (0, "PD7", 1), (10, "PB1", 1), (110, "PB1", 0))
    assert pulse.channels == ()


def test_light_before_the_trigger_is_not_seen() -> None:
    [pulse] = play((0, "PD4", 1), (10, "PB2", 1), (110, "PB1", 1), (210, "PB1", 0), (260, "PB2", 0))
    assert pulse.on_us == 150.0


def test_light_without_a_trigger_is_no_shot_and_is_not_the_next_ones() -> None:
    before = [(0, "PD4", 1), (10, "PB2", 1), (60, "PB2", 0), (70, "PD4", 0)]
    [pulse] = play(*before, (1000, "PD6", 1), (2000, "PB1", 1), (2000, "PB2", 1), (2100, "PB2", 0), (2100, "PB1", 0))
    assert (pulse.channels, pulse.on_us) == ((2,), 100.0)

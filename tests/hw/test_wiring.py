"""The wiring: one source, the firmware's pins, every figure within its limit, drawings that can be read."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from hw.wiring.circuit import SOURCE, Circuit, read_circuit
from hw.wiring.figure import LIMITS, Figure, Firmware
from hw.wiring.figures import all_figures
from hw.wiring.pages import PORTS, made
from vaoi_station.errors import InputError

HW = SOURCE.parents[1]
CIRCUIT = read_circuit()


@pytest.fixture(scope="module")
def drawn() -> dict[Path, str]:
    """Every generated file; not made when the module is imported, which every test process does."""
    return made(CIRCUIT)


def test_what_is_drawn_is_what_the_circuit_says(drawn: dict[Path, str]) -> None:
    differing = [path.name for path, content in drawn.items() if path.read_text(encoding="utf-8") != content]
    assert differing == [], "run: python -m hw.wiring"


# ── pins ──


def firmware_pins() -> dict[str, str]:
    """Net → port pin, from the definitions the firmware is compiled with."""
    text = (HW / "firmware" / "chip" / "board.h").read_text(encoding="utf-8")
    pins = dict(re.findall(r"#define (\w+) \(1 << (P[BCD]\d)\)", text))
    first = re.search(r"#define CHANNEL_SHIFT PD(\d)", text)
    assert first is not None
    assert pins.pop("SERIAL_RX") == "PD0"  # the Nano's own USB bridge is there
    channels = {f"CHANNEL_{k}": f"PD{int(first[1]) + k}" for k in range(4)}
    return {name.removesuffix("_PIN"): port for name, port in pins.items()} | channels


def test_the_pins_are_those_of_the_firmware() -> None:
    drawn = {net: PORTS[pin] for pin, net in CIRCUIT.part("A1").pins if pin in PORTS}
    assert drawn == firmware_pins()


# ── from the chip to cameras and light ──


def through(ref: str, pin: str) -> Iterator[str]:
    """Output pins of a chip that follow one of its inputs."""
    names = [name for name, _ in CIRCUIT.part(ref).right]
    if ref == "U1":
        yield from (n for n in names if n[0] == pin[0] and n[1] == " " and pin[1] == " ")
    elif ref == "U3":  # 1A0 → 1Y0
        yield from (n for n in names if n.split(maxsplit=1)[0] == pin.split(maxsplit=1)[0].replace("A", "Y"))
    elif ref in {"U4", "U5"} and pin.isdigit():  # inputs opposite outputs
        yield from (n for n in names if n == str(19 - int(pin)))
    elif ref in {"U6", "U7"}:  # 1A, 1B → 1Y
        yield from (n for n in names if n.startswith(f"{pin[0]}Y"))
    elif ref in {"U8", "U9"} and pin[1] == "B":
        yield from (n for n in names if n.startswith(f"{pin[0]}Q"))


def reached(net: str) -> set[str]:
    """All nets that a signal on a net leads to."""
    nets = {(p.ref, p.name): n for n, pins in CIRCUIT.nets.items() for p in pins}
    seen, waiting = {net}, [net]
    while waiting:
        for pin in CIRCUIT.nets[waiting.pop()]:
            if any(pin.name == n for n, _ in CIRCUIT.part(pin.ref).left):
                new = {nets[pin.ref, out] for out in through(pin.ref, pin.name)} - seen
                seen |= new
                waiting += new
    return seen


@pytest.mark.parametrize("channel", range(4))
def test_a_channel_lights_its_own_strings_through_its_own_one_shot(channel: int) -> None:
    nets = reached(f"CHANNEL_{channel}")
    assert {n for n in nets if n.startswith("LIGHT")} == {f"LIGHT_{channel}"}
    assert {n for n in nets if n.startswith("MAY")} == {f"MAY_{channel}"}
    strings = [p for p in CIRCUIT.nets[f"LIGHT_{channel}"] if p.ref == "R31"]
    assert len(strings) == CIRCUIT.design["led"]["strings_per_channel"]


def test_the_gate_is_in_every_channel() -> None:
    assert {n for n in reached("GATE") if n.startswith("LIGHT")} == {f"LIGHT_{k}" for k in range(4)}


def test_nothing_conducts_from_the_pc_to_the_machine() -> None:
    pc, machine = {"5V_USB", "0V_USB"}, {"5V", "0V", "24V", "24V_SENSOR"}
    across = {
        part.ref
        for sheet in CIRCUIT.sheets
        for part in sheet.parts
        if {n for _, n in part.pins} & pc and {n for _, n in part.pins} & machine
    }
    assert across == {"U1"}  # U2's LED hangs on the sensor alone
    assert {s.barrier for s in CIRCUIT.sheets} - {""} == {"U1", "U2", "U12"}


# ── figures ──


def figure(name: str, start: str, firmware: Firmware | None = None, circuit: Circuit = CIRCUIT) -> Figure:
    figures = all_figures(circuit, firmware or Firmware.read())[name]
    return next(f for f in figures if f.name.startswith(start))


def test_the_current_is_where_the_amplifier_balances() -> None:
    """The node at the inverting input, solved by bisection instead of by formula."""
    v, wanted = 5.0, 5.0 * 6200 / (51e3 + 6200)
    low, high = 0.0, 5.0
    for _ in range(60):
        amperes = (low + high) / 2
        sense = amperes * 0.27
        inverting = sense + (v - sense) * 1000 / (1000 + 100e3)
        low, high = (amperes, high) if inverting < wanted else (low, amperes)
    assert figure("current", "pulse, nominal").value == pytest.approx(low, rel=1e-9)


def test_longer_pulses_in_the_firmware_break_the_one_shots_figures(tmp_path: Path) -> None:
    changed = tmp_path / "limits.h"
    changed.write_text(LIMITS.read_text(encoding="utf-8").replace("US(1000), US(1000)", "US(1400), US(1000)"))
    assert not figure("one-shots", "channel 0, shortest", Firmware.read(changed)).ok
    assert figure("one-shots", "channel 1, shortest", Firmware.read(changed)).ok


def test_another_value_in_the_source_changes_drawing_bill_and_figures(tmp_path: Path, drawn: dict[Path, str]) -> None:
    source = tmp_path / "circuit.toml"
    text = SOURCE.read_text(encoding="utf-8")
    source.write_text(text.replace("value = 0.27", "value = 0.22").replace("0.27 Ω", "0.22 Ω"))
    changed = read_circuit(source)
    assert not figure("current", "pulse, most", circuit=changed).ok
    differing = {path.name for path, content in made(changed).items() if content != drawn[path]}
    assert differing == {"sink.svg", "bill-of-materials.csv", "wiring.md"}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('["D9", "TRIGGER"]', '["D9", "TRIGER"]', "net 'TRIGER' has one end only, A1 D9"),
        ('ref = "R32"', 'ref = "R31"', r"parts \['R31'\] appear twice"),
        ("column = 0", "colum = 0", "colum: is an unknown key"),
    ],
)
def test_a_circuit_that_cannot_be_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    source = tmp_path / "circuit.toml"
    source.write_text(SOURCE.read_text(encoding="utf-8").replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        read_circuit(source)


# ── drawings ──

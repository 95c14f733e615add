"""The figures of the pages of hw/ are those of the circuit."""

from __future__ import annotations

from pathlib import Path

from hw.wiring.circuit import read_circuit
from hw.wiring.figure import Firmware, shown
from hw.wiring.light import currents, one_shots

ROOT = Path(__file__).resolve().parents[2]
BRING_UP = (ROOT / "hw" / "bring-up.md").read_text(encoding="utf-8")


def test_the_guides_figures_are_those_of_the_circuit() -> None:
    circuit = read_circuit()
    volts = [ampere * circuit.value("R37") for ampere in currents(circuit)]
    assert f"{min(volts):.2f} … {max(volts):.2f} V" in BRING_UP
    times = one_shots(circuit)
    assert times[0] == times[1]
    assert times[2] == times[3]
    for low, high in (times[0], times[2]):
        number, unit = shown(low, "s").split()
        assert f"{number} … {shown(high, 's')}" in BRING_UP, (number, unit)
    assert Firmware.read().longest_s[0] < times[0][0]

"""Calculate the quantities of the circuit from the values in `circuit.toml` and the limits in the firmware.

Each quantity is calculated for the worst combination of tolerances and is compared with its limit.
"""

from __future__ import annotations

from hw.wiring.circuit import Circuit
from hw.wiring.figure import Figure, Firmware
from hw.wiring.light import bank_figures, current_figures, currents, heat_figures, one_shot_figures
from hw.wiring.signals import input_figures, interlock_figures, output_figures, trigger_figures
from hw.wiring.transient import transient_figures


def all_figures(circuit: Circuit, firmware: Firmware) -> dict[str, list[Figure]]:
    """Return every table of calculated quantities in hw/wiring.md, by the name of the table."""
    return {
        "inputs": input_figures(circuit),
        "outputs": output_figures(circuit),
        "interlock": interlock_figures(circuit),
        "trigger": trigger_figures(circuit),
        "one-shots": one_shot_figures(circuit, firmware),
        "current": current_figures(circuit, firmware),
        "transient": transient_figures(circuit),
        "bank": bank_figures(circuit, firmware),
        "heat": heat_figures(circuit, firmware),
        "power": power_figures(circuit, firmware),
    }


def power_figures(circuit: Circuit, firmware: Firmware) -> list[Figure]:
    """Calculate the load on the 24 V supply and on the 5 V converter."""
    d, usual = circuit.design, circuit.design["operating"]
    strings = d["led"]["channels"] * d["led"]["strings_per_channel"]
    most = max(currents(circuit))
    cameras = circuit.part("X10").count * d["camera"]["draws_a"][1]
    inputs = circuit.part("X10").count * (d["logic_supply_v"][1] - d["array"]["input_v"]) / d["array"]["input_ohm"]
    return [
        Figure(
            "light, at the firmware's limit",
            "16 · I · duty",
            strings * most * firmware.duty,
            "A",
            "≤",
            circuit.value("F20") - cameras - 0.5,
            "5 A less cameras and sensors",
        ),
        Figure(
            "light, on the paper's line",
            "16 · I · 250 µs/125 ms",
            strings * most * usual["pulse_s"] / usual["period_s"],
            "A",
        ),
        Figure("5 V: inputs of the drivers", "12 · (V − 1.4 V)/2.7 kΩ", inputs, "A", "≤", 0.25, "half the converter"),
    ]

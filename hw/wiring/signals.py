"""Calculate the inputs, the outputs, and the trigger lines to the cameras. Units are V, A, Ω, F, s, W."""

from __future__ import annotations

from hw.wiring.circuit import Circuit
from hw.wiring.figure import Figure

RESISTOR = 0.05
"""Tolerance of resistors on which no measure depends."""


def input_figures(circuit: Circuit) -> list[Figure]:
    """Calculate the 24 V inputs for barrier and encoder."""
    d, opto, sensor = circuit.design, circuit.design["opto"], circuit.design["sensor"]
    series, bleed, filter_f = circuit.value("R1"), circuit.value("R2"), circuit.value("C2")
    low, high = d["sensor_supply_v"]
    least = (low - sensor["drop_v"] - opto["led_v"][1]) / (series * (1 + RESISTOR))
    least -= opto["led_v"][1] / (bleed * (1 - RESISTOR))
    most_v = high - opto["led_v"][0]
    most = most_v / (series * (1 - RESISTOR))
    tau = filter_f / (1 / series + 1 / bleed)
    pull_up = d["logic_supply_v"][1] / (circuit.value("R3") * (1 - RESISTOR))
    watt = circuit.part("R1").watt or 0.0
    return [
        Figure(
            "LED of the optocoupler, least", "(V − drop − V_LED)/R1 − V_LED/R2", least, "A", "≥", opto["on_a"], "on"
        ),
        Figure("LED of the optocoupler, most", "(V − V_LED)/R1", most, "A", "≤", opto["largest_a"]),
        Figure("heat in R1", "(V − V_LED)²/R1", most_v * most, "W", "≤", watt),
        Figure(
            "LED with the sensor off",
            "leakage · R2",
            sensor["leakage_a"] * bleed * (1 + RESISTOR),
            "V",
            "≤",
            opto["off_v"],
            "off",
        ),
        Figure("filter", "(R1 ∥ R2) · C2", tau, "s", "≤", 100e-6, "0.01 mm at 100 mm/s"),
        Figure("fastest encoder", "1/(10 · filter)", 1 / (10 * tau), "Hz", "≥", 1000, "0.1 mm per period at 100 mm/s"),
        Figure("output of the optocoupler", "V/R3", pull_up, "A", "≤", opto["sinks_a"]),
    ]


def output_figures(circuit: Circuit) -> list[Figure]:
    """Calculate the chip's outputs, during its reset and afterwards."""
    chip, supply = circuit.design["chip"], circuit.design["logic_supply_v"]
    pull = circuit.value("R11")
    floating = (chip["pin_leakage_a"] + chip["isolator_leakage_a"]) * pull * (1 + RESISTOR)
    return [
        Figure("pin in reset", "leakage · R11", floating, "V", "≤", chip["isolator_low"] * supply[0], "low at U1"),
        Figure("pin when high", "V/R11", supply[1] / (pull * (1 - RESISTOR)), "A", "≤", chip["pin_source_a"]),
    ]


def interlock_figures(circuit: Circuit) -> list[Figure]:
    """Calculate the output "line ready": the relay's LED at the chip, and its contact at the conveyor."""
    chip, relay, conveyor = circuit.design["chip"], circuit.design["relay"], circuit.design["conveyor"]
    supply, series = circuit.design["logic_supply_v"], circuit.value("R40")
    floating = chip["pin_leakage_a"] * circuit.value("R39") * (1 + RESISTOR)
    least = (supply[0] - chip["pin_drop_v"] - relay["led_v"][1]) / (series * (1 + RESISTOR))
    most = (supply[1] - relay["led_v"][0]) / (series * (1 - RESISTOR))
    pull = supply[1] / (circuit.value("R39") * (1 - RESISTOR))
    drop = conveyor["draws_a"] * relay["on_ohm"]
    return [
        Figure("LED of the relay in reset", "leakage · R39", floating, "V", "≤", relay["off_v"], "off"),
        Figure("LED of the relay, least", "(V − drop − V_LED)/R40", least, "A", "≥", relay["on_a"], "on"),
        Figure("LED of the relay, most", "(V − V_LED)/R40", most, "A", "≤", relay["led_largest_a"]),
        Figure("pin when high", "the same + V/R39", most + pull, "A", "≤", chip["pin_source_a"]),
        Figure("contact, closed", "I · R_on", drop, "V", "≤", conveyor["low_v"], "0 of a 24 V input"),
        Figure("contact, current", "conveyor's input", conveyor["draws_a"], "A", "≤", relay["largest_a"]),
        Figure("contact, open", "suppressor diode", relay["clamp_v"], "V", "≤", relay["largest_v"]),
    ]


def trigger_figures(circuit: Circuit) -> list[Figure]:
    """Calculate the trigger output, which drives up to 12 opto-isolated camera inputs."""
    d = circuit.design
    camera, array, buffer = d["camera"], d["array"], d["buffer"]
    low, high = d["light_supply_v"]
    per_input = (d["logic_supply_v"][1] - array["input_v"]) / array["input_ohm"]
    worst = max(len([n for _, n in circuit.part(u).left if n == f"FAN_{k}"]) for u in ("U4", "U5") for k in range(6))
    cameras = circuit.part("X10").count
    return [
        Figure("buffer, high", "data sheet", buffer["high_v"], "V", "≥", array["turns_on_at_v"], "input of ULN2803A"),
        Figure("buffer, current", "2 · (V − 1.4 V)/2.7 kΩ", worst * per_input, "A", "≤", buffer["drives_a"]),
        Figure("camera, on, least", "V − V_CE", low - array["saturation_v"][1], "V", "≥", camera["one_v"], "logic 1"),
        Figure("camera, on, most", "V − V_CE", high - array["saturation_v"][0], "V", "≤", camera["largest_v"]),
        Figure("driver, off", "V", high, "V", "≤", array["largest_v"]),
        Figure("fuse", "camera's own limiter", camera["draws_a"][1], "A", "≤", circuit.value("F1"), "holds"),
        Figure(
            "all cameras together",
            f"{cameras} · {camera['draws_a'][1] * 1e3:g} mA",
            cameras * camera["draws_a"][1],
            "A",
        ),
    ]

"""Calculate the LED channels: one-shots, current sinks, capacitor banks and heat. Units are V, A, Ω, F, s, W, K."""

from __future__ import annotations

import itertools

from hw.wiring.circuit import Circuit
from hw.wiring.figure import Figure, Firmware


def one_shots(circuit: Circuit) -> list[tuple[float, float]]:
    """Return the shortest and the longest pulse, in s, of each channel's one-shot."""
    o = circuit.design["one_shot"]
    spread = 1.0
    for tolerance in (o["tolerance"], o["resistor_tolerance"], o["capacitor_tolerance"]):
        spread *= 1 + tolerance
    times = [o["factor"] * circuit.value(r) * circuit.value("C22") for r in ("R22", "R22", "R24", "R24")]
    return [(t * (2 - spread), t * spread) for t in times]


def one_shot_figures(circuit: Circuit, firmware: Firmware) -> list[Figure]:
    """Calculate the one-shots: longer than any pulse that the firmware permits, and at most twice as long."""
    times = one_shots(circuit)
    figures = []
    for k, ((least, most), longest) in enumerate(zip(times, firmware.longest_s, strict=True)):
        figures.append(Figure(f"channel {k}, shortest", "0.7 · R · C", least, "s", "≥", longest, "firmware's limit"))
        figures.append(Figure(f"channel {k}, longest", "0.7 · R · C", most, "s", "≤", 2 * longest, "twice that"))
    return figures


def currents(circuit: Circuit) -> list[float]:
    """Return the pulse current of an LED string for every combination of tolerances. The first one is nominal."""
    d = circuit.design
    offset, supply = d["amplifier"]["offset_v"], d["logic_supply_v"]
    nominal = {ref: circuit.value(ref) for ref in ("R31", "R32", "R33", "R34", "R37")}
    middle = sum(supply) / 2

    def current(v: float, error: float, r: dict[str, float]) -> float:
        wanted = v * r["R32"] / (r["R31"] + r["R32"]) + error
        share = r["R33"] / (r["R33"] + r["R34"])
        return (wanted - v * (1 - share)) / share / r["R37"]

    signs = itertools.product((-1, 1), repeat=len(nominal))
    corners = [
        {ref: r * (1 + 0.01 * s) for (ref, r), s in zip(nominal.items(), chosen, strict=True)} for chosen in signs
    ]
    return [current(middle, 0.0, nominal)] + [
        current(v, error, r) for v in supply for error in (-offset, offset) for r in corners
    ]


def current_figures(circuit: Circuit, firmware: Firmware) -> list[Figure]:
    """Calculate the current through an LED string: during a pulse, the mean, and between pulses."""
    d, led = circuit.design, circuit.design["led"]
    corners = currents(circuit)
    most, supply = max(corners), d["logic_supply_v"]
    bias = supply[0] * circuit.value("R34") * 0.99 / (circuit.value("R33") * 1.01 + circuit.value("R34") * 0.99)
    dark = d["amplifier"]["gate_low_v"] * circuit.value("R32") / (circuit.value("R31") + circuit.value("R32"))
    over = led["over_drive"] * led["rated_a"]
    mean = most * firmware.duty
    return [
        Figure("pulse, nominal", "(V·R32/(R31+R32) − V·R34/R33)/R37", corners[0], "A"),
        Figure("pulse, least", "all tolerances", min(corners), "A"),
        Figure("pulse, most", "all tolerances", most, "A", "≤", over, "300 % of the LED's rating"),
        Figure("duty", "firmware", firmware.duty, "", "≤", led["over_drive_duty"], "for that"),
        Figure("mean, most", "pulse · duty", mean, "A", "≤", led["rated_a"], "LED's rating"),
        Figure(
            "amplifier's bias while dark",
            "V·R34/R33",
            bias,
            "V",
            "≥",
            dark + d["amplifier"]["offset_v"],
            "offset, low level",
        ),
    ]


def fault_current(circuit: Circuit) -> float:
    """Return the current through an LED string if its transistor never switches off. Resistor R38 limits it."""
    led = circuit.design["led"]
    string = led["in_series"] * led["forward_small_v"]
    return float((circuit.design["light_supply_v"][1] - string) / (circuit.value("R38") * 0.95 + circuit.value("R37")))


def bank_figures(circuit: Circuit, firmware: Firmware) -> list[Figure]:
    """Calculate the capacitor of an LED string and how it is charged; voltages are added from supply to string."""
    d, led, bank = circuit.design, circuit.design["led"], circuit.design["bank"]
    most, longest = max(currents(circuit)), max(firmware.longest_s)
    capacity = circuit.value("C32") * (1 - bank["capacitor_tolerance"])
    droop = most * longest / capacity
    series = most * bank["resistance_ohm"]
    sag = most * firmware.duty * circuit.value("R38") * 1.05
    across = most * (circuit.value("R37") * 1.01 + d["transistor"]["on_ohm"])
    left = d["light_supply_v"][0] - sag - droop - series - across
    usual = d["operating"]
    fault = fault_current(circuit)
    return [
        Figure("sag of the mean", "duty · I · R38", sag, "V"),
        Figure("droop in the longest pulse", "I · t/C32", droop, "V"),
        Figure("in the capacitor's resistance", "I · ESR", series, "V"),
        Figure("across sense resistor and transistor", "I · (R37 + R_on)", across, "V"),
        Figure(
            "left for the string",
            "V − all these",
            left,
            "V",
            "≥",
            led["in_series"] * led["forward_v"][1],
            "5 LEDs, largest",
        ),
        Figure("droop at the paper's exposure", "I · 250 µs/C32", most * usual["pulse_s"] / capacity, "V"),
        Figure(
            "time to recharge",
            "3 · R38 · C32",
            3 * circuit.value("R38") * circuit.value("C32"),
            "s",
            "≤",
            2 * usual["period_s"],
            "two periods of the paper",
        ),
        Figure("switch on for ever", "(V − 5·V_LED)/(R38 + R37)", fault, "A", "≤", led["rated_a"], "LED's rating"),
        Figure(
            "heat in R38 then", "I² · R38", fault**2 * circuit.value("R38"), "W", "≤", circuit.part("R38").watt or 0.0
        ),
    ]


def heat_figures(circuit: Circuit, firmware: Firmware) -> list[Figure]:
    """Calculate the heat of the transistor, which regulates the current. The worst case is a pulse without end."""
    d, led, q = circuit.design, circuit.design["led"], circuit.design["transistor"]
    most, high = max(currents(circuit)), d["light_supply_v"][1]
    usual = (high - led["in_series"] * led["forward_v"][0] - most * circuit.value("R37")) * most
    shorted = (high - most * circuit.value("R37")) * most
    mean = d["ambient_c"] + shorted * firmware.duty * q["junction_ambient_k_w"]
    sense = most**2 * circuit.value("R37")
    return [
        Figure("transistor in a pulse", "(V − 5·V_LED − I·R37) · I", usual, "W"),
        Figure("the same, string shorted", "(V − I·R37) · I", shorted, "W"),
        Figure("energy of that pulse", "until the one-shot ends", shorted * max(t for _, t in one_shots(circuit)), "J"),
        Figure(
            "junction, string shorted",
            "ambient + mean · R_JA + pulse · R_JC",
            mean + shorted * q["junction_case_k_w"],
            "°C",
            "≤",
            q["largest_c"],
        ),
        Figure("voltage", "V", high, "V", "≤", q["largest_v"]),
        Figure("heat in R37", "I² · R37 · duty", sense * firmware.duty, "W", "≤", circuit.part("R37").watt or 0.0),
    ]

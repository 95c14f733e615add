"""Simulate how the current sink of an LED string switches on and off, as four differential equations.

The amplifier is modelled as an integrator with a maximum slope, limits of its output voltage, and an output resistance.
The transistor is modelled as a square law with two capacitances, and the LED string as a voltage and a resistance. The
values are typical and extreme values of data sheets. The simulation shows whether the current overshoots or oscillates,
which a calculation of steady values cannot show. It is a calculation, not a measurement.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

from hw.wiring.circuit import Circuit
from hw.wiring.figure import Figure
from hw.wiring.light import currents

STEP_S = 2e-9
"""A fifth of the quickest time constant (amplifier 11 ns at 14 MHz; gate and feedback are slower)."""
EDGE_S = 12e-6
"""Time that is simulated after an edge."""


@dataclass(frozen=True)
class Corner:
    """One combination of those values for which the data sheets give a range."""

    gain_hz: float
    """Gain-bandwidth product of the amplifier."""
    gate_f: float
    """C_iss of the transistor."""
    slope_a_v2: float
    """k of I = k·(V_GS − V_th)²."""


@dataclass(frozen=True)
class Edges:
    """The start and the end of a simulated pulse for one combination of values."""

    settled_a: float
    peak_a: float
    rise_s: float
    """From 10 % to 90 %."""
    on_s: float
    """From the edge of LIGHT to half the current."""
    off_s: float


@dataclass
class _Sink:
    """The circuit and its state: amplifier output a (V), gate voltage x (V_GS, V), voltage u (V) on capacitor C31."""

    circuit: Circuit
    corner: Corner
    a: float = 0.0
    x: float = 0.0
    u: float = 0.0

    def __post_init__(self) -> None:
        value, d = self.circuit.value, self.circuit.design
        self.divider = value("R32") / (value("R31") + value("R32"))
        self.supply = sum(d["logic_supply_v"]) / 2
        self.r_bias, self.r_back, self.r_gate = value("R33"), value("R34"), value("R35")
        self.r_down, self.r_sense, self.c_back = value("R36"), value("R37"), value("C31")
        self.threshold, self.c_drain = d["transistor"]["threshold_v"], d["transistor"]["reverse_f"]
        self.r_out, self.slew = d["amplifier"]["output_ohm"], d["amplifier"]["slew_v_s"]
        self.r_drain = d["led"]["in_series"] * d["led"]["slope_ohm"]
        self.u = -self._inverting_at_rest()  # dark for long: the output is at its lower rail

    def current(self) -> float:
        """Return the current through the LED string, A."""
        above: float = max(self.x - self.threshold, 0.0)
        return self.corner.slope_a_v2 * above**2

    def step(self, lit: bool) -> None:
        """Compute the state after one more time step `STEP_S`."""
        wanted = self.supply * self.divider if lit else 0.0
        amperes = self.current()
        sense, gate = amperes * self.r_sense, self.x + amperes * self.r_sense
        out, inverting, into_back = self._nodes(sense, gate)
        steep = 2 * math.sqrt(self.corner.slope_a_v2 * amperes)
        load_f = self.corner.gate_f + self.c_drain * steep * (self.r_sense + self.r_drain)
        slope = 2 * math.pi * self.corner.gain_hz * (wanted - inverting)
        self.a = min(max(self.a + STEP_S * min(max(slope, -self.slew), self.slew), 0.0), self.supply)
        self.x += STEP_S * ((out - gate) / self.r_gate - gate / self.r_down) / load_f
        self.u += STEP_S * into_back / self.c_back

    def _nodes(self, sense: float, gate: float) -> tuple[float, float, float]:
        """Return the voltages of output and inverting input, and the current into C31, from the two node equations."""
        # inverting = out − u; all that flows through the two resistors to it comes through C31
        g_back, g_bias, g_gate, g_out = 1 / self.r_back, 1 / self.r_bias, 1 / self.r_gate, 1 / self.r_out
        known = g_back * (sense + self.u) + g_bias * (self.supply + self.u)
        out = (self.a * g_out + gate * g_gate + known) / (g_out + g_gate + g_back + g_bias)
        inverting = out - self.u
        return out, inverting, g_back * (inverting - sense) + g_bias * (inverting - self.supply)

    def _inverting_at_rest(self) -> float:
        rest: float = self.supply * self.r_back / (self.r_back + self.r_bias)
        return rest


def corners(circuit: Circuit) -> list[Corner]:
    """Return all combinations of the smallest and largest values in the data sheets."""
    amplifier, transistor = circuit.design["amplifier"], circuit.design["transistor"]
    spreads = (amplifier["gain_hz"], transistor["gate_f"], transistor["slope_a_v2"])
    return [Corner(*chosen) for chosen in itertools.product(*spreads)]


def edges(circuit: Circuit, corner: Corner) -> Edges:
    """Simulate the start of a pulse until the current is steady, and then the end of the pulse."""
    sink, steps = _Sink(circuit, corner), round(EDGE_S / STEP_S)
    rising: list[float] = []
    falling: list[float] = []
    for lit, course in ((True, rising), (False, falling)):
        for _ in range(steps):
            sink.step(lit)
            course.append(sink.current())
    settled = rising[-1]
    first = {share: next(k for k, i in enumerate(rising) if i >= share * settled) for share in (0.1, 0.5, 0.9)}
    off = next(k for k, i in enumerate(falling) if i <= 0.5 * settled)
    return Edges(settled, max(rising), (first[0.9] - first[0.1]) * STEP_S, first[0.5] * STEP_S, off * STEP_S)


def transient_figures(circuit: Circuit) -> list[Figure]:
    """Return the worst values over all combinations as calculated quantities."""
    led = circuit.design["led"]
    all_edges = [edges(circuit, corner) for corner in corners(circuit)]
    over = max(e.peak_a / e.settled_a for e in all_edges) - 1
    peak, limit = max(currents(circuit)) * (1 + over), led["over_drive"] * led["rated_a"]
    return [
        Figure("overshoot", "loop of U11 and Q1", over, "", "≤", 0.05, "of the current"),
        Figure("peak", "most · (1 + overshoot)", peak, "A", "≤", limit, "300 % of the LED's rating"),
        Figure(
            "rise, 10 to 90 %",
            "the same",
            max(e.rise_s for e in all_edges),
            "s",
            "≤",
            5e-6,
            "a tenth of the shortest pulse",
        ),
        Figure("light after the gate", "to half the current", max(e.on_s for e in all_edges), "s"),
        Figure("end after the gate's", "to half the current", max(e.off_s for e in all_edges), "s"),
        Figure(
            "pulse shorter by",
            "their difference",
            max(abs(e.on_s - e.off_s) for e in all_edges),
            "s",
            "≤",
            5e-6,
            "2 % of 250 µs",
        ),
    ]

"""One board of the twin, prepared for the belt: its barrier edges, its pulses and its rendered frames.

The controller reacts to all edges of the barrier, including bounces. The pulses are therefore predicted with the rule
of the firmware, and the frames are rendered for the predicted times.
"""

from __future__ import annotations

import math
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.controller.interface import ControllerEvent, PulseFired, TriggerPlan
from vaoi_station.acquisition.controller.trigger_rule import BeltCounter, TriggerRule
from vaoi_station.model.light_program import row_of
from vaoi_station.simulation import Passage

FAR_S = 1e4
"""A time that is later than the end of any passage, s."""


class SimulatedBoard:
    """A board with its barrier edges, pulses and frames. All times are seconds since the start of its passage."""

    def __init__(self, passage: Passage, plan: TriggerPlan, cameras: int) -> None:
        self.passage = passage
        self.edges = barrier_edges(passage)
        self.pulses = predict_pulses(self.edges, plan, passage.encoder)
        self._program = plan.program
        self._to_render = [(c, r) for r in range(len(self.pulses)) for c in range(cameras)]
        self._frames: dict[tuple[int, int], NDArray[np.uint8]] = {}

    @property
    def ready(self) -> bool:
        """Whether all frames of the board are rendered."""
        return not self._to_render

    def render_one(self) -> None:
        """Render the next frame of the board that is not rendered yet."""
        camera, row = self._to_render.pop(0)
        pulse = self.pulses[row]
        filmed = row_of(self._program, row)
        image = self.passage.frame_at(camera, pulse.time_s, pulse.light, row, filmed)
        self._frames[camera, row] = to_bytes(image)

    def pixels(self, camera: int, row: int) -> NDArray[np.uint8]:
        """Return the flat bytes of a frame.

        A stuck board may have more rows than frames; then the last one is repeated.
        """
        return self._frames[camera, min(row, len(self.pulses) - 1)]


def to_bytes(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Return a frame (height, width) as the flat bytes that a camera sends."""
    return np.ascontiguousarray(image).reshape(-1).view(np.uint8)


def barrier_edges(passage: Passage) -> list[tuple[float, bool]]:
    """Return every change of the barrier as (time, whether it is interrupted then); bounces invert the true state."""
    toggles = [passage.blocked_s, passage.clear_s]
    for bounce in passage.faults.bounces:
        toggles += [bounce.at_s, bounce.at_s + bounce.duration_s]
    # A board that is stuck never clears the barrier: its time is infinite and gives no edge.
    finite = sorted(t for t in toggles if math.isfinite(t))
    return [(0.0, False), *((t, n % 2 == 0) for n, t in enumerate(finite))]


def predict_pulses(
    edges: list[tuple[float, bool]], plan: TriggerPlan, belt: BeltCounter | None = None
) -> list[PulseFired]:
    """Return the pulses that the controller will fire for these edges of the barrier, and this way of the belt."""
    rule = TriggerRule(plan, count(), belt)
    events: list[ControllerEvent] = []
    for time_s, blocked in edges:
        events += rule.advance(time_s)
        rule.add_edge(time_s, blocked)
    events += rule.advance(FAR_S)
    return [e for e in events if isinstance(e, PulseFired)]

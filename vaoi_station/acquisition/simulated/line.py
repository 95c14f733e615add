"""The conveyor of a simulated station: it prepares boards and lets one after another pass the barrier.

Boards come only while the controller is armed. A board enters the belt when all its frames are rendered, and nothing
is rendered while a board passes, so that rendering does not take processor time from the station under test. Pulses
without the barrier show the calibration board at rest under the cameras.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Collection
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.cameras.simulated import SimulatedCamera
from vaoi_station.acquisition.controller.interface import EventQueue, LineOutput, Permit, PulseFired, TriggerPlan
from vaoi_station.acquisition.controller.program_faults import require_none, unknown_lights
from vaoi_station.acquisition.controller.simulated import SimulatedController
from vaoi_station.acquisition.device_clock import DeviceClock
from vaoi_station.acquisition.simulated.board import SimulatedBoard, to_bytes
from vaoi_station.errors import InputError, InternalError, VaoiError
from vaoi_station.simulation import Twin, calibration_board
from vaoi_station.supervised_thread import SupervisedThread

AHEAD = 2
"""Number of boards that are prepared in advance."""
LEAD_S = 0.02
"""Time from the decision to let a board pass to the start of its passage, s."""
RENDER_LIMIT_S = 600.0
"""Longest time for one frame of the twin, s. The first one may wait for the compiler on a busy computer."""
SAME_TIME_S = 1e-6
"""Largest accepted difference between the times of a fired and a predicted pulse, s."""


def accept_plan(asked: TriggerPlan, expected: TriggerPlan, lights: Collection[str] = ()) -> TriggerPlan:
    """Return the requested plan, without a light program with the lights and the program of the scenario.

    Raises:
        InputError: the requested plan has other times than the scenario's plan, or lights that the scenario lacks.
    """
    for key in ("start_delay_s", "period_s", "tail_s", "debounce_s"):
        value, must = getattr(asked, key), getattr(expected, key)
        if not math.isclose(value, must, rel_tol=1e-9, abs_tol=1e-12):
            raise InputError.field("trigger plan", key, value, f"{must}, as in the scenario", "Adapt [line].")
    if asked.belt != expected.belt:
        raise InputError.field(
            "trigger plan", "belt", asked.belt, f"{expected.belt}, as in the scenario", "Adapt [line]."
        )
    require_none(unknown_lights(asked.program, lights))
    if asked.program:
        return asked
    if asked.lights and tuple(asked.lights) != tuple(expected.lights):
        limit = f"{tuple(expected.lights)}, as in the scenario"
        raise InputError.field("trigger plan", "lights", tuple(asked.lights), limit)
    return replace(asked, lights=tuple(expected.lights), program=expected.program)


class SimulatedLine:
    """The simulated conveyor: it gives barrier edges to the controller and exposes the cameras on its pulses."""

    def __init__(
        self,
        twin: Twin,
        plan: TriggerPlan,
        cameras: tuple[SimulatedCamera, ...],
        clock: DeviceClock,
        boards: int,
        interval_s: float,
        interlock: bool = False,
    ) -> None:
        """Start without boards.

        Args:
            twin: the digital twin.
            plan: the trigger plan for which frames are rendered.
            cameras: the station's cameras.
            clock: the controller's clock.
            boards: count of boards; 0: without end.
            interval_s: shortest time from the start of one passage to the start of the next.
            interlock: whether the conveyor holds boards back while the output "line ready" is low.
        """
        self._twin, self._cameras, self._clock = twin, cameras, clock
        self._scenario_plan = self._plan = plan
        self._boards, self._interval_s, self._interlock = boards, interval_s, interlock
        self._permit: Permit | None = None
        self._spent: int | None = None
        """Number of the permit that the last board has used up."""
        self._change = threading.Condition()
        self._ready: deque[SimulatedBoard] = deque()
        self._prepared = 0
        self._board: SimulatedBoard | None = None
        self._still: list[NDArray[np.uint8]] = []
        """Flat bytes of every camera's frame of the calibration board; rendered with the first pulse that shows it."""
        self._start_s = 0.0
        self._next_host_s = float("-inf")
        self._armed = self._passing = self._closing = False
        self._thread = SupervisedThread(self._work, "line", RENDER_LIMIT_S)

    def start(self, controller: SimulatedController, faults: EventQueue) -> None:
        """Begin to prepare boards; report faults to `faults`."""
        self._controller, self._faults = controller, faults
        self._thread.start()

    def accept(self, plan: TriggerPlan) -> TriggerPlan:
        """Return the plan that is simulated; `accept_plan` states which plans are refused.

        Boards that were rendered for another light program are rendered again.
        """
        accepted = accept_plan(plan, self._scenario_plan, self._twin.scenario.lights)
        with self._change:
            if accepted.program != self._plan.program:
                self._prepared -= len(self._ready)
                self._ready.clear()
                self._change.notify()
            self._plan = accepted
        return accepted

    def lights(self) -> tuple[str, ...]:
        """Return the names of the lights of the scenario."""
        return tuple(self._twin.scenario.lights)

    def counts_at(self, time_s: float) -> int:
        """Return the counts of the belt's encoder up to a time of the controller's clock; it rests between boards."""
        track = self._board.passage.encoder if self._board is not None else None
        return 0 if track is None else track.counts_at(time_s - self._start_s)

    def time_of(self, counts: int) -> float:
        """Return the controller's time at which the encoder reaches a count; infinite if the belt stops before."""
        track = self._board.passage.encoder if self._board is not None else None
        return math.inf if track is None else track.time_of(counts) + self._start_s

    def set_armed(self, armed: bool) -> None:
        """Let boards enter the belt if `armed`; otherwise hold them back."""
        with self._change:
            self._armed = armed
            self._change.notify()

    def end_run(self) -> None:
        """Record that the run has ended, so that the next board may come."""
        with self._change:
            self._passing = False
            self._change.notify()

    def permit_board(self, permit: Permit | None) -> None:
        """Let one board enter the belt while the permit is valid, if the conveyor obeys the interlock."""
        with self._change:
            self._permit = permit
            self._change.notify()

    def line_output(self) -> LineOutput | None:
        """Return whether a board may enter now; None if the conveyor does not obey the interlock."""
        if not self._interlock:
            return None
        if not self._armed or self._passing:
            return LineOutput(False, "the controller is not armed, or a board is being filmed")
        return LineOutput(True) if self._permitted() else LineOutput(False, "the station does not permit a board")

    def _permitted(self) -> bool:
        if not self._interlock:
            return True
        permit = self._permit
        return permit is not None and permit.number != self._spent and time.monotonic() < permit.until_s

    def fire(self, event: PulseFired) -> None:
        """Expose all cameras, for a pulse that was fired during a passage."""
        board, row = self._board, event.index
        if board is None or not self._agrees(board, event):
            error = InternalError(f"pulse {row} was fired at {event.time_s} s, when the twin did not expect one.")
            self._faults.put(DeviceFault("simulated line", error))
            return
        for n in range(len(self._cameras)):
            self._expose(board, n, row, self._clock.host_s(event.time_s))

    def fire_single(self, event: PulseFired) -> None:
        """Expose all cameras for a pulse without a board: they show the calibration board at rest."""
        if not self._still:
            self._still = [to_bytes(image) for _, _, image in calibration_board.frames(self._twin)]
        host_s = self._clock.host_s(event.time_s)
        for camera, pixels in zip(self._cameras, self._still, strict=True):
            camera.trigger(host_s, self._exposed(pixels, camera.brightness(event.on_us)))

    def _exposed(self, pixels: NDArray[np.uint8], brightness: float) -> NDArray[np.uint8]:
        """Return the flat bytes of a frame as bright as exposure and gain make it, clipped at the full scale."""
        if brightness == 1.0:
            return pixels
        bits = self._twin.scenario.array.bits
        grey = pixels if bits == 8 else pixels.view(np.uint16)
        return to_bytes(np.clip(grey * brightness, 0, (1 << bits) - 1).astype(grey.dtype))

    def _expose(self, board: SimulatedBoard, n: int, row: int, host_s: float) -> None:
        """Expose one camera for a row, with the faults of the scenario."""
        camera, faults = self._cameras[n], board.passage.faults
        if (interval_s := faults.free_running_interval_s(n)) is not None:
            if row == 0:
                self._run_freely(board, n, host_s, interval_s)
            return
        if faults.ignored(n, row):
            return
        other = faults.metadata_row(n, row)
        last = len(board.pulses) - 1
        # An exchanged frame has the time stamp and the id of the other row.
        stamp_error_s = board.pulses[min(other, last)].time_s - board.pulses[min(row, last)].time_s
        stamp_error_s += faults.stamps_late_s(n)
        camera.trigger(
            host_s,
            board.pixels(n, row),
            lost=faults.lost(n, row),
            late_s=faults.delay_s(n, row),
            share=faults.received_share(n, row),
            stamp_error_s=stamp_error_s,
            id_error=other - row,
        )
        for after_s in faults.extra_delays_s(n, row):
            camera.trigger(host_s + after_s, board.pixels(n, row), stamp_error_s=faults.stamps_late_s(n))

    def _run_freely(self, board: SimulatedBoard, n: int, host_s: float, interval_s: float) -> None:
        """Expose a camera at a fixed interval, independent of the pulses, from the first pulse until the last."""
        # The exposures are a third of an interval late, so that they do not coincide with pulses by construction.
        passing_s = board.pulses[-1].time_s - board.pulses[0].time_s
        for k in range(math.ceil(passing_s / interval_s)):
            self._cameras[n].trigger(host_s + (k + 1 / 3) * interval_s, board.pixels(n, 0))

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the thread that lets boards pass."""
        return (self._thread,)

    def close(self) -> None:
        """End the thread that lets boards pass, and wait for its end."""
        self._thread.expect_end()
        with self._change:
            self._closing = True
            self._change.notify()
        if self._thread.ident is not None:
            self._thread.join()

    def _agrees(self, board: SimulatedBoard, event: PulseFired) -> bool:
        if event.index >= len(board.pulses):
            return board.passage.faults.stuck is not None
        return abs(board.pulses[event.index].time_s + self._start_s - event.time_s) < SAME_TIME_S

    def _work(self) -> None:
        try:
            while not self._closing:
                self._thread.beat()
                if self._may_pass():
                    self._let_pass()
                elif not self._passing and self._to_prepare():
                    self._prepare()
                else:
                    self._wait()
        except VaoiError as error:
            self._thread.expect_end()  # the fault is reported; no board comes any more
            self._faults.put(DeviceFault("simulated line", error))

    def _may_pass(self) -> bool:
        # The list may be emptied at any time, by a new plan.
        ready = any(board.ready for board in [*self._ready][:1])
        may_enter = self._armed and not self._passing and self._permitted()
        return ready and may_enter and time.monotonic() >= self._next_host_s

    def _to_prepare(self) -> bool:
        if self._still and not self._armed:
            return False  # single pulses show the calibration board: rendering would delay their frames
        if any(not board.ready for board in [*self._ready][-1:]):
            return True
        return len(self._ready) < AHEAD and (self._boards == 0 or self._prepared < self._boards)

    def _prepare(self) -> None:
        """Render one frame; if all frames of the board are rendered, begin with the next board."""
        with self._change:
            newest = self._ready[-1] if self._ready else None
            if newest is None or newest.ready:
                passage = self._twin.passage(self._prepared)
                self._ready.append(SimulatedBoard(passage, self._plan, len(self._cameras)))
                self._prepared += 1
                return
        newest.render_one()

    def _let_pass(self) -> None:
        with self._change:
            # Disarming, or the end of the permit, may have come between the check in _may_pass and here.
            if not self._armed or not self._permitted() or not self._ready or not self._ready[0].ready:
                return
            self._spent = self._permit.number if self._permit else None
            board, now_s = self._ready.popleft(), time.monotonic()
            self._start_s = self._clock.device_s(now_s + LEAD_S)
            self._board, self._passing = board, True
            self._next_host_s = now_s + self._interval_s
        self._controller.schedule_edges([(self._start_s + t, blocked) for t, blocked in board.edges])

    def _wait(self) -> None:
        with self._change:
            if self._closing or self._may_pass() or (not self._passing and self._to_prepare()):
                return
            waiting_for_time = self._armed and self._ready and not self._passing and self._permitted()
            with self._thread.waiting():
                self._change.wait(max(self._next_host_s - time.monotonic(), 0.0) if waiting_for_time else None)

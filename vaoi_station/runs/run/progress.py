"""A run that is filmed or stitched: what the coordinator knows of it until it is in the archive."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from vaoi_station.acquisition.controller.announced import Came
from vaoi_station.acquisition.process.messages import RunFinished, RunStarted
from vaoi_station.config import StationConfig
from vaoi_station.line_config import row_ways_mm
from vaoi_station.model import FrameRecord, Pulse, Reason, RecordingHead, Status, Stitch, Verdict
from vaoi_station.model.recording import row_of
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.tables import RUN, RunState, RunStep
from vaoi_station.runs.workers.jobs import Concluded, ExplainJob, OpenRun, RunContext, WantedCheck
from vaoi_station.runs.workers.run_stitcher import RunStitcher, Stitched
from vaoi_station.stitching.matching.evidence import FrameKey

WHOLE = frozenset({"clear", "single"})
"""Values of `controller.RunEnded.reason` for a regular end of the pulses: the run shows everything that passed."""
CAUSE = "the acquisition process ended before it arrived"
"""Cause of missing frames that is stated in their records."""


@dataclass
class Progress:
    """A run that has not ended. Times in s are host times by time.monotonic()."""

    order: Order
    stitcher: RunStitcher
    state: RunState = RUN.start
    recorded: RunFinished | None = None
    """The final report of the acquisition process; None while filming."""
    armed_s: float = float("-inf")
    """Time since which the order of the run has been in force."""
    id_doubted: bool = False
    """Whether the order's board id may belong to another board."""
    came: Came | None = None
    """How the line announced the board."""
    faults: list[Reason] = field(default_factory=list)
    """Reasons why the run is degraded or failed, other than missing or incomplete frames."""
    stitched: Stitched | None = None
    """The answer of the stitcher; None until the run only waits for earlier ones to end."""
    result: Concluded | None = None

    @classmethod
    def begin(cls, report: RunStarted, bay: Bay, order: Order) -> Progress:
        """Begin the run of a board that has interrupted the barrier; its frames go into `bay`."""
        reference = order.reference.directory if order.reference else None
        opening = OpenRun(RunContext(report.run, bay.number, bay.generation), order.setup, reference)
        belt = order.plan.belt if order.plan is not None else None
        return cls(order, RunStitcher(opening, report.host_time_s, None if belt is None else belt.row_mm))

    @property
    def context(self) -> RunContext:
        """The id of the run, with the number of its bay and the generation of the bay."""
        return self.stitcher.opening.context

    @property
    def run(self) -> str:
        """Id of the run."""
        return self.context.run

    @property
    def barrier_s(self) -> float:
        """Time at which the board interrupted the barrier."""
        return self.stitcher.barrier_s

    @property
    def pulses(self) -> dict[int, Pulse]:
        """The reported pulses by row."""
        return self.stitcher.pulses

    @property
    def frames(self) -> dict[FrameKey, FrameRecord]:
        """The settled frames by camera and row."""
        return self.stitcher.frames

    @property
    def head(self) -> RecordingHead | None:
        """Head of the run's recording; None while the board is filmed."""
        return self.recorded.head if self.recorded else None

    @property
    def stitch(self) -> Stitch | None:
        """The result without its tables of components; None while there is no result."""
        return self.result.without_components if self.result else None

    @property
    def board_id(self) -> str | None:
        """The caller's id of the board; None if there is none, or if it may belong to another board."""
        return None if self.id_doubted else self.order.board_id

    def advance(self, event: RunStep) -> None:
        """Change to the state that follows a step in the table `RUN`; `StateError` if the step is illegal."""
        self.state = RUN.next(self.state, event)

    def film(self, report: RunFinished) -> None:
        """Take the final report of the acquisition process, and let the stitcher have the run concluded."""
        self.advance(RunStep.FILMED)
        # A later stitch of the recording demands the same boards, and expects the same rotation.
        stated: dict[str, object] = {"skip": self.order.skip} if self.order.skip else {}
        if self.order.flip is not None and self.order.line is not None:
            stated["rotation_deg"] = self.order.line.expected_board.rotation_deg or None
        if stated:
            report = replace(report, head=report.head.model_copy(update=stated))
        self.recorded = report
        self.stitcher.film(report.head, report.frames)

    def take(self, stitched: Stitched) -> None:
        """Take the answer of the stitcher; its errors become faults."""
        self.stitched, self.result = stitched, stitched.result
        for error in stitched.errors:
            self.add_fault(Reason.of(error))

    def explain_job(self) -> ExplainJob | None:
        """Return the job that completes the result, once the faults of the run are known; None without a result."""
        if (stitch := self.stitch) is None:
            return None
        return ExplainJob(self.run, stitch.status, stitch.reasons, stitch.reason_codes, self._wanted_check())

    def _wanted_check(self) -> WantedCheck | None:
        """Return the calibration check that follows the result; None if the run would give no evidence.

        A failed result gives none about the cameras: its board was not found, or is hardly in the picture. A single
        camera has no neighbour that could show its displacement. A run that was cut short shows a part of its board: a
        solution that fits this part well may fit the cameras badly, which looks like a drift.
        """
        if self.recorded is None or self.recorded.reason not in WHOLE or len(self.order.setup.cameras) < 2:
            return None
        if self.stitch is None or self.stitch.status is Status.FAILED:
            return None
        return WantedCheck(self.run, utc(), self.order.filmed_digest, self.order.calibration_digest)

    def add_fault(self, reason: Reason) -> None:
        """Add a fault to the reasons of the run, unless the same fault is present already."""
        if reason not in self.faults:
            self.faults.append(reason)

    def doubt_id(self, why: str) -> None:
        """Withhold the order's board id, and add the cause to the faults. No effect if there is no id."""
        if self.order.board_id is None or self.id_doubted:
            return
        self.id_doubted = True
        message = f"This run has no board id: {self.order.board_id!r} was armed, but {why}."
        action = "Identify the board, arm again with the id of the next board, and film this one again."
        self.add_fault(Reason(code="board-id-uncertain", message=message, action=action))

    def disown(self, why: str) -> None:
        """State that it is not known which order the board has: it was filmed for that for which the line was set."""
        self.id_doubted = True
        message = f"It is not known which order this board has: {why}. The run has no board id."
        action = "Identify the board, compare the orders that wait, and arm again."
        self.add_fault(Reason(code="order-uncertain", message=message, action=action))

    def salvaged(self, config: StationConfig) -> RunFinished | None:
        """Return the final report that the acquisition process did not send any more; None if there is no row.

        Frames that were not reported get the verdict MISSING.
        """
        rows = 0
        # Only rows before the first missing pulse are used: later rows have no certain time.
        while rows in self.pulses:
            rows += 1
        if not rows:
            return None
        keys = [(camera, row) for camera in range(len(config.cameras)) for row in range(rows)]
        frames = tuple(
            self.frames.get(key) or FrameRecord(camera=key[0], row=key[1], verdict=Verdict.MISSING, cause=CAUSE)
            for key in keys
        )
        # Times are relative to the first pulse and rounded to 1 ns, as the acquisition process does it. So the tasks
        # that were requested while filming remain valid.
        first_s = self.pulses[0].time_s
        line, plan = self.order.line or config.line, self.order.plan
        lights = tuple(self.pulses[row].light for row in range(rows))
        program = plan.program if plan is not None else ()
        filmed = [expected for row in range(rows) if (expected := row_of(program, row)) is not None]
        head = RecordingHead(
            format="vaoi-recording",
            version=1,
            cameras=config.heads,
            rows=rows,
            trigger_period_s=line.trigger_period_s,
            conveyor_mm_s=line.conveyor_mm_s,
            rotation_deg=config.line.expected_board.rotation_deg or None,
            missing=tuple((f.camera, f.row) for f in frames if f.verdict is Verdict.MISSING),
            trigger_times_s=tuple(round(self.pulses[row].time_s - first_s, 9) for row in range(rows)),
            belt_mm=None if plan is None or plan.belt is None else row_ways_mm(plan.belt.row_mm, rows),
            exposures_us=tuple(row.lit_us for row in filmed) or None,
            gains=tuple(row.gains for row in filmed) or None,
            lights=lights if any(lights) else None,
        )
        settled_s = [at_s for key, at_s in self.stitcher.settled_s.items() if key in self.stitcher.present]
        last_s = max(settled_s, default=self.barrier_s)
        return RunFinished(self.run, self.context.bay, head, frames, last_s, "acquisition lost")

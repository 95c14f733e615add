"""The tables of docs/measured.md: one twin camera turned by 0.1°, or none.

    python tests/drift/measure.py SCENARIO CAMERA UNDISTURBED KNOCKED [SEED]

SCENARIO is a name ("small", "demo") or a file. UNDISTURBED boards pass before the knock and KNOCKED after it, for each
axis. Where none pass after a knock, the camera creeps instead: it turns about its x axis a little more with each board.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vaoi_station.drift.check_run import check_run
from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.recalibrate import recalibrate
from vaoi_station.drift.watch import find_drifts
from vaoi_station.errors import InputError
from vaoi_station.model import Calibration, Stitch
from vaoi_station.simulation import Passage, Scenario, Twin, read_scenario, scenario_path
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks


class Board:
    """One board of the twin, filmed."""

    def __init__(self, twin: Twin, number: int) -> None:
        self.passage: Passage = twin.passage(number)
        head, frames = self.passage.head(), self.passage.render_all()
        self.number, self._frames, self._times_s = number, frames, head.row_times_s()
        self._setup = StitchSetup(twin.cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)

    def stitched(self, calibration: Calibration | None = None) -> tuple[RunCheck, Stitch]:
        """Its result and its check, under the twin's calibration or another one."""
        setup = self._setup
        if calibration is not None:
            setup = replace(setup, cameras=calibration.cameras(self.passage.twin.heads))
        runner, present = TaskRunner(setup, lambda i, j: self._frames.get((i, j))), sorted(self._frames)
        tasks = all_tasks(present, dict(enumerate(self._times_s)), setup)
        evidence = [runner.perform(task) for task in tasks]
        stitch, findings = runner.conclude_with_findings(self._times_s, present, evidence)
        return check_run(f"{self.number}", "", "b", findings), stitch

    def components_px(self, stitch: Stitch) -> str:
        """Error of component positions in all views: rms and largest, px; or that there are none."""
        if stitch.components is None:
            return f"no C ({stitch.status})"
        ours = {(ref, i, j): (x, y) for ref, seen in stitch.components.items() for i, j, x, y in seen}
        off = [
            np.hypot(ours[ref, i, j][0] - x, ours[ref, i, j][1] - y)
            for ref, seen in self.passage.truth()["views"].items()
            for i, j, x, y in seen
            if (ref, int(i), int(j)) in ours
        ]
        return f"{np.sqrt(np.mean(np.square(off))):.3f} / {max(off):.3f} ({stitch.status})"


def matrix_px(calibration: Calibration, passage: Passage, camera: int) -> str:
    """Error of N_i over the whole frame: rms and largest, px."""
    ours, truly = calibration.cameras(passage.twin.heads)[camera], passage.pinholes[camera]
    x, y = np.meshgrid(np.linspace(0, ours.width_px - 1, 17), np.linspace(0, ours.height_px - 1, 13))
    grid = np.column_stack([x.ravel(), y.ravel()])
    off = np.hypot(*(ours.project(truly.ground(grid, 0.0)) - grid).T)
    return f"{np.sqrt(np.mean(off**2)):.3f} / {off.max():.3f}"


def scenario_of(name: str, seed: int) -> dict[str, Any]:
    """Read a scenario and give it boards of its own."""
    given = read_scenario(Path(name) if name.endswith(".toml") else scenario_path(name)).model_dump()
    given["belt"]["seed"] += seed
    given["array"]["seed"] += seed
    return given


def main(name: str, camera: int, undisturbed: int, knocked: int, seed: int = 0) -> None:
    """Print the tables."""
    scenario = scenario_of(name, seed)
    still = Twin(Scenario.model_validate(scenario))
    checks = [Board(still, number).stitched()[0] for number in range(undisturbed)]
    alarms = sum(bool(find_drifts(checks[: k + 1])) for k in range(undisturbed))
    shown = np.array([[c.displacement_px for c in check.cameras] for check in checks])
    print(f"{name}, seed {seed}: {undisturbed} undisturbed runs, {alarms} with an alarm")
    print(f"displacements shown: rms {np.sqrt((shown**2).mean()):.4f}, largest {np.abs(shown).max():.4f} px")
    if not knocked:
        measure_creep(scenario, camera, checks)
    for axis in "xyz" if knocked else "":
        scenario["faults"]["knocked"] = [{"camera": camera, "from_board": undisturbed, "about": axis, "angle_deg": 0.1}]
        measure_knock(Twin(Scenario.model_validate(scenario)), camera, axis, checks, knocked)


def measure_creep(scenario: dict[str, Any], camera: int, before: list[RunCheck]) -> None:
    """Turn a camera by a fifth of a thousandth of a degree per board, until a drift is reported."""
    checks = list(before)
    for step in range(1, 101):
        knock = {"camera": camera, "about": "x", "angle_deg": 2e-4 * step}
        scenario["faults"]["knocked"] = [knock]
        board = Board(Twin(Scenario.model_validate(scenario)), len(before) + step - 1)
        check, stitch = board.stitched()
        checks.append(check)
        if found := find_drifts(checks):
            off = matrix_px(board.passage.twin.calibration, board.passage, camera)
            named = [(d.camera, round(d.size_px, 3), d.since_run, d.instead) for d in found]
            print(f"creeping: reported after {step} boards, N off by {off} px; {named}")
            print(f"  components px: {board.components_px(stitch)}")
            return
    print("creeping: not reported within 100 boards")


def measure_knock(twin: Twin, camera: int, axis: str, before: list[RunCheck], knocked: int) -> None:
    """One row of the table: a knock about one axis."""
    boards = [Board(twin, len(before) + k) for k in range(knocked)]
    results = [board.stitched() for board in boards]
    since = [check for check, _ in results]
    alarms = [find_drifts(before + since[: k + 1]) for k in range(knocked)]
    runs = next((k + 1 for k, found in enumerate(alarms) if found), None)
    named = [(d.camera, round(d.size_px, 3), d.since_run, d.instead) for d in alarms[-1]]
    print(f"about {axis}: reported after {runs} runs; {named}")
    try:
        proposal = recalibrate(twin.calibration, twin.heads, since)
    except InputError as refusal:
        print(f"  {refusal}")
        return
    after = boards[-1].stitched(proposal.calibration)[1]
    passage, board = boards[-1].passage, boards[-1]
    print(
        f"  N px: {matrix_px(twin.calibration, passage, camera)} -> {matrix_px(proposal.calibration, passage, camera)}"
    )
    print(f"  components px: {board.components_px(results[-1][1])} -> {board.components_px(after)}")
    print("  " + proposal.lines()[camera])


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))

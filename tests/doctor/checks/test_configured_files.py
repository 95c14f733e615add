"""Check calibration, board types, scenario and recordings; every fault is made for real."""

from __future__ import annotations

import json
import os
import shutil
from datetime import UTC, datetime
from pathlib import Path

from tests.doctor.conftest import assert_problem, changed, only, with_config, without_privileges
from vaoi_station.config import LightConfig, ReplayConfig
from vaoi_station.doctor.check_context import CheckContext
from vaoi_station.doctor.checks import configured_files
from vaoi_station.doctor.finding import Level
from vaoi_station.model import ProgramStep


def test_complete_files_are_ok(context: CheckContext) -> None:
    for check in (configured_files.calibration, configured_files.board_types, configured_files.stand_ins):
        assert {finding.level for finding in check(context)} == {Level.OK}, check


def test_calibration_of_another_array_is_a_fault(context: CheckContext) -> None:
    cameras = (*context.config.cameras, context.config.cameras[0].model_copy(update={"name": "third"}))
    three = with_config(context, context.config.model_copy(update={"cameras": cameras}))
    assert_problem(only(configured_files.calibration(three)), Level.FAULT, "calibration.json", "3")


def test_absent_calibration_is_a_fault(context: CheckContext) -> None:
    context.config.calibration.unlink()
    finding = only(configured_files.calibration(context))
    assert_problem(finding, Level.FAULT, "calibration.json")
    assert "vaoi calibrate" in finding.action


def test_unreadable_board_types_are_named_one_by_one(context: CheckContext) -> None:
    directory = context.config.board_types
    (directory / "broken.json").write_text('{"format": "vaoi-board",')
    (directory / "foreign.json").write_text('{"format": "something"}')
    bad = [f for f in configured_files.board_types(context) if f.level is Level.FAULT]
    assert [f.subject for f in bad] == ["broken.json", "foreign.json"]
    assert all(f.action for f in bad)


def test_absent_and_empty_directory_of_board_types(context: CheckContext) -> None:
    shutil.rmtree(context.config.board_types)
    assert_problem(only(configured_files.board_types(context)), Level.FAULT, "there is no directory")
    context.config.board_types.mkdir()
    assert_problem(only(configured_files.board_types(context)), Level.WARNING, "is empty", "cannot be armed")


def test_read_only_directory_of_board_types_is_a_warning(context: CheckContext) -> None:
    for directory in (context.config.board_types, *context.config.board_types.parents):
        if directory.is_relative_to(Path("/tmp")) and os.access(directory, os.W_OK):
            directory.chmod(directory.stat().st_mode | 0o055)
    context.config.board_types.chmod(0o555)
    with without_privileges():
        finding = only(configured_files.board_types(context))
    assert_problem(finding, Level.WARNING, "cannot be written to")


def test_a_program_that_does_not_fit_is_named_with_its_board_type(context: CheckContext) -> None:
    assert "none in station.toml, 0 of 1 board types" in only(configured_files.programs(context)).message
    path = next(context.config.board_types.glob("*.json"))
    board_type = json.loads(path.read_text())
    path.write_text(json.dumps(board_type | {"line": {"speed_mm_s": 3.0}}))
    finding = only(configured_files.programs(context))
    assert_problem(finding, Level.FAULT, "line.speed_mm_s is 3.0, but must be")
    assert finding.subject == board_type["name"]
    long = context.config.model_copy(update={"program": (ProgramStep(light="ring", exposure_us=(9e5,)),)})
    found = [f.subject for f in configured_files.programs(with_config(context, long))]
    assert found == ["station", board_type["name"]]


def test_scenario_with_another_period_is_a_fault(context: CheckContext) -> None:
    slower = with_config(context, changed(context.config, "line", trigger_period_s=0.2))
    assert_problem(only(configured_files.stand_ins(slower)), Level.FAULT, "period_s is 0.2")


def test_absent_recordings_are_a_fault(context: CheckContext, tmp_path: Path) -> None:
    config = changed(context.config, "controller", backend="replay")
    config = config.model_copy(update={"replay": ReplayConfig(recordings=(tmp_path / "gone",))})
    assert_problem(only(configured_files.stand_ins(with_config(context, config))), Level.FAULT, "gone")


def test_real_devices_need_no_stand_ins(context: CheckContext) -> None:
    config = changed(context.config, "controller", backend="serial")
    finding = only(configured_files.stand_ins(with_config(context, config)))
    assert finding.level is Level.NOT_APPLICABLE


def with_flat_fields(
    context: CheckContext, directory: Path, created: str, width: int | None = None, light: str | None = None
) -> CheckContext:
    heads = [camera.head for camera in context.config.cameras]
    size = [{"width": width or h.width, "height": h.height, "read": 1.0, "shot": 0.03} for h in heads]
    each = [{"camera": i, "file": f"fields/{i}.tiff", "level": 0.5, "rows": 4} for i in range(len(heads))]
    if light is not None:
        each = [field | {"light": light} for field in each]
    document = {"format": "vaoi-flatfield", "version": 1, "created": created, "cameras": size, "fields": each}
    (directory / "flatfield.json").write_text(json.dumps(document))
    return with_config(context, context.config.model_copy(update={"flat_fields": directory, "program": ()}))


def test_flat_fields_of_this_array_are_ok_until_they_expire(context: CheckContext, tmp_path: Path) -> None:
    assert only(configured_files.flat_fields(context)).level is Level.NOT_APPLICABLE
    today = datetime.now(UTC).isoformat()
    assert only(configured_files.flat_fields(with_flat_fields(context, tmp_path, today))).level is Level.OK
    old = only(configured_files.flat_fields(with_flat_fields(context, tmp_path, "2020-01-01T00:00:00+00:00")))
    assert_problem(old, Level.WARNING, "days old and expire after 180")


def test_flat_fields_of_other_lights_than_those_of_the_rows_are_reported(context: CheckContext, tmp_path: Path) -> None:
    """The lights of a program, of the controller's order, and of the programs of board types."""
    lit = with_flat_fields(context, tmp_path, datetime.now(UTC).isoformat(), light="ring")
    assert only(configured_files.flat_fields(lit)).level is Level.OK
    lights = {name: LightConfig(channels=(0,), on_us=100.0) for name in ("ring", "left")}
    serial = changed(lit.config, "controller", backend="serial", lights=lights, order=("ring",))
    assert only(configured_files.flat_fields(with_config(lit, serial))).level is Level.OK
    turns = changed(serial, "controller", order=("ring", "left"))
    finding = only(configured_files.flat_fields(with_config(lit, turns)))
    assert_problem(finding, Level.FAULT, "have no field for the light 'left'")
    path = next(context.config.board_types.glob("*.json"))
    path.write_text(json.dumps(json.loads(path.read_text()) | {"program": [{"light": "left"}]}))
    unfit, fit = configured_files.flat_fields(lit)
    assert_problem(unfit, Level.WARNING, "board type", "have no field for the light 'left'")
    assert fit.level is Level.OK


def test_flat_fields_of_another_array_are_a_fault(context: CheckContext, tmp_path: Path) -> None:
    today = datetime.now(UTC).isoformat()
    other = with_flat_fields(context, tmp_path, today, width=100)
    assert_problem(only(configured_files.flat_fields(other)), Level.FAULT, "has 100×", "px, but its frames have")
    (tmp_path / "flatfield.json").unlink()
    assert_problem(only(configured_files.flat_fields(other)), Level.FAULT, "flatfield.json: there is no such file")

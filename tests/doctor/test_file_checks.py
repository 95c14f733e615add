"""Check the files that the configuration names; every fault is made for real."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import pytest

from tests.doctor.conftest import assert_problem, changed, only, with_config, without_privileges
from tests.peers.certificates import Certificate, make_certificate
from vaoi_station.config import ApiConfig, LightConfig
from vaoi_station.doctor import file_checks
from vaoi_station.doctor.file_checks import readable_by_others, station_certificate
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.running_station import CheckContext
from vaoi_station.model import ProgramStep


def test_unreadable_board_types_are_named_one_by_one(context: CheckContext) -> None:
    directory = context.config.board_types
    (directory / "broken.json").write_text('{"format": "vaoi-board",')
    (directory / "foreign.json").write_text('{"format": "something"}')
    bad = [f for f in file_checks.board_types(context) if f.level is Level.FAULT]
    assert [f.subject for f in bad] == ["broken.json", "foreign.json"]
    assert all(f.action for f in bad)


def test_a_program_that_does_not_fit_is_named_with_its_board_type(context: CheckContext) -> None:
    assert "none in station.toml, 0 of 1 board types" in only(file_checks.programs(context)).message
    path = next(context.config.board_types.glob("*.json"))
    board_type = json.loads(path.read_text())
    path.write_text(json.dumps(board_type | {"line": {"speed_mm_s": 3.0}}))
    finding = only(file_checks.programs(context))
    assert_problem(finding, Level.FAULT, "line.speed_mm_s is 3.0, but must be")
    assert finding.subject == board_type["name"]
    long = context.config.model_copy(update={"program": (ProgramStep(light="ring", exposure_us=(9e5,)),)})
    found = [f.subject for f in file_checks.programs(with_config(context, long))]
    assert found == ["station", board_type["name"]]


def test_scenario_with_another_period_is_a_fault(context: CheckContext) -> None:
    slower = with_config(context, changed(context.config, "line", trigger_period_s=0.2))
    assert_problem(only(file_checks.stand_ins(slower)), Level.FAULT, "period_s is 0.2")


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
    assert only(file_checks.flat_fields(context)).level is Level.NOT_APPLICABLE
    today = datetime.now(UTC).isoformat()
    assert only(file_checks.flat_fields(with_flat_fields(context, tmp_path, today))).level is Level.OK
    old = only(file_checks.flat_fields(with_flat_fields(context, tmp_path, "2020-01-01T00:00:00+00:00")))
    assert_problem(old, Level.WARNING, "days old and expire after 180")


def test_flat_fields_of_other_lights_than_those_of_the_rows_are_reported(context: CheckContext, tmp_path: Path) -> None:
    """The lights of a program, of the controller's order, and of the programs of board types."""
    lit = with_flat_fields(context, tmp_path, datetime.now(UTC).isoformat(), light="ring")
    assert only(file_checks.flat_fields(lit)).level is Level.OK
    lights = {name: LightConfig(channels=(0,), on_us=100.0) for name in ("ring", "left")}
    serial = changed(lit.config, "controller", backend="serial", lights=lights, order=("ring",))
    assert only(file_checks.flat_fields(with_config(lit, serial))).level is Level.OK
    turns = changed(serial, "controller", order=("ring", "left"))
    finding = only(file_checks.flat_fields(with_config(lit, turns)))
    assert_problem(finding, Level.FAULT, "have no field for the light 'left'")
    path = next(context.config.board_types.glob("*.json"))
    path.write_text(json.dumps(json.loads(path.read_text()) | {"program": [{"light": "left"}]}))
    unfit, fit = file_checks.flat_fields(lit)
    assert_problem(unfit, Level.WARNING, "board type", "have no field for the light 'left'")
    assert fit.level is Level.OK


def test_only_a_file_that_every_user_can_read_is_named(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.touch(0o600)
    secret.chmod(0o640)
    assert list(readable_by_others(secret, "the secret", "mes")) == []
    secret.chmod(0o644)
    finding = only(readable_by_others(secret, "the secret", "mes"))
    assert_problem(finding, Level.WARNING, "the secret", str(secret))
    assert finding.action == f"chmod o= {secret}"
    assert finding.code == "secret-not-private"


def with_certificate(context: CheckContext, made: Certificate) -> CheckContext:
    api = ApiConfig(certificate=made.certificate, private_key=made.private_key)
    return with_config(context, context.config.model_copy(update={"api": api}))


@pytest.mark.parametrize(("days", "level", "word"), [(400, Level.OK, "valid until"), (20, Level.WARNING, "refuse it")])
def test_the_end_of_a_certificate_is_announced(
    context: CheckContext, tmp_path: Path, days: int, level: Level, word: str
) -> None:
    finding = only(station_certificate(with_certificate(context, make_certificate(tmp_path, days=days))))
    assert finding.level is level
    assert word in finding.message
    assert finding.code == ("certificate-expires" if level is Level.WARNING else "")
    assert finding.figures["days"] == pytest.approx(days, abs=1)


def test_files_that_are_absent_or_do_not_fit_each_other_are_a_fault(context: CheckContext, tmp_path: Path) -> None:
    made = make_certificate(tmp_path)
    other = make_certificate(tmp_path, "other")
    for wrong in (
        Certificate(made.certificate, tmp_path / "absent.key"),
        Certificate(made.certificate, other.private_key),
        Certificate(made.private_key, made.private_key),
    ):
        finding = only(station_certificate(with_certificate(context, wrong)))
        assert_problem(finding, Level.FAULT, "[api] certificate", "cannot be used")
        assert finding.code == "certificate-unusable"


def test_a_key_that_the_service_cannot_read_is_a_fault(context: CheckContext, tmp_path: Path) -> None:
    made = make_certificate(tmp_path)
    made.private_key.chmod(0)
    with without_privileges():
        finding = only(station_certificate(with_certificate(context, made)))
    assert_problem(finding, Level.FAULT, "Permission denied")


def private(path: Path, text: str, mode: int = 0o600) -> Path:
    path.write_text(text)
    path.chmod(mode)
    return path

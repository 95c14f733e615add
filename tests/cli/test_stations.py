"""The commands on a station."""

from __future__ import annotations

import getpass
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from tests.board_data.readers import samples
from tests.cli.conftest import Result
from tests.transfer.conftest import Site, make_rig, site, store
from vaoi_station import doctor, station
from vaoi_station.cli import app
from vaoi_station.cli.options import credentials_of
from vaoi_station.config import read_config
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.doctor.finding import Finding, Report, fault, ok, warning
from vaoi_station.errors import InputError
from vaoi_station.files import open_recording, write_calibration
from vaoi_station.files.access_keys import AUDIT_FILE, KEY_FILE, KeyFile
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.store import Database


def test_the_key_comes_from_a_file_or_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "key").write_text("vaoi_1_a\n")
    monkeypatch.setenv("VAOI_KEY", "vaoi_2_b")
    assert credentials_of(tmp_path / "key", None).key == "vaoi_1_a"
    assert credentials_of(None, tmp_path).key == "vaoi_2_b"
    assert credentials_of(None, tmp_path).ca == tmp_path


def parameters(command: Any, name: str = "vaoi") -> Iterator[tuple[str, str]]:
    """Yield every command below this one, with the name of each of its parameters."""
    for parameter in command.params:
        yield name, parameter.name or ""
    for below, sub in getattr(command, "commands", {}).items():
        yield from parameters(sub, f"{name} {below}")


def test_no_option_takes_a_secret_itself() -> None:
    """All users of a machine can read the arguments of its processes."""
    words = ("key", "secret", "token", "password")
    named = [(c, p) for c, p in parameters(typer.main.get_command(app)) if any(w in p for w in words)]
    assert [(c, p) for c, p in named if not p.endswith("_file")] == []
    assert {c for c, _ in named} >= {"vaoi doctor", "vaoi bundle"}


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Any, ...]]:
    """Arguments with which the station was started."""
    calls: list[tuple[Any, ...]] = []
    monkeypatch.setattr(station, "serve", lambda *arguments: calls.append(arguments))
    monkeypatch.setattr("vaoi_station.runs.host.logs.configure_logging", lambda as_json: calls.append((as_json,)))
    return calls


def test_station_runs_with_configuration_port_and_log(
    vaoi: Callable[..., Result], served: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path)
    assert vaoi("serve", "--config", path, "--port", "0", "--log-json").code == 0
    (as_json,), (config, port, given) = served
    assert (as_json, port, config.name[:5], given) == (True, 0, "demo-", path)


def test_unsuitable_configuration_is_refused_before_the_start(
    vaoi: Callable[..., Result], served: list[tuple[Any, ...]], tmp_path: Path
) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path)
    path.write_text(path.read_text().replace("trigger_period_s = ", "trigger_period_s = 1"))
    done = vaoi("serve", "--config", path)
    assert done.code == 2
    assert "period_s is 10.11, but must be 0.11" in done.err
    assert served == []


SCENARIO = """
[array]
cameras = 1
width_px = 96
height_px = 72
px_per_mm = 4.0
[board]
width_mm = 20.0
length_mm = 20.0
density = 0.5
[line]
barrier_mm = -20.0
start_delay_s = 0.12
period_s = 0.05
tail_s = 0.2
longest_board_mm = 22.0
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    """A station of the tiny twin, as files."""
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    twin = Twin(read_scenario(tmp_path / "scenario.toml"))
    write_calibration(tmp_path / "calibration.json", twin.calibration)
    (tmp_path / "shm").mkdir()
    line = twin.line.model_dump(mode="json", exclude={"expected_board"}, exclude_none=True)
    keys = "\n".join(f"{key} = {json.dumps(value)}" for key, value in line.items())
    path = tmp_path / "station.toml"
    path.write_text(
        f"""name = "record"
calibration = "calibration.json"
board_types = "types"
data = "data"
[line]
{keys}
[[cameras]]
name = "c0"
width = 96
height = 72
exposure_us = 250
[simulation]
scenario = "scenario.toml"
interval_s = 0.01
[ring]
directory = "shm"
"""
    )
    return path


def test_one_run_is_written_to_the_directory_itself_and_never_overwrites(config: Path, tmp_path: Path) -> None:
    out = tmp_path / "one"
    arguments = ["record", "--config", str(config), "--out", str(out)]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    assert open_recording(out).head.rows > 1
    refused = CliRunner().invoke(app, arguments)
    assert isinstance(refused.exception, InputError)
    assert "exists already" in str(refused.exception)


def test_exit_code_and_text(vaoi: Callable[..., Result], tmp_path: Path) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path)
    (tmp_path / "data").mkdir()
    done = vaoi("check-config", path)
    assert (done.code, done.err) in {(0, ""), (1, "")}  # 1 where the machine has little space left
    path.write_text(path.read_text().replace("[line]", "colour = 1\n[line]\ntint = 2"))
    done = vaoi("check-config", path)
    assert done.code == 2
    assert "colour: is an unknown key" in done.out
    assert "line.tint: is an unknown key" in done.out
    assert "2 faults" in done.out


@pytest.mark.parametrize(
    ("finding", "code"),
    [(ok("fine"), 0), (warning("x", "slow", "Hurry."), 1), (fault("x", "broken", "Repair it."), 2)],
)
@pytest.mark.parametrize("as_json", [False, True])
def test_exit_code_and_output(
    vaoi: Callable[..., Result], monkeypatch: pytest.MonkeyPatch, finding: Finding, code: int, as_json: bool
) -> None:
    report = Report("s", "station.toml", "2026-01-01T00:00:00+00:00", "host", "1.0", None, (finding,))
    monkeypatch.setattr(doctor, "run_checks", lambda *_, **__: report)
    done = vaoi("doctor", *(["--json"] if as_json else []))
    assert (done.code, done.err) == (code, "")
    assert finding.message in done.out
    if as_json:
        assert json.loads(done.out) == report.document()


def test_a_bundle_is_written_once(vaoi: Callable[..., Result], tmp_path: Path) -> None:
    out = tmp_path / "s.tar.gz"
    done = vaoi("bundle", "--config", tmp_path / "none.toml", "--out", out)
    assert done.code == 0
    assert "without pictures, layouts and secrets" in done.out
    assert "station.toml: not available: " in done.err
    assert "there is no such file" in done.err
    assert out.stat().st_size > 500
    assert vaoi("bundle", "--config", tmp_path / "none.toml", "--out", out).code == 2


def test_a_station_is_backed_up_and_restored(vaoi: Callable[..., Result], tmp_path: Path) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path / "a")
    with path.open("a") as file:
        file.write('\n[api]\ncertificate = "station.toml"\nprivate_key = "station.key"\n')
    config = read_config(path)
    backup = tmp_path / "station.backup"
    refused = vaoi("backup", backup, "--config", path)
    assert refused.code == 2
    assert "does not exist" in refused.err
    Database(config.data / "station.db").close()
    KeyFile(config.data / KEY_FILE).create("tester-3", ["operate"])
    made = vaoi("backup", backup, "--config", path, "--recordings")
    assert made.code == 0
    assert f"{backup}: " in made.out
    assert vaoi("restore", backup, "--config", path).code == 2, "a station is there"
    restored = vaoi("restore", backup, "--config", tmp_path / "b" / "station.toml")
    assert restored.code == 2, "the paths of this station.toml are absolute"
    moved = tmp_path / "old"
    (tmp_path / "a").rename(moved)
    done = vaoi("restore", backup, "--config", path)
    assert done.code == 0
    assert f"not in the backup, put it back: {tmp_path / 'a' / 'station.key'} (api.private_key)" in done.out
    assert "valid key: tester-3 (operate), made " in done.out
    assert f"if it was revoked since: vaoi keys revoke tester-3 --config {path}" in done.out
    again = read_config(path)
    assert again == config
    assert again.simulation is not None
    assert read_scenario(again.simulation.scenario)
    assert (again.data / "station.db").is_file()


__all__ = ["make_rig", "site", "store"]


def test_a_run_is_exported_and_imported(vaoi: Callable[..., Result], site: Site, tmp_path: Path) -> None:
    out = tmp_path / "run.vaoi"
    for run, frames in ((site.sound, "without frames"), (site.degraded, "with frames")):
        done = vaoi("export", run, "--out", out, "--config", site.config)
        assert (done.code, done.out) == (0, f"{out}: run {run} {frames}\n")
        back = vaoi("import", out, "--out", tmp_path / run)
        assert back.code == 0
        assert f"run {run} of board type 'small'" in back.out
        out.unlink()
    assert vaoi("export", "unknown", "--out", out, "--config", site.config).code == 2
    assert vaoi("cut", tmp_path / site.degraded, "--result", tmp_path / site.degraded / "result.json",
                "--component", "U1", "--out", tmp_path / "cut").code == 0  # fmt: skip


def test_keys_are_made_listed_rotated_and_revoked(vaoi: Callable[..., Result], tmp_path: Path) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path)
    keys = KeyFile(read_config(path).data / KEY_FILE)
    made = vaoi("keys", "create", "tester", "--scope", "operate", "--scope", "teach", "--config", path)
    found = keys.find(made.out.strip())
    assert found is not None
    assert found.scopes == ("operate", "teach")
    listed = vaoi("keys", "list", "--config", path)
    assert "tester" in listed.out
    assert made.out.strip() not in listed.out
    rotated = vaoi("keys", "rotate", "tester", "--config", path)
    assert keys.find(rotated.out.strip()) is not None
    revoked = vaoi("keys", "revoke", "tester", "--config", path)
    assert (revoked.code, revoked.out) == (0, "Key 'tester' is revoked.\n")
    assert keys.entries() == ()
    none = vaoi("keys", "list", "--config", path)
    assert (none.code, none.out) == (0, "")
    assert "There is no key" in none.err
    text = (keys.path.parent / AUDIT_FILE).read_text()
    entries = [json.loads(line) for line in text.splitlines()]
    assert [entry["path"] for entry in entries] == ["keys create tester", "keys rotate tester", "keys revoke tester"]
    assert entries[0].items() >= {"user": getpass.getuser(), "method": "vaoi", "query": "operate,teach"}.items()
    assert made.out.strip() not in text
    assert vaoi("keys", "revoke", "tester", "--config", path).code == 2


Vaoi = Callable[..., Result]


@pytest.fixture
def board(tmp_path: Path) -> Path:
    path = tmp_path / "b.kicad_pcb"
    path.write_text(samples.KICAD)
    return path


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--side", "left"], "the side is 'left', but must be top or bottom"),
        (["--units", "cm"], "the unit is 'cm'"),
        (["--format", "odb"], "is no readable folder, zip or tar file"),
        (
            ["--repeat", "2x2"],
            "--repeat 2x2 needs --pitch, two lengths in mm such as 30x28.5, from board to board along x",
        ),
    ],
)
def test_wrong_options_are_refused(vaoi: Vaoi, board: Path, tmp_path: Path, options: list[str], message: str) -> None:
    done = vaoi("import", str(board), "--out", str(tmp_path / "x.json"), *options)
    assert (done.code, message in done.err) == (2, True), done.err
    assert not (tmp_path / "x.json").exists()

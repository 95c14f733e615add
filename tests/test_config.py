from __future__ import annotations

import re
from pathlib import Path

import pytest

from vaoi_station.config import read_config
from vaoi_station.errors import InputError
from vaoi_station.line_config import Line

VALID = """
name = "line 3"
calibration = "calibration.json"
board_types = "boards"
data = "/var/lib/vaoi"
workers = 2

[line]
conveyor_mm_s = [0.0, 100.0]
barrier_mm = -40.0
start_delay_s = 0.3
trigger_period_s = 0.125
tail_s = 0.6
longest_board_mm = 474
debounce_s = 0.005

[line.expected_board]
rail_mm = -12.5
rotation_deg = 90
tolerance_mm = 3.0

[[cameras]]
name = "left"
width = 1392
height = 1040
exposure_us = 250.0

[[cameras]]
name = "right"
width = 1392
height = 1040
exposure_us = 250
pixel_format = "Mono16"

[controller]
backend = "simulated"

[simulation]
scenario = "scenario.toml"
boards = 0

[ring]
runs = 3
spare_rows = 2

[api]
host = "127.0.0.1"
port = 8350
"""


def config_file(directory: Path, *changes: tuple[str, str]) -> Path:
    text = VALID
    for old, new in changes:
        assert old in text, f"the valid file has no {old!r}"
        text = text.replace(old, new)
    path = directory / "station.toml"
    path.write_text(text)
    return path


def test_valid_file_is_read_completely(tmp_path: Path) -> None:
    station = read_config(config_file(tmp_path))
    assert station.name == "line 3"
    assert station.line.speed_mm_s == 100
    assert station.line.expected_board.rotation_deg == 90
    assert [c.name for c in station.cameras] == ["left", "right"]
    assert [c.frame_bytes for c in station.cameras] == [1392 * 1040, 2 * 1392 * 1040]
    assert station.ring.lease_s == 600


def test_relative_paths_are_relative_to_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "etc").mkdir()
    (tmp_path / "elsewhere").mkdir()
    path = config_file(tmp_path / "etc")
    monkeypatch.chdir(tmp_path / "elsewhere")
    station = read_config(Path("../etc") / path.name)
    assert station.calibration == tmp_path / "etc" / "calibration.json"
    assert station.simulation is not None
    assert station.simulation.scenario == tmp_path / "etc" / "scenario.toml"
    assert station.data == Path("/var/lib/vaoi")
    assert station.ring.directory == Path("/dev/shm")


def test_real_cameras_need_the_real_controller(tmp_path: Path) -> None:
    """Lights are used in the order of the file, if none is given."""
    real = (
        ('exposure_us = 250.0\n', 'exposure_us = 250.0\nbackend = "aravis"\nserial = "A17"\n'),
        ('pixel_format = "Mono16"', 'backend = "aravis"\naddress = "10.0.0.7"\nreadout_us = 8000.0'),
        ('[controller]\nbackend = "simulated"', '[controller]\nbackend = "serial"\nport = "/dev/ttyUSB3"\n'
         'lights.top = {channels = [0, 1], on_us = 300.0}\nlights.low = {channels = [2], on_us = 200.0}'),
    )  # fmt: skip
    station = read_config(config_file(tmp_path, *real))
    assert station.controller.port == "/dev/ttyUSB3"
    assert station.controller.lights["top"].channels == (0, 1)
    assert station.controller.light_sequence == ("top", "low")
    assert station.cameras[1].readout_us == 8000.0
    assert [camera.head.serial for camera in station.cameras] == ["A17", None]
    assert station.known_lights == ("top", "low")
    ordered = (("lights.top =", 'order = ["low", "top", "low"]\nlights.top ='),)
    assert read_config(config_file(tmp_path, *real, *ordered)).controller.light_sequence == ("low", "top", "low")


def test_rows_of_the_longest_board(tmp_path: Path) -> None:
    """474 mm at 100 mm/s and 0.6 s of tail end 5.34 s after the barrier; pulses begin at 0.3 s."""
    station = read_config(config_file(tmp_path))
    assert station.line.passing_s == pytest.approx(5.34)
    assert station.line.rows_of_longest_board == 1 + 41
    assert station.rows_per_run == 44


@pytest.mark.parametrize(("delay", "rows"), [(0.0, 1 + 5), (0.45, 1 + 1), (0.4, 1 + 1), (0.3999, 1 + 2), (0.5, 1)])
def test_every_pulse_of_the_longest_board_has_a_slot(delay: float, rows: int) -> None:
    line = Line(
        conveyor_mm_s=(0.0, -100.0), barrier_mm=0.0, start_delay_s=delay, trigger_period_s=0.1, tail_s=0.1,
        longest_board_mm=40.0,
    )  # fmt: skip
    fired = sum(delay + k * 0.1 <= 0.5 + 1e-9 for k in range(20))
    assert fired <= line.rows_of_longest_board == rows


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ('name = "line 3"', 'name = "line 3"\ncolour = 1', r"colour: is an unknown key \(given: 1\)"),
        ("tail_s = 0.6", "tail_s = 0.6\ntial_s = 0.7", r"line\.tial_s: is an unknown key"),
        ("workers = 2", "workers = 0", r"workers: .*greater than or equal to 1 \(given: 0\)"),
        ('calibration = "calibration.json"', "", "calibration: Field required"),
        ("conveyor_mm_s = [0.0, 100.0]", "conveyor_mm_s = [0, 0]", r"line: conveyor_mm_s is \[0, 0\], but must"),
        ("conveyor_mm_s = [0.0, 100.0]", "conveyor_mm_s = [nan, 1]", r"line\.conveyor_mm_s\.0: .*finite"),
        ("start_delay_s = 0.3", "start_delay_s = 9", r"line: start_delay_s is 9\.0, but the longest .* 5\.340 s"),
        ("debounce_s = 0.005", "debounce_s = inf", r"line\.debounce_s: .*finite"),
        ("rail_mm = -12.5", "rail_mm = 1\ncenter_mm = 2", r"line\.expected_board: rail_mm and center_mm exclude"),
        ('name = "right"', 'name = "left"', r"cameras have the names \['left', 'left'\]; they must differ"),
        ('name = "right"\nwidth = 1392', 'name = "right"\nwidth = 8', r"cameras\.1\.width: .*16 \(given: 8\)"),
        ("exposure_us = 250.0", "exposure_us = 125000.0", r"camera 'left' exposes 125000\.0 us, .*every 125000 us"),
        ('"Mono16"', '"Mono12"', r"cameras\.1: .*sends Mono8 or Mono16 only"),
        ('"Mono16"', '"Mono8"\nbackend = "replay"', r"cameras with backend 'simulated', but there are \['replay'\]"),
        ('oller]\nbackend = "simulated"', 'oller]\nbackend = "serial"', r"fires cameras with backend 'aravis'"),
        ('"simulated"\n', '"simulated"\norder = ["top"]\n', r"order names the lights \['top'\], but there are \[\]"),
        ("[simulation]\nscenario = \"scenario.toml\"\nboards = 0", "", r"'simulated' needs a table \[simulation\]"),
        ('"simulated"\n', '"simulated"\ntrigger_us = 1e9\n', r"controller\.trigger_us: .*equal to 2000"),
        ("runs = 3", "runs = 1", r"ring\.runs: .*equal to 2 \(given: 1\)"),
        ("[line]", "[line", "not valid TOML"),
    ],
)  # fmt: skip
def test_impossible_values_are_refused_with_file_key_value_and_limit(
    tmp_path: Path, old: str, new: str, complaint: str
) -> None:
    path = config_file(tmp_path, (old, new))
    with pytest.raises(InputError) as refused:
        read_config(path)
    assert str(refused.value).startswith(str(path))
    assert re.search(complaint, str(refused.value))

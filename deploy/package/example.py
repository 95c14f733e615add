"""Write the files of the station with which the package begins: the example configuration on the twin.

python3 deploy/package/example.py DIRECTORY
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from vaoi_station.config import read_config
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.simulation import Twin, read_scenario, scenario_path

STATE = "/var/lib/vaoi-station"
DOCUMENTS = "/usr/share/doc/vaoi-station/docs"
DEPLOY = Path(__file__).resolve().parents[1]


def write_example(folder: Path) -> None:
    """Write station.toml, scenario.toml, calibration.json and board-types/ into a new directory."""
    folder.mkdir(parents=True)
    scenario = scenario_path("demo")
    twin = Twin(read_scenario(scenario))
    shutil.copyfile(scenario, folder / "scenario.toml")
    write_calibration(folder / "calibration.json", twin.calibration)
    (folder / "board-types").mkdir()
    write_board_type(folder / "board-types" / f"{twin.board_type.name}.json", twin.board_type)
    text = (DEPLOY / "station.toml").read_text(encoding="utf-8")
    # What the service writes lies below its state directory, the only one that the unit lets it write to.
    for key, name in (("board_types", "board-types"), ("data", "data")):
        assert f'{key} = "{name}"' in text
        text = text.replace(f'{key} = "{name}"', f'{key} = "{STATE}/{name}"')
    text = f"# What is called docs/ here and in messages is {DOCUMENTS}.\n{text}"
    (folder / "station.toml").write_text(text, encoding="utf-8")
    read_config(folder / "station.toml")


if __name__ == "__main__":
    write_example(Path(sys.argv[1]))

"""Write the files of the station with which the package begins, the example on the twin, and that of the paper.

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
    """Write both configurations, scenario.toml, calibration-twin.json and board-types/ into a new directory.

    The twin's calibration has a name of its own, which no station.toml of a real line has.
    """
    folder.mkdir(parents=True)
    scenario = scenario_path("demo")
    twin = Twin(read_scenario(scenario))
    shutil.copyfile(scenario, folder / "scenario.toml")
    write_calibration(folder / "calibration-twin.json", twin.calibration)
    (folder / "board-types").mkdir()
    write_board_type(folder / "board-types" / f"{twin.board_type.name}.json", twin.board_type)
    for name in ("station.toml", "station-paper.toml"):
        text = (DEPLOY / name).read_text(encoding="utf-8")
        # What the service writes lies below its state directory, the only one that the unit lets it write to.
        for key, at in (("board_types", "board-types"), ("data", "data")):
            text = _replaced(text, f'{key} = "{at}"', f'{key} = "{STATE}/{at}"')
        if name == "station.toml":
            text = _replaced(text, '"calibration.json"', '"calibration-twin.json"')
        (folder / name).write_text(
            f"# What is called docs/ here and in messages is {DOCUMENTS}.\n{text}", encoding="utf-8"
        )
        read_config(folder / name)


def _replaced(text: str, old: str, new: str) -> str:
    assert old in text
    return text.replace(old, new)


if __name__ == "__main__":
    write_example(Path(sys.argv[1]))

"""One board with its output directory and pictures, and board after board."""

from __future__ import annotations

import io
import json
import socket
import zipfile
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from vaoi_station.config import ApiConfig
from vaoi_station.demo import boards
from vaoi_station.demo.boards import PICTURES, REPORT, SHEET, fetch_component_images, prepare_output
from vaoi_station.demo.client import Client
from vaoi_station.errors import DeviceError, InputError
from vaoi_station.files.contact_sheet import contact_sheet
from vaoi_station.files.images import encode_png, read_image
from vaoi_station.model import BoardType, Status
from vaoi_station.simulation import scenario_path

VIEWS = [{"k": k, "camera": 1, "row": 3 + k} for k in range(2)]
RUN = {"id": "r1", "verdict": "ok"}
BOARD = BoardType.model_validate(
    {
        "name": "b",
        "components": [
            {"ref": "U1", "panel": "2", "center": (1, 1), "width": 1, "height": 1},
            {"ref": "R1", "center": (4, 1), "width": 1, "height": 1},
        ],
    }
)


class Station(Client):
    """Client with two scripted components; the first has no view, the second two. The batch has them in this order."""

    end: ClassVar[dict[str, Any]] = {"complete": True}

    def __init__(self) -> None:
        super().__init__("http://station")

    def content(self, path: str, **query: Any) -> bytes:
        assert (path, query) == ("/runs/r1/images", {"container": "zip"})
        files, shown = io.BytesIO(), [{**view, "file": f"components/2/U1/{view['k']}.png"} for view in VIEWS]
        with zipfile.ZipFile(files, "w") as made:
            made.writestr("run.json", json.dumps(RUN))
            made.writestr("components/R1/views.json", json.dumps({"address": "R1", "views": []}))
            made.writestr("components/2/U1/views.json", json.dumps({"address": "2/U1", "views": shown}))
            for view in shown:
                made.writestr(str(view["file"]), encode_png(np.full((4, 6), int(str(view["k"])) + 1, np.uint8)))
            made.writestr("end.json", json.dumps(self.end))
        return files.getvalue()


def test_images_and_matrices_are_written_per_component_and_the_best_is_shown(tmp_path: Path) -> None:
    (first, second), pictures = fetch_component_images(Station(), RUN, BOARD, tmp_path)
    assert pictures == 2
    assert first.picture is not None
    assert int(first.picture[0, 0]) == 1
    assert second.picture is None
    assert sorted(p.name for p in tmp_path.iterdir()) == ["2_U1", "R1"]
    assert sorted(p.name for p in (tmp_path / "2_U1").glob("*.png")) == ["00_c01_r003.png", "01_c01_r004.png"]
    assert json.loads((tmp_path / "2_U1" / "views.json").read_text()) == VIEWS
    assert json.loads((tmp_path / "R1" / "views.json").read_text()) == []


def test_an_incomplete_answer_of_the_station_ends_the_demo(tmp_path: Path) -> None:
    class Released(Station):
        end: ClassVar = {"complete": False, "error": {"message": "The frames are released.", "action": "Hold the run."}}

    with pytest.raises(DeviceError, match="released") as refusal:
        fetch_component_images(Released(), RUN, BOARD, tmp_path)
    assert refusal.value.action == "Hold the run."


def test_only_the_output_of_an_earlier_demo_is_deleted(tmp_path: Path) -> None:
    prepare_output(tmp_path / "new")
    (tmp_path / PICTURES / "U1").mkdir(parents=True)
    with pytest.raises(InputError, match="holds files that no demo has written") as refusal:
        prepare_output(tmp_path)
    assert "another --out" in refusal.value.action
    for name in (REPORT, SHEET, "mine.txt"):
        (tmp_path / name).write_text("x")
    prepare_output(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_the_picture_of_the_readme_is_a_small_contact_sheet() -> None:
    path = Path(__file__).resolve().parents[2] / "docs" / "pictures" / SHEET
    assert path.stat().st_size <= 400_000
    assert read_image(path).shape[1] == contact_sheet([], "demo", Status.OK, []).shape[1]
    assert f"docs/pictures/{SHEET}" in (path.parents[2] / "README.md").read_text(encoding="utf-8")


def test_a_port_in_use_is_refused_before_the_board_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """A random port in its place would leave callers of the documented port with another station."""
    said: list[str] = []
    with socket.create_server(("127.0.0.1", 0)) as other:
        taken = other.getsockname()[1]
        monkeypatch.setattr(boards, "ApiConfig", lambda: ApiConfig(port=taken))
        for port in (None, taken):
            with pytest.raises(DeviceError, match=f"port {taken} .*--port 0"):
                boards.run_continuously(scenario_path("small"), port, said.append)
    assert said == []

"""The commands of the documents run as they are printed, page by page, on the simulated station.

Each page has a folder of its own with the files that it names, and a shell. `vaoi` runs in this process, which costs
no start. What cannot run here stands in `NOT_RUN` with the reason, pages that other tests run in `ELSEWHERE`; that
the commands and options of those exist is checked by tests/project/test_blocks.py.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
from typer.testing import CliRunner

from tests.blocks import ROOT, blocks
from tests.board_data.readers import samples
from tests.board_data.test_net_points import PLACES as PLACES_OF_PARTS
from tests.board_data.test_net_points import kicad
from tests.photometry import white_recordings
from vaoi_station.cli import app
from vaoi_station.config import read_config
from vaoi_station.demo.station_files import to_toml, write_station_files
from vaoi_station.files.documents import read_json, write_json
from vaoi_station.simulation import scenario_path
from vaoi_station.store import Database

ELSEWHERE = {
    "docs/CONTRIBUTING.md": "tests/project/test_documents.py",
    "docs/first-board.md": "tests/api/clients/test_first_board.py",
    "docs/line.md": "tests/cli/test_line.py",
    "docs/rest.md": "tests/system/test_demo.py",
    "docs/tutorials/demo.md": "tests/system/test_demo.py",
    "docs/how-to/rig.md": "tests/system/test_rig.py",
    "docs/how-to/swapping.md": "tests/cli/test_cameras.py",
}
"""Pages whose commands another test runs."""
NOT_RUN = {
    r"(apt|dpkg|pip|python3 -m venv|\S*pip-audit|\.ci/run|tests/|deploy/build|pip)\b": "installs, or runs all tests",
    r"(install|ln|sed|chgrp|udevadm|sysctl|ip|nginx|systemd-\S+|journalctl|curl)\b": "is about the machine",
    r"make\b|hw/firmware/|python3 deploy/": "builds the firmware or the package: tests/hw and tests/deploy do",
    r"(api|at\(\)|show)\b|get ": "talks to a running station: tests/system/test_demo.py runs this search",
    r"vaoi serve": "does not end",
    r"vaoi doctor .*--toggle": "needs a controller",
    r"vaoi record": "needs acquisition: tests/cli/test_stations.py films",
    r"vaoi calibrate ": "needs a filmed board of marks: tests/cli/test_calibrating.py has one",
    r"vaoi recalibrate": "needs boards with a camera that has moved: tests/cli/test_calibrating.py has them",
    r"vaoi (export|import) .*(run\.vaoi|--config)": "needs a run in the history: tests/cli/test_stations.py has one",
    r"vaoi import product.cad": "needs a GenCAD file with its netlist: tests/board_data/test_net_points.py has one",
    r"vaoi restitch|vaoi dataset s3": "needs a cluster: tests/plant has one",
}
"""Commands, by how they begin, that cannot run here, and why."""
PLACES = r"((?:/etc/vaoi-station|/var/lib/vaoi-station|/media/usb|/mnt|/root|/archives)\b)"
"""Folders of the machine that documents name; each page has them below its own folder."""
PREFIX = r"(?:runuser -u vaoi -- )?"
SHELL = """
vaoi() { printf '%s\\0' "$PWD" "$@" > "$HERE/ask"; read -r code < "$HERE/code"; cat "$HERE/out"; return "$code"; }
python3() { "$PYTHON" "$@"; }
runuser() { shift 3; "$@"; }
systemctl() { :; }
trap ': > "$HERE/ask"' EXIT
set -eu
"""
WARNS = frozenset({"check-config", "doctor"})
"""Commands that end with 1 or 2 for what they find on this machine."""


def scripts() -> dict[str, list[tuple[str, list[str], str]]]:
    """Return the blocks of each page that has commands to run here: place, commands, output that is shown."""
    found: dict[str, list[tuple[str, list[str], str]]] = {}
    seen: set[str] = set()
    for block in blocks():
        if block.language in {"sh", "console"} and block.page not in ELSEWHERE:
            kept = [c for c in block.commands() if not any(re.match(PREFIX + p, c) for p in NOT_RUN) and c not in seen]
            seen.update(c for c in kept if re.match("vaoi (doctor|import) ", c))  # nothing after them needs these twice
            if kept:
                found.setdefault(block.page, []).append((str(block), kept, block.output()))
    return found


SCRIPTS = scripts()


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Files by the names that the documents give them."""
    folder, films = tmp_path_factory.mktemp("stock"), tmp_path_factory.mktemp("films")

    def vaoi(*words: str | Path) -> None:
        done = CliRunner().invoke(app, [str(word) for word in words])
        assert done.exit_code == 0, done.output

    vaoi("simulate", "light", "--out", films / "light")
    (folder / "recordings").mkdir()
    for name in ("CASE", "RUN", "NEXT", "recordings/1"):
        (folder / name).symlink_to(films / "light")
    for name in ("DIR1", "DIR2"):
        (folder / name).symlink_to(shutil.copytree(films / "light", films / name))
    board = read_json(folder / "CASE" / "board.json")
    board["identity"] = {
        "places": [{"center": [30.0, 20.0], "width": 4.0, "height": 4.0}]
    }  # not anywhere: that takes long
    write_json(folder / "CASE" / "board.json", board)
    vaoi("stitch", folder / "CASE", "--out", folder / "result.json")
    for component in board["components"]:
        component["center"][0] += 0.5  # what the check of board data corrects
    write_json(folder / "board.json", board)
    lights = read_json(folder / "CASE" / "recording.json")["lights"]
    white_recordings.film(
        folder / "WHITE", white_recordings.white(180), lights=sorted(set(lights)), rows=12, size=(640, 480)
    )
    white_recordings.film(folder / "DARK", white_recordings.white(0), size=(640, 480))
    vaoi("flatfield", folder / "WHITE", "--dark", folder / "DARK", "--out", folder / "DIR")
    (folder / "product.kicad_pcb").write_text(kicad(), encoding="utf-8")
    mil = [f"{ref}\tR_0805\t{x / 0.0254:.1f}\t{y / 0.0254:.1f}\t0\tT" for ref, (x, y) in PLACES_OF_PARTS.items()]
    placement = "\n".join(["Units: mil", "Ref\tPackage\tX\tY\tRot\tLayer", *mil, ""])
    (folder / "placement.txt").write_text(placement, encoding="utf-8")
    (folder / "placement.csv").write_text(
        "Ref,Package,Mid X,Mid Y,Rot,Layer\nR1,R_0603,10mm,10mm,90,top\n", encoding="utf-8"
    )
    (folder / "panel.zip").write_bytes(samples.odb_zip(samples.ODB | samples.ODB_PANEL))
    (folder / "board-film").mkdir()
    vaoi("archive", "create", folder / "archives" / "plant")
    vaoi("archive", "add", folder / "archives" / "plant", folder / "recordings" / "1", "--station", "line 1")
    (folder / "media/usb").mkdir(parents=True)
    (folder / "root").mkdir()
    (folder / "mnt").mkdir()
    return folder


def lay_out(page: str, folder: Path, stock: Path) -> None:
    """Put the files of the stock and a station that is not running into the folder of a page."""
    shutil.copytree(stock, folder, symlinks=True)
    etc, var = folder / "etc" / "vaoi-station", folder / "var" / "lib" / "vaoi-station"
    path, _ = write_station_files(scenario_path("small"), etc)
    config = read_config(path).model_copy(update={"data": var / "data", "board_types": var / "board-types"})
    shutil.move(etc / "board-types", var / "board-types")
    Database(var / "data" / "station.db").close()
    (var / "before-upgrade").mkdir()
    shutil.copy(var / "data" / "station.db", var / "before-upgrade")
    path.write_text(to_toml(config), encoding="utf-8")
    for name in ("station.toml", "FILE"):
        shutil.copy(path, folder / name)
    if page == "docs/configuration.md":
        (folder / "deploy").mkdir()
        shutil.copy(ROOT / "deploy" / "station.toml", folder / "deploy")


class Session:
    """A shell in the folder of a page, whose `vaoi` is served by this process."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._own = folder.with_name("session")

    def perform(self, commands: Sequence[str]) -> tuple[int, str]:
        """Perform commands; return the exit code, and what was printed."""
        script = "\n".join(commands)
        assert re.findall(rf"(?<![\w/.:])(?!{PLACES})/(?!CN=)\w+", script) == [], "a place of this machine"
        script = re.sub(rf"(?<![\w/.:]){PLACES}", rf"{self.folder}\1", script)
        self._own.mkdir(exist_ok=True)
        pipes = tuple(self._own / name for name in ("ask", "code"))
        for pipe in pipes:
            os.mkfifo(pipe)
        printed = self._own / "printed"
        with printed.open("wb") as output:
            environment = os.environ | {"HERE": str(self._own), "PYTHON": sys.executable}
            shell = subprocess.Popen(
                ["bash", "-c", SHELL + script], cwd=self.folder, env=environment, stdout=output, stderr=output
            )
            while words := pipes[0].read_text(encoding="utf-8").split("\0")[:-1]:
                pipes[1].write_text(f"{self._vaoi(Path(words[0]), words[1:])}\n")
            code = shell.wait()
        for pipe in pipes:
            pipe.unlink()
        return code, printed.read_text(encoding="utf-8")

    def _vaoi(self, place: Path, words: list[str]) -> int:
        if "--out" in words:
            # The lines of a block may be alternatives that write the same file, or one that other pages read.
            out = place / words[words.index("--out") + 1]
            if out.is_dir():
                shutil.rmtree(out)
            out.unlink(missing_ok=True)
        before = Path.cwd()
        os.chdir(place)
        try:
            done = CliRunner().invoke(app, words)
        finally:
            os.chdir(before)
        error = "" if done.exception is None or isinstance(done.exception, SystemExit) else f"{done.exception!r}\n"
        (self._own / "out").write_text(done.stdout + error, encoding="utf-8")
        return 0 if words[0] in WARNS and not error else done.exit_code


@pytest.mark.parametrize("page", SCRIPTS)
def test_the_commands_of_a_page_run_and_print_what_it_shows(page: str, stock: Path, tmp_path: Path) -> None:
    folder = tmp_path / "page"
    lay_out(page, folder, stock)
    session = Session(folder)
    for place, commands, shown in SCRIPTS[page]:
        code, printed = session.perform(commands)
        assert code == 0, f"{place}: {printed}"
        # A line with … stands for any lines.
        parts = [re.escape(part.strip("\n")) for part in re.split(r"^…$", shown, flags=re.MULTILINE)]
        assert re.search("(?:.|\n)*".join(parts), printed), f"{place} shows other lines than\n{printed}"


def test_every_exception_is_needed() -> None:
    commands = [c for block in blocks() if block.language in {"sh", "console"} for c in block.commands()]
    assert [p for p in NOT_RUN if not any(re.match(PREFIX + p, c) for c in commands)] == []
    for page, test in ELSEWHERE.items():
        assert any(block.page == page for block in blocks()), page
        assert (ROOT / test).is_file(), test

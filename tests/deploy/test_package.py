"""What the Debian package is made of: requirements, pages of the command line, example, scripts of dpkg."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

from tests.api.proxy.nginx import FRAME, shipped_site
from tests.needs import need, program
from tests.peers.certificates import make_certificate
from vaoi_station.config import read_config
from vaoi_station.files.caller_credentials import CA_VARIABLE, KEY_FILE_VARIABLE, KEY_VARIABLE

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "deploy" / "package"
BUILD = (ROOT / "deploy" / "build").read_text(encoding="utf-8")


def module(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"deploy_{name}", PACKAGE / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def test_what_the_scripts_import_exists() -> None:
    """An import that fails in a script of dpkg shows only as a slower first start."""
    found = re.findall(r"from (vaoi_station[\w.]*) import (\w+)", (PACKAGE / "postinst").read_text(encoding="utf-8"))
    assert found
    assert all(hasattr(importlib.import_module(path), name) for path, name in found)


def test_requirements_are_those_of_run_time_with_hashes() -> None:
    text = module("requirements").at_run_time((ROOT / "constraints.txt").read_text(encoding="utf-8"))
    names = re.findall(r"^([\w.-]+)==", text, re.MULTILINE)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    direct = {re.split(r"[<>=]", requirement)[0] for requirement in project["project"]["dependencies"]}
    tools = {re.split(r"[<>=]", requirement)[0] for requirement in project["dependency-groups"]["dev"]}
    assert direct <= set(names)
    assert tools & set(names) == set()
    assert {"llvmlite", "starlette", "pydantic-core"} <= set(names), "what they require"
    assert names.count("numpy") == 2, "one for each release's Python"
    for entry in re.split(r"^(?=[\w.-]+==)", text, flags=re.MULTILINE)[1:]:
        assert "--hash=sha256:" in entry
        assert not entry.rstrip().endswith("\\"), "pip would join the next entry"


def test_pages_name_every_command_and_option(tmp_path: Path) -> None:
    pages = module("command_pages")
    page, completion = pages.man_page(), pages.completion()
    for command in ("serve", "check-config", "doctor", "rig run", "rig up"):
        assert f".SS vaoi {command}".replace("-", r"\-") in page
        assert f'"{command}") options=' in completion
    assert not [line for line in page.splitlines() if line.startswith("'")]
    for variable in ("VAOI_STATION", KEY_FILE_VARIABLE, KEY_VARIABLE, CA_VARIABLE):
        assert variable in page.partition(".SH ENVIRONMENT")[2]
    (tmp_path / "vaoi").write_text(completion)
    ask = f'source {tmp_path}/vaoi; COMP_WORDS=(vaoi $1 $2); COMP_CWORD=$#; _vaoi; echo "${{COMPREPLY[@]}}"'
    for words, expected in ((("check-c",), "check-config"), (("rig", "u"), "up"), (("serve", "--lo"), "--log-json")):
        done = subprocess.run(["bash", "-c", ask, "bash", *words], capture_output=True, text=True, check=True)
        assert done.stdout.split() == [expected]


@pytest.mark.parametrize("script", ["preinst", "postinst", "prerm", "postrm"])
def test_scripts_of_dpkg_are_those_of_a_posix_shell(script: str) -> None:
    path = PACKAGE / script
    assert path.read_text(encoding="utf-8").startswith("#!/bin/sh\n")
    assert "\nset -e\n" in path.read_text(encoding="utf-8")
    subprocess.run(["sh", "-n", str(path)], check=True)
    assert path.stat().st_mode & 0o111


def test_a_real_line_never_takes_the_calibration_of_the_twin(tmp_path: Path) -> None:
    module("example").write_example(tmp_path / "example")
    twin, paper = (read_config(tmp_path / "example" / name) for name in ("station.toml", "station-paper.toml"))
    assert twin.calibration.is_file()
    assert twin.calibration.name in (PACKAGE / "postinst").read_text(encoding="utf-8")
    assert not paper.calibration.exists()
    # The service may write nowhere else.
    assert {twin.data, twin.board_types, paper.data, paper.board_types} == {
        Path("/var/lib/vaoi-station/data"), Path("/var/lib/vaoi-station/board-types"),
    }  # fmt: skip


class Machine:
    """A directory that stands for a machine with the package: scripts of dpkg run with its paths, tools only log."""

    TOOLS = ("systemctl", "systemd-sysusers", "systemd-tmpfiles", "runuser", "udevadm", "sysctl", "df",
             "deb-systemd-helper", "deb-systemd-invoke")  # fmt: skip

    def __init__(self, root: Path) -> None:
        self.root, self.log = root, root / "log"
        self.home, self.data = root / "opt/vaoi-station", root / "var/lib/vaoi-station/data"
        for folder in (root / "bin", root / "run/systemd/system", self.home / "venv/bin", self.data):
            folder.mkdir(parents=True)
        (self.home / "venv/version").write_text("old")
        (self.data / "station.db").write_bytes(bytes(100_000))
        for path in ("etc/vaoi-station/station.toml", "usr/share/vaoi-station/example/board-types/x.json"):
            (root / path).parent.mkdir(parents=True)
            (root / path).touch()
        self.free_kb, self.starts = 10**9, True
        for tool in self.TOOLS:
            self.script(root / "bin" / tool, f'echo "{tool} $*" >> "{self.log}"')
        self.script(root / "bin/install", "true")
        self.script(self.home / "venv/bin/python3", "true")

    def script(self, path: Path, text: str) -> None:
        path.write_text(f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)

    def run(self, name: str, *arguments: str) -> bool:
        self.script(self.root / "bin/df", f"echo Avail; echo {self.free_kb}")
        refused = "" if self.starts else '[ "$1" != start ] || exit 1'
        self.script(self.root / "bin/systemctl", f'echo "systemctl $*" >> "{self.log}"\n{refused}')
        text = re.sub(
            r"/(opt|var|etc|usr/share|usr/lib|run)/", rf"{self.root}/\1/", (PACKAGE / name).read_text("utf-8")
        )
        self.script(self.root / name, text.removeprefix("#!/bin/sh\n"))
        environment = {"PATH": f"{self.root}/bin:/usr/bin:/bin"}
        return subprocess.run([self.root / name, *arguments], check=False, env=environment).returncode == 0

    def unpack(self, version: str) -> None:
        """Replace the program as dpkg does, by renaming."""
        (self.home / "new").write_text(version)
        (self.home / "new").rename(self.home / "venv/version")

    @property
    def version(self) -> str:
        return (self.home / "venv/version").read_text()

    def commands(self) -> list[str]:
        """Return what systemd was asked for since the last call, without questions."""
        lines = self.log.read_text().splitlines() if self.log.exists() else []
        self.log.unlink(missing_ok=True)
        return [
            words[1] for words in map(str.split, lines) if words[0] == "systemctl" and words[1] in ("stop", "start")
        ]


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_an_upgrade_without_room_for_the_copy_does_not_stop_the_station(machine: Machine) -> None:
    machine.free_kb = 50_000
    assert not machine.run("preinst", "upgrade", "1.0", "2.0")
    assert machine.commands() == []


@pytest.mark.parametrize(("script", "arguments"), [("postrm", ("1.0", "2.0")), ("postinst", ("2.0",))])
def test_an_upgrade_that_is_given_up_starts_the_station_again(
    machine: Machine, script: str, arguments: tuple[str, ...]
) -> None:
    assert machine.run("preinst", "upgrade", "1.0", "2.0")
    assert machine.commands() == ["stop"]
    assert machine.run(script, "abort-upgrade", *arguments)
    assert machine.commands() == ["start"]
    assert not (machine.home / "previous").exists()


def test_a_version_that_was_replaced_by_the_one_before_is_never_called_installed(machine: Machine) -> None:
    assert machine.run("preinst", "upgrade", "1.0", "2.0")
    machine.unpack("new")
    machine.starts = False
    assert not machine.run("postinst", "configure", "1.0")
    machine.starts = True
    assert machine.version == "old"
    assert not machine.run("postinst", "configure", "1.0"), "as apt tries with the next package"
    assert machine.run("preinst", "upgrade", "2.0", "3.0")
    machine.unpack("newer")
    assert machine.run("postinst", "configure", "2.0")
    assert machine.version == "newer"


def test_every_file_that_the_build_installs_exists() -> None:
    subprocess.run(["bash", "-n", str(ROOT / "deploy" / "build")], check=True)
    sources = re.findall(r"^  put ((?:deploy|docs|LICENSE)\S*) ", BUILD, re.MULTILINE)
    assert len(sources) > 8
    assert [source for source in sources if not (ROOT / source).is_file()] == []
    named = {*sources, *re.findall(r"deploy/package/[\w.-]+", BUILD)}
    scripts = {"preinst", "postinst", "prerm", "postrm"}
    assert {p.name for p in PACKAGE.iterdir() if p.is_file()} - scripts <= {Path(name).name for name in named}


def test_the_site_of_nginx_is_shipped_and_one_that_nginx_accepts(tmp_path: Path) -> None:
    need("nginx")
    assert "put deploy/nginx.conf /usr/share/vaoi-station/nginx.conf" in BUILD
    site = shipped_site(8443, make_certificate(tmp_path))
    (tmp_path / "nginx.conf").write_text(FRAME.format(folder=tmp_path, site=site))
    command = [str(program("nginx")), "-t", "-e", "stderr", "-p", str(tmp_path), "-c", str(tmp_path / "nginx.conf")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, "warn" in done.stderr) == (0, False), done.stderr

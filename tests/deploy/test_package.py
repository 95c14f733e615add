"""What the Debian package is made of: requirements, pages of the command line, example, scripts of dpkg."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import tomllib
from pathlib import Path
from types import ModuleType

import pytest

from vaoi_station.config import read_config
from vaoi_station.doctor.config_check import check_config
from vaoi_station.doctor.finding import Level

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
    (tmp_path / "vaoi").write_text(completion)
    ask = f'source {tmp_path}/vaoi; COMP_WORDS=(vaoi $1 $2); COMP_CWORD=$#; _vaoi; echo "${{COMPREPLY[@]}}"'
    for words, expected in ((("check-c",), "check-config"), (("rig", "u"), "up"), (("serve", "--lo"), "--log-json")):
        done = subprocess.run(["bash", "-c", ask, "bash", *words], capture_output=True, text=True, check=True)
        assert done.stdout.split() == [expected]


def test_the_example_is_sound(tmp_path: Path) -> None:
    folder = tmp_path / "example"
    module("example").write_example(folder)
    config = read_config(folder / "station.toml")
    assert str(config.data).startswith("/var/lib/vaoi-station/")
    # its directories exist only where the package is installed
    text = (folder / "station.toml").read_text().replace("/var/lib/vaoi-station/", "")
    (folder / "station.toml").write_text(text)
    assert [f.message for f in check_config(folder / "station.toml") if f.level is Level.FAULT] == []


@pytest.mark.parametrize("script", ["preinst", "postinst", "prerm", "postrm"])
def test_scripts_of_dpkg_are_those_of_a_posix_shell(script: str) -> None:
    path = PACKAGE / script
    assert path.read_text(encoding="utf-8").startswith("#!/bin/sh\n")
    assert "\nset -e\n" in path.read_text(encoding="utf-8")
    subprocess.run(["sh", "-n", str(path)], check=True)
    assert path.stat().st_mode & 0o111


def test_the_start_script_can_be_imported_by_child_processes() -> None:
    """multiprocessing imports the main script again in each child: without the guard, each would be a station."""
    script = re.search(r"<<'SCRIPT'\n(.*?)\nSCRIPT\n", BUILD, re.DOTALL)
    assert script is not None
    assert 'if __name__ == "__main__":\n    sys.exit(main())' in script[1]


def test_every_file_that_the_build_installs_exists() -> None:
    subprocess.run(["bash", "-n", str(ROOT / "deploy" / "build")], check=True)
    sources = re.findall(r"^  put ((?:deploy|docs|LICENSE)\S*) ", BUILD, re.MULTILINE)
    assert len(sources) > 8
    assert [source for source in sources if not (ROOT / source).is_file()] == []
    named = {*sources, *re.findall(r"deploy/package/[\w.-]+", BUILD)}
    scripts = {"preinst", "postinst", "prerm", "postrm"}
    assert {p.name for p in PACKAGE.iterdir() if p.is_file()} - scripts <= {Path(name).name for name in named}


def test_releases_have_the_python_that_the_project_supports() -> None:
    versions = re.findall(r"deb\d+\) minor=(3\.\d+) next=(3\.\d+)", BUILD)
    assert [minor for minor, _ in versions] == ["3.11", "3.13"]
    assert all(int(after.split(".")[1]) == int(minor.split(".")[1]) + 1 for minor, after in versions)

"""The package of `deploy/build` without the packages that pip would fetch: what dpkg and systemd find in it."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.needs import need

ROOT = Path(__file__).resolve().parents[2]
VENV = Path("opt/vaoi-station/venv")


@dataclass(frozen=True)
class Built:
    """A package, unpacked as dpkg unpacks it; `control` holds what dpkg itself reads."""

    file: Path
    root: Path
    control: Path

    def field(self, name: str) -> str:
        """Return a field of the control file."""
        return subprocess.run(["dpkg-deb", "-f", self.file, name], check=True, capture_output=True, text=True).stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    need("avr-gcc", "make")
    folder = tmp_path_factory.mktemp("package")
    subprocess.run(
        [ROOT / "deploy" / "build", "deb12", "--no-libraries", "--out", folder],
        env=os.environ | {"PYTHON": sys.executable}, check=True, capture_output=True,
    )  # fmt: skip
    [file] = folder.glob("*.deb")
    root = folder / "root"
    subprocess.run(["dpkg-deb", "-R", file, root], check=True)
    return Built(file, root, root / "DEBIAN")


def test_its_fields_name_version_and_interpreter(built: Built) -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
    assert built.file.name == f"vaoi-station_{version}~deb12_amd64.deb"
    assert built.field("Version").strip() == f"{version}~deb12"
    needed = built.field("Depends")
    for package in ("python3 (>= 3.11)", "python3 (<< 3.12)", "python3-gi", "gir1.2-aravis-0.8", "systemd"):
        assert package in needed
    assert (built.control / "conffiles").read_text().split() == ["/etc/security/limits.d/vaoi-station.conf"]


def test_its_files_are_those_of_its_checksums_and_belong_to_root(built: Built) -> None:
    stated = dict(line.split("  ")[::-1] for line in (built.control / "md5sums").read_text().splitlines())
    files = [p for p in built.root.rglob("*") if p.is_file() and not p.is_symlink() and built.control not in p.parents]
    found = {str(p.relative_to(built.root)): hashlib.md5(p.read_bytes()).hexdigest() for p in files}
    assert found == stated
    listed = subprocess.run(["dpkg-deb", "-c", built.file], check=True, capture_output=True, text=True).stdout
    assert {line.split()[1] for line in listed.splitlines()} == {"root/root"}
    assert [line for line in listed.splitlines() if re.match(r".{5}w|.{8}w", line) and line[0] != "l"] == []


def test_its_program_is_the_whole_station(built: Built, tmp_path: Path) -> None:
    packages = built.root / VENV / "lib/python3.11/site-packages"
    inside = {p.relative_to(packages) for p in (packages / "vaoi_station").rglob("*") if p.is_file()}
    here = subprocess.run(["git", "ls-files", "vaoi_station"], cwd=ROOT, check=True, capture_output=True, text=True)
    assert {Path(name) for name in here.stdout.splitlines()} <= inside
    assert (built.root / VENV / "bin/python3").readlink() == Path("/usr/bin/python3.11")
    assert (built.root / "usr/bin/vaoi").readlink() == Path("/") / VENV / "bin/vaoi"
    # With the libraries of this environment in place of those that are left out.
    done = subprocess.run(
        [sys.executable, built.root / VENV / "bin/vaoi", "--version"],
        env=os.environ | {"PYTHONPATH": str(packages)}, cwd=tmp_path, check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert done.stdout.split()[-1] in built.field("Version")


def test_what_unit_and_scripts_name_is_in_it(built: Built) -> None:
    units = built.root / "usr/lib/systemd/system"
    for name in ("vaoi-station.service", "vaoi-hermes-tap.service"):
        started = re.search(r"^ExecStart=/(\S+)", (units / name).read_text(), re.MULTILINE)
        assert started is not None
        program = built.root / started[1]
        # The environment links to the interpreter of its release, which this machine may lack.
        assert program.is_symlink() or os.access(program, os.X_OK), name
    for script in ("preinst", "postinst", "prerm", "postrm"):
        subprocess.run(["sh", "-n", built.control / script], check=True)
        assert os.access(built.control / script, os.X_OK)
        for path in re.findall(r"/usr/(?:lib|share)/[\w./-]*vaoi[\w./-]*", (built.control / script).read_text()):
            assert (built.root / path.lstrip("/")).exists(), path
    example = tomllib.loads((built.root / "usr/share/vaoi-station/example/station.toml").read_text())
    assert (built.root / "usr/share/vaoi-station/example" / Path(example["simulation"]["scenario"]).name).is_file()
    assert (built.root / "usr/share/vaoi-station/firmware/firmware.hex").read_text().endswith(":00000001FF\n")


def test_the_documents_that_messages_name_are_in_it(built: Built) -> None:
    documents = built.root / "usr/share/doc/vaoi-station"
    named = [(built.root / "usr/share/vaoi-station/example/station.toml").read_text()]
    named += [p.read_text("utf-8") for p in (built.root / VENV).rglob("vaoi_station/**/*.py")]
    found = set(re.findall(r"\bdocs/[\w/-]+\.md\b", "".join(named)))
    assert "docs/configuration.md" in found
    assert {name for name in found if not (documents / name).is_file()} == set()
    assert f"/{documents.relative_to(built.root)}/docs" in named[0]
    unit = (built.root / "usr/lib/systemd/system/vaoi-station.service").read_text()
    [guide] = re.findall(r"^Documentation=.* file:/(\S+)$", unit, re.MULTILINE)
    assert (built.root / guide).is_file()


def test_the_documents_are_in_it_as_a_site(built: Built) -> None:
    site = built.root / VENV / "lib/python3.11/site-packages/vaoi_station/help"
    pages = [page.read_text("utf-8") for page in site.rglob("*.html")]
    assert (site / "docs/index.html").is_file()
    assert "verdict" in (site / "searchindex.js").read_text("utf-8")
    assert len(pages) > 50
    assert not any("<script>" in page or "http-equiv" in page for page in pages)


def test_lintian_finds_nothing_where_it_is_installed(built: Built) -> None:
    if shutil.which("lintian") is None:
        return  # CI has none; deploy/boot runs it on the whole package
    done = subprocess.run(
        ["lintian", "--fail-on", "error,warning", built.file], check=False, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout

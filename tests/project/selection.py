"""Tests of what changed, for the quick loop: `python -m tests.project.selection` prints paths for pytest.

Changed is what differs from the commit that the branch shares with its upstream; without an upstream, from the parent
of the last commit. If nothing changed that has tests, all quick tests are chosen.
"""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SLOW = ("acquisition", "benchmarks", "cases", "demo", "drift", "hostile", "hw", "rig", "system")
"""Folders of tests that wait for real time, start whole stations or film boards; chosen only for their own subject."""
ALWAYS = ("tests/project/test_documents.py", "tests/project/test_structure.py")
FIGURES = "tests/cases/test_figures.py"
BY_FOLDER = {
    "vaoi_station/api/web": ("tests/api/web",),
    "docs/examples": ("tests/library/test_examples.py",),
    "hw": ("tests/hw/test_logic.py", "tests/hw/test_vectors.py", "tests/hw/test_pages.py"),
}
"""Tests of files that are not Python modules of the package."""


def changed_files() -> list[str]:
    """Return paths that differ from upstream, untracked files included."""
    upstream = _git("rev-parse", "--abbrev-ref", "@{upstream}")
    base = _git("merge-base", "HEAD", upstream) if upstream else _git("rev-parse", "HEAD~1")
    differing = _git("diff", "--name-only", base or "HEAD").splitlines()
    return differing + _git("ls-files", "--others", "--exclude-standard").splitlines()


def select_tests(changed: Iterable[str], root: Path = ROOT) -> list[str]:
    """Return the test files and folders that belong to changed files, without duplicates."""
    chosen: set[str] = set()
    for path in changed:
        tests = _tests_of_one(Path(path), root)
        if tests is None:
            return quick_tests(root)
        chosen |= {test for test in tests if (root / test).exists()}
    return sorted(chosen | set(ALWAYS)) if chosen else quick_tests(root)


def quick_tests(root: Path = ROOT) -> list[str]:
    """Return everything that does not wait for real time."""
    folders = (p for p in sorted((root / "tests").iterdir()) if p.is_dir() and p.name not in SLOW)
    files = sorted((root / "tests").glob("test_*.py"))
    return [str(p.relative_to(root)) for p in (*folders, *files) if p.name != "__pycache__"]


def _tests_of_one(path: Path, root: Path) -> list[str] | None:
    """Return the tests of one file; None if only all quick tests cover it."""
    if path.parts[0] == "tests":
        is_test = path.name.startswith("test_") and path.suffix == ".py"
        return [str(path)] if is_test else None
    if path.parts[0] == "vaoi_station" and path.suffix == ".py" and len(path.parts) > 2:
        mirrored = Path("tests", *path.parts[1:-1])
        own = mirrored / f"test_{path.name}"
        siblings = sorted((root / mirrored).glob("test_*.py"))
        quick = [str(p.relative_to(root)) for p in siblings] if path.parts[1] not in SLOW else []
        return [str(own), *quick]
    for start, tests in BY_FOLDER.items():
        if path.is_relative_to(start):
            return list(tests)
    return [FIGURES] if path.suffix in {".md", ".svg", ".png"} else None


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else ""


if __name__ == "__main__":
    print("\n".join(select_tests(changed_files())))

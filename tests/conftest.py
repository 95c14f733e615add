"""Profiles of Hypothesis, and the recorded cases: boards with a truth that the product never reads."""

from __future__ import annotations

import fcntl
import gc
import hashlib
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from tests.needs import FILMS, LONG, VERDICT, need_films
from vaoi_station.files import open_recording, read_board_type, read_calibration, write_stitch
from vaoi_station.model import BoardType, Calibration, Stitch
from vaoi_station.stitching.work import StitchSetup, stitch_frames

# The result of a commit must not depend on the day, so its examples are fixed; during development they are new.
# No example has a deadline: the first call of a compiled function waits for the compiler.
EXAMPLES = 300 if LONG else 50
hypothesis.settings.register_profile("desk", deadline=None, max_examples=EXAMPLES)
hypothesis.settings.register_profile("verdict", deadline=None, max_examples=EXAMPLES, derandomize=True)
hypothesis.settings.load_profile("verdict" if VERDICT else "desk")

# A shell lets the jobs that it starts in the background ignore SIGINT, and every child process inherits that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@dataclass
class Cases:
    """Recorded cases, with the results of this session; all test processes of the session share them on disk."""

    filmed: Path
    """Directory of the cases with their truth; only the scorer and the copies read it."""
    scratch: Path
    """Directory of this session; what one test process makes there, the others find."""
    _results: dict[str, Stitch] = field(default_factory=dict)

    def __call__(self, name: str) -> Path:
        """Return a read-only copy of a case without its truth."""
        return self._once(name, lambda to: self.copied(name, to))

    def copied(self, name: str, to: Path) -> Path:
        """Make a copy of a case without its truth, for a test that changes it."""
        shutil.copytree(self._source(name), to, ignore=shutil.ignore_patterns("truth.json"))
        return to

    def stitched(self, name: str) -> Stitch:
        """Stitch a case once per session and return the result."""
        if name not in self._results:
            case = self(name)
            path = self._once(f"{name}.pickle", lambda to: to.write_bytes(pickle.dumps(self.stitch(case))))
            self._results[name] = pickle.loads(path.read_bytes())
        return self._results[name]

    def stitch(
        self, directory: Path, *, board_type: BoardType | None = None, calibration: Calibration | None = None
    ) -> Stitch:
        """Stitch a recording as the command does, perhaps with another board type or calibration."""
        recording = open_recording(directory)
        head = recording.head
        calibration = calibration or read_calibration(directory / "calibration.json", len(head.cameras))
        board_type = board_type or read_board_type(directory / "board.json")
        setup = StitchSetup(
            calibration.cameras(head.cameras),
            head.conveyor_mm_s,
            head.trigger_period_s,
            board_type,
            lights=head.lights or (),
        )
        return stitch_frames(setup, head, recording.frame)

    def score(self, name: str, result: Stitch) -> dict[str, Any]:
        """Score a result by the program that knows the truth."""
        with tempfile.TemporaryDirectory(dir=self.scratch) as folder:
            path = Path(folder) / "result.json"
            write_stitch(path, result)
            return self.score_file(name, path)

    def score_file(self, name: str, path: Path) -> dict[str, Any]:
        """Score a written result or calibration by the same program, once per session."""
        command = [sys.executable, str(FILMS / "score.py"), str(self._source(name)), str(path)]

        def run(to: Path) -> None:
            output = subprocess.run(command, capture_output=True, check=True).stdout
            to.write_bytes(output)

        content = hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        figures: dict[str, Any] = json.loads(self._once(f"{name}-{content}.score", run).read_bytes())
        return figures

    def with_truth(self, name: str) -> Path:
        """Return the folder of a case with its truth, for a program that scores."""
        return self._source(name)

    def truth(self, name: str) -> dict[str, Any]:
        """Read the truth of a case; copies do not carry it."""
        truth: dict[str, Any] = json.loads((self._source(name) / "truth.json").read_text(encoding="utf-8"))
        return truth

    def _once(self, name: str, make: Callable[[Path], object]) -> Path:
        """Return the file or folder of a name; the first process that asks makes it, the others wait for it."""
        path = self.scratch / name
        if not path.exists():
            with _locked(self.scratch / f".{name}.lock"):
                if not path.exists():
                    aside = self.scratch / f".{name}.aside"
                    make(aside)
                    aside.replace(path)
        return path

    def _source(self, name: str) -> Path:
        case = self.filmed / name
        if not (case / "recording.json").is_file():
            if "VAOI_CASES" in os.environ:
                pytest.fail(f"VAOI_CASES={os.environ['VAOI_CASES']} holds no case {name!r}")
            # Sessions on several interpreters run side by side: one films, the others wait for it.
            self.filmed.mkdir(parents=True, exist_ok=True)
            with _locked(self.filmed / f".{name}.lock"):
                if not (case / "recording.json").is_file():
                    _film(name, case)
        return case


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock between processes."""
    with path.open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@pytest.fixture(scope="session")
def cases(tmp_path_factory: pytest.TempPathFactory) -> Cases:
    """Provide the recorded cases: those in VAOI_CASES, else filmed on first use and kept for later sessions."""
    need_films()
    kept = os.environ.get("VAOI_CASES")
    filmed = Path(kept) if kept else Path(tempfile.gettempdir()) / f"vaoi-cases-{os.getuid()}-{_fingerprint()}"
    # each process of pytest-xdist has a folder within that of the session
    own = tmp_path_factory.getbasetemp()
    scratch = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "cases"
    scratch.mkdir(exist_ok=True)
    return Cases(filmed, scratch)


def _fingerprint() -> str:
    """Compute a digest of everything the cases are made from."""
    digest = hashlib.sha256()
    for path in sorted(p for p in FILMS.rglob("*") if p.is_file() and "__pycache__" not in p.parts):
        digest.update(str(path.relative_to(FILMS)).encode() + path.read_bytes())
    return digest.hexdigest()[:12]


def _film(name: str, case: Path) -> None:
    """Film one case in a temporary directory, then rename it: sessions may run side by side."""
    case.parent.mkdir(parents=True, exist_ok=True)
    aside = Path(tempfile.mkdtemp(dir=case.parent, prefix=f".{name}-"))
    try:
        command = [sys.executable, str(FILMS / "make.py"), str(aside), name]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            pytest.fail(f"make.py could not film {name!r}: {done.stderr.strip()[-400:]}")
        if not case.exists():
            (aside / name).replace(case)
    except OSError:
        if not (case / "recording.json").is_file():  # another session was quicker
            raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)


SLOW_FIRST = ("acquisition", "system", "hw", "benchmarks", "cases", "hostile", "rig", "runs", "demo", "doctor", "drift")
"""Folders whose tests wait for devices and processes, the slowest first."""


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect tests without garbage collections, and exclude what was collected from all later ones.

    The modules of all tests are 400 000 objects that stay until the end. A full collection of them takes 0.2 s, and
    every coordinator that a test starts makes one.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start the slow folders first, so that no process is left alone with them at the end."""

    def rank(item: pytest.Item) -> int:
        folder = item.path.relative_to(Path(__file__).parent).parts[0]
        return SLOW_FIRST.index(folder) if folder in SLOW_FIRST else len(SLOW_FIRST)

    items.sort(key=rank)  # stable: within a folder the order stays


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Treat skipped tests as failures where the result of a commit depends on them."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None or not VERDICT:
        return
    skipped = reporter.stats.get("skipped", [])
    if skipped and session.exitstatus == 0:
        reporter.write_line(f"{len(skipped)} test(s) were skipped, which is an error here", red=True)
        session.exitstatus = pytest.ExitCode.TESTS_FAILED

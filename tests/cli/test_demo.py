"""`vaoi demo`: options, and the exit code of one board."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.cli.conftest import Result
from vaoi_station.demo import boards, report
from vaoi_station.simulation import scenario_path


@pytest.mark.parametrize("options", [["--json"], ["--out", "x"]])
def test_options_of_one_board_need_once(vaoi: Callable[..., Result], options: list[str]) -> None:
    done = vaoi("demo", *options)
    assert done.code == 2
    assert "--out and --json need --once" in done.err


@pytest.mark.parametrize(("ok", "code"), [(True, 0), (False, 1)])
def test_exit_code_of_one_board_and_its_document(
    vaoi: Callable[..., Result], monkeypatch: pytest.MonkeyPatch, ok: bool, code: int
) -> None:
    calls: list[tuple[object, ...]] = []
    filmed = SimpleNamespace(ok=ok, model_dump_json=lambda indent: json.dumps({"ok": ok}, indent=indent))

    def film(*arguments: Any) -> object:
        scenario, out, service, say = arguments
        calls.append((scenario, out, service.port))
        say("a stage")
        return filmed

    monkeypatch.setattr(boards, "film_single_board", film)
    monkeypatch.setattr(report, "as_text", lambda _: "the report as text")
    done = vaoi("demo", "--once", "--scenario", "small")
    assert (done.out, done.err) == ("the report as text\n", "a stage\n")
    done = vaoi("demo", "--once", "--scenario", "small", "--json", "--out", "x", "--port", "7")
    assert (done.code, json.loads(done.out)) == (code, {"ok": ok})
    assert calls == [(scenario_path("small"), Path("vaoi-demo"), 0), (scenario_path("small"), Path("x"), 7)]


@pytest.mark.parametrize(("options", "code"), [([], 0), (["--once"], 130)])
def test_interrupted_demo(
    vaoi: Callable[..., Result], monkeypatch: pytest.MonkeyPatch, options: list[str], code: int
) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(boards, "run_continuously", interrupt)
    monkeypatch.setattr(boards, "film_single_board", interrupt)
    assert vaoi("demo", "--scenario", "small", *options).code == code

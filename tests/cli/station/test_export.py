"""`vaoi export` and `vaoi import`; the package itself is tested in tests/transfer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tests.cli.conftest import Result
from tests.transfer.conftest import Site, make_rig, site, store

__all__ = ["make_rig", "site", "store"]


def test_a_run_is_exported_and_imported(vaoi: Callable[..., Result], site: Site, tmp_path: Path) -> None:
    out = tmp_path / "run.vaoi"
    for run, frames in ((site.sound, "without frames"), (site.degraded, "with frames")):
        done = vaoi("export", run, "--out", out, "--config", site.config)
        assert (done.code, done.out) == (0, f"{out}: run {run} {frames}\n")
        back = vaoi("import", out, "--out", tmp_path / run)
        assert back.code == 0
        assert f"run {run} of board type 'small'" in back.out
        out.unlink()
    assert vaoi("export", "unknown", "--out", out, "--config", site.config).code == 2
    assert vaoi("cut", tmp_path / site.degraded, "--result", tmp_path / site.degraded / "result.json",
                "--component", "U1", "--out", tmp_path / "cut").code == 0  # fmt: skip


def test_a_run_is_imported_into_a_history_or_a_folder(vaoi: Callable[..., Result], site: Site, tmp_path: Path) -> None:
    out = tmp_path / "run.vaoi"
    assert vaoi("export", site.sound, "--out", out, "--config", site.config).code == 0
    for options in ((), ("--out", tmp_path / "x", "--config", site.config)):
        refused = vaoi("import", out, *options)
        assert refused.code == 2
        assert "either --out or --config" in refused.err
    site.rig.archive.retention.forget_details([site.sound]).result(10)
    done = vaoi("import", out, "--config", site.config)
    assert (done.code, done.out) == (0, f"{site.config}: run {site.sound} of 'test', without frames, pinned\n")

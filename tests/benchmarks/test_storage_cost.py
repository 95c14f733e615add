"""The benchmark of the storage."""

from __future__ import annotations

import json
from pathlib import Path

from vaoi_station.benchmarks.storage_cost import measure_storage


def test_the_cost_of_a_run_is_measured_on_the_given_disk(tmp_path: Path) -> None:
    result = json.dumps([{"row": n, "matrix": [1.0, n / 3, n / 7]} for n in range(500)])
    figures = measure_storage(tmp_path / "disk", result, "{}", runs=5)
    assert (tmp_path / "disk" / "bench.db").stat().st_size > 0
    assert figures.result_kb > 2 * figures.packed_kb > 0
    assert 0 < figures.database_kb_per_run < figures.result_kb
    assert set(figures.document()["commit_ms"]) == {"durable", "not durable"}
    assert min(figures.run_ms["median"], figures.commit_ms["durable"], figures.pack_cpu_ms) > 0

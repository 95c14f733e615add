"""Format the figures of `station_pace` and `scaling` as Markdown tables, for the terminal and the documentation."""

from __future__ import annotations

from collections.abc import Sequence

from vaoi_station.benchmarks.figure_formats import number
from vaoi_station.benchmarks.station.scaling import ScalingFigures
from vaoi_station.benchmarks.station.station_pace import RateFigures


def station_table(figures: Sequence[RateFigures]) -> str:
    """Return a table of the station's figures, with one row per rate."""
    head = (
        "rate", "frames/s", "Mbit/s", "boards", "missed", "frames lost", "kept up", "ready ms (median, p99)",
        "conclude ms", "link lag ms", "links open", "cores", "sender cores", "load",
    )  # fmt: skip
    return _table(head, [_station_row(f) for f in figures])


def process_table(figures: Sequence[RateFigures]) -> str:
    """Return a table of CPU time per frame and private memory, one row per process and one column per rate."""
    names = list(figures[0].cpu_ms_per_frame) if figures else []
    head = ("process", *(f"{f.rate:g}×: CPU ms/frame, MB" for f in figures))
    return _table(
        head,
        [
            (name, *(f"{number(f.cpu_ms_per_frame[name], 2)}, {f.memory_mb[name]:.0f}" for f in figures))
            for name in names
        ],
    )


def scaling_table(figures: Sequence[ScalingFigures]) -> str:
    """Return a table of the scaling figures, with one row per board."""
    head = ("frames", "rows", "board mm", "components", "links ms/frame", "conclude ms/frame", "own MB", "frames MB")
    return _table(head, [_scaling_row(f) for f in figures])


def _scaling_row(f: ScalingFigures) -> tuple[object, ...]:
    width, length = f.board_mm
    return (
        f.frames, f.rows, f"{width:.0f} × {length:.0f}", f.components, f"{f.links_ms_per_frame:.2f}",
        f"{f.conclude_ms_per_frame:.2f}", f"{f.own_memory_mb:.1f}", f"{f.frames_mb:.0f}",
    )  # fmt: skip


def _station_row(f: RateFigures) -> tuple[object, ...]:
    ready = f.ready_after_last_frame_ms
    return (
        f"{f.rate:g}×", f"{f.frames_per_s:.2f}", f"{f.mbit_per_s:.0f}", f.boards, f.boards_missed, f.frames_lost,
        "yes" if f.kept_up else "no", f"{number(ready['median'], 0)}, {number(ready['p99'], 0)}",
        number(f.conclude_ms, 0),
        f"{number(f.lag_first_half_ms, 0)} → {number(f.lag_second_half_ms, 0)}",
        number(f.links_open_at_last_frame, 0), number(f.cores, 2), number(f.sender_cores, 2), f"{f.load_before:.1f}",
    )  # fmt: skip


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = ["| " + " | ".join(str(cell) for cell in row) + " |" for row in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])

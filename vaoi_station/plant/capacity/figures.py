"""Rates, sizes and cost of a plant."""

from __future__ import annotations

from typing import NamedTuple

HOURS_PER_DAY = 24.0
DAYS_PER_MONTH = 30.4


class Measured(NamedTuple):
    """What was measured on runs like those of the plant; docs/plant.md has the commands."""

    pixels_per_frame: float = 1032 * 776
    frames_per_run: float = 9.0
    ratio: float = 2.26
    """Compression of frames in the archive."""
    task_cpu_s: float = 0.33
    """CPU time to extract, stitch and lay out one run."""
    tables_kb: float = 40.0
    """Size of its rows in the Parquet tables."""
    worker_mb: float = 262.0
    """Memory of a worker."""


class Plant(NamedTuple):
    """A plant and its prices."""

    stations: int = 100
    frames: float = 1e8
    """Number of frames that the archive keeps."""
    boards_per_hour: float = 60.0
    """Boards of one station."""
    hours_per_day: float = 20.0
    workers: int = 64
    core_hour: float = 0.04
    """Price of a core for an hour."""
    gb_month: float = 0.02
    """Price of a gigabyte of storage for a month."""


class Figures(NamedTuple):
    """What a plant needs. Sizes are decimal."""

    runs: float
    """Number of kept runs."""
    kept_days: float
    """For how long a run is kept until the archive has this number of frames."""
    boards_per_day: float
    archive_tb: float
    data_set_gb: float
    """Size of the Parquet tables of all kept runs."""
    station_mbit_s: float
    """Mean rate at which one station hands runs over while it works."""
    storage_mbit_s: float
    """The same of all stations."""
    restitch_hours: float
    """Time to stitch everything again, if all workers work all the time."""
    restitch_mbit_s: float
    """Rate at which the workers then read."""
    memory_gb: float
    """Memory of all workers."""
    cost_restitch: float
    """Price of stitching a million boards again."""
    cost_month: float
    """Price of keeping a million boards for a month."""


def figures(measured: Measured, plant: Plant) -> Figures:
    """Calculate what a plant needs."""
    runs = plant.frames / measured.frames_per_run
    boards_per_day = plant.stations * plant.boards_per_hour * plant.hours_per_day
    run_mb = measured.pixels_per_frame * measured.frames_per_run / measured.ratio / 1e6
    station_mbit_s = run_mb * 8 * plant.boards_per_hour / 3600
    restitch_hours = runs * measured.task_cpu_s / 3600 / plant.workers
    return Figures(
        runs=runs,
        kept_days=runs / boards_per_day,
        boards_per_day=boards_per_day,
        archive_tb=runs * run_mb / 1e6,
        data_set_gb=runs * measured.tables_kb / 1e6,
        station_mbit_s=station_mbit_s,
        storage_mbit_s=station_mbit_s * plant.stations,
        restitch_hours=restitch_hours,
        restitch_mbit_s=runs * run_mb * 8 / (restitch_hours * 3600),
        memory_gb=plant.workers * measured.worker_mb / 1e3,
        cost_restitch=1e6 * measured.task_cpu_s / 3600 * plant.core_hour,
        cost_month=1e6 * run_mb / 1e3 * plant.gb_month,
    )

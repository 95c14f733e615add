"""A simulation of the cluster's queue: requests of many runs arrive, workers take one run at a time."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np


class Requests(NamedTuple):
    """How work arrives: requests at random times, each for a number of runs that varies."""

    per_hour: float
    runs: float
    """Mean number of runs of a request."""
    spread: float = 1.0
    """Standard deviation of the logarithm of the number of runs; 0: all are equal."""


class Waits(NamedTuple):
    """What requests experience, and how busy the workers are."""

    requests: int
    busy: float
    """Share of the workers' time that is work."""
    start_mean_s: float
    """Time from a request to the begin of its first run, mean."""
    start_p50_s: float
    """Time from a request to the begin of its first run; half of the requests wait no longer."""
    start_p95_s: float
    end_p50_s: float
    """Time from a request to the end of its last run."""
    end_p95_s: float
    lost_s: float
    """Work that was done twice because its worker ended, of all requests."""


def simulate(
    requests: Requests,
    workers: int,
    task_s: Sequence[float],
    *,
    hours: float = 24.0,
    killed_per_hour: float = 0.0,
    seed: int = 1,
) -> Waits:
    """Simulate the requests of a time, until all are done.

    Args:
        requests: how work arrives.
        workers: number of workers.
        task_s: measured times of single runs, of which times are drawn.
        hours: for how long requests arrive.
        killed_per_hour: how often any one worker ends in mid-run. Its run begins anew.
        seed: of the random numbers; equal seeds give equal results.
    """
    random = np.random.default_rng(seed)
    count = int(random.poisson(requests.per_hour * hours))
    arrivals_s = np.sort(random.uniform(0, hours * 3600, count))
    # The mean of a log-normal number is that of its median times exp(spread² / 2).
    sizes = requests.runs * np.exp(requests.spread * random.standard_normal(count) - requests.spread**2 / 2)
    free_s = [0.0] * workers
    starts, ends, worked_s, lost_s = [], [], 0.0, 0.0
    # First come, first served, as Dask has it for tasks of equal priority.
    for arrival_s, size in zip(arrivals_s.tolist(), sizes.tolist(), strict=True):
        times_s = random.choice(np.asarray(task_s, dtype=np.float64), max(1, round(size)))
        killed = random.uniform(size=len(times_s)) < times_s * (killed_per_hour / 3600)
        wasted_s = np.where(killed, times_s * random.uniform(size=len(times_s)), 0.0)
        first_s, last_s = np.inf, 0.0
        for time_s in (times_s + wasted_s).tolist():
            begin_s = max(heapq.heappop(free_s), arrival_s)
            heapq.heappush(free_s, begin_s + time_s)
            first_s, last_s = min(first_s, begin_s), max(last_s, begin_s + time_s)
        starts.append(first_s - arrival_s)
        ends.append(last_s - arrival_s)
        worked_s += float((times_s + wasted_s).sum())
        lost_s += float(wasted_s.sum())
    if not count:
        return Waits(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    over_s = max(hours * 3600, *free_s)
    start_p50_s, start_p95_s = map(float, np.percentile(starts, (50, 95)))
    end_p50_s, end_p95_s = map(float, np.percentile(ends, (50, 95)))
    return Waits(
        requests=count,
        busy=worked_s / (workers * over_s),
        start_mean_s=float(np.mean(starts)),
        start_p50_s=start_p50_s,
        start_p95_s=start_p95_s,
        end_p50_s=end_p50_s,
        end_p95_s=end_p95_s,
        lost_s=lost_s,
    )

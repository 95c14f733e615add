"""Errors of points of clamped boards over their stated σ: `python -m tests.clamping.draws` prints a table.

Boards are turned, shifted, tilted (0.5 mm at the edge), bowed (0.2 mm), the axes of testers differ (100 ppm); all 1 σ.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from tests.clamping.boards import FIDUCIALS, Clamp, board_type, filmed, request
from vaoi_station.clamping import CadPoint, clamp
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Status
from vaoi_station.model.board_type import Fiducial

SIGMA_MM, SIGMA_Z_MM = 0.01, 0.02
PARTS = tuple(f"U{n}" for n in range(9))
CENTERS = np.array([c.center for c in board_type().components])


def ratios(count: int, draws: int, seed: int) -> Floats:
    """Return the root mean squares (3,) of errors in x, y and z over their σ, by `count` readings of each board."""
    random, film, errors = np.random.default_rng(seed), filmed(), []
    for _ in range(draws):
        turn, shift = random.uniform(-3, 3), tuple(random.uniform(-200, 200, 2))
        plane = (random.normal(0, 1), *random.normal(0, 0.5, 2))
        there = Clamp(turn, shift, tuple(random.normal(0, 1e-4, 3)), plane, tuple(random.normal(0, 0.2, 3)))
        names = random.permutation(list(FIDUCIALS))[:count]
        noise = random.normal(0, 1, (count, 3)) * (SIGMA_MM, SIGMA_MM, SIGMA_Z_MM)
        stated = float(np.degrees(turn) + random.normal(0, 0.5))
        readings = there.readings(*names, z=True, noise=noise)
        asked = request(readings, sigma=SIGMA_MM, sigma_z=SIGMA_Z_MM, turn_deg=stated, points=PARTS)
        answer = clamp(film, asked)
        assert answer.status is not Status.FAILED
        sigma = np.array([(p.sigma_x, p.sigma_y, p.sigma_z) for p in answer.points])
        errors.append((np.array([(p.x, p.y, p.z) for p in answer.points]) - there(CENTERS)) / sigma)
    return np.asarray(np.sqrt((np.array(errors) ** 2).mean((0, 1))))


def _cpu_ms(act: Callable[[], object]) -> str:
    times = []
    for _ in range(25):
        begun = time.process_time()
        act()
        times.append(1e3 * (time.process_time() - begun))
    return f"{min(times):.1f} / {np.median(times):.1f}"


def main() -> None:
    """Print the table of errors, and what an answer costs."""
    for count in range(1, 6):
        print(count, "readings: error/σ x, y, z", ratios(count, 300, count).round(2).tolist())
    random, readings = np.random.default_rng(1), Clamp().readings(*FIDUCIALS)
    places = random.uniform((0, 0), (160, 100), (3000, 2)).tolist()
    many = request(readings, points=tuple(CadPoint(x=x, y=y) for x, y in places))
    marks = tuple(
        Fiducial(name=f"M{n}", x=8.0 * (n // 20) + dx, y=5.0 * (n % 20) + dy, diameter=0.5)
        for n, (dx, dy) in enumerate(random.uniform(0, 3, (400, 2)).tolist())
    )
    film = filmed(board_type(fiducials=marks, components=(), outline=((0.0, 0.0), (170.0, 110.0))))
    at = Clamp()(np.array([(m.x, m.y) for m in marks]))[::2].tolist()
    read = [{"fiducial": f"M{2 * n}", "x": x, "y": y} for n, (x, y, _) in enumerate(at)]
    for n in range(3):
        read[n]["x"] += 5.0
    wrong = request(read)  # type: ignore[arg-type]
    print("CPU ms, least / median: transform", _cpu_ms(lambda: clamp(filmed(), request(readings))))
    print("  with 3,000 points", _cpu_ms(lambda: clamp(filmed(), many)))
    print("  200 readings of 400 fiducials, 3 wrong", _cpu_ms(lambda: clamp(film, wrong)))


if __name__ == "__main__":
    main()

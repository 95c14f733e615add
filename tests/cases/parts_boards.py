"""Many small boards with painted parts of known truth, filmed and stitched, for figures of measured parts.

`python -m tests.cases.parts_boards DIR [--set choosing held-out] [--families N]` makes DIR/SET/FAMILY/BOARD: recordings
with `result.json`. A family is one layout, photograph, array, lamp and belt, with good boards and bad ones. Families of
the two sets share no photograph, layout or seed: constants are chosen on the first, figures are stated of the second.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.needs import FILMS
from vaoi_station.library.recordings import open_recording

SETS = ("choosing", "held-out")
GOOD, BAD = 6, 4
"""Boards of a family."""
FAULTS = ("absent",) * 4 + ("shifted", "turned", "exchanged") + ("reversed",) * 3
"""What is done to every tenth of the faulty parts: most are absent or reversed."""
PHOTOS = {
    "choosing": ("ulx3s_v18_bottom_red", "ulx3s_v18_top_red", "colorlight_5a75b_v70_back", "innova2_ADLT_back"),
    "held-out": ("colorlight_5a75e_v71_front", "redox_black_keyboard_pair"),
}


def family(which: str, number: int) -> tuple[str, str]:
    """Return name and film.py's options of a family: 40 px/mm, or, of every third one, 12 px/mm."""
    g = np.random.default_rng([SETS.index(which), number])
    coarse = number % 3 == 2
    photos = PHOTOS[which]
    photo = photos[number % len(photos)]
    ground = cv2.imread(str(FILMS / f"photos/{photo}.jpg"), cv2.IMREAD_GRAYSCALE)
    assert ground is not None, photo
    height, width = ground.shape
    board_w, board_l = (72, 48) if coarse else (31, 54)
    # The board's size in pixels of the photograph, which serves as ground whatever its own resolution is.
    scale = min(40.0, 0.7 * width / board_w, 0.8 * height / board_l)
    w, h = round(board_w * scale), round(board_l * scale)
    x, y = int(g.integers(0, width - w)), int(g.integers(0, height - h))
    lights = "--mv 4.4 --lights even left right" if number % 6 == 4 else ""
    camera = "--r 12 --texture-scale 14 --width 1032 --height 776" if coarse else "--texture-scale 44"
    options = (
        f"--photo photos/{photo}.jpg --crop {x} {y} {x + w} {y + h} --photo-scale {scale:.3f} {camera} {lights} "
        f"--photo-rotate {g.choice([0, 2])} --cameras 1 --fiducials 3 --png-level 1 "
        f"--parts {210 if coarse else 100} --board-seed {1000 * SETS.index(which) + number + 100} "
        f"--rig-seed {1000 * SETS.index(which) + number + 300} --shot {g.uniform(0.02, 0.05):.3f} "
        f"--read {g.uniform(1, 2.5):.2f} --psf {g.uniform(0.5, 0.8):.2f} --blur-px {g.uniform(0.4, 1.2):.2f} "
        f"--gain {g.uniform(0.8, 1.1):.2f} --vignette {g.uniform(0.15, 0.3):.2f} --wander {g.uniform(0.005, 0.03):.4f} "
        f"--direction {g.choice([-1, 1])} --distortion-px {g.choice([0, 0.8])} --lift {g.choice([0, 0.4])}"
    )
    return f"{number:02d}-{'12' if coarse else '40'}{'-lights' if lights else ''}", options


def boards(number: int) -> Iterator[tuple[str, str]]:
    """Yield name and further options of each board of a family."""
    for k in range(GOOD):
        yield f"good-{k}", f"--seed {number * 100 + k + 1}"
    for k in range(BAD):
        faults = 4 if number % 3 != 2 else 8
        yield f"bad-{k}", f"--seed {number * 100 + k + 51} --part-faults {faults}"


def _program() -> dict[str, Any]:
    """Return film.py's functions; a board is sampled once for all parts of one height."""
    sys.path.insert(0, str(FILMS))
    source = (FILMS / "film.py").read_text(encoding="utf-8").rsplit("main()", 1)[0]
    names: dict[str, Any] = {"__name__": "film"}
    exec(compile(source, "film.py", "exec"), names)  # noqa: S102  (a program beside the checkout, without its last line)
    film, sample = names["Film"], names["Film"].sample
    kept: dict[float | None, Any] = {}
    of: list[Any] = [None, None]

    def once(self: Any, pose: Any, flat: float | None = None) -> Any:
        if of[0] is not pose or of[1] is not self:
            kept.clear()
            of[:] = pose, self
        key = None if flat is None else round(float(flat), 6)
        if key not in kept:
            kept[key] = sample(self, pose, flat)
        return kept[key]

    film.sample = once
    sys.modules["part_faults"].KINDS = FAULTS  # type: ignore[attr-defined]
    return names


def make(out: Path, options: str) -> None:
    """Film one board and stitch it, if that is not done."""
    if (out / "result.json").exists():
        return
    names = _program()
    sys.argv = ["film.py", str(out), *options.split()]
    names["main"]()
    open_recording(out).stitch().save(out / "result.json")


def main() -> None:
    """Film the boards of the sets."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--set", nargs="+", choices=SETS, default=list(SETS))
    parser.add_argument("--families", type=int, nargs=2, default=(0, 12), metavar=("FROM", "TO"))
    given = parser.parse_args()

    out = given.out.resolve()
    os.chdir(FILMS)
    for which in given.set:
        for number in range(*given.families):
            name, options = family(which, number)
            for board, more in boards(number + 1000 * SETS.index(which)):
                make(out / which / name / board, f"{options} {more}")


if __name__ == "__main__":
    main()

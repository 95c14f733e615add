from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data.design import rotated
from vaoi_station.board_data.readers.gencad import read_gencad
from vaoi_station.errors import InputError

PATH = Path("b.cad")


@pytest.mark.parametrize(
    ("units", "mm"),
    [("INCH", 25.4), ("THOU", 0.0254), ("MM", 1), ("MM100", 0.01), ("USER 1000", 0.0254), ("USERMM 5", 0.2)],
)
def test_units(units: str, mm: float) -> None:
    design = read_gencad(samples.GENCAD.replace("USER 1000", units).encode(), PATH)
    assert design.parts[0].origin[0] == pytest.approx(393.7008 * mm)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("UNITS USER 1000", "UNITS FURLONG", "b.cad, line 4: UNITS is 'FURLONG', but must be INCH, THOU"),
        ("UNITS USER 1000", "UNITS USER 0", "line 4: UNITS"),
        ("PLACE 393.7008 393.7008", "PLACE 393.7008", "line 32: 'PLACE 393.7008' must have 2 numbers after word 1"),
        ("PLACE 393.7008 393.7008", "PLACE here there", "must have 2 numbers"),
        ("$COMPONENTS", "$COMPONENTZ", r"has no section \$COMPONENTS"),
    ],
)
def test_wrong_files_are_refused(before: str, after: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_gencad(samples.GENCAD.replace(before, after).encode(), PATH)


PINS = {"1": (0.0, 0.0), "2": (7.0, 0.0), "3": (7.0, 1.0)}
Map = Callable[[float, float], tuple[float, float]]
AS_DRAWN: Map = lambda x, y: (x, y)  # noqa: E731
ABOUT_X: Map = lambda x, y: (x, -y)  # noqa: E731
ABOUT_Y: Map = lambda x, y: (-x, y)  # noqa: E731


def board(
    words: str, side: str, mirror: Map, sign: int = 1, *, routes: bool = True, angles: Sequence[int] = (0, 45, 90)
) -> str:
    """Return a file in mm with a connector at several angles; tracks end on its pins."""
    shapes = "$SHAPES\nSHAPE J\nRECTANGLE 0 -2 8 4\n"
    shapes += "".join(f"PIN {name} S {x} {y} TOP 0 0\n" for name, (x, y) in PINS.items()) + "$ENDSHAPES\n"
    components, signals, tracks = "$COMPONENTS\n", "$SIGNALS\n", "$ROUTES\n"
    for n, angle in enumerate(angles):
        x0, y0 = 30.0 * n, 10.0
        components += f"COMPONENT J{n}\nPLACE {x0} {y0}\nLAYER {side}\nROTATION {angle}\nSHAPE J {words}\n"
        for name, pin in PINS.items():
            dx, dy = rotated(mirror(*pin), sign * angle)
            signals += f'SIGNAL "net {n} {name}"\nNODE J{n} {name}\n'
            tracks += f'ROUTE "net {n} {name}"\nLINE {x0 + dx:.4f} {y0 + dy:.4f} 99 99\nVIA V 98 98 ALL 1 v\n'
    head = "$HEADER\nGENCAD 1.4\nUNITS MM\n$ENDHEADER\n"
    return f"{head}{shapes}{components}$ENDCOMPONENTS\n{signals}$ENDSIGNALS\n{tracks if routes else ''}$ENDROUTES\n"


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("mirror", [AS_DRAWN, ABOUT_X, ABOUT_Y])
@pytest.mark.parametrize("words", ["0 0", "MIRRORX FLIP", "MIRRORY FLIP", "MIRRORY 0", "0 FLIP"])
@pytest.mark.parametrize("side", ["TOP", "BOTTOM"])
def test_ends_of_tracks_show_what_the_words_mean(side: str, words: str, mirror: Map, sign: int) -> None:
    design = read_gencad(board(words, side, mirror, sign).encode(), PATH)
    for n, (part, angle) in enumerate(zip(design.parts, (0, 45, 90), strict=True)):
        dx, dy = rotated(mirror(4, 0), sign * angle)
        assert part.center == pytest.approx((30 * n + dx, 10 + dy), abs=1e-6)
    (note,) = (note for note in design.notes if note.code != "vias-mask-unknown")
    assert (note.code, note.values["fit"], note.values["pins"]) == ("rotation-by-pins", "6", "6")


@pytest.mark.parametrize(
    ("words", "mirror"),
    [
        ("0 0", AS_DRAWN),
        ("MIRRORX FLIP", ABOUT_X),
        ("0 FLIP", ABOUT_X),
        ("MIRRORY FLIP", ABOUT_Y),
        ("MIRRORY 0", ABOUT_Y),
    ],
)
@pytest.mark.parametrize("routes", [True, False])
def test_the_angle_is_that_of_the_file_where_words_mean_what_is_usual(words: str, mirror: Map, routes: bool) -> None:
    design = read_gencad(board(words, "BOTTOM", mirror, routes=routes).encode(), PATH)
    assert [part.rotation for part in design.parts] == [0, 45, 90]
    for n, (part, angle) in enumerate(zip(design.parts, (0, 45, 90), strict=True)):
        dx, dy = rotated(mirror(4, 0), angle)
        assert part.center == pytest.approx((30 * n + dx, 10 + dy), abs=1e-6)
    assert design.notes[0].code == ("rotation-by-pins" if routes else "rotation-unconfirmed")

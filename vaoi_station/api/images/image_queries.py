"""Query parameters that choose temporary images, and the request that they make.

The functions are coroutines because FastAPI performs other ones in a thread, which takes longer than the functions.
"""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Depends, Query

from vaoi_station.api.parameters import MinCoverage, PxPerMm
from vaoi_station.rendering.framing import MOST_MARGIN_MM, Framing
from vaoi_station.rendering.request import MOST_IMAGES, Bounds, Choice, ImageRequest, direction

Number = Annotated[float, Query(allow_inf_nan=False)]


async def _framing(
    px_per_mm: PxPerMm = None,
    margin_mm: Annotated[
        Number, Query(description="Strip of surroundings on all sides of the component.", ge=0, le=MOST_MARGIN_MM)
    ] = 0.0,
    align: Annotated[
        Literal["cad", "part"],
        Query(description="What is upright: CAD, or the component as at rotation 0."),
    ] = "cad",
    plane: Annotated[
        Literal["board", "top"],
        Query(description="Plane in which the images are right: the board's surface, or the top of the body."),
    ] = "board",
) -> Framing:
    return Framing(px_per_mm, margin_mm, align, plane)


async def _bounds(
    min_coverage: MinCoverage = 0.5,
    min_exposure_us: Annotated[Number | None, Query(description="Least exposure time.", ge=0)] = None,
    max_exposure_us: Annotated[Number | None, Query(description="Longest exposure time.", ge=0)] = None,
    min_angle_deg: Annotated[
        Number, Query(description="Least angle between line of sight and vertical.", ge=0, le=90)
    ] = 0.0,
    max_angle_deg: Annotated[Number, Query(description="Largest such angle.", ge=0, le=90)] = 90.0,
    min_sharpness_per_mm: Annotated[Number | None, Query(description="Least sharpness.", ge=0)] = None,
    max_saturated: Annotated[Number | None, Query(description="Largest share of saturated pixels.", ge=0, le=1)] = None,
) -> Bounds:
    return Bounds(
        min_coverage,
        min_exposure_us,
        max_exposure_us,
        min_angle_deg,
        max_angle_deg,
        min_sharpness_per_mm,
        max_saturated,
    )


async def _choice(
    light: Annotated[str | None, Query(description="Only images under this light.", max_length=200)] = None,
    minus: Annotated[
        str | None,
        Query(description="Subtract the image under this light, seen most nearly from the same side.", max_length=200),
    ] = None,
    seen_from: Annotated[
        str | None,
        Query(
            description="Only images that see the component from this side of the image (`left`, `right`, `front`: "
            "below, `back`: above), or from this azimuth in CAD, 0 to 360.",
            max_length=20,
        ),
    ] = None,
    within_deg: Annotated[
        Number | None, Query(description="Largest difference from `seen_from` [45]; only with it.", ge=0, le=180)
    ] = None,
    order: Annotated[Literal["best", "sharpest"], Query(description="What comes first; see the guide.")] = "best",
    limit: Annotated[int | None, Query(description="Largest number of images.", ge=1, le=MOST_IMAGES)] = None,
    measure: Annotated[bool, Query(description="Measure sharpness and saturation of every image.")] = False,
) -> Choice:
    return Choice(light, minus, direction(seen_from), within_deg, order, limit, measure)


async def _wanted(
    framing: Annotated[Framing, Depends(_framing)],
    bounds: Annotated[Bounds, Depends(_bounds)],
    choice: Annotated[Choice, Depends(_choice)],
) -> ImageRequest:
    return ImageRequest(framing, bounds, choice).check()


Wanted = Annotated[ImageRequest, Depends(_wanted)]
"""The request for images that the query of an HTTP request makes."""

"""Closed contours from lines and arcs: the outline of a board and its cut-outs."""

from vaoi_station.board_data.contours.arcs import arc_points, arc_through, area, circle_points
from vaoi_station.board_data.contours.outline import Contours, find_contours
from vaoi_station.board_data.contours.places import places

__all__ = ["Contours", "arc_points", "arc_through", "area", "circle_points", "find_contours", "places"]

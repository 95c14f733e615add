"""The hand-over: where a board lies that a tester has clamped, from its readings of fiducials. It does no I/O."""

from vaoi_station.clamping.clamped import clamp
from vaoi_station.clamping.documents import CadPoint, Clamped, ClampedRequest, Reading, request_of
from vaoi_station.clamping.filmed import FilmedBoard

__all__ = ["CadPoint", "Clamped", "ClampedRequest", "FilmedBoard", "Reading", "clamp", "request_of"]

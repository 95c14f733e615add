"""Small pictures and tiles of mosaics that the station process renders itself, straight from the ring.

A small picture takes one to ten milliseconds. By a worker it would take a lease, the queues and two pipes besides, and
the wait for what all workers have under way: links of a row, or a piece of work in spare time. The caller's own thread
makes it: OpenCV releases the GIL, so that the coordinator's thread goes on.
"""

from __future__ import annotations

import threading

from vaoi_station.acquisition.ring import Ring
from vaoi_station.errors import GoneError
from vaoi_station.runs.workers.picture_jobs import RenderJob, TileJob
from vaoi_station.runs.workers.worker import perform_with_frames

SEATS = 2
"""Largest number of pictures that the station process renders at a time; workers render the others."""
LARGEST_PX = 1_000_000
"""Largest number of pixels of a picture that the station process renders: some 25 × 25 mm at 40 px/mm, in 10 ms.

While the limit was 400,000 px, the largest components of a board, which are one in a hundred, waited 40 ms for a worker
that measured heights of the board before.
"""


class SmallPictures:
    """Renders small pictures in the threads of their callers. Methods may be called from any thread."""

    def __init__(self, ring: Ring) -> None:
        """Store the ring that holds the frames."""
        self._ring = ring
        self._seats = threading.BoundedSemaphore(SEATS)

    def render(self, job: RenderJob | TileJob) -> bytes | None:
        """Return the encoded picture of a job with its place in the ring; None if a worker has to render it.

        A worker renders what is large, what no caller waits for, and HDR.

        No lease is needed: the generation of the bay is checked after the pixels were read, as in workers.
        """
        if not _is_small(job) or not self._seats.acquire(blocking=False):
            return None
        try:
            picture: bytes = perform_with_frames(job, self._ring)
            return picture
        except GoneError:
            return None  # the frame may be in a recording, which the caller looks up
        finally:
            self._seats.release()


def _is_small(job: RenderJob | TileJob) -> bool:
    """Return whether the station process renders the picture of a job."""
    if isinstance(job, RenderJob):
        return job.file is None and job.minus is None and job.view.width * job.view.height <= LARGEST_PX
    return job.format is not None and not job.spec.hdr and job.spec.width * job.spec.height <= LARGEST_PX

"""Evidence in shared memory: each worker writes what it finds to a log of its own, and the owner of a run reads it.

A log is a circle of bytes with one writer. Its head has the positions at which the oldest record begins and the newest
one ends; both only grow. Records are written before the end moves, and the begin moves before one is overwritten. Each
has its length and a checksum in front. So a reader that is too slow reads less, and never anything wrong: who needs
evidence that was overwritten, or lost with its worker, finds it again.
"""

from __future__ import annotations

import mmap
import os
import pickle
import struct
import zlib
from collections.abc import Iterator, Mapping

import numpy as np

from vaoi_station.stitching.matching.evidence import Evidence, FrameKey

LOG_BYTES = 16 << 20
"""Room of one log: the evidence of several boards of 420 frames. Only pages that were written use memory."""
_HEAD_BYTES, _RECORD = 16, struct.Struct("<II")

Found = tuple[str, int, list[Evidence], Mapping[FrameKey, int]]
"""A record: run, generation of its bay, the evidence of one job, and the slots of its frames."""


def shared_memory(workers: int, file: int = -1) -> mmap.mmap:
    """Map the logs of all workers in a file in memory, which workers of all fork servers of a station share.

    Without a file, the memory is that of this process and its children.
    """
    size = workers * (LOG_BYTES + _HEAD_BYTES)
    if file >= 0:
        os.ftruncate(file, size)
    return mmap.mmap(file, size)


class EvidenceLog:
    """The log of one worker in the shared memory."""

    def __init__(self, memory: mmap.mmap, index: int) -> None:
        start = index * (LOG_BYTES + _HEAD_BYTES)
        self._memory, self._start = memory, start + _HEAD_BYTES
        # Aligned numbers, which the processor writes at once: a reader never finds half of one.
        self._head = np.frombuffer(memory, np.uint64, 2, start)
        self._position = self._span()[0]
        """Where this reader goes on."""

    def write(self, found: Found) -> None:
        """Append a record; older ones make room. What is larger than the log is left out."""
        body = pickle.dumps(found, pickle.HIGHEST_PROTOCOL)
        record = _RECORD.pack(len(body), zlib.crc32(body)) + body
        begin, end = self._span()
        if len(record) > LOG_BYTES:
            return
        while end + len(record) - begin > LOG_BYTES:
            begin += _RECORD.size + _RECORD.unpack(self._bytes(begin, _RECORD.size))[0]
        self._head[0] = begin
        first = self._start + end % LOG_BYTES
        split = min(len(record), self._start + LOG_BYTES - first)
        self._memory[first : first + split] = record[:split]
        self._memory[self._start : self._start + len(record) - split] = record[split:]
        self._head[1] = end + len(record)
        # The writer knows what it wrote; it only reads what a worker before it has left.
        if self._position == end:
            self._position = end + len(record)

    def new_records(self) -> Iterator[Found]:
        """Yield the records that this reader has not read; at first, all that are left."""
        while True:
            begin, end = self._span()
            self._position = max(self._position, begin)
            if self._position >= end:
                return
            size, checksum = _RECORD.unpack(self._bytes(self._position, _RECORD.size))
            body = self._bytes(self._position + _RECORD.size, size) if size <= LOG_BYTES else b""
            if self._span()[0] > self._position:
                continue  # It was overwritten meanwhile.
            if len(body) != size or zlib.crc32(body) != checksum:
                self._position = end
                continue
            self._position += _RECORD.size + size
            yield pickle.loads(body)

    def _span(self) -> tuple[int, int]:
        begin, end = self._head.tolist()
        return begin, end

    def _bytes(self, position: int, size: int) -> bytes:
        first = self._start + position % LOG_BYTES
        split = min(size, self._start + LOG_BYTES - first)
        return self._memory[first : first + split] + self._memory[self._start : self._start + size - split]

"""The stream of a batch: order of readiness, bounded work ahead of the reader, and its end."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from vaoi_station.api.batch.batch_stream import PARTS_AHEAD, CutThreads, stream
from vaoi_station.errors import GoneError
from vaoi_station.runs.batches.batch_job import CutPart
from vaoi_station.runs.batches.batches import Batch, BatchPart
from vaoi_station.runs.batches.containers import Member, Packed, pack


def batch(count: int) -> Any:
    parts = [BatchPart((), k) for k in range(count)]
    made: Any = SimpleNamespace(
        run="r1",
        components=parts,
        request=SimpleNamespace(container="tar"),
        modified_s=0,
        head=Member("run.json", "", b"head"),
        parts=lambda: list(parts),
        pack=lambda m: pack("tar", [m], 0),
    )
    made.end = partial(Batch.end, made)
    return made


def reply(content: bytes) -> CutPart:
    return CutPart(Packed(content, (), 1), 1, 0, None)


async def read(answer: AsyncIterator[bytes]) -> list[bytes]:
    return [piece async for piece in answer]


def test_parts_come_in_the_order_of_their_readiness() -> None:
    async def check() -> None:
        first_may_end = asyncio.Event()

        async def cut(part: BatchPart) -> tuple[CutPart, None]:
            if part.image == 0:
                await first_may_end.wait()
            return reply(b"part %d" % part.image), None

        answer = stream(batch(3), cut)
        await anext(answer)
        assert {await anext(answer), await anext(answer)} == {b"part 1", b"part 2"}
        first_may_end.set()
        assert await anext(answer) == b"part 0"
        assert b'"images":3' in await anext(answer)

    asyncio.run(check())


def test_a_reader_that_waits_stops_the_work() -> None:
    async def check() -> None:
        begun = []

        async def cut(part: BatchPart) -> tuple[CutPart, None]:
            begun.append(part.image)
            return reply(b"x"), None

        answer = stream(batch(50), cut)
        await anext(answer)
        assert begun == []
        await anext(answer)
        assert len(begun) <= PARTS_AHEAD
        await answer.aclose()  # type: ignore[attr-defined]  # it is a generator
        assert len(begun) <= PARTS_AHEAD

    asyncio.run(check())


def test_the_rest_of_a_part_is_cut_before_later_parts() -> None:
    async def check() -> None:
        begun = []

        async def cut(part: BatchPart) -> tuple[CutPart, BatchPart | None]:
            begun.append(part.image)
            return reply(b"x"), BatchPart((), 100) if part.image == 0 else None

        await read(stream(batch(PARTS_AHEAD + 5), cut))
        assert begun[PARTS_AHEAD] == 100

    asyncio.run(check())


@pytest.mark.parametrize("fault", [GoneError("gone", code="frames-gone"), RuntimeError("a bug")])
def test_a_fault_ends_the_stream_with_a_last_file(fault: Exception) -> None:
    async def check() -> None:
        async def cut(part: BatchPart) -> tuple[CutPart, None]:
            raise fault

        *_, end, closing = await read(stream(batch(9), cut))
        assert b'"complete":false' in end
        assert closing == bytes(1024)

    asyncio.run(check())


def test_a_part_whose_reader_has_gone_keeps_its_thread() -> None:
    async def check() -> None:
        begun, ready, may_end = [], threading.Event(), threading.Event()

        def cut(_: Batch, part: BatchPart) -> tuple[CutPart, None]:
            begun.append(part.image)
            ready.set()
            may_end.wait()
            return reply(b"x"), None

        threads, whole = CutThreads(1), batch(3)
        left = asyncio.ensure_future(threads.ask(cut, whole, BatchPart((), 0)))
        await asyncio.to_thread(ready.wait)
        left.cancel()
        waiting, last = (asyncio.ensure_future(threads.ask(cut, whole, BatchPart((), k))) for k in (1, 2))
        await asyncio.wait([left])
        waiting.cancel()
        assert begun == [0]
        may_end.set()
        assert (await last)[0].images == 1
        assert begun == [0, 2]

    asyncio.run(check())

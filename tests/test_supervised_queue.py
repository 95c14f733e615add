"""A bounded queue that one supervised thread serves."""

from __future__ import annotations

import threading

from vaoi_station.supervised_queue import SupervisedQueue

PATIENCE_S = 10.0


def test_items_are_served_in_order_and_the_start_comes_first() -> None:
    served: list[str] = []
    done = threading.Event()

    def serve(item: str) -> None:
        served.append(item)
        if item == "c":
            done.set()

    queue = SupervisedQueue(serve, "work", 8, begin=lambda: served.append("begin"))
    for item in "abc":
        assert queue.put(item) is None
    queue.start()
    assert done.wait(PATIENCE_S)
    queue.stop()
    assert served == ["begin", "a", "b", "c"]
    assert queue.thread.has_ended


def test_an_item_may_take_any_time_without_a_fault_and_sees_the_end() -> None:
    begun, ended = threading.Event(), threading.Event()

    def serve(item: str) -> None:
        begun.set()
        assert not queue.pause(0.0)
        assert queue.pause(PATIENCE_S)
        assert queue.stopping
        assert item == "a", "what waits behind the item under way is not begun"
        ended.set()

    queue = SupervisedQueue(serve, "work", 8)
    queue.thread._limit_s = 0.0
    queue.put("a")
    queue.put("b")
    queue.start()
    assert begun.wait(PATIENCE_S)
    assert queue.thread.fault() is None
    queue.stop()
    assert ended.is_set()
    assert queue.thread.has_ended


def test_an_item_that_ends_the_thread_is_a_fault() -> None:
    queue = SupervisedQueue[int](lambda item: 1 // item, "work", 8)
    queue.put(0)
    queue.start()
    queue.thread.join(PATIENCE_S)
    fault = queue.thread.fault()
    assert fault is not None
    assert "ZeroDivisionError" in fault.what

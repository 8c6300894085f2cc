"""Queues of what was received: who closes one, who ends it, what is left in it."""

from __future__ import annotations

import threading

from aces_bus.hardware.queues import Inbox


def test_a_closed_queue_takes_nothing_more_and_tells_its_owner() -> None:
    """`close` ends the queue and leaves: its owner is told which, readers get what is left, and nothing more goes in."""
    left: list[Inbox[int]] = []
    inbox = Inbox[int](leave=left.append)
    inbox.put([1, 2])
    inbox.close()
    assert left == [inbox]
    inbox.put([3])
    assert inbox.is_closed
    assert inbox.get() == [1, 2]
    assert inbox.get() == []


def test_closing_wakes_who_waits() -> None:
    """A reader that waits without a time limit gets an empty list when another thread closes the queue."""
    inbox = Inbox[int]()
    found: list[list[int]] = []
    reader = threading.Thread(target=lambda: found.append(inbox.get()), daemon=True)
    reader.start()
    inbox.close()
    reader.join(10)
    assert found == [[]]


def test_a_full_queue_keeps_the_newest_and_counts_the_others() -> None:
    """What does not fit is dropped from the old end, counted, and said once for each time."""
    said: list[int] = []
    inbox = Inbox[int](3, wanted=lambda item: item != 0, overflowed=said.append)
    inbox.put([0, 1, 2, 3])
    assert (len(inbox), inbox.dropped, said) == (3, 0, [])
    inbox.put([4, 0, 5])
    assert (inbox.dropped, said) == (2, [2])
    assert inbox.get() == [3, 4, 5]

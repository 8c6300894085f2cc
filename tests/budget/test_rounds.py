"""What a tick brings about: bounds that no schedule exceeds, and that are not far from what can happen."""

from __future__ import annotations

import random

import pytest

from aces_bus.errors import CallerError, UnknownNameError
from aces_lab.budget import BusMessage, MessageSet, RoundFrame, round_times

HOST = "host"


def drawn_tick(draw: random.Random) -> tuple[list[RoundFrame], MessageSet, int, dict[str, str]]:
    """Set-points, requests with answers (some of two frames, some that lead to another request), and others' messages."""
    tick = draw.randint(120, 400)
    # Priorities as identifiers are: some are shared by the host's messages.
    pool = [draw.randrange(30) for _ in range(40)]
    late = draw.choice((0, 0, draw.randint(0, 20)))
    frames: list[RoundFrame] = []
    for number in range(draw.randint(1, 6)):
        ask = f"ask{number}"
        frames.append(RoundFrame(BusMessage(ask, pool.pop(), draw.randint(3, 12), tick, late, node=HOST)))
        for answer in range(draw.choice((0, 1, 1, 1, 2))):
            name = f"answer{number}.{answer}"
            delay = draw.choice((0, draw.randint(0, 30)))
            message = BusMessage(name, pool.pop(), draw.randint(3, 12), tick, delay, node=f"board{number}")
            frames.append(RoundFrame(message, ask))
    if draw.random() < 0.3:  # a request that waits for an answer
        first = draw.choice(frames).message.name
        frames.append(RoundFrame(BusMessage("then", pool.pop(), 5, tick, 2, node=HOST), first))
    others = []
    for number in range(draw.choice((0, 0, 1, 2))):
        period, jitter = draw.randint(60, 500), draw.choice((0, draw.randint(0, 60)))
        others.append(BusMessage(f"other{number}", pool.pop(), draw.randint(3, 12), period, jitter))
    return frames, MessageSet(tuple(others), 1), tick, {HOST: draw.choice(("priority", "fifo"))}


def played(
    frames: list[RoundFrame],
    others: MessageSet,
    tick: int,
    queues: dict[str, str],
    draw: random.Random,
    ticks: int,
) -> dict[str, int]:
    """The longest times from tick to arrival in some ticks of a bus that is played out, frame by frame."""
    worst = {frame.message.name: 0 for frame in frames} | {one.name: 0 for one in others.messages}
    is_hard = draw.random() < 0.5
    fifo = queues[HOST] == "fifo"
    #: When it is queued, from when it counts, in which order, what.
    coming: list[tuple[int, int, int, BusMessage]] = []
    count = 0

    def upto(most: int) -> int:
        return most if is_hard and draw.random() < 0.8 else draw.randint(0, most)

    for number in range(ticks):
        begin = number * tick
        late = upto(frames[0].message.jitter_ns)
        for frame in frames:
            if not frame.after:
                count += 1
                coming.append((begin + late, begin, count, frame.message))
    for one in others.messages:
        nominal, last = draw.randrange(one.period_ns), 0
        while nominal < ticks * tick:
            last = max(last, nominal + upto(one.jitter_ns))
            count += 1
            coming.append((last, nominal, count, one))
            nominal += one.period_ns
    now = 0
    while coming:
        ready = [one for one in coming if one[0] <= now]
        if fifo:
            mine = [one for one in ready if one[3].node == HOST]
            first = min(mine, key=lambda one: (one[0], one[2]), default=None)
            ready = [one for one in ready if one[3].node != HOST or one is first]
        if not ready:
            now = min(one[0] for one in coming)
            continue
        chosen = min(ready, key=lambda one: (one[3].priority, one[2]))
        coming.remove(chosen)
        _, begin, _, message = chosen
        now += message.wire_ns if is_hard else draw.randint(max(1, message.wire_ns // 2), message.wire_ns)
        worst[message.name] = max(worst[message.name], now - begin)
        for frame in frames:
            if frame.after == message.name:
                count += 1
                coming.append((now + upto(frame.message.jitter_ns), begin, count, frame.message))
    return worst


@pytest.mark.slow
def test_no_schedule_is_longer_than_its_bound() -> None:
    """Host queues of both kinds, answers as late as they may be or sooner, overruns, messages that come by themselves."""
    bounded, near = 0, list[float]()
    for number in range(100):
        draw = random.Random(f"ticks {number}")
        frames, others, tick, queues = drawn_tick(draw)
        found = round_times(frames, others, tick, queues=queues)  # type: ignore[arg-type]
        bounds = {name: one.response_ns for name, one in (*found.frames.items(), *found.others.items())}
        longest = dict.fromkeys(bounds, 0)
        for _ in range(12):
            for name, seen in played(frames, others, tick, queues, draw, 8).items():
                longest[name] = max(longest[name], seen)
        for name, bound in bounds.items():
            if bound is not None:
                assert longest[name] <= bound, (number, name)
                bounded += 1
                near.append(longest[name] / bound)
    assert bounded > 500
    assert sorted(near)[len(near) // 2] > 0.65


def test_an_answer_is_counted_once_a_tick() -> None:
    """Messages that know nothing of one another would meet twice; those of one tick do not."""
    frames = [RoundFrame(BusMessage(f"ask{n}", 1, 10, 100, node=HOST)) for n in range(4)]
    frames += [RoundFrame(BusMessage(f"answer{n}", 10 + n, 12, 100), f"ask{n}") for n in range(4)]
    found = round_times(frames, MessageSet((), 1), 100)
    assert found.round_ns == 88
    assert found.frames["answer3"].response_ns == 88


def test_where_a_tick_is_not_over_only_what_goes_first_has_a_bound() -> None:
    """What is left over of the last tick is less urgent than the set-point, and blocks it once at most."""
    frames = [
        RoundFrame(BusMessage("set", 1, 10, 100, node=HOST)),
        RoundFrame(BusMessage("ask", 2, 10, 100, node=HOST)),
        RoundFrame(BusMessage("long", 9, 90, 100), "ask"),
    ]
    found = round_times(frames, MessageSet((), 1), 100)
    assert found.round_ns is None
    assert {name: one.response_ns for name, one in found.frames.items()} == {
        "set": 100,
        "ask": None,
        "long": None,
    }
    behind = round_times(frames, MessageSet((), 1), 100, queues={HOST: "fifo"})
    assert behind.frames["set"].response_ns is None  # what is left over may stand before it


def test_what_is_no_tick_is_refused() -> None:
    """Names, and causes."""
    one = RoundFrame(BusMessage("a", 1, 1, 10))
    with pytest.raises(CallerError, match="one name: a"):
        round_times([one, one], MessageSet((), 1), 10)
    with pytest.raises(UnknownNameError, match="b"):
        round_times([RoundFrame(BusMessage("a", 1, 1, 10), "b")], MessageSet((), 1), 10)

"""What both ends of a packet say to each other while it is under way: go-aheads, acknowledgements, aborts.

1. A transport writes these frames and reads them (`Transport.go_ahead`, `acknowledgement`, `abort`, `steering`); when one
   is due, and what becomes of the packet, the ports of devices decide (`device.carried_port`). They keep all state.
2. Frames of a packet are named by their places: the first one has place 0, those behind it 1, 2, ….
"""

from __future__ import annotations

from typing import Literal, NamedTuple

#: Why an end gives a packet up: the other one was silent; a stop or another packet goes first; it has too many under way;
#: frames contradict one another; the same frames were asked for too often.
GivenUp = Literal["timed out", "overtaken", "busy", "contradiction", "asked too often"]


class Steering(NamedTuple):
    """What a receiver answers to a packet whose first frame has `key`, and the bytes of `opening` at their places.

    "on": send `frames` frames (0: all), `gap_ns` from the end of one to the next, from the one at place `start` on (0: from
    the one that is due). "wait": there will be another one. "stop": it does not take the packet, for a `reason`. "done": it
    has all of it.
    """

    go: Literal["on", "wait", "stop", "done"]
    key: int
    frames: int = 0
    gap_ns: int = 0
    start: int = 0
    opening: tuple[tuple[int, bytes], ...] = ()
    reason: str = ""


class AnswerTimes(NamedTuple):
    """How long each end waits for the other one (s).

    A sender for a go-ahead or the acknowledgement (`answer_s`), and for another go-ahead after one that says "wait"
    (`hold_s`); a receiver for the first frame after its go-ahead (`begin_s`), and for the next one (`next_s`).
    """

    answer_s: float
    hold_s: float
    begin_s: float
    next_s: float


__all__ = ["AnswerTimes", "GivenUp", "Steering"]

"""Tickets and jobs: something asked of a device, and something that takes several steps.

1. Nothing waits inside: a ticket calls back, a job goes on when what it waits for is there. `wait` is for programs.
2. What is not answered in time is asked again, then fails with `NoReplyError`; a job gets that raised where it waits.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, Literal

from ..errors import AcesError, CallerError, DeviceError
from ..runtime.clock import EventClock, Timer
from .port import Packet

#: A job yields a ticket or another job (and gets its result), or ns to let pass.
Step = Any
Steps = Generator[Step, Any, Any]


class Awaited:
    """Something that will be done or will have failed."""

    __slots__ = ("_followers", "clock", "error", "result", "state")

    def __init__(self, clock: EventClock) -> None:
        self.clock = clock
        self.state: Literal["waiting", "done", "failed"] = "waiting"
        self.result: Any = None
        self.error: AcesError | None = None
        self._followers: list[Callable[[Awaited], None]] | None = None

    @property
    def is_over(self) -> bool:
        """True if the work is done or has failed."""
        return self.state != "waiting"

    def then(self, follower: Callable[[Any], None]) -> None:
        """Call `follower` with this when it is over; at once when it is."""
        if self.is_over:
            follower(self)
        elif self._followers is None:
            self._followers = [follower]
        else:
            self._followers.append(follower)

    def finish(self, result: Any = None) -> None:
        """End with a result. Does nothing if it has ended."""
        if self.state == "waiting":
            self.state, self.result = "done", result
            if self._followers is not None:
                self._notify()

    def fail(self, error: AcesError) -> None:
        """End with an error. Does nothing if it has ended."""
        if self.state == "waiting":
            self.state, self.error = "failed", error
            self._notify()

    def follow(self, other: Awaited) -> None:
        """End with `other`, which stands for this and is over."""
        if other.error is not None:
            self.fail(other.error)
        else:
            self.finish(other.result)

    def _notify(self) -> None:
        followers, self._followers = self._followers, None
        for follower in followers or ():
            follower(self)

    def wait(self, timeout_s: float = 10.0) -> Any:
        """Let time pass until it is over; its result. Raises its error, or `DeviceError` when the time is up."""
        if not self.clock.wait(lambda: self.is_over, round(timeout_s * 1e9)):
            raise DeviceError(f"{self!r} is not over after {timeout_s:g} s")
        if self.error is not None:
            raise self.error
        return self.result

    def __await__(self) -> Generator[object, None, Any]:
        """Let an asyncio program wait: `await device.ask("SendStatus", reply="Status")`; returns and raises as `wait`."""
        from .asyncio_face import wait_in_asyncio

        yield from wait_in_asyncio(self)
        if self.error is not None:
            raise self.error
        return self.result


class Ticket(Awaited):
    """One request of a device. `result` is the record that answered, None when no answer is expected.

    One without an answer is over when its packet has left, and fails when it does not. `urgent`: a stop (`Device.send_now`);
    `confirms`: it asks whether one was obeyed.
    `packet` is what went out; `sent_at` and `answered_at` are instants (ns); `tries` counts how often it went out.
    """

    __slots__ = (
        "answered_at",
        "confirms",
        "deadline",
        "device",
        "message",
        "packet",
        "poll",
        "reply",
        "retries",
        "sent_at",
        "timeout_ns",
        "tries",
        "urgent",
    )

    def __init__(
        self,
        clock: EventClock,
        device: Any,
        message: str,
        packet: Packet,
        reply: frozenset[str],
        timeout_ns: int,
        retries: int = 0,
        poll: Any = None,
        urgent: bool = False,
        confirms: bool = False,
    ) -> None:
        self.clock, self.state, self.result, self.error, self._followers = clock, "waiting", None, None, None
        self.device, self.message, self.packet = device, message, packet
        self.reply, self.timeout_ns, self.retries, self.poll = reply, timeout_ns, retries, poll
        self.urgent, self.confirms = urgent, confirms
        self.tries = 0
        self.sent_at = self.answered_at = self.deadline = 0

    @property
    def latency_ns(self) -> int | None:
        """From sending to the answer."""
        return self.answered_at - self.sent_at if self.answered_at else None

    def __repr__(self) -> str:
        return f"<{self.message} to {self.device.name}: {self.state}>"


class Job(Awaited):
    """Steps that follow one another, written as a generator: it yields tickets, jobs, or ns to let pass.

    `progress` (0…1) and `text` say how far it is; the steps set them. `cancel` ends it.
    """

    __slots__ = ("_steps", "_timer", "name", "progress", "text")

    def __init__(self, clock: EventClock, name: str, steps: Callable[[Job], Steps]) -> None:
        super().__init__(clock)
        self.name = name
        self.progress, self.text = 0.0, ""
        self._timer: Timer | None = None
        self._steps = steps(self)
        clock.call_soon(lambda: self._go_on(None, None))

    def _go_on(self, value: Any, error: AcesError | None) -> None:
        while not self.is_over:
            try:
                step = self._steps.throw(error) if error is not None else self._steps.send(value)
            except StopIteration as ended:
                self.progress = 1.0
                self.finish(ended.value)
                return
            except AcesError as failed:
                self.fail(failed)
                return
            except Exception as wrong:  # the driver's own fault: it is over, and raised where it happened
                self.fail(DeviceError(f"{self.name}: {type(wrong).__name__}: {wrong}"))
                raise
            if isinstance(step, Awaited):
                if not step.is_over:
                    step.then(self._continued)
                    return
                value, error = step.result, step.error
            elif isinstance(step, int) and step >= 0:
                self._timer = self.clock.call_in(step, lambda: self._go_on(None, None))
                return
            else:
                value, error = (
                    None,
                    CallerError(f"{self.name}: a step is a ticket, a job or ns, not {step!r}"),
                )

    def _continued(self, step: Awaited) -> None:
        # Not from within the bus's own call: what a step sends comes after what is being received.
        self.clock.call_soon(lambda: self._go_on(step.result, step.error))

    def cancel(self) -> None:
        """End it: it has failed."""
        if self._timer is not None:
            self._timer.cancel()
        if not self.is_over:
            self._steps.close()
            self.fail(DeviceError(f"{self.name} was cancelled"))

    def __repr__(self) -> str:
        text = f", {self.text}" if self.text else ""
        return f"<{self.name}: {self.state}, {self.progress:.0%}{text}>"


def together(clock: EventClock, name: str, parts: list[Any]) -> Job:
    """Return a job that is done when all tickets and jobs are; fails with the first error, after all are over."""

    def steps(job: Job) -> Steps:
        failed: AcesError | None = None
        results: list[Any] = []
        for number, part in enumerate(parts):
            try:
                results.append((yield part))
            except AcesError as error:
                failed = failed or error
            job.progress = (number + 1) / len(parts)
        if failed is not None:
            raise failed
        return results

    return Job(clock, name, steps)

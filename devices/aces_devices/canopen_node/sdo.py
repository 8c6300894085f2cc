"""Reading and writing a node's objects over SDO, as steps of a job.

1. Nothing blocks: a transfer asks, and goes on when the answer is there. So it runs in virtual time as in life, on the
   thread of its bus; `canopen`'s own client waits on a thread, which neither could.
2. One transfer a node at a time, in the order in which they were asked for; a stop ends those under way and those that wait.
3. A transfer is bounded: `LONGEST` bytes, one time-out a segment.

Bytes and toggle bits: CiA 301, 7.2.4.3. Block transfers are not made.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from aces_bus.device import Device, Job, Steps, Ticket
from aces_bus.errors import AcesError, DeviceError
from aces_bus.protocol import Record

#: The longest object that is read (bytes).
LONGEST = 1 << 16
#: Seconds to wait for an answer (canopen waits as long).
TIMEOUT_S = 0.3

#: What refusals say, in words; others show their name or number.
WORDS = {
    "no_object": "the drive has no such object",
    "no_subindex": "the object has no such subindex",
    "read_only": "it cannot be written",
    "write_only": "it cannot be read",
    "value_range": "the value is out of range",
    "value_high": "the value is too high",
    "value_low": "the value is too low",
    "length": "it has another length",
    "device_state": "not in the drive's present state",
    "no_data": "it is empty",
}


class SdoRefused(DeviceError):
    """The node has ended a transfer; `code` is the spec's name for why, or a number."""

    def __init__(self, who: str, index: int, subindex: int, code: Any) -> None:
        name = f"0x{code:08X}" if isinstance(code, int) else str(code)
        said = WORDS.get(name, name)
        super().__init__(f"{who} refuses object {index:04X}:{subindex}: {said}")
        self.code = code


class SdoChannel:
    """The transfers of one node, made with its device's requests."""

    def __init__(self, device: Device, timeout_s: float = TIMEOUT_S) -> None:
        self.device, self.timeout_s = device, timeout_s
        #: Transfers that are not over, in their order.
        self._jobs: list[Job] = []

    def upload(self, index: int, subindex: int = 0) -> Job:
        """Read an object; the result is its bytes. Fails with `SdoRefused` or `NoReplyError`."""
        return self._queued(f"read {index:04X}:{subindex}", lambda: self._upload(index, subindex))

    def download(self, index: int, subindex: int, data: bytes) -> Job:
        """Write an object. Fails with `SdoRefused` or `NoReplyError`."""
        return self._queued(f"write {index:04X}:{subindex}", lambda: self._download(index, subindex, data))

    def download_now(self, writes: Sequence[tuple[int, int, bytes]]) -> Job:
        """Write objects (index, subindex, at most 4 bytes) as a stop: at once, instead of all other transfers.

        The transfer under way and those that wait are cancelled. Fails with `SdoRefused` or `NoReplyError`, after all were
        written.
        """
        for job in self._jobs:
            job.cancel()
        first = self._order_now(*writes[0])

        def steps() -> Steps:
            failed: AcesError | None = None
            for number, (index, subindex, data) in enumerate(writes):
                try:
                    answer = yield self._order_now(index, subindex, data) if number else first
                    if not self._is_about(answer, index, subindex):
                        about = f"{answer.index:04X}:{answer.subindex}, not {index:04X}:{subindex}"
                        raise DeviceError(f"{self.device.name} answers about {about}")
                except AcesError as error:
                    failed = failed or error
            if failed is not None:
                raise failed

        return self._queued("stop", steps)

    def _order_now(self, index: int, subindex: int, data: bytes) -> Ticket:
        return self.device.send_now(
            "SdoDownload",
            reply=("SdoDownloaded", "SdoAborted"),
            timeout_s=self.timeout_s,
            retries=1,
            **_order(index, subindex, data),
        )

    def _is_about(self, answer: Record, index: int, subindex: int) -> bool:
        """Return whether an answer is about this object; raises `SdoRefused`."""
        if (answer.index, answer.subindex) != (index, subindex):
            return False
        if type(answer).__name__ == "SdoAborted":
            raise SdoRefused(self.device.name, index, subindex, answer.code)
        return True

    def _queued(self, name: str, steps: Callable[[], Steps]) -> Job:
        self._jobs = [job for job in self._jobs if not job.is_over]
        before = self._jobs[-1] if self._jobs else None

        def whole(job: Job) -> Steps:
            nonlocal before
            if before is not None:
                try:
                    yield before
                except AcesError:
                    pass  # its own trouble
                before = None
            return (yield from steps())

        made = self.device.job(name, whole)
        self._jobs.append(made)
        return made

    def _ask(self, message: str, replies: tuple[str, ...], index: int, subindex: int, **fields: Any) -> Steps:
        """Ask once about an object and return the answer; answers about another object come from an older request."""
        for _ in range(3):
            answer = yield self.device.ask(
                message,
                reply=(*replies, "SdoAborted"),
                timeout_s=self.timeout_s,
                retries=1,
                index=index,
                subindex=subindex,
                **fields,
            )
            if self._is_about(answer, index, subindex):
                return answer
        raise DeviceError(
            f"{self.device.name} answers about other objects than {index:04X}:{subindex}: does another master use its SDO?"
        )

    def _segment(
        self, message: str, reply: str, index: int, subindex: int, toggle: int, **fields: Any
    ) -> Steps:
        """Send one segment. It is not repeated: the node would take it for the next one."""
        answer = yield self.device.ask(
            message, reply=(reply, "SdoAborted"), timeout_s=self.timeout_s, retries=0, toggle=toggle, **fields
        )
        if type(answer).__name__ == "SdoAborted":
            raise SdoRefused(self.device.name, index, subindex, answer.code)
        if answer.toggle != toggle:
            self._abort(index, subindex, "toggle")
            raise DeviceError(
                f"{self.device.name}: a segment of {index:04X}:{subindex} came twice or not at all"
            )
        return answer

    def _abort(self, index: int, subindex: int, code: str) -> None:
        self.device.send("SdoAbort", index=index, subindex=subindex, code=code)

    def _upload(self, index: int, subindex: int) -> Steps:
        answer = yield from self._ask("SdoUpload", ("SdoUploaded", "SdoUploadStarted"), index, subindex)
        if type(answer).__name__ == "SdoUploaded":
            return answer.data[: 4 - answer.unused] if answer.sized else answer.data
        data = bytearray()
        toggle, is_last = 0, False
        while not is_last:
            part = yield from self._segment("SdoUploadSegment", "SdoUploadedSegment", index, subindex, toggle)
            data += part.data[: 7 - part.unused]
            is_last, toggle = bool(part.last), toggle ^ 1
            if len(data) > LONGEST:
                self._abort(index, subindex, "too_long")
                raise DeviceError(
                    f"{self.device.name}: object {index:04X}:{subindex} is longer than {LONGEST} bytes"
                )
        return bytes(data)

    def _download(self, index: int, subindex: int, data: bytes) -> Steps:
        if 0 < len(data) <= 4:
            yield from self._ask("SdoDownload", ("SdoDownloaded",), **_order(index, subindex, data))
            return None
        yield from self._ask("SdoDownloadStart", ("SdoDownloaded",), index, subindex, sized=1, size=len(data))
        toggle, at = 0, 0
        while at == 0 or at < len(data):
            part = data[at : at + 7]
            at += 7
            yield from self._segment(
                "SdoDownloadSegment",
                "SdoDownloadedSegment",
                index,
                subindex,
                toggle,
                unused=7 - len(part),
                last=int(at >= len(data)),
                data=part.ljust(7, b"\0"),
            )
            toggle ^= 1
        return None


def _order(index: int, subindex: int, data: bytes) -> dict[str, Any]:
    """Return the fields of a download in one frame: 1 to 4 bytes."""
    return {
        "index": index,
        "subindex": subindex,
        "sized": 1,
        "unused": 4 - len(data),
        "data": data.ljust(4, b"\0"),
    }

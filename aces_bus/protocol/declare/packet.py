"""A whole packet as one construct: what `message.struct` is.

1. `parse` accepts a packet only when everything the template says holds, and then consumes it to the last byte.
2. `build` writes what is derived (identifier, length, check, stuffing) itself; a caller gives fields.
3. The result is flat: captures, head fields and payload fields are siblings, as in records.

On CAN a packet's image is the identifier as 4 bytes, big-endian, with the flags of SocketCAN's `can_id` (bit 31 extended,
bit 30 remote; linux/can.h), then 1 byte of `canfd_frame` flags (bit 2 set for CAN FD), then the data.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from contextlib import suppress
from functools import cached_property
from operator import index
from typing import TYPE_CHECKING, Any, BinaryIO

from construct import (
    Array,
    ConstError,
    Construct,
    ConstructError,
    Container,
    Default,
    GreedyBytes,
    Renamed,
    StreamError,
    Struct,
    Subconstruct,
    stream_read_entire,
)

from ...errors import FieldError
from ...frames import FD, AnyFrame, key_of
from .checks import Check
from .fields import innermost, is_raw
from .framing import Framing, Verdict
from .head import Head, flags_of
from .pattern import IdPattern, describe_values

if TYPE_CHECKING:
    from .message import Message

FD_FLAG = 0x04


class NotThisError(ConstructError):
    """The packet is another message: identifier, flags or a constant differ."""


class LengthError(ConstructError):
    """The packet is this message by its constants, but too short or too long."""

    def __init__(self, message: Message, why: str, path: str, error: StreamError | None = None) -> None:
        super().__init__(why, path=path)
        self._message = message
        self._where = (getattr(error, "path", "") or "").removeprefix(path).split(" -> ")[1:2]

    @property
    def what(self) -> str:
        """Sizes that the message can have; of a list that ends before its last item, the field that counts its items."""
        message, where = self._message, self._where
        for subcon in getattr(message.payload, "subcons", ()) if where else ():
            if subcon.name == where[0] and (names := re.findall(r"\['(\w+)'\]", repr(_count_of(subcon)))):
                return f"too short for the items of {message.name}.{where[0]} that {'.'.join(names)} counts"
        return f"{message.name} has {message.describe_lengths}"


class WrongCheckError(ConstructError):
    """The packet is this message, but its check does not hold."""


class ContentError(ConstructError):
    """The packet is this message by its template, but a field cannot be read.

    `what` says which and why, without values; it is empty where a constant in the payload is another one.
    """

    def __init__(self, message: Message, error: Exception, path: str) -> None:
        where = (getattr(error, "path", "") or "").partition(" -> ")[2].replace(" -> ", ".")
        super().__init__(str(error) or type(error).__name__, path=path)
        name = f"{message.name}.{where}" if where else message.name
        self.what = "" if isinstance(error, ConstError) else f"{name} cannot be read ({type(error).__name__})"


def _count_of(con: Construct) -> Any:
    """Return what counts the items of a list; None of what is no list."""
    while isinstance(con, Subconstruct) and not isinstance(con, Array):
        con = con.subcon
    return getattr(con, "count", None)


def error_text(error: BaseException) -> str:
    """Return what a construct's error says, on one line and without the path to it."""
    lines = str(error).splitlines()
    said = [line for line in lines if line and not line.startswith("Error in path")] or lines
    return " ".join(" ".join(said).split()) or type(error).__name__


def can_image(
    identifier: int, data: bytes, *, extended: bool = False, remote: bool = False, fd: bool = False
) -> bytes:
    """Return the image of a CAN frame that `message.struct` parses."""
    return key_image(key_of(identifier, extended=extended, remote=remote, fd=fd), data)


def key_image(key: int, data: bytes) -> bytes:
    """Return the image of a frame with this key, whose upper flags are those of `can_id`."""
    return (key & ~FD).to_bytes(4, "big") + (bytes([FD_FLAG]) if key & FD else b"\0") + data


def frame_image(frame: AnyFrame) -> bytes:
    """Return the image of a frame, ours or python-can's."""
    return can_image(
        frame.arbitration_id,
        bytes(frame.data),
        extended=frame.is_extended_id,
        remote=frame.is_remote_frame,
        fd=frame.is_fd,
    )


class PacketStruct(Construct):
    """The construct of one message's packet."""

    def __init__(self, message: Message) -> None:
        super().__init__()
        self.message = message
        found = [(head.name, flags_of(head.field)) for head in message.heads_written]
        #: The header fields of flags, by name.
        self._flags = {name: flags for name, flags in found if flags is not None}

    # ------------------------------------------------------------------ parsing

    def _parse(self, stream: BinaryIO, context: Container, path: str) -> Container:
        try:
            return self._read(stream, context, path)
        except (NotThisError, LengthError, WrongCheckError, ContentError):
            raise
        except Exception as error:  # whatever a construct raises, construct's own or a user's
            raise ContentError(self.message, error, path) from error

    def _read(self, stream: BinaryIO, context: Container, path: str) -> Container:
        packet: bytes = stream_read_entire(stream, path)
        message = self.message
        values = Container()
        request = context._params.get("request")
        identifier = 0
        if message.framing is None:
            if len(packet) < 5:
                raise NotThisError("an image of a frame begins with 5 bytes", path=path)
            identifier = int.from_bytes(packet[:4], "big") & 0x1FFF_FFFF
            flags = (bool(packet[0] & 0x80), bool(packet[0] & 0x40), bool(packet[4] & FD_FLAG))
            captures = message.identifier.match(identifier)
            is_kind = flags[:2] == (message.extended, message.remote) and flags[2] in message.formats
            if captures is None or not is_kind:
                raise NotThisError("another identifier", path=path)
            _read_captures(message.identifier, captures, context, values)
            data, end = packet[5:], len(packet) - 5
        else:
            judged = message.framing.judge(
                packet, 0, silent=True, extras=message.extras, request=message.question(request)
            )
            if judged.verdict is not Verdict.WHOLE or judged.size != len(packet):
                raise NotThisError(judged.reason or "not a packet of this framing", path=path)
            data = message.framing.logical(packet)
            end = len(data) - message.framing.check_size - len(message.framing.end)
        for name in message.request_fields:
            values[name] = (request or {}).get(name)
        heads = message.heads
        short = heads[-1].offset + heads[-1].size > end if heads else False
        for head in message.heads_written:
            if (
                head.offset + head.size <= end
                and head.pattern is not None
                and head.pattern.match(head.number(data)) is None
            ):
                raise NotThisError(f"{head.name} is another", path=path)
        for offset, wanted in message.constants:
            if data[offset : min(offset + len(wanted), end)] != wanted[: max(0, end - offset)]:
                raise NotThisError("a constant is another", path=path)
        if short or (message.lengths is not None and len(data) not in message.lengths):
            raise LengthError(message, f"length {len(data)}", path)
        self._fields(values, data, end, context, path)
        check = message.check
        if check is not None and check.field is not None:
            found = values.pop(check.field)
            if found != check.compute(message.covered(data, identifier)):
                raise WrongCheckError("checksum", path=path)
        return values

    def look(self, data: bytes, end: int) -> Container:
        """Return the fields of a packet's bytes up to `end`, in physical units, as far as they can be read: whether it
        is whole, and its check, are not asked."""
        values, context = Container(), Container(raw=False)
        context._params = context
        with suppress(Exception):  # whatever a construct raises, construct's own or a user's
            self._fields(values, data, end, context, "(looking)")
        return values

    def _fields(self, values: Container, data: bytes, end: int, context: Container, path: str) -> None:
        """Read head fields and payload into `values`."""
        message = self.message
        inner = Container(
            _=context, _params=context._params, _root=None, _parsing=True, _building=False, _sizing=False
        )
        for head in message.heads:
            self._read_head(head, data, context, values, f"{path} -> {head.name}")
        inner.update(values)
        for head in message.heads_written:
            if head.name and (
                head.is_constant or (message.framing and head.offset < message.framing.head_end)
            ):
                inner[head.name] = head.number(data)
        body = io.BytesIO(data[message.payload_start : end])
        try:
            payload = message.payload._parsereport(body, inner, path)
        except StreamError as error:
            raise LengthError(message, str(error), path, error) from None
        if body.read(1):
            raise LengthError(message, "bytes left over", path)
        for name in message.payload_names:
            values[name] = payload.get(name)  # a StopIf leaves the fields behind it out

    @staticmethod
    def _read_head(head: Head, data: bytes, context: Container, values: Container, path: str) -> None:
        if head.pattern is not None and not head.is_own:
            _read_captures(head.pattern, head.pattern.match(head.number(data)) or {}, context, values)
        elif head.name is not None and not head.is_constant:
            values[head.name] = head.field._parsereport(
                io.BytesIO(data[head.offset : head.offset + head.size]), context, path
            )

    # ------------------------------------------------------------------ building

    def _build(self, obj: Any, stream: BinaryIO, context: Container, path: str) -> Any:
        message = self.message
        raw = is_raw(context)
        for name, flags in self._flags.items():
            if name in obj:  # what is present by its bits reads the number
                obj = {**obj, name: flags.to_raw(obj[name], f"{path} -> {name}")}
        inner = Container(
            _=context, _params=context._params, _root=None, _parsing=False, _building=True, _sizing=False
        )
        inner.update(
            {
                h.name: h.pattern.constant
                for h in message.heads_written
                if h.name and h.pattern and h.is_constant
            }
        )
        inner.update({k: v for k, v in obj.items() if not k.startswith("_")})
        written = b"".join(
            self._head_bytes(h, obj, context, raw, f"{path} -> {h.name}")
            for h in message.heads_written
            if h not in message.overlaid
        )
        values: Any = obj
        check = message.check
        if check is not None and check.field is not None:
            values = {**obj, check.field: 0}
        body = io.BytesIO()
        message.payload._build(Container(values), body, inner, path)
        if message.framing is not None:
            packet = self.framed(message.framing, written, body.getvalue(), message.question(obj))
            if check is not None:
                packet = self._checked(check, message.framing, packet, written, body.getvalue(), obj)
            stream.write(packet)
            return obj
        data = written + body.getvalue()
        captures = _captured(message.identifier, obj, raw, path)
        identifier = message.identifier.number(captures)
        if message.identifier.match(identifier) is None:
            raise FieldError(f"{path}: no identifier for {captures}")
        if message.lengths is not None and len(data) not in message.lengths:
            raise FieldError(
                f"{path}: {len(data)} bytes of data; {message.name} has {message.describe_lengths}"
            )
        if check is not None:
            data = self._with_check(check, data, identifier)
        stream.write(
            can_image(identifier, data, extended=message.extended, remote=message.remote, fd=message.fd)
        )
        return obj

    def _head_bytes(self, head: Head, obj: Any, context: Container, raw: bool, path: str) -> bytes:
        framing = self.message.framing
        if framing is not None and head.name in framing.derived:
            return bytes(head.size)
        if head.pattern is not None and not head.is_own:
            return head.bytes(head.pattern.number(_captured(head.pattern, obj, raw, path)))
        if head.name is None:
            return bytes(head.field.build(None))
        out = io.BytesIO()
        value = obj.get(head.name) if head.field.flagbuildnone else _given(obj, head.name, path)
        head.field._build(value, out, context, path)
        written = out.getvalue()
        if (
            head.pattern is not None
            and head.pattern.match(int.from_bytes(written, "big" if head.order == "big" else "little"))
            is None
        ):
            wanted = _described(head.pattern)
            raise FieldError(f"{path}: {value!r} does not go with {self.message.name} ({wanted})")
        return written

    @cached_property
    def _is_filled_up(self) -> bool:
        """True if the last field, left out when sending, takes the zeros that make the packet a framing's `multiple=`."""
        last = self.message.payload
        if isinstance(last, Struct) and last.subcons:
            last = last.subcons[-1]
        while isinstance(last, Renamed):
            last = last.subcon
        return isinstance(last, Default) and innermost(last) is GreedyBytes

    def framed(self, framing: Framing, head: bytes, body: bytes, request: bytes = b"") -> bytes:
        """Return the packet of a head and a body; `request` is the packet that it answers, for a check that covers it."""
        inside = max(0, framing.head_end - self.message.payload_start)
        least = self.message.least - inside
        packet, body = framing.sync + head + body[:inside], body[inside:]
        behind = b""
        for over in self.message.overlaid:
            if over.pattern is not None and over.pattern.match(over.number(packet)) is None:
                raise FieldError(
                    f"{self.message.name}: by its fields {over.name} is {over.number(packet):#04x},"
                    f" which does not go with it ({_described(over.pattern)})"
                )
        if framing.affine is not None and (size := framing.affine.trailing(packet)):
            if len(body) < least + size:
                name = framing.affine.flags.name if framing.affine.flags is not None else ""
                raise FieldError(
                    f"{self.message.name}: by its {name} {size} bytes are behind its check; its last field ends with them"
                )
            body, behind = body[:-size], body[-size:]
        if framing.sizes and len(body) > least and not body[-1]:
            raise FieldError(f"{self.message.name}: zeros at its end are not sent; leave them out")
        if framing.stuffing is not None and framing.affine is not None:
            packet = packet[: framing.head_end] + framing.stuffing.stuff(packet[framing.head_end :] + body)
        else:
            packet += body
        size = len(packet) + framing.check_size
        if (missing := -size % framing.multiple) and not self._is_filled_up:
            raise FieldError(
                f"{self.message.name}: these fields make a packet of {size} bytes, and those of {framing.name} have"
                f" a multiple of {framing.multiple}: give {missing} more, or end the message with"
                f' "padding" / Default(GreedyBytes, b"")'
            )
        packet += bytes(missing)
        size += missing
        if framing.affine is not None:
            length = framing.affine.length
            if size > framing.max_size:
                raise FieldError(
                    f"{self.message.name}: a packet of {size} bytes is longer than {framing.max_size}"
                )
            number = framing.affine.invert(size)
            if number is None:
                raise FieldError(f"{self.message.name}: no {length.name} gives a packet of {size} bytes")
            wanted = self.message.length_pattern
            if wanted is not None and wanted.match(number) is None:
                raise FieldError(
                    f"{self.message.name}: a packet of {size} bytes has {length.name} {number};"
                    f" this message has {_described(wanted)}"
                )
            packet = packet[: length.offset] + length.bytes(number) + packet[length.offset + length.size :]
        elif framing.measure is not None:
            said = framing.measure.size_of(packet)
            if said != size:
                raise FieldError(
                    f"{self.message.name}: by its bits a packet has {said} bytes ({framing.measure.describe}),"
                    f" these fields make {size}"
                )
        elif framing.fixed_size is not None and size != framing.fixed_size:
            raise FieldError(
                f"{self.message.name}: a packet of {size} bytes; its framing has {framing.fixed_size}"
            )
        if framing.check is not None:
            # Slices of the check count from the whole packet's end, so its room must be there.
            room = bytes(framing.check_size)
            whole = packet + (framing.end + room if framing.check_behind else room + framing.end)
            written = framing.check.encode(framing.check_covers(whole, self.message.check_extra, request))
            at = framing.check_at if framing.check_head is not None else len(packet)
            if framing.check_behind:
                behind = written
            else:
                packet = packet[:at] + written + packet[at + len(written) :]
        if framing.end:
            if len(packet) == len(framing.sync):
                raise FieldError(
                    f"{self.message.name}: with nothing before its end a packet would not be read as one"
                )
            if framing.stuffing is not None:
                packet = framing.sync + framing.stuffing.stuff(packet[len(framing.sync) :])
            if (framing.short_end or framing.end) in packet[len(framing.sync) :]:
                raise FieldError(f"{self.message.name}: the bytes that end a packet occur inside it")
            if framing.strays(packet, len(framing.sync), len(packet)):
                never = framing.not_inside.hex(" ").upper()
                raise FieldError(
                    f"{self.message.name}: no packet may have one of the bytes {never} inside it"
                )
            packet += framing.end
        packet += behind
        if framing.not_next and packet[len(framing.sync)] in framing.not_next:
            followed = f"{packet[len(framing.sync)]:02X} behind {framing.sync.hex(' ').upper()}"
            raise FieldError(
                f"{self.message.name}: {followed} would not be read as a packet; choose other values"
            )
        if len(packet) > framing.max_size:
            raise FieldError(
                f"{self.message.name}: a packet of {len(packet)} bytes is longer than {framing.max_size}"
            )
        return packet

    def _checked(
        self, check: Check, framing: Framing, packet: bytes, head: bytes, body: bytes, obj: Any
    ) -> bytes:
        """Return a packet with the message's own check, which covers what else is in `packet`."""
        start, size, _ = self.message.check_span
        whole = self._with_check(check, framing.logical(packet), 0)
        at = start - self.message.payload_start
        body = body[:at] + whole[start : start + size] + body[at + size :]
        found = self.framed(framing, head, body, self.message.question(obj))
        if self._with_check(check, plain := framing.logical(found), 0) != plain:
            raise FieldError(
                f"{self.message.name}: its check covers what the check itself changes: say in over= what it covers"
            )
        return found

    def _with_check(self, check: Check, data: bytes, identifier: int) -> bytes:
        message = self.message
        number = check.compute(message.covered(data, identifier))
        start, size, order = message.check_span
        return data[:start] + number.to_bytes(size, order) + data[start + size :]

    def _sizeof(self, context: Container, path: str) -> int:
        from construct import SizeofError

        raise SizeofError("a packet's size depends on its message", path=path)


def _read_captures(
    pattern: IdPattern, captures: Mapping[str, int], context: Container, values: Container
) -> None:
    """Put the parts of a number into `values`."""
    for capture in pattern.captures:
        raw = captures[capture.name]
        values[capture.name] = raw if is_raw(context) else capture.to_physical(raw)


def _captured(pattern: IdPattern, obj: Any, raw: bool, path: str) -> dict[str, int]:
    """Return the raw parts of a number, from the fields that are given."""
    given = {capture: _given(obj, capture.name, path) for capture in pattern.captures}
    return {
        capture.name: index(value) if raw else capture.to_raw(value, f"{path} -> {capture.name}")
        for capture, value in given.items()
    }


def _described(pattern: IdPattern) -> str:
    """Return the numbers of a pattern where they are a plain set, else as the sheet would write it."""
    if not pattern.constant and len(pattern.captures) == 1 and not pattern.captures[0].shift:
        return describe_values(pattern.captures[0].values)
    return pattern.describe(2)


def _given(obj: Any, name: str, path: str) -> Any:
    if name not in obj:
        raise FieldError(f"{path}: no value given for {name!r}")
    return obj[name]

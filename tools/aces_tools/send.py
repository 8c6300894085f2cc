"""Send a message, once or every so often. Without --tx it only shows it.

  aces send ControlOn board=3 -p hubo
  aces send ControlOn board=3 -p hubo -i socketcan -c can0 --tx
  aces send Reference board=2 position=[100,-40] -p hubo -c can0 --tx \\
       --every 10ms --for 5s
  aces send Read id=1 start=36 count=2 -p robotis --serial /dev/ttyUSB0 \\
       --half-duplex --tx --reply
  aces send 123#DEADBEEF 18FEF100#R8 -i socketcan -c can0 --tx
  aces send '#FFFF010201FB' --serial /dev/ttyUSB0 --tx

Values are in the sheet's units, and checked against the ranges of the spec.
Identifier, length and check are written by the protocol; so is a rolling
counter that is not given.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from typing import Any

from aces_bus.errors import CallerError, UnknownNameError
from aces_bus.frames import Frame, message_to_frame
from aces_bus.protocol import Variant, make_scanner
from aces_bus.protocol.declare.message import Message
from aces_bus.recordings.candump.line import read_line
from aces_bus.recordings.text.rows import UnreadableRow

from .bus_arg import CAN_OPTIONS, ChosenBus, add_bus_arguments, chosen_bus
from .console import Output, abandon_stdout, say, terminal_width, wants_colour
from .live import LINGER_S, LivePatience, SendQueue, Told, parse_duration
from .live_text import LiveText, Times, notation
from .output.shape import plans_of
from .protocols_arg import parse_protocols
from .replies import Replies, Word
from .values import parse_fields

RATE = 1000.0
REPLY = "0.5s"

EPILOG = """\
values:
  board=3  mode=torque  error=hot|cold  data=0a00  name="left arm"
  position=[120,-4]  or  position.0=120 position.1=-4
  servos=[{id=1,data=hex:0a00}]  temperature=none

raw frames, as cansend takes them: 123#DEADBEEF, 12345678#00 (29 bits),
123##1AABB (FD, flags 1: bit rate switch), 123#R8 (remote); '#0A0B' are the
bytes of a serial line or a datagram.

--every keeps absolute deadlines: what comes too late is left out and counted
(late), never made up for. --rate bounds what one call may do to a bus.

--reply prints the decoded answer: the first message that the protocol says
answers this one, or, where it says nothing of the kind, the first that comes.

summary (last on stderr): sent= failed= late= (and replies=)
exit status: 0; 1 when something was not sent, or no reply came; 2 a wrong
call, a value that does not fit, or a bus that cannot be opened
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.epilog = EPILOG
    add = parser.add_argument
    add("what", nargs="+", metavar="MESSAGE field=value", help="a message and its fields, or raw frames")
    add("-p", "--protocol", action="append", default=[], metavar="PROTOCOL", help="as of 'aces decode'")
    add("--tx", action="store_true", help="really send; nothing else makes it")
    add("--every", metavar="DURATION", help="send again and again: 10ms, 0.5s")
    add("-n", "--count", type=int, metavar="N", help="with --every: so many times")
    add("--for", dest="duration", metavar="DURATION", help="with --every: for so long")
    add(
        "--rate", type=float, default=RATE, metavar="N", help=f"at most N frames a second (default: {RATE:g})"
    )
    add(
        "--reply",
        nargs="?",
        const=REPLY,
        metavar="DURATION",
        help=f"print the reply, decoded, when it comes within this time (default: {REPLY})",
    )
    add("--bits", action="store_true", help="without --tx: also draw the layout of the message")
    add("--format", choices=["text", "jsonl"], default="text", help="of what is printed (default: text)")
    add(
        "--color",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="colour, also where the output is no terminal; or never",
    )
    add_bus_arguments(parser)


def run(arguments: argparse.Namespace) -> int:
    sending = Sending(arguments)
    return sending.run() if arguments.tx else sending.show()


class Sending:
    """One run of `aces send`. A wrong call raises before anything is opened."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self.arguments = arguments
        self.variants = parse_protocols(arguments.protocol)
        self.variant: Variant | None = None
        self.message: Message | None = None
        self.fields: dict[str, Any] = {}
        #: Makes what is sent next: counters go on.
        self.make: Callable[[], list[Word]] = self._raw() if "#" in arguments.what[0] else self._message()
        self.first = self.make()
        self.is_can = isinstance(self.first[0], Frame)
        self.every, self.count, self.until = self._often()
        self.reply_ns = None if arguments.reply is None else parse_duration("--reply", arguments.reply)
        if self.reply_ns is not None and not arguments.tx:
            raise CallerError("--reply waits for an answer, and without --tx nothing is sent")
        is_named = any(name in arguments for name in CAN_OPTIONS) or arguments.serial or arguments.udp
        self.bus: ChosenBus | None = None
        if arguments.tx or is_named:
            self.bus = chosen_bus(arguments, self.variants)
            if (self.bus.kind == "can") != self.is_can:
                what, where = ("CAN frames", "no CAN bus") if self.is_can else ("bytes", "a CAN bus")
                raise CallerError(f"these are {what}, and {self.bus.name} is {where}")
        self.plans = plans_of(self.variants)
        self.output = Output(None)
        self.late = 0

    # ------------------------------------------------------------------ what is sent

    def _raw(self) -> Callable[[], list[Word]]:
        words = [raw_word(text) for text in self.arguments.what]
        if len({isinstance(word, Frame) for word in words}) > 1:
            raise CallerError("CAN frames and bytes of a line do not go to one bus")
        return lambda: words

    def _message(self) -> Callable[[], list[Word]]:
        name, *texts = self.arguments.what
        if not self.variants:
            raise CallerError(
                f"{name}: name the protocol that has this message: -p NAME; a raw frame is written 123#DEADBEEF"
            )
        found = [variant for variant in self.variants if name in variant.messages]
        if not found:
            raise UnknownNameError(
                "message", name, {one for variant in self.variants for one in variant.messages}
            )
        self.variant, self.message = found[0], found[0].messages[name]
        self.fields = parse_fields(self.message, texts)
        encoder = self.variant.encoder
        return lambda: [_word(encoder.next(name, **self.fields))]

    def _often(self) -> tuple[int | None, int | None, int | None]:
        """The period, how many times, and for how long, in ns."""
        arguments = self.arguments
        if not arguments.rate > 0:
            raise CallerError(f"--rate {arguments.rate:g}: a rate is a number above 0")
        if arguments.every is None:
            for option, value in (("--count", arguments.count), ("--for", arguments.duration)):
                if value is not None:
                    raise CallerError(
                        f"{option} is for what is sent again and again; say how often: --every 10ms"
                    )
            return None, None, None
        every = parse_duration("--every", arguments.every)
        rate = 1e9 * len(self.first) / every
        if rate > arguments.rate:
            raise CallerError(
                f"--every {arguments.every} is {rate:g} frames/s, and at most {arguments.rate:g} are allowed; if the bus"
                f" stands it: --rate {rate:g}"
            )
        if arguments.count is not None and arguments.count < 1:
            raise CallerError(f"--count {arguments.count}: at least once")
        duration = None if arguments.duration is None else parse_duration("--for", arguments.duration)
        return every, arguments.count, duration

    # ------------------------------------------------------------------ without --tx

    def show(self) -> int:
        """Print what would be sent, and send nothing."""
        writer = self.writer()
        self.output.write(writer.begin(self._where, self.link))
        lines: list[str] = []
        for word in self.first:
            items = self._decoded(word)
            if self.arguments.format == "jsonl":
                self.output.write(writer.items(items))
                continue
            lines.append(
                f"{self._where}  {notation(word) if isinstance(word, Frame) else word.hex(' ').upper()}"
            )
            self.output.write("".join(f"{line}\n" for line in lines).encode())
            lines.clear()
            if self.plans:
                self.output.write(writer.items(items))
        if self.arguments.bits and self.message is not None:
            from aces_bus.protocol.draw import picture

            self.output.write("".join(f"{line}\n" for line in ["", *picture(self.message)]).encode())
        self.output.close()
        say("nothing was sent: add --tx" + ("" if self.bus is not None else " and a bus"))
        return 0

    @property
    def _where(self) -> str:
        return self.bus.name if self.bus is not None else "can" if self.is_can else "line"

    @property
    def link(self) -> str:
        """What writers call the kind of bus."""
        return "can" if self.is_can else "serial"

    def _decoded(self, word: Word) -> list[Any]:
        """What a receiver would make of it."""
        if not self.variants:
            from aces_bus.protocol import Meta, Unknown

            if isinstance(word, bytes):
                return [
                    Unknown("unknown", Meta(None, None, None, None, None, word, offset=0, size=len(word)))
                ]
            from aces_bus.protocol import CanScanner

            return CanScanner((), include_unknown=True).feed([word])
        direction = self.message.direction if self.message is not None else None
        scanner: Any = make_scanner(self.variants, direction=direction or "both", include_unknown=True)
        return list(scanner.feed([word]) if isinstance(word, Frame) else scanner.datagram(word))

    def writer(self) -> Any:
        """What prints records."""
        if self.arguments.format == "jsonl":
            from .output.jsonl import JsonLines

            return JsonLines(self.plans, None)
        from .output.text import make_paint, no_paint

        is_terminal = self.output.is_terminal
        return _Untitled(
            self.plans,
            None,
            times=Times("z"),
            paint=make_paint() if wants_colour(self.arguments.color, is_terminal) else no_paint,
            width=terminal_width() if is_terminal else None,
            encoding=self.output.encoding,
        )

    # ------------------------------------------------------------------ with --tx

    def run(self) -> int:
        """Send."""
        assert self.bus is not None
        gate = self.bus.gate(listen_only=False, send_rate=self.arguments.rate if self.is_can else None)
        told = Told(gate)
        replies = self._replies(gate)
        outgoing = SendQueue(gate)
        status = 0
        with LivePatience() as patience:
            self.bus.start(gate)
            try:
                self._send(outgoing, patience, told, replies)
                outgoing.drain()
                patience.wait_until(time.monotonic_ns() + round(LINGER_S * 1e9))
                if replies is not None:
                    replies.wait(patience)
                self.output.close()
            except BrokenPipeError:
                abandon_stdout()
            except KeyboardInterrupt:
                status = 130
            except CallerError as error:  # the gate takes no more
                say(str(error))
                status = 1
            finally:
                gate.stop()
                told.tell(last=True)
            counters = gate.counters
            if replies is not None and not replies.count:
                say(f"{self.bus.name}: no reply within {self.arguments.reply}")
                status = status or 1
            unit = "bytes" if gate.items == "pieces" else gate.items
            line = f"sent={counters.sent} failed={counters.send_failed} late={self.late}"
            if missed := counters.not_sent - counters.send_failed:
                line += f" unsent={missed}"
            if unit == "bytes":
                line = f"packets={outgoing.items} {line}"
            say(line + (f" replies={replies.count}" if replies is not None else ""), who="")
            if counters.not_sent:
                status = status or 1
        return status

    def _replies(self, gate: Any) -> Replies | None:
        if self.reply_ns is None:
            return None
        writer = self.writer() if self.variants else None
        made = Replies(self.output, writer, gate, self.link, wait_ns=self.reply_ns)
        if self.variants:
            made.decode(self.variants, self.variant, self.message, self.fields)
        return made

    def _send(self, outgoing: SendQueue, patience: LivePatience, told: Told, replies: Replies | None) -> None:
        words = self.first
        due = time.monotonic_ns()
        until = None if self.until is None else due + self.until
        number = 0
        while not patience.is_over:
            if outgoing.pending <= 2 * _size(words):
                for word in words:
                    if replies is not None:
                        replies.sent(word)
                    outgoing.send(word)
                number += 1
                if self.every is None or number == self.count:
                    return
                words = self.make()
            else:
                self.late += 1  # what was sent before has not left: what is old must not pile up
            told.tell()
            due += self.every or 0
            behind = time.monotonic_ns() - due
            if self.every and behind >= self.every:
                self.late += behind // self.every
                due += behind // self.every * self.every
            if until is not None and due >= until:
                return
            if replies is not None:
                replies.take(0)
            if not patience.wait_until(due):
                return


def _size(words: Sequence[Word]) -> int:
    return sum(1 if isinstance(word, Frame) else len(word) for word in words)


def raw_word(text: str) -> Word:
    """A raw frame from `123#DEADBEEF`, or bytes from `#DEADBEEF`; raises `CallerError`."""
    if text.startswith("#"):
        try:
            data = bytes.fromhex(text[1:].replace(".", ""))
        except ValueError:
            raise CallerError(
                f"{text!r}: bytes are written as hexadecimal digits, two a byte: #FF00"
            ) from None
        if not data:
            raise CallerError(f"{text!r}: no bytes to send")
        return data
    if "#" not in text:
        raise CallerError(f"{text!r} is not a raw frame as the first one is; write 123#DEADBEEF")
    try:
        frame = read_line(b"(0.0) x " + text.encode("utf-8", "replace"))
    except UnreadableRow as error:
        raise CallerError(
            f"{text!r} is not a frame: {error}; write 123#DEADBEEF, 12345678#00 or 123#R8"
        ) from None
    if frame.is_error_frame:
        raise CallerError(f"{text!r}: error frames are made by controllers; they cannot be sent")
    return message_to_frame(frame)


def _word(made: Any) -> Word:
    """What an encoder made: a python-can message as a frame, bytes as they are."""
    return made if isinstance(made, bytes) else message_to_frame(made)


class _Untitled(LiveText):
    """Lines without the name of a source above them."""

    def _title(self) -> list[str]:
        self._is_titled = True
        return []


__all__ = ["Sending", "add_arguments", "raw_word", "run"]

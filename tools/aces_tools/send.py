"""Send a message, once or periodically. Without --tx it is only shown.

  aces send ControlOn board=3 -p hubo
  aces send ControlOn board=3 -p hubo -i socketcan -c can0 --tx
  aces send Reference board=2 position=[100,-40] -p hubo -c can0 --tx \\
       --every 10ms --for 5s
  aces send Read id=1 start=present_position -p robotis --half-duplex \\
       --serial /dev/ttyUSB0 --tx --reply
  aces send Write id=1 goal_position=150 -p robotis --serial /dev/ttyUSB0 --tx
  aces send 123#DEADBEEF 18FEF100#R8 -i socketcan -c can0 --tx
  aces send '#FFFF010201FB' --serial /dev/ttyUSB0 --tx

Values are in the units of the device's documentation, and checked against the
ranges of the spec. The protocol adds identifier, length and check, and a
rolling counter where none is given.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from typing import Any

import msgspec

from aces_bus import Frame, Unknown, make_scanner
from aces_bus.errors import CallerError, DeviceError, UnknownNameError
from aces_bus.frames import message_to_frame
from aces_bus.hardware import CanGate, DatagramGate, SerialGate
from aces_bus.protocol import CanScanner, Message, Record, Variant
from aces_bus.protocol.draw.text import picture
from aces_bus.protocol.record import FieldValue, Meta
from aces_bus.recordings.base import Chunk
from aces_bus.recordings.candump.line import read_line
from aces_bus.recordings.text.rows import UnreadableRow

from .bus_arg import BUS_ARGUMENTS, CAN_OPTIONS, ChosenBus, chosen_bus
from .console import ENDLESS, Output, abandon_stdout, say, say_note, terminal_width, wants_colour
from .live import LINGER_S, BusEventLines, SendQueue, received_frame
from .live_text import CandumpLines, notation
from .options import COLOR, COUNT, EVERY, FOR, PROTOCOL, RATE, TX, Arguments, argument, duration, flag
from .output.shape import plans_of
from .output.text import TextOutput, Times
from .patience import Patience
from .protocols_arg import parse_protocols
from .registers import RegisterNotes, with_registers
from .values import parse_fields

#: Frames a second, unless --rate says otherwise.
LIMIT_HZ = 1000.0

SUMMARY = "send a message, once or periodically; only with --tx"

EPILOG = """\
values:
  board=3  mode=torque  error=hot|cold  data=0a00  name="left arm"
  position=[120,-4]  or  position.0=120 position.1=-4
  servos=[{id=1,data=hex:0a00}]  temperature=none
  start=present_position          a register's address, by name
  goal_position=150               in messages with start and data: both of them

raw frames, as cansend takes them: 123#DEADBEEF, 12345678#00 (29 bits),
123##1AABB (FD, flags 1: bit rate switch), 123#R8 (remote); '#0A0B' are the
bytes of a serial line or a datagram.

--every keeps absolute deadlines: what comes too late is left out and counted
(late), never made up for. --rate bounds what one call may do to a bus.

A message in several frames waits for its receiver's go-aheads (ISO-TP, J1939)
and obeys them; with --reply its answer is let go on.

--reply prints the decoded answer: the first message that the protocol says
answers this one, or, where it says nothing of the kind, the first that comes.

summary (last on stderr): sent= failed= late= (and replies=)
exit status: 0; 1 when something was not sent, or no reply came; 2 a wrong
call, a value that does not fit, or a bus that cannot be opened
"""


ARGUMENTS: Arguments = (
    argument(
        "what", nargs="+", metavar="MESSAGE field=value", help="a message and its fields, or raw frames"
    ),
    PROTOCOL,
    TX,
    EVERY.but(help="send again and again: 10ms, 0.5s"),
    COUNT.but(help="with --every: this many times"),
    FOR.but(help="with --every: for this time"),
    RATE.but(default=LIMIT_HZ, help="at most N frames a second (default: %(default)g)"),
    argument(
        "--reply",
        nargs="?",
        type=duration,
        const="0.5s",
        metavar="DURATION",
        help="print the reply, decoded, when it comes within this time (default: 0.5s)",
    ),
    flag("--bits", help="without --tx: also draw the layout of the message"),
    argument(
        "--format", choices=["text", "jsonl"], default="text", help="of what is printed (default: text)"
    ),
    COLOR,
    *BUS_ARGUMENTS,
)


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
        self.fields: dict[str, FieldValue] = {}
        #: Makes what is sent next: counters go on.
        self.make: Callable[[], list[Packet]] = self._raw() if "#" in arguments.what[0] else self._message()
        self.first = self.make()
        self.is_can = isinstance(self.first[0], Frame)
        carrier = self.message.transport if self.message is not None and len(self.first) > 1 else None
        if arguments.tx and carrier is not None and carrier.unsendable:
            raise CallerError(f"{arguments.what[0]} is not sent by {carrier.title}: {carrier.unsendable}")
        self.every, self.count, self.until = self._often()
        self.reply_ns: int | None = arguments.reply
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
        self.registers = RegisterNotes(self.variants)
        self.output = Output(None)
        self.late = 0
        #: What sends packets with a handshake, where the message's transport wants one.
        self._session: Any = None

    # ------------------------------------------------------------------ what is sent

    def _raw(self) -> Callable[[], list[Packet]]:
        packets = [raw_packet(text) for text in self.arguments.what]
        if len({isinstance(packet, Frame) for packet in packets}) > 1:
            raise CallerError("CAN frames and bytes of a line do not go to one bus")
        return lambda: packets

    def _message(self) -> Callable[[], list[Packet]]:
        name, *texts = self.arguments.what
        if not self.variants:
            raise CallerError(
                f"{name}: name the protocol that has this message: -p NAME; a raw frame is written 123#DEADBEEF"
            )
        found = [variant for variant in self.variants if name in variant.messages]
        if not found:
            raise UnknownNameError(
                "message",
                name,
                {message_name for variant in self.variants for message_name in variant.messages},
            )
        self.variant, self.message = found[0], found[0].messages[name]
        self.fields = parse_fields(self.message, with_registers(self.message, texts))
        encoder = self.variant.encoder
        return lambda: _packets(encoder.next(name, **self.fields))

    def _often(self) -> tuple[int | None, int | None, int | None]:
        """Return the period, how many times, and for how long, in ns."""
        arguments = self.arguments
        if arguments.every is None:
            for option, value in (("--count", arguments.count), ("--for", arguments.duration)):
                if value is not None:
                    raise CallerError(
                        f"{option} is for what is sent again and again; say how often: --every 10ms"
                    )
            return None, None, None
        rate = 1e9 * len(self.first) / arguments.every
        if rate > arguments.rate:
            raise CallerError(
                f"--every {arguments.every / 1e9:g}s is {rate:g} frames/s, and at most {arguments.rate:g} are allowed;"
                f" if the bus can carry it: --rate {rate:g}"
            )
        return arguments.every, arguments.count, arguments.duration

    # ------------------------------------------------------------------ without --tx

    def show(self) -> int:
        """Print what would be sent, and send nothing."""
        writer = self.writer()
        self.output.write(writer.begin(self._where, self.link))
        is_json = self.arguments.format == "jsonl"
        scanner = self._receiver()
        for packet in self.first:
            if not is_json:
                shown = notation(packet) if isinstance(packet, Frame) else packet.hex(" ").upper()
                self.output.write(f"{self._where}  {shown}\n".encode())
            if is_json or self.plans:
                items = self._decoded(scanner, packet)
                self.registers.see(items)
                self.output.write(writer.items(items))
        if self.arguments.bits and self.message is not None:
            self.output.write("".join(f"{line}\n" for line in ["", *picture(self.message)]).encode())
        self.output.close()
        say("nothing was sent: add --tx" + ("" if self.bus is not None else " and a bus"))
        return 0

    @property
    def _where(self) -> str:
        return self.bus.name if self.bus is not None else "can" if self.is_can else "line"

    @property
    def link(self) -> str:
        """Link as writers name it: `can` or `serial`."""
        return "can" if self.is_can else "serial"

    def _receiver(self) -> Any:
        """Return a scanner for what is sent."""
        if not self.variants:
            return CanScanner((), include_unknown=True)
        direction = self.message.direction if self.message is not None else None
        return make_scanner(self.variants, direction=direction or "both", include_unknown=True)

    def _decoded(self, scanner: Any, packet: Packet) -> list[Any]:
        """Return what a receiver would make of it; of a packet in several frames, with its last one."""
        if not self.variants and isinstance(packet, bytes):
            return [
                Unknown("unknown", Meta(None, None, None, None, None, packet, offset=0, size=len(packet)))
            ]
        return list(scanner.feed([packet]) if isinstance(packet, Frame) else scanner.datagram(packet))

    def writer(self) -> Any:
        """Return what prints records in the format that was asked for."""
        if self.arguments.format == "jsonl":
            from .output.jsonl import JsonLines

            return JsonLines(self.plans, None)
        from .output.text import make_paint, no_paint

        is_terminal = self.output.is_terminal
        return TextOutput(
            self.plans,
            None,
            notes=self.registers,
            times=Times("relative"),
            has_title=False,
            paint=make_paint() if wants_colour(self.arguments.color, is_terminal) else no_paint,
            width=terminal_width() if is_terminal else None,
            encoding=self.output.encoding,
        )

    # ------------------------------------------------------------------ with --tx

    def run(self) -> int:
        """Send."""
        assert self.bus is not None
        gate = self.bus.gate(listen_only=False, send_rate=self.arguments.rate if self.is_can else None)
        events = BusEventLines(gate)
        replies = self._replies(gate)
        outgoing = SendQueue(gate)
        self._session = self._handshakes(gate)
        status = 0
        with Patience() as patience:
            self.bus.start(gate)
            try:
                self._send(outgoing, patience, events, replies)
                outgoing.drain()
                patience.wait_until(time.monotonic_ns() + round(LINGER_S * 1e9))
                if replies is not None:
                    replies.wait(patience)
                self.output.close()
            except BrokenPipeError:
                abandon_stdout()
            except KeyboardInterrupt:
                status = 130
            except (CallerError, DeviceError) as error:  # the gate takes no more, or a receiver no packet
                say(str(error))
                status = 1
            finally:
                if self._session is not None:
                    self._session.close()
                gate.stop()
                events.report(last=True)
            counters = gate.counters
            if replies is not None and self.reply_ns is not None and not replies.count:
                say(f"{self.bus.name}: no reply within {self.reply_ns / 1e9:g} s")
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

    def _handshakes(self, gate: CanGate | SerialGate | DatagramGate) -> Any:
        """Return what sends packets that take a handshake, or pauses, and lets their answers go on; None where there
        is neither.
        """
        carrier = None if self.message is None else self.message.transport
        if carrier is None or self.variant is None or (len(self.first) == 1 and self.reply_ns is None):
            return None
        from aces_bus.device import PacketSender

        return PacketSender(gate, [self.variant], self._is_answer)

    def _is_answer(self, key: int, data: bytes) -> bool:
        """Return whether the packet that a frame begins may be the reply that is waited for."""
        if self.variant is None or self.reply_ns is None:
            return False
        sent = [self.message] if self.message is not None else []
        for name in answers(self.variant, self.message):
            found = self.variant.messages[name]
            if found.transport is not None and found.transport.is_for(key, data, found, self.fields, sent):
                return True
        return False

    def _replies(self, gate: CanGate | SerialGate | DatagramGate) -> Replies | None:
        if self.reply_ns is None:
            return None
        writer = self.writer() if self.variants else None
        made = Replies(self.output, writer, gate, self.link, wait_ns=self.reply_ns)
        if self.variants:
            made.decode(self.variants, self.variant, self.message, self.fields, self.registers)
        return made

    def _send(
        self, outgoing: SendQueue, patience: Patience, events: BusEventLines, replies: Replies | None
    ) -> None:
        packets = self.first
        if self.every is not None and self.count is None and self.until is None:
            say_note(ENDLESS)
        due = time.monotonic_ns()
        until = None if self.until is None else due + self.until
        number = 0
        while not patience.is_over:
            if outgoing.pending <= 2 * sum(
                1 if isinstance(packet, Frame) else len(packet) for packet in packets
            ):
                for packet in packets:
                    if replies is not None:
                        replies.sent(packet)
                    if self._session is None:
                        outgoing.send(packet)
                if self._session is not None:
                    self._session.send(packets)
                number += 1
                if self.every is None or number == self.count:
                    return
                packets = self.make()
            else:
                self.late += 1  # what was sent before has not left: what is old must not pile up
            events.report()
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


def raw_packet(text: str) -> Packet:
    """Return a raw frame from `123#DEADBEEF`, or bytes from `#DEADBEEF`; raises `CallerError`."""
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


def _packets(made: Any) -> list[Packet]:
    """Return all frames or packets of what an encoder made."""
    return made if isinstance(made, list) else [made]


# ---------------------------------------------------------------------- replies

#: A frame (CAN), or the bytes of a packet.
Packet = Frame | bytes
#: Seconds between two looks at whether the wait is over.
LOOK_S = 0.05


class Replies:
    """Listens to a gate from when it is made; `count` is how many replies were printed."""

    def __init__(self, output: Output, writer: Any, gate: Any, link: str, *, wait_ns: int) -> None:
        self._output, self._writer, self._link = output, writer, link
        self._name: str = gate.name
        self._is_datagrams = gate.items == "datagrams"
        self._inbox = gate.subscribe()
        self._wait_ns = wait_ns
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._scanner: Any = None
        self._expected: frozenset[str] = frozenset()
        self._is_broadcast = False
        self._lines = CandumpLines(Times("relative"), encoding=output.encoding)
        self._is_begun = False
        self.count = 0

    def decode(
        self,
        variants: Sequence[Variant],
        variant: Variant | None,
        message: Message | None,
        fields: dict[str, Any],
        registers: RegisterNotes,
    ) -> None:
        """Decode what comes; `message` of `variant`, with these fields, is what was asked; `registers` is the writer's."""
        self._registers = registers
        messages_for: Any = (
            "from device" if message is not None and message.direction == "to device" else "both"
        )
        self._scanner = make_scanner(variants, direction=messages_for)
        #: What reads back what is sent.
        self._requests: Any = make_scanner(variants, direction="to device")
        self._expected = answers(variant, message)
        every = variant.protocol.broadcast.items() if variant is not None else ()
        self._is_broadcast = any(fields.get(name) == number for name, number in every)

    def sent(self, packet: Packet) -> None:
        """Remember what the reply will be to."""
        self.take(0)
        if self._scanner is None:
            return
        now = (time.monotonic_ns() + self._epoch_ns) / 1e9
        if isinstance(packet, Frame):
            self._scanner.sent(msgspec.structs.replace(packet, timestamp=now, channel=self._name))
        else:
            self._scanner.sent(packet, now)
            self._registers.see(self._requests.datagram(packet))

    def wait(self, patience: Patience) -> None:
        """Wait until the first reply, or until the time is up; of a broadcast all that come in time."""
        until = time.monotonic_ns() + self._wait_ns
        while not patience.is_over and (not self.count or self._is_broadcast):
            left = until - time.monotonic_ns()
            if left <= 0:
                return
            self.take(min(left / 1e9, LOOK_S))

    def take(self, timeout: float) -> None:
        """Print the replies that have come; wait so long (s) for the first."""
        for item in self._inbox.get(timeout):
            if self._scanner is None:
                self._unnamed(item)
                continue
            items = self._decoded(item)
            wanted = [
                record for record in items if not self._expected or type(record).__name__ in self._expected
            ]
            if not wanted:
                continue
            self._registers.see(items)
            if not self._is_begun:
                self._is_begun = True
                self._output.write(self._writer.begin(self._name, self._link, wanted[0].meta.time))
            self._print(self._writer.items(wanted), len(wanted))

    def _decoded(self, item: Record) -> list[Any]:
        seconds = (item.host_ns + self._epoch_ns) / 1e9
        found: list[Any]
        if self._link == "can":
            found = self._scanner.feed(
                [msgspec.structs.replace(item.content, timestamp=seconds, channel=self._name)]
            )
        elif self._is_datagrams:
            found = self._scanner.datagram(item.content, seconds)
        else:
            found = self._scanner.feed(item.content, seconds)
        return found

    def _unnamed(self, item: Any) -> None:
        data = (
            self._lines.frames([received_frame(item, self._name, self._epoch_ns)])
            if self._link == "can"
            else self._lines.chunks([Chunk(item.content, (item.host_ns + self._epoch_ns) / 1e9)], self._name)
        )
        self._print(data, 1)

    def _print(self, data: bytes, count: int) -> None:
        self._output.write(data)
        self._output.flush()
        self.count += count


def answers(variant: Variant | None, message: Message | None) -> frozenset[str]:
    """Return the messages that the protocol says answer this one."""
    if variant is None or message is None:
        return frozenset()
    return frozenset(
        other.name
        for other in variant.messages.values()
        if any(request.message.name == message.name for request in (*other.reply_to, *other.after))
    )

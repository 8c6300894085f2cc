"""A wrong spec fails when it is imported, with file and line, and says what to do."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest

from aces_bus import Frame
from aces_bus.errors import SpecError
from aces_bus.protocol import Protocol

HEAD = """\
from construct import *
from aces_bus.protocol import *
can = Protocol("can_test", link="can", dialects={"old": "", "new": ""}, configurations={"one": {"kind": {0: 1, 1: 2}}})
wire = Protocol("wire_test", link="serial")
"""

#: name: (the wrong lines, what the message must say; `{line N}` stands for the place of the Nth wrong line)
WRONG = {
    "bit fields that overlap": (
        """
can.message("M", id=1, payload=BitLayout(
    8,
    "current" / bits(12, at=36),
    "status" / Quantity(bits(8, at=44), unit="A"),
))""",
        r"{line 5}: field 'status' overlaps 'current' \({line 4}\) at byte 5 bit 4",
    ),
    "a bit field past its layout": (
        """
can.message("M", id=1, payload=BitLayout(2,
    "a" / bits(12),
    "b" / bits(8)))""",
        r"{line 4}: field 'b' ends at bit 19, past the layout of 2 bytes",
    ),
    "a data id that no byte chooses": (
        """
can.message("M", id=1, payload=Struct("crc" / Byte, "count" / Int16ul),
    check=Crc("CRC8-AUTOSAR", field="crc", over=(slice(1, None), DataIds("count", b"ab"))))""",
        r"{line 2}: 'count', which chooses the data id of M, is not a field of the payload in one byte",
    ),
    "data ids in the check of a framing": (
        """
wire.framing(sync=b"a", size=4, check=Crc("CRC8-AUTOSAR", over=(slice(1, -1), DataIds("count", b"ab"))))""",
        r"{line 2}: DataIds are of a message's own check",
    ),
    "a second end that is not the last bytes of the first": (
        """
wire.framing(sync=b"a", end=(b"\\r\\n", b"\\r"), max_size=9)""",
        r"{line 2}: of two ends the second is the last bytes of the first",
    ),
    "packets of a multiple that their message has not": (
        """
packet = wire.framing(sync=b"a", header=Struct("n" / Byte), size=this.n, multiple=4, max_size=16)
packet("M", payload=Struct("x" / Byte))""",
        r"{line 3}: a packet of M would have 3 bytes, and those of wire_test a multiple of 4; end it with",
    ),
    "a field twice": (
        """
can.message("M", id=1, payload=Struct(
    "speed" / Int16ul,
    "mode" / Byte,
    "speed" / Byte))""",
        r"{line 3}: field 'speed' is declared twice",
    ),
    "a field of the payload named like a captured part": (
        """
can.message("M", id=0x10 + IdField("board", range(4)), payload=Struct(
    "board" / Byte))""",
        r"{line 3}: field 'board' of M is declared twice: in its payload and in its identifier",
    ),
    "a name that records use": (
        """
can.message("M", id=1, payload=Struct("meta" / Byte))""",
        r"{line 2}: field name 'meta' is taken by the record",
    ),
    "a Python keyword": (
        """
can.message("M", id=1, payload=Struct("class" / Byte))""",
        r"{line 2}: 'class' cannot be a field name",
    ),
    "bytes without a name": (
        """
can.message("M", id=1, payload=Struct("a" / Byte, Padding(3)))""",
        r"{line 2}: payload: .*Padd.* has no name, so its bytes would be lost; name it .*Reserved",
    ),
    "an unnamed field": (
        """
can.message("M", id=1, payload=Struct(Byte))""",
        r"{line 2}: payload: .* has no name, so its bytes would be lost",
    ),
    "more fields than a frame holds": (
        """
can.message("M", id=1, payload=Struct("a" / Array(9, Byte)))""",
        r"{line 2}: M has 9 bytes of fields; a classic CAN frame has 8",
    ),
    "a length that does not go with the fields": (
        """
can.message("M", id=1, length=4, payload=Struct("a" / Int64ul))""",
        r"{line 2}: length 4 does not go with the fields of M, which take 8 bytes",
    ),
    "an identifier past 11 bits": (
        """
can.message("M", id=0x7F0 + IdField("node", range(32)))""",
        r"{line 2}: M reaches identifier 0x80f, past 0x7ff; is it extended=True\?",
    ),
    "captures that share bits": (
        """
can.message("M", id=IdField("node", range(64)) << 4 | IdField("command", range(32)))""",
        r"{line 2}: node << 4 \| command share bit 4; shift them apart, or write \+",
    ),
    "a constant that shares bits with a capture": (
        """
can.message("M", id=IdField("node", range(4)) << 4 | 0x18)""",
        r"{line 2}: node << 4 \| 0x18 share bit 4; shift",
    ),
    "captures that share bits when added": (
        """
can.message("M", id=(IdField("node", range(64)) << 4) + IdField("command", range(32)))""",
        r"{line 2}: capture 'command' shares bits",
    ),
    "two messages nobody can tell apart": (
        """
can.message("First", id=0x100, payload=Struct("a" / Int16ul))
can.message("Second", id=0x0F0 + IdField("node", range(32)), payload=Struct("b" / Int16sl))""",
        r"{line 3}: message 'Second' is ambiguous with 'First' \({line 2}\): both accept 100#0000; say what tells",
    ),
    "two stream messages nobody can tell apart": (
        """
frame = wire.framing(sync=b"\\xaa", header=Struct("length" / Byte), size=this.length + 2, max_size=40)
frame("First", payload=Struct("kind" / Byte, "rest" / GreedyBytes))
frame("Second", payload=Struct(Const(7, Byte), "rest" / GreedyBytes))""",
        r"{line 4}: message 'Second' is ambiguous with 'First' \({line 3}\): both accept AA .*07",
    ),
    "a message twice": (
        """
can.message("M", id=1, dialect="old")
can.message("M", id=2)""",
        r"{line 3}: message 'M' is declared twice; the other is at {line 2}",
    ),
    "a dialect that does not exist": (
        """
can.message("M", id=1, dialect="middle")""",
        r"{line 2}: no dialect 'middle' \(there are: .*\)",
    ),
    "a configuration table that does not exist": (
        """
can.configured("colour", by="board")""",
        r"{line 2}: configuration 'one' has no table 'colour'",
    ),
    "a reply to nothing": (
        """
can.message("M", id=1, reply_to="Ask")""",
        r"{line 2}: no message named 'Ask' before this line",
    ),
    "match of a field that is not there": (
        """
family = can.family(id=1, prefix=Struct("opcode" / Byte))
family("M", match={"command": 3})""",
        r"{line 3}: match names 'command', which is not a head field \(there are: opcode\)",
    ),
    "match that does not fit": (
        """
family = can.family(id=1, prefix=Struct("opcode" / Byte))
family("M", opcode=300)""",
        r"{line 3}: opcode is 8 bits wide",
    ),
    "a framing without an end": (
        """
wire.framing(sync=b"\\xaa", max_size=10)""",
        r"{line 2}: a framing ends by one of size",
    ),
    "a framing without a bound": (
        """
wire.framing(sync=b"\\xaa", header=Struct("length" / Byte), size=this.length + 2)""",
        r"{line 2}: max_size= is missing",
    ),
    "a size that cannot be inverted": (
        """
wire.framing(sync=b"\\xaa", header=Struct("length" / Byte), size=this.length * this.length, max_size=99)""",
        r"{line 2}: size must be a whole multiple of 'length'",
    ),
    "an opaque size": (
        """
wire.framing(sync=b"\\xaa", header=Struct("length" / Byte), size=lambda ctx: ctx.size + 1, max_size=99)""",
        r"{line 2}: size must be an expression of header fields",
    ),
    "bits outside of a layout": (
        """
can.message("Torn", id=1, payload=Struct("angle" / Split((0, 8), (16, 8)), "mode" / Byte))""",
        r"{line 2}: the pieces of a Split that is not a field of a BitLayout are whole bytes side by side",
    ),
    "a CRC that is not in the catalogue": (
        """
Crc("CRC16-MODBUSS")""",
        r"{line 2}: no CRC named 'CRC16-MODBUSS' in the catalogue; near: CRC16-MODBUS",
    ),
    "a CRC by the name that sheets give it": (
        """
Crc("CRC-16/CCITT-FALSE")""",
        r"{line 2}: no CRC named 'CRC-16/CCITT-FALSE' in the catalogue; there it is CRC16-IBM-3740",
    ),
    "a CRC in another spelling": (
        """
Crc("crc-8/autosar")""",
        r"{line 2}: no CRC named 'crc-8/autosar' in the catalogue; there it is CRC8-AUTOSAR",
    ),
    "a CRC by a name that means three": (
        """
Crc("CRC-CCITT")""",
        r"{line 2}: no CRC named 'CRC-CCITT' in the catalogue; there it is CRC16-IBM-3740 .*CRC16-XMODEM .*CRC16-KERMIT",
    ),
    "a check without its field": (
        """
can.message("M", id=1, check=Xor(field="crc"), payload=Struct("a" / Byte))""",
        r"{line 2}: check field 'crc' is not a field of M",
    ),
    "two names for one value": (
        """
Enumeration(Byte, idle=0, off=0)""",
        r"{line 2}: enumeration value 0 has two names, 'idle' and 'off'",
    ),
    "two flags on one bit": (
        """
Flags(Byte, hot=3, jam=3)""",
        r"{line 2}: flags 'hot' and 'jam' share bit 3",
    ),
    "a flag outside its field": (
        """
Flags(Byte, hot=8)""",
        r"{line 2}: flag 'hot' is bit 8 of a 8-bit field",
    ),
    "a scale of nothing": (
        """
Quantity(Byte, scale=0)""",
        r"{line 2}: a scale must be finite and not zero",
    ),
    "a selector that comes later": (
        """
can.message("M", id=1, payload=Struct(
    "value" / Multiplexed("mode", 1, Byte),
    "mode" / Byte))""",
        r"{line 3}: field 'value' is multiplexed by 'mode', which is not before it",
    ),
    "fields in a remote frame": (
        """
can.message("M", id=1, remote=True, payload=Struct("a" / Byte))""",
        r"{line 2}: a remote frame carries no data",
    ),
    "registers that overlap": (
        """
frame = wire.framing(sync=b"\\xaa", size=4)
frame("Read", payload=Struct("id" / Byte, "start" / Byte, "count" / Byte))
table = wire.registers(read="Read", write="Read")
table.add("goal", 0x1E, Int16ul)
table.add("speed", 0x1F, Int16ul)""",
        r"{line 6}: register 'speed' \(address 0x1f, 2 bytes\) overlaps 'goal' \(0x1e, 2 bytes\) at {line 5}",
    ),
}


def imported(path: Path) -> None:
    """Import a file as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    spec.loader.exec_module(importlib.util.module_from_spec(spec))


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_spec_fails_at_import_with_its_line(name: str, tmp_path: Path) -> None:
    """The message begins with file and line of the fault, and names both places where two are at odds."""
    lines, wanted = WRONG[name]
    path = tmp_path / "wrong_spec.py"
    path.write_text(HEAD + lines.lstrip("\n") + "\n")
    first = HEAD.count("\n")
    pattern = re.sub(r"\{line (\d+)\}", lambda m: rf"\S*wrong_spec\.py:{first + int(m[1]) - 1}", wanted)
    with pytest.raises(SpecError) as caught:
        imported(path)
    assert re.match(pattern, str(caught.value)), str(caught.value)


def test_a_right_spec_imports(tmp_path: Path) -> None:
    """The head that all wrong specs share is right, so each fails for its own reason only."""
    path = tmp_path / "right_spec.py"
    path.write_text(HEAD)
    imported(path)


def test_a_scanner_knows_what_was_declared_before_it() -> None:
    """Declaring goes on after a first scanner; that one keeps what it knew, the next one knows all."""
    protocol = Protocol("growing", link="can")
    protocol.message("First", id=1)
    early = protocol.scanner()
    protocol.message("Second", id=2)
    frames = [Frame(1), Frame(2)]
    assert [type(r).__name__ for r in early.feed(frames)] == ["First"]
    assert early.counts.unknown == 1
    assert [type(r).__name__ for r in protocol.scanner().feed(frames)] == ["First", "Second"]


@pytest.mark.parametrize(
    ("framing", "message", "wanted"),
    [
        (
            "",
            "kind=2",
            r"a message has no keyword 'kind' \(M\); for the field of the header: match=\{'kind': 2\}",
        ),
        ("", "exmaples=[]", r"no keyword 'exmaples' \(M\); near: examples"),
        ("", 'payload="x" / Byte', r"one field goes into a Struct, too"),
        ("check=Sum", "", r"are made by calling: Sum\(\)"),
        ("size=this.lenght + 4", "", r"not of 'lenght' \(there are: kind, length\)"),
    ],
)
def test_a_newcomers_slips_are_told_from_bugs(
    framing: str, message: str, wanted: str, tmp_path: Path
) -> None:
    """What somebody writes who has read one page: the error says what to write instead."""
    size = "" if "size" in framing else "size=this.length + 4, "
    head = f'header=Struct("kind" / Byte, "length" / Byte), {size}max_size=64'
    for declare in ("packet", 'packet.family(Struct("opcode" / Byte))'):
        path = tmp_path / "slip.py"
        path.write_text(
            f'{HEAD}packet = wire.framing(sync=b"!", {head}, {framing})\n{declare}("M", {message})\n'
        )
        with pytest.raises(SpecError, match=rf"slip\.py:\d+: .*{wanted}"):
            imported(path)

"""The printed C does what the scanner does: a compiler's program reads and writes drawn frames and packets, both ways.

1. What it unpacks are our raw numbers, what it decodes our quantities, to the last bit; what it packs is what came.
2. It is compiled with every warning as an error. Without a compiler on the machine these tests skip.
"""

from __future__ import annotations

import math
import random
import shutil
import subprocess
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from construct import Byte, Float32l, GreedyBytes, Int16ub, Struct, this
from hypothesis import settings

from aces_bus import load_protocol, make_scanner
from aces_bus.protocol import Enumeration, Fletcher, IdField, Protocol, Quantity, Variant
from aces_bus.testing.packets import DrawnPacket, UndrawableError
from aces_lab.exchange import print_c_source
from aces_lab.exchange.export_c import CMessage, CSource
from tests.laws.drawn import drawn_packet
from tests.specs.catalogue import SPECS

CC = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
needs_cc = pytest.mark.skipif(CC is None, reason="no C compiler is installed")
IS_LONG = settings().max_examples > 100
SEEDS = 30 if IS_LONG else 3
#: Messages of a protocol that are compiled in the short profile, about.
MESSAGES = 12
#: Those that C can say something of; in the short profile few, as each is compiled.
NAMES = ["hubo", "robstride", "ubx", "robotis", "automotive"]
MORE = ["canopen", "odrive", "vesc", "vesc_uart", "damiao", "modbus", "feetech", "pololu_qik", "minihubo_adc"]
ALL = [*(name for name in SPECS if name not in NAMES), *MORE]


MAIN = r"""
#include "spec.h"
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void show_bytes(const uint8_t *data, size_t size) {
    size_t at;
    for (at = 0; at < size; at++) printf("%02x", data[at]);
    printf("\n");
}

int main(void) {
    static char text[200000];
    static uint8_t data[100000], out[100000];
    int which;
    unsigned long id;
    while (scanf("%d %lx %199999s", &which, &id, text) == 3) {
        size_t size = strcmp(text, "-") ? strlen(text) / 2 : 0, at;
        uint32_t made = 0;
        int length;
        for (at = 0; at < size; at++) {
            unsigned byte;
            sscanf(text + 2 * at, "%2x", &byte);
            data[at] = (uint8_t)byte;
        }
        switch (which) {
CASES
        }
        (void)made; (void)length; (void)out;
    }
    return 0;
}
"""


def case(number: int, one: CMessage) -> str:
    """What the program does with a frame of a message: it prints members, quantities, and what it packs."""
    is_can = one.message.framing is None
    lines = [
        f"struct {one.name} s;",
        f"if ({one.name}_unpack(&s, {'(uint32_t)id, ' if is_can else ''}data, size))",
    ]
    lines += ['{ printf("refused\\n"); break; }', 'printf("taken\\n");']
    for member in one.fields:
        value = f"s.{member.name}"
        if member.type == "rest":
            lines.append(f"show_bytes({value}, {value}_size);")
        elif member.type == "bytes":
            lines.append(f"show_bytes({value}, sizeof {value});")
        elif member.type in ("float", "double"):
            lines.append(f'printf("%a\\n", (double){value});')
        else:
            kind = "%llu" if member.type.startswith("u") else "%lld"
            cast = "unsigned long long" if member.type.startswith("u") else "long long"
            lines.append(f'printf("{kind}\\n", ({cast}){value});')
        if member.can_decode:
            lines.append(f'printf("%a\\n", {one.name}_{member.name}_decode({value}));')
        if member.can_encode:
            call = f"{one.name}_{member.name}_encode(&again, {one.name}_{member.name}_decode({value}))"
            lines.append(f"{{ {member.type} again = 0; int bad = {call};")
            lines.append(f'printf("%d\\n", bad ? -1 : again == {value}); }}')
    lines.append(f"length = {one.name}_pack(out, sizeof out, {'&made, ' if is_can else ''}&s);")
    lines.append('printf("%lx\\n", (unsigned long)made); show_bytes(out, length < 0 ? 0 : (size_t)length);')
    # A byte less room than it takes, and it is refused.
    lines.append(
        f"if (length > 0 && {one.name}_pack(out, (size_t)length - 1, {'&made, ' if is_can else ''}&s) != -1) abort();"
    )
    return (
        f"        case {number}: {{\n"
        + "\n".join(f"            {line}" for line in lines)
        + "\n            break; }"
    )


def compiled(folder: Path, made: CSource) -> Path:
    """The program."""
    assert CC is not None
    (folder / "spec.h").write_text(made.header, encoding="utf-8")
    (folder / "spec.c").write_text(made.source, encoding="utf-8")
    cases = "\n".join(case(number, one) for number, one in enumerate(made.messages))
    (folder / "main.c").write_text(MAIN.replace("CASES", cases), encoding="utf-8")
    strict = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
    run = [CC, *strict, "-c", "spec.c", "-o", "spec.o"]
    subprocess.run(run, cwd=folder, check=True, timeout=120)
    subprocess.run([CC, "main.c", "spec.o", "-o", "program", "-lm"], cwd=folder, check=True, timeout=120)
    return folder / "program"


def answers(program: Path, inputs: Sequence[tuple[int, int, bytes]]) -> list[str]:
    text = "".join(f"{number} {identifier:x} {data.hex() or '-'}\n" for number, identifier, data in inputs)
    run = subprocess.run([program], input=text, capture_output=True, text=True, timeout=60, check=True)
    return run.stdout.splitlines()


def identifier_and_data(packet: DrawnPacket) -> tuple[int, bytes]:
    """Identifier and data, or 0 and the packet."""
    (sent,) = packet.as_sent
    return (0, sent) if isinstance(sent, bytes) else (sent.arbitration_id, sent.data)


def value_at(record: Any, way: Sequence[Any]) -> Any:
    for step in way:
        if record is None:
            return None
        record = record[step] if isinstance(step, int) else getattr(record, step)
    return record


@cache
def scanner_of(variant: Variant, direction: Any, raw: bool) -> Any:
    return make_scanner([variant], direction=direction, include_unknown=True, raw=raw)


def decoded(variant: Variant, packet: DrawnPacket, *, raw: bool) -> Any:
    """The record of a packet, which follows its request."""
    direction: Any = None
    if variant.link != "can":
        direction = packet.message.direction or ("both" if variant.direction_conflict else None)
    scanner = scanner_of(variant, direction, raw)
    scanner.reset()
    found: list[Any] = []
    for one in (packet.request, packet):
        for sent in one.as_sent if one is not None else ():
            found = scanner.feed(sent if isinstance(sent, bytes) else [sent])
    return next((one for one in found if type(one).__name__ == packet.message.name), None)


def compare(variant: Variant, one: CMessage, packet: DrawnPacket, lines: list[str], made: CSource) -> int:
    """Take the lines of one packet off, and hold them against ours; how many values were compared."""
    raw, meant = (decoded(variant, packet, raw=is_raw) for is_raw in (True, False))
    assert lines.pop(0) == "taken", (one.name, packet)
    count = 0
    for member in one.fields:
        node, way = member.leaf.node, member.leaf.way
        shown = lines.pop(0)
        physical = float.fromhex(lines.pop(0)) if member.can_decode else None
        again = lines.pop(0) if member.can_encode else None
        value = value_at(raw, way)
        if value is None or raw is None:
            continue  # a field of another page, or a message that the request alone tells
        count += 1
        if isinstance(value, (bytes, str)):
            assert bytes.fromhex(shown) == (value.encode("latin-1") if isinstance(value, str) else value)
        elif member.type in ("float", "double"):
            assert same(float.fromhex(shown), value), (one.name, member.name)
        else:
            assert int(shown) == int(value), (one.name, member.name, packet.image.hex())
        if physical is None:
            continue
        unit = value_at(meant, way)
        if unit is None:
            assert math.isnan(physical)
            assert again in (None, "-1")  # unknown is never sent
        elif isinstance(unit, (int, float)):
            assert same(physical, float(unit)), (one.name, member.name)
            limits = node.scale.limits if node.scale is not None else None
            if math.isnan(unit):
                assert again in (None, "-1")  # and neither is what is not a number
            elif again is not None and (limits is None or limits[0] <= unit <= limits[1]):
                assert again == "1", (one.name, member.name, unit)
    identifier, data = identifier_and_data(packet)
    assert int(lines.pop(0), 16) == identifier
    packed = bytes.fromhex(lines.pop(0))
    if not any(loss.message == packet.message.name and "written as 0" in loss.reason for loss in made.losses):
        assert packed == data, one.name
    return count


def same(one: float, other: float) -> bool:
    return one == other or (math.isnan(one) and math.isnan(other))


def variant_of(name: str) -> Variant:
    return (SPECS[name] if name in SPECS else load_protocol(name)).variant()


@pytest.mark.slow
@needs_cc
@pytest.mark.parametrize("name", [*NAMES, *(ALL if IS_LONG else [])])
def test_a_compiler_agrees_with_the_scanner(tmp_path: Path, name: str) -> None:
    """Drawn frames of every message, whole and corrupted: the same values, the same bytes back, the same refusals."""
    variant = variant_of(name)
    every = 1 if IS_LONG else max(1, len(variant.messages) // MESSAGES)
    made = print_c_source(variant, only=list(variant.messages)[::every], name="spec")
    if not made.messages:
        pytest.skip("C says none of its messages")
    program = compiled(tmp_path, made)
    packets: list[tuple[int, DrawnPacket]] = []
    for number, one in enumerate(made.messages):
        for seed in range(SEEDS):
            try:
                packets.append((number, drawn_packet(one.message, seed, variant)))
            except UndrawableError:
                break
    lines = answers(program, [(number, *identifier_and_data(packet)) for number, packet in packets])
    count = sum(compare(variant, made.messages[number], packet, lines, made) for number, packet in packets)
    assert lines == []
    assert count > len(packets)
    check_refusals(program, variant, made, packets)


def check_refusals(
    program: Path, variant: Variant, made: CSource, packets: Sequence[tuple[int, DrawnPacket]]
) -> None:
    """Packets with another bit, byte or length are taken by the C of a message where the scanner takes them for it."""
    random_ = random.Random(3)
    inputs: list[tuple[int, int, bytes]] = []
    wanted: list[bool] = []
    for number, packet in [one for one in packets for _ in range(4)]:
        message = packet.message
        identifier, data = identifier_and_data(packet)
        changed = bytearray(data)
        kind = random_.randrange(4)
        if changed and kind < 2:
            changed[random_.randrange(len(changed))] ^= 1 << random_.randrange(8)
        elif kind == 2 and message.framing is None:
            identifier ^= 1 << random_.randrange(29 if message.extended else 11)
        else:
            changed = changed[:-1] if random_.random() < 0.5 else changed + b"\0"
        inputs.append((number, identifier, bytes(changed)))
        wanted.append(_fits(message, identifier, bytes(changed)))
    lines = answers(program, inputs)
    found = [line == "taken" for line in lines if line in ("taken", "refused")]
    assert found == wanted
    assert False in wanted


def _fits(message: Any, identifier: int, data: bytes) -> bool:
    """Whether construct, the slow truth, parses it as this message."""
    if message.framing is not None:
        image = data
    else:
        word = identifier | (1 << 31 if message.extended else 0)
        image = word.to_bytes(4, "big") + bytes([4 if message.fd else 0]) + data
    try:
        message.struct.parse(image)
    except Exception:
        return False
    return True


# ---------------------------------------------------------------------- what it says, and what it does not


def small() -> Variant:
    """A stream with names, a quantity that may be unknown, and open data."""
    line = Protocol("probe", link="serial")
    packet = line.framing(
        sync=b"\xb5", header=Struct("length" / Byte), size=this.length + 4, check=Fletcher(), max_size=64
    )
    packet(
        "Reading",
        payload=Struct(
            "mode" / Enumeration(Byte, {"off": 0, "torque": 2}),
            "angle" / Quantity(Int16ub, scale=0.1, offset=-50, unit="°", unknown=[0xFFFF]),
            "double" / Float32l,
            "speed" / Quantity(Int16ub, scale=0.01, unit="/*", rounding="truncate"),
            "rest" / GreedyBytes,
        ),
        doc="What it says. */ /*",
    )
    return line.variant()


def test_names_units_and_keywords_are_fit_for_c() -> None:
    """Enumerations are macros, units comments; no word of C is a member, and no comment is left early."""
    made = print_c_source(small())
    (one,) = made.messages
    assert [member.name for member in one.fields] == ["mode", "angle", "double_", "speed", "rest"]
    assert "#define PROBE_READING_MODE_TORQUE (2)" in made.header
    assert "uint16_t angle; /* [°] */" in made.header
    assert "What it says. * / / *" in made.header
    assert "uint16_t speed; /* [/ *] */" in made.header
    assert (
        "int probe_reading_unpack(struct probe_reading *to, const uint8_t *data, size_t size);" in made.header
    )
    assert made.losses == []


@needs_cc
def test_truncated_numbers_come_back(tmp_path: Path) -> None:
    """What C has decoded it encodes as it was, also where the quotient is a rounding error below its integer."""
    variant = small()
    made = print_c_source(variant, name="spec")
    program = compiled(tmp_path, made)
    values = {"mode": "off", "angle": 0.0, "double": 0.0, "rest": b""}
    encode = variant.encoder.encode
    inputs = [(0, 0, bytes(encode("Reading", speed=raw * 0.01, **values))) for raw in range(200)]
    lines = answers(program, inputs)
    step = len(lines) // len(inputs)
    # Behind "taken", mode, three lines of the angle and the float.
    assert lines[6::step] == [str(raw) for raw in range(200)]
    assert lines[8::step] == ["1"] * 200


def test_what_c_does_not_say_is_named() -> None:
    """Transports, lists, stuffing, replies that need their request: left out, each with its reason, in the header too."""
    reasons = {
        "obd2": "carried by ISO-TP",
        "dynamixel": "its packets are stuffed",
        "nmea0183": "delimited text",
        "hubo": "shows fields of its request",
        "ubx": "a list of items",
        "canopen": "a remote frame",
    }
    for name, reason in reasons.items():
        made = print_c_source(load_protocol(name).variant())
        lost = [loss for loss in made.losses if reason in loss.reason]
        assert lost
        assert all(str(loss) in made.header for loss in lost)
        assert {loss.message for loss in lost}.isdisjoint(one.message.name for one in made.messages)


def test_the_same_spec_gives_the_same_text() -> None:
    """Byte for byte; and of one message, only that."""
    variant = load_protocol("hubo").variant()
    assert print_c_source(variant) == print_c_source(variant)
    only = print_c_source(variant, only=["Encoder"])
    assert [one.message.name for one in only.messages] == ["Encoder"]
    assert "hubo_status" not in only.header


@needs_cc
def test_packing_refuses_numbers_that_the_identifier_does_not_have(tmp_path: Path) -> None:
    """A board that is not declared would be another message's identifier: pack gives -1, and an identifier else."""
    made = Protocol("boards", link="can", source="drawn")
    made.message("M", id=0x100 + IdField("board", range(3, 9)), payload=Struct("x" / Byte))
    printed = print_c_source(made.variant(), name="spec")
    (tmp_path / "spec.h").write_text(printed.header, encoding="utf-8")
    (tmp_path / "spec.c").write_text(printed.source, encoding="utf-8")
    main = """#include <stdio.h>
#include "spec.h"
int main(void) {
    for (int board = 0; board < 12; board++) {
        struct boards_m m = {0};
        uint8_t data[8];
        uint32_t id = 0;
        m.board = (uint8_t)board;
        const int length = boards_m_pack(data, sizeof data, &id, &m);
        printf("%d %x\\n", length, (unsigned)id);
    }
    return 0;
}
"""
    (tmp_path / "main.c").write_text(main, encoding="utf-8")
    subprocess.run([str(CC), "main.c", "spec.c", "-o", "program"], cwd=tmp_path, check=True, timeout=120)
    run = subprocess.run([tmp_path / "program"], capture_output=True, text=True, timeout=60, check=True)
    wanted = [f"1 {0x100 + board:x}" if 3 <= board < 9 else "-1 0" for board in range(12)]
    assert run.stdout.splitlines() == wanted

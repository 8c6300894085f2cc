"""Generated code is code: it reads well, shows in tracebacks, and is the same bytes each time."""

from __future__ import annotations

import inspect
import os
import pdb
import subprocess
import sys
import traceback
from pathlib import Path
from typing import Any

import pytest
from construct import Array, Byte, Int16sl, Int16ul, Int32sl, Struct

from aces_bus import Frame
from aces_bus.errors import FieldError
from aces_bus.protocol import BitLayout, Enumeration, Flags, IdField, Protocol, Quantity, Variant, bits
from aces_bus.protocol.generate.load import decoders_of

ROOT = Path(__file__).resolve().parents[2]
PROTOCOLS = ["canopen", "hubo", "hubovia", "minihubo_adc", "pololu_qik", "robotis"]


def small() -> Protocol:
    """A protocol of two messages."""
    protocol = Protocol("small", link="can")
    protocol.message(
        "Position",
        id=0x060 + IdField("board", range(4)),
        payload=Struct("position" / Array(2, Quantity(Int32sl, unit="rad", scale=0.001))),
        doc="Where the motors are.",
    )
    protocol.message(
        "Mode",
        id=0x100,
        payload=BitLayout(
            3,
            "mode" / bits(3),
            "speed" / Quantity(bits(12, signed=True), unit="rpm", scale=0.5),
            "level" / bits(9),
        ),
    )
    return protocol


@pytest.mark.slow
def test_the_same_spec_prints_the_same_bytes_in_every_process() -> None:
    """Neither hash order nor the current folder leaves a trace in generated source."""
    program = (
        "from aces_bus import load_protocol\n"
        "from aces_bus.protocol.generate.load import print_decoders\n"
        "import hashlib\n"
        f"for name in {PROTOCOLS!r}:\n"
        "    for variant in load_protocol(name).variants():\n"
        "        text = print_decoders(variant) + variant.encoder.source\n"
        "        print(variant.label, hashlib.sha256(text.encode()).hexdigest())\n"
    )
    path = os.pathsep.join(str(ROOT / folder) for folder in (".", "protocols", "devices", "tools"))
    outputs = set()
    for seed, folder in (("0", ROOT), ("12345", ROOT.parent)):
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": path}
        done = subprocess.run(
            [sys.executable, "-c", program],
            cwd=folder,
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        )
        outputs.add(done.stdout)
    assert len(outputs) == 1
    assert outputs.pop().count("\n") >= len(PROTOCOLS)


def test_generated_code_shows_in_tracebacks() -> None:
    """An error inside a generated function shows its line, under a name that says which protocol and what it does."""
    decode = decoders_of(small().variant(), False, False)["Position"]
    with pytest.raises(Exception, match="buffer") as caught:
        decode(b"too short to be eight", 0x60, None, None, b"", None)
    last = traceback.extract_tb(caught.value.__traceback__)[-1]
    assert last.filename == "<aces small quick decoders: Position>"
    assert last.line == "v0, v1 = _unpack_Position(data)"


def test_a_debugger_finds_the_source() -> None:
    """`inspect` and `pdb` see generated functions as they see any other."""
    decode = decoders_of(small().variant())["Mode"]
    assert inspect.getsource(decode).startswith("def decode_Mode(")
    assert pdb.Pdb().canonic(decode.__code__.co_filename) == "<aces small decoders: Mode>"


def test_a_printed_encoder_builds_what_construct_builds() -> None:
    """The quick way and construct give the same frame, and the quick way is taken."""
    variant = small().variant()
    assert variant.encoder.through_construct == {}
    for fields in ({"board": 3, "position": [1.5, -2.25]}, {"board": 0, "position": (0, 2_000_000.0)}):
        frame = variant.encoder.encode("Position", **fields)
        assert bytes(frame.data) == variant["Position"].struct.build(fields)[5:]
    fields = {"mode": 5, "speed": -3.5, "level": 511}
    assert bytes(variant.encoder.encode("Mode", **fields).data) == variant["Mode"].struct.build(fields)[5:]


def nested() -> Variant:
    """A message with records inside, bits without a field among them, and flags."""
    made = Protocol("nested", link="can")
    error = BitLayout(
        1, "code" / Enumeration(bits(3), fine=0, hot=1), "lamps" / Flags(bits(3), red=0, green=2)
    )
    made.message(
        "Status",
        id=0x10,
        payload=Struct("error" / error, "place" / Struct("x" / Int16ul, "y" / Quantity(Int16sl, scale=0.1))),
    )
    return made.variant()


@pytest.mark.parametrize("lamps", [["red"], ["green", "red", "green"], (), {"green"}, 7, "red", ""])
@pytest.mark.parametrize("more", [{}, {"reserved": 0xC0}])
def test_records_and_flags_are_built_as_construct_builds_them(lamps: Any, more: dict[str, int]) -> None:
    """Names of flags in any order and collection, a number, a single name; bits without a field where they are given."""
    variant = nested()
    assert variant.encoder.through_construct == {}
    fields = {"error": {"code": "hot", "lamps": lamps, **more}, "place": {"x": 65_535, "y": -0.3}}
    frame = variant.encoder.encode("Status", **fields)
    assert bytes(frame.data) == variant["Status"].struct.build(fields)[5:]


@pytest.mark.parametrize(
    ("error", "place", "complaint"),
    [
        ({"code": "hot", "lamps": ["blue"]}, {"x": 1, "y": 1}, "no flag named 'blue'"),
        ({"code": "hot", "lamps": "rd"}, {"x": 1, "y": 1}, "no flag named 'rd'"),
        ({"code": "hot"}, {"x": 1, "y": 1}, "lamps"),
        ({"code": "hot", "lamp": 1}, {"x": 1, "y": 1}, "lamp"),
        ({"code": 8, "lamps": 0}, {"x": 1, "y": 1}, "code"),
        ({"code": 0, "lamps": 0}, {"x": 65_536, "y": 1}, "x: 65536 is outside 0…65535"),
        (None, {"x": 1, "y": 1}, "NoneType"),
    ],
)
def test_a_value_in_a_record_that_does_not_fit_is_named(error: Any, place: Any, complaint: str) -> None:
    """What is in a record is as strict as what is not, and explained by construct."""
    with pytest.raises(FieldError, match=complaint):
        nested().encoder.encode("Status", error=error, place=place)


def test_a_record_whose_fields_share_bits_is_built_by_construct() -> None:
    """Which of them is sent, construct says."""
    made = Protocol("shared", link="can")
    both = BitLayout(1, "low" / bits(4), "all" / bits(8, at=0), overlapping=True)
    made.message("Both", id=0x11, payload=Struct("both" / both))
    assert made.variant().encoder.through_construct == {"Both": "its fields share bits"}


@pytest.mark.parametrize(
    ("fields", "complaint"),
    [
        ({"board": 9, "position": [0, 0]}, "board: 9 is not one of 0…3"),
        ({"board": 1, "position": [0]}, "position"),
        ({"board": 1, "position": [0, 1e12]}, "position"),
        ({"board": 1, "position": ["fast", 0]}, "'fast' is not a number"),
        ({"board": 1, "position": [float("nan"), 0]}, "nan"),
        ({"board": 1}, "no value given for position"),
        ({"board": 1, "position": [0, 0], "speed": 3}, "no field of Position named 'speed'"),
    ],
)
def test_a_value_that_does_not_fit_is_named(fields: dict[str, Any], complaint: str) -> None:
    """Whatever the printed encoder refuses, construct explains: message, field and value."""
    with pytest.raises(Exception, match=complaint) as caught:
        small().encode("Position", **fields)
    assert type(caught.value).__module__ == "aces_bus.errors"


def test_bits_that_do_not_fit_never_spill() -> None:
    """A value one step past either end of a bit field raises; it never reaches its neighbour's bits."""
    protocol = small()
    good: dict[str, Any] = {"mode": 7, "speed": 0, "level": 0}
    for name, value in (("mode", 8), ("mode", -1), ("speed", 1024.0), ("speed", -1024.5), ("level", 512)):
        with pytest.raises(FieldError, match=name):
            protocol.variant().encoder.encode("Mode", **{**good, name: value})


def test_construct_still_reads_the_payload_alone() -> None:
    """The payload stays a plain construct: it parses by itself when it needs nothing else."""
    protocol = Protocol("plain", link="can")
    message = protocol.message("M", id=1, payload=Struct("a" / Byte, "b" / Int16ul))
    assert message.payload.parse(b"\x01\x02\x03") == {"a": 1, "b": 0x302}
    assert message.payload.build({"a": 1, "b": 2}) == b"\x01\x02\x00"


def test_two_flag_fields_of_one_name_keep_their_own_names() -> None:
    """Nested records may repeat a field name; each keeps its own flags."""
    protocol = Protocol("twins", link="can")
    motor = {"left": Flags(Byte, hot=0), "right": Flags(Byte, jam=0)}
    protocol.message(
        "M", id=1, payload=Struct(*(side / Struct("fault" / field) for side, field in motor.items()))
    )
    record = protocol.scanner().feed([Frame(1, b"\x01\x01")])[0]
    assert (list(record.left.fault), list(record.right.fault)) == (["hot"], ["jam"])

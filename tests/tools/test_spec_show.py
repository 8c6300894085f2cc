"""`aces spec show`: pictures, plans, paths, and what differs between two specs."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from aces_bus import load_protocol
from aces_bus.protocol.draw.svg import picture_svg
from aces_bus.protocol.draw.text import picture

from .conftest import Aces

OLD = """from construct import *
from aces_bus.protocol import *
p = Protocol("arm", link="can")
p.message("State", id=5, payload=Struct("speed" / Quantity(Int16ul, unit="rad/s"), "mode" / Byte, "spare" / Byte))
p.message("Gone", id=6, payload=Struct("a" / Byte))
p.message("Same", id=7, payload=Struct("a" / Byte), doc="one")
p.message("Before", id=8, payload=Struct("a" / Int32ul))
"""
NEW = """from construct import *
from aces_bus.protocol import *
p = Protocol("arm", link="can")
p.message("State", id=5, direction="from device",
    payload=Struct("mode" / Byte, "speed" / Quantity(Int16ul, unit="rad/s", scale=0.01), "fresh" / Byte))
p.message("Fresh", id=9, payload=Struct("a" / Byte))
p.message("Same", id=7, payload=Struct("a" / Byte), doc="other")
p.message("Behind", id=8, payload=Struct("a" / Int32ul))
"""


@pytest.fixture
def versions(tmp_path: Path) -> tuple[Path, Path]:
    """Two versions of a spec."""
    old, new = tmp_path / "old.py", tmp_path / "new.py"
    old.write_text(OLD)
    new.write_text(NEW)
    return old, new


def test_all_messages_are_drawn(aces: Aces) -> None:
    """Each with its name and picture, as the drawing has it."""
    out = aces("spec", "show", "robotis").out
    robotis = load_protocol("robotis")
    for message in robotis.declared:
        assert f"robotis.{message.name}  " in out
        assert "\n".join(picture(message)) in out


def test_one_message_is_as_protocols_has_it(aces: Aces) -> None:
    """Picture and table are those of `aces protocols`, source and JSON too."""
    for more in ([], ["--json"], ["--source"]):
        assert aces("spec", "show", "hubo", "NameInfo", *more, "--no-color").out == (
            aces("protocols", "hubo", "NameInfo", *more, "--no-color").out
        ) or more == ["--source"]
    assert "def decode_Read(" in aces("spec", "show", "robotis", "Read", "--source").out


def test_a_picture_is_svg(aces: Aces, tmp_path: Path) -> None:
    """Every cell of the message, its name and its doc; of a protocol all messages; never a script."""
    file = tmp_path / "nameinfo.svg"
    assert aces("spec", "show", "hubo", "NameInfo", "--svg", file).status == 0
    texts = [one.text or one[0].tail for one in ET.parse(file).iter("{http://www.w3.org/2000/svg}text")]
    assert None not in texts
    assert "hubo.NameInfo" in texts
    for cell in ("period", "limit.0", "z_phase.1 11…8", "z_phase.0 11…8"):
        assert any(cell in str(text) for text in texts), cell
    every = picture_svg(load_protocol("hubo").declared)
    ET.fromstring(every)
    assert "<script" not in every
    assert all(f"hubo.{m.name}<" in every for m in load_protocol("hubo").declared)


def test_the_plan(aces: Aces) -> None:
    """Constants, lengths, places and steps; as JSON every node says what it is."""
    out = aces("spec", "show", "hubo", "NameInfo", "--plan").out
    assert "constant    byte 1 = 0x01" in out
    assert "z_phase.0  byte 5 + byte 7 bits 3…0  uint12  count" in out
    (plan,) = json.loads(aces("spec", "show", "hubo", "NameInfo", "--plan", "--json").out)
    assert (plan["is"], plan["lengths"]) == ("MessagePlan", [8])
    assert {field["node"]["is"] for field in plan["fields"]} <= {"Scalar", "Many", "FromIdentifier", "Rest"}


def test_the_paths(aces: Aces) -> None:
    """What is generated, what goes through construct, and why; what columns read one by one."""
    out = aces("spec", "show", "robotis", "--paths").out
    assert "SyncWrite  construct  one by one  bytes of a length that varies" in out
    assert "7 of 8 messages are decoded by generated code" in out
    told = {one["message"]: one for one in json.loads(aces("spec", "show", "hubo", "--paths", "--json").out)}
    assert told["Encoder"]["columns"] == "at once"
    assert told["Parameters1"]["columns"] == "one by one"
    assert {"field": "board", "path": "generated", "how": "a part of the identifier"} in told["Encoder"][
        "fields"
    ]
    assert "unpacked by struct" in aces("spec", "show", "hubo", "Encoder", "--paths").out


def test_versions_differ(aces: Aces, versions: tuple[Path, Path]) -> None:
    """Messages that came, went and changed their name; fields that moved; docs do not count."""
    result = aces("spec", "show", "--diff", *versions)
    assert result.status == 1
    lines = result.out.splitlines()
    assert "- Gone" in lines
    assert "+ Fresh" in lines
    assert "~ Before → Behind" in lines
    assert "    direction: none → from device" in lines
    assert "    ~ speed: moved byte 0…1 → byte 1…2; scale none → 0.01; range 0…65535 → 0…655.35" in lines
    assert "    ~ mode: moved byte 2 → byte 0" in lines
    assert "    ~ spare: name spare → fresh" in lines
    assert lines[-1] == "1 removed, 1 added, 2 changed, 1 the same"
    told = json.loads(aces("spec", "show", "--diff", *versions, "--json").out)
    assert (told["removed"], told["added"], told["same"]) == (["Gone"], ["Fresh"], 1)


LISTED = """
from construct import Byte, GreedyRange, Int16ul, PascalString, PrefixedArray, Struct
from aces_bus.protocol import Enumeration, Protocol, Quantity
listed = Protocol("listed", link="can")
item = Struct({item})
listed.message("Rest", id=1, payload=Struct("items" / GreedyRange(item)))
listed.message("Counted", id=2, payload=Struct("items" / PrefixedArray(Byte, item)))
"""


@pytest.mark.parametrize("of_one_size", [True, False])
@pytest.mark.parametrize(
    ("item", "opaque", "generated"),
    [
        ('"a" / Quantity(Int16ul, scale=0.2, unit="V")', "~ items.a: scale 0.1 → 0.2", ""),
        ('"a" / Quantity(Int16ul, scale=0.1, unit="A")', "~ items.a: unit V → A", ""),
        (
            '"a" / Quantity(Byte, scale=0.1, unit="V")',
            "~ items.a: type Quantity of uint16 le → Quantity of uint8",
            "~ items: type groups of 2 → groups of 1",
        ),
        (
            '"a" / Quantity(Int16ul, scale=0.1, unit="V"), "b" / Byte',
            "+ items.b: uint8",
            "+ items.b: byte 2 of each, uint8",
        ),
        (
            '"b" / Enumeration(Byte, off=0)',
            "+ items.b: Enumeration of uint8",
            "+ items.b: byte 0 of each, enum8",
        ),
    ],
)
def test_what_is_in_lists_differs_too(
    aces: Aces, tmp_path: Path, item: str, opaque: str, generated: str, of_one_size: bool
) -> None:
    """A scale, a unit, a type, a field more, inside of lists; also where construct alone takes them apart."""
    old, new = tmp_path / "old.py", tmp_path / "new.py"
    more = "" if of_one_size else ', "text" / PascalString(Byte, "utf8")'
    old.write_text(LISTED.format(item='"a" / Quantity(Int16ul, scale=0.1, unit="V")' + more))
    new.write_text(LISTED.format(item=item + more))
    said = (generated if of_one_size else "") or opaque
    result = aces("spec", "show", "--diff", old, new)
    assert result.status == 1
    assert any(line.strip().startswith(said) for line in result.out.splitlines()), result.out
    assert result.out.splitlines()[-1] == "0 removed, 0 added, 2 changed, 0 the same"
    assert aces("spec", "show", "--diff", old, old).status == 0


def test_dialects_differ(aces: Aces, versions: tuple[Path, Path]) -> None:
    """Of one protocol too; a spec does not differ from itself."""
    result = aces("spec", "show", "--diff", "hubo:D08", "hubo:D12")
    assert result.status == 1
    assert "+ GetParameters" in result.out
    same = aces("spec", "show", "--diff", versions[0], versions[0])
    assert (same.status, same.out.splitlines()[-1]) == (0, "0 removed, 0 added, 0 changed, 4 the same")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "name a protocol or a file"),
        (["robotis", "--plan", "--paths"], "show different things"),
        (["robotis", "--plan", "--svg", "x.svg"], "show different things"),
        (["robotis", "--diff", "hubo", "hubo"], "leave the other out"),
        (["robotis", "Red"], "did you mean 'Read'?"),
        (["robotis", "Red", "--svg", "x.svg"], "did you mean 'Read'?"),
        (["nix"], "no protocol named 'nix'"),
    ],
)
def test_wrong_calls(aces: Aces, arguments: list[str], says: str) -> None:
    """One line that says what would have worked; status 2."""
    result = aces("spec", "show", *arguments)
    assert result.status == 2
    assert says in result.err

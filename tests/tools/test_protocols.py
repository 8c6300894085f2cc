"""`aces protocols`: what it lists and draws."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from aces_bus import list_protocols, load_protocol
from aces_tools import protocols as verb

from .conftest import Aces


def test_every_installed_protocol_is_listed(aces: Aces) -> None:
    """With its link, dialects, configurations, framing and check."""
    result = aces("protocols")
    assert result.status == 0
    assert set(list_protocols()) <= set(re.findall(r"^\w+", result.out, re.MULTILINE))
    assert "dialects: D08" in result.out
    assert "inverted sum" in result.out


def test_a_search_lists_those_with_all_words(aces: Aces) -> None:
    """In names, texts, devices and messages; nothing found is exit status 1."""
    out = aces("protocols", "--search", "imu").out
    names = re.findall(r"^\w+", out, re.MULTILINE)
    assert {"hubo", "vectornav"} <= set(names)
    assert "robotis" not in names
    assert re.match(r"ld06 .*\brplidar ", aces("protocols", "--search", "LIDAR").out, re.DOTALL)
    nothing = aces("protocols", "--search", "imu lidar")
    assert (nothing.status, nothing.out) == (1, "")
    assert aces("protocols", "hubo", "--search", "imu").status == 2


def test_badges_are_shown(aces: Aces) -> None:
    """In the list by their names, with their days for one protocol."""
    assert re.search(r"^lx16a .* messages · bronze silver gold", aces("protocols").out, re.MULTILINE)
    shown = r"badges of Hiwonder LX-16A: bronze, silver, gold.* 20\d\d-\d\d-\d\d"
    assert re.search(shown, aces("protocols", "lx16a").out)
    assert "gold" in json.loads(aces("protocols", "lx16a", "--json").out)["badges"]


def test_a_protocol_without_a_check_says_so(aces: Aces) -> None:
    """What is taken for a packet without proof is marked `unchecked`."""
    assert "check: unchecked" in aces("protocols", "minihubo_adc").out
    assert "unchecked" not in aces("protocols", "robotis").out
    assert "unchecked" not in aces("protocols", "hubo").out


def test_a_protocol_lists_messages_and_registers(aces: Aces) -> None:
    """Each message with what tells it from others, length, direction and meaning; registers by address."""
    out = aces("protocols", "robotis").out
    assert re.search(r"^Read +instruction=0x02 +8 +→ +\w", out, re.MULTILINE)
    assert re.search(r"^0x1e +goal_position +uint16 le +rw ", out, re.MULTILINE)
    assert not re.search(r" $", out, re.MULTILINE)


def test_a_dialect_has_its_messages(aces: Aces) -> None:
    """NAME lists the messages of all dialects, NAME:DIALECT those of one."""
    hubo = load_protocol("hubo")
    include_unknown = json.loads(aces("protocols", "hubo", "--json").out)["messages"]
    assert len(include_unknown) == len(hubo.declared)
    some = json.loads(aces("protocols", "hubo:D08", "--json").out)["messages"]
    assert {m["name"] for m in some} == set(hubo.variant("D08").messages)


def test_a_message_is_drawn(aces: Aces, spec: Path) -> None:
    """Template, bits, fields with units and ranges, names and sources."""
    out = aces("protocols", f"{spec}:arm", "State").out
    assert "recognised by  0x300 + board" in out
    assert "identifier     board 0…3" in out
    assert re.search(r"^ +1 │ error 7…4 +│ cold +│ error 2…1 +│ hot +│$", out, re.MULTILINE)
    assert re.search(r"^angle +byte 2…3 +int16 be +° +0.01 +-100…100", out, re.MULTILINE)
    assert "0=off, 2=torque" in out
    assert "sheet 7.1" in aces("protocols", f"{spec}:arm", "Encoder").out


def test_a_name_in_several_dialects_is_drawn_for_each(aces: Aces, tmp_path: Path) -> None:
    """The same name may stand for different layouts."""
    path = tmp_path / "twice.py"
    path.write_text(
        "from construct import Byte, Int16ul, Struct\nfrom aces_bus.protocol import Protocol\n"
        "twice = Protocol('twice', link='can', dialects={'a': '', 'b': ''})\n"
        "twice.message('M', id=1, dialect='a', payload=Struct('x' / Byte))\n"
        "twice.message('M', id=1, dialect='b', payload=Struct('x' / Int16ul))\n"
    )
    out = aces("protocols", path, "M").out
    assert out.count("twice.M") == 2
    assert aces("protocols", f"{path}:b", "M").out.count("twice.M") == 1


@pytest.mark.parametrize(
    "arguments", [["nosuch"], ["robotis", "Sttaus"], ["hubo:D99"], ["robotis", "Sttaus", "--source"]]
)
def test_an_unknown_name_lists_those_that_exist(aces: Aces, arguments: list[str]) -> None:
    """Protocols, messages, dialects."""
    result = aces("protocols", *arguments)
    assert result.status == 2
    assert "there are:" in result.err
    assert result.err.count("\n") == 1


def test_json_of_a_message(aces: Aces) -> None:
    """For programs: one object with the same facts."""
    (message,) = json.loads(aces("protocols", "robotis", "Status", "--json").out)
    assert message["name"] == "Status"
    assert message["direction"] == "from device"
    assert [row["name"] for row in message["fields"]] == ["id", "error", "parameters"]
    assert message["picture"][0].split() == ["byte", *"76543210"]
    assert {p["name"] for p in json.loads(aces("protocols", "--json").out)} == set(list_protocols())


def test_the_generated_source_is_shown(aces: Aces) -> None:
    """--source prints what decodes: of a message, of a protocol, of a stream with its scanner."""
    assert (
        aces("protocols", "robotis", "Status", "--source")
        .out.splitlines()[-1]
        .strip()
        .startswith("return Status(")
    )
    whole = aces("protocols", "robotis", "--source").out
    assert "def decode_Ping(" in whole
    assert "def scan(" in whole
    compile(whole, "source", "exec")
    assert "\x1b[" in aces("protocols", "robotis", "Status", "--source", "--color").out


def test_colour_only_where_wanted(aces: Aces) -> None:
    """Not in a pipe, unless asked for."""
    assert "\x1b[" not in aces("protocols", "robotis").out
    coloured = aces("protocols", "robotis", "--color").out
    assert re.sub(r"\x1b\[[0-9;]*m", "", coloured) == aces("protocols", "robotis").out


def test_a_protocol_that_cannot_be_imported_does_not_hide_the_others(
    aces: Aces, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is one line on stderr, the rest is listed, status 2."""
    points = {
        **list_protocols(),
        "broken": list_protocols()["robotis"]._replace(name="broken", value="no_such_module_here:x"),
    }
    monkeypatch.setattr(verb, "list_protocols", lambda: points)
    monkeypatch.setattr("aces_bus.protocol.files.PROTOCOLS.points", lambda: points)
    result = aces("protocols")
    assert result.status == 2
    assert "no_such_module_here" in result.err
    assert result.err.count("\n") == 1
    assert "robotis" in result.out


def test_a_database_is_listed_with_what_cannot_be_used(aces: Aces, tmp_path: Path) -> None:
    """Messages on stdout; on stderr each problem with file and line."""
    pytest.importorskip("cantools")
    path = tmp_path / "car.dbc"
    path.write_text(
        'BU_: A\nBO_ 100 Speed: 8 A\n SG_ speed : 0|16@1+ (1,0) [0|0] "" A\nFOO_ 1;\nCM_ SG_ 100 speed "of\nwheels";\n'
    )
    assert " of wheels\n" in aces("protocols", str(path), "Speed").out  # one row of a table is one line
    result = aces("protocols", str(path))
    assert result.status == 0
    assert "Speed" in result.out
    assert f"{path}:4:1: cannot be read at 'FOO_' (FOO_ 1;)" in result.err.splitlines()

"""Record types by name, and the stubs that tell editors of them."""

from __future__ import annotations

import ast
import functools
import importlib
from pathlib import Path
from typing import Any

import pytest
from construct import Byte, GreedyRange, Int16sl, Struct

from aces_bus import list_protocols, load_protocol
from aces_bus.protocol import Enumeration, Flags, Multiplexed, Protocol, Quantity, Record, record_types
from aces_bus.protocol.exchange.export_stubs import print_stub
from aces_bus.protocol.generate.load import records_of
from aces_bus.protocol.record import field_names
from tests.specs.catalogue import SPECS

INSTALLED = sorted(list_protocols())
PROTOCOLS: dict[str, Protocol] = {name: load_protocol(name) for name in INSTALLED} | SPECS

lamp = Protocol("lamp", link="can", dialects={"a": "", "b": ""})
lamp.message(
    "Level",
    id=1,
    dialect="a",
    payload=Struct("level" / Quantity(Byte, unit="%", scale=0.5)),
    doc='A "level".',
)
lamp.message("Level", id=1, dialect="b", payload=Struct("level" / Int16sl, "more" / Byte))
lamp.message(
    "Mode", id=2, payload=Struct("mode" / Enumeration(Byte, off=0, on=1), "bits" / Flags(Byte, hot=0))
)
lamp.message("List", id=3, payload=Struct("items" / GreedyRange(Struct("x" / Byte))))
lamp.message("Page", id=4, payload=Struct("page" / Byte, "low" / Multiplexed("page", 0, Byte)))
types = record_types(lamp)


def records(dialect: str, name: str, **fields: Any) -> Any:
    (record,) = lamp.scanner(dialect=dialect).feed([lamp.encode(name, dialect=dialect, **fields)])
    return record


A, B = records("a", "Level", level=20.0), records("b", "Level", level=-3, more=1)


def test_a_type_has_the_records_of_every_dialect() -> None:
    """`isinstance` and `match` do not ask in which dialect a record was decoded."""
    Level, Mode = types("Level"), types("Mode")
    assert isinstance(A, Level)
    assert isinstance(B, Level)
    assert not isinstance(A, Mode)
    assert not isinstance("Level", Level)
    match B:
        case Level(level=level, more=more):
            assert (level, more) == (-3, 1)
        case _:
            pytest.fail("no match")
    match A:
        case Level(level):  # type: ignore[misc]
            assert level == 20.0
        case _:
            pytest.fail("no match")


def test_another_protocols_message_of_the_same_name_is_not_meant() -> None:
    """The protocol counts too."""
    other = Protocol("lamp_other", link="can")
    other.message("Mode", id=2, payload=Struct("mode" / Byte))
    (record,) = other.scanner().feed([other.encode("Mode", mode=1)])
    assert not isinstance(record, types("Mode"))
    assert isinstance(record, record_types(other)("Mode"))


def test_types_dispatch() -> None:
    """functools.singledispatch takes them."""

    @functools.singledispatch
    def name(record: Any) -> str:
        return "?"

    name.register(types("Level"), lambda record: "level")
    assert (name(A), name(B), name(3)) == ("level", "level", "?")


def test_a_type_cannot_be_made_to_a_record() -> None:
    """It says how packets are made."""
    made: Any = types("Level")
    with pytest.raises(TypeError, match=r"lamp.encode\('Level'"):
        made(level=1)


def test_an_unknown_name_lists_the_messages() -> None:
    """As AttributeError, so that it can be a module's `__getattr__`."""
    with pytest.raises(AttributeError, match="there are: Level, Mode"):
        types("Lvel")


# ---------------------------------------------------------------------- stubs


def classes(text: str) -> dict[str, dict[str, str]]:
    """Class → attribute → annotation, of a stub."""
    return {
        node.name: {
            i.target.id: ast.unparse(i.annotation)
            for i in node.body
            if isinstance(i, ast.AnnAssign) and isinstance(i.target, ast.Name)
        }
        for node in ast.parse(text).body
        if isinstance(node, ast.ClassDef)
    }


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_stub_has_every_field_of_every_record(name: str) -> None:
    """Of all dialects and configurations; what it names is imported or declared in it."""
    protocol = PROTOCOLS[name]
    text = print_stub(protocol, "protocol")
    found = classes(text)
    for variant in protocol.variants():
        for message, kind in records_of(variant).items():
            assert set(field_names(kind)) <= set(found[message])
    known = {
        alias.name
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    known |= {*found, "int", "float", "str", "bytes", "bool", "tuple", "protocol"}
    annotations = ast.parse("\n".join(a for fields in found.values() for a in fields.values()))
    assert {node.id for node in ast.walk(annotations) if isinstance(node, ast.Name)} <= known


def test_stub_types_are_exact() -> None:
    """Names as literals, flags one by one, dialects together, nested records, absent values."""
    found = classes(print_stub(lamp, "lamp"))
    assert found["Level"] == {"level": "float | int", "more": "int"}
    assert found["Mode"] == {"mode": "Literal['off', 'on'] | int", "bits": "_Mode_bits"}
    assert found["_Mode_bits"] == {"hot": "bool"}
    assert found["List"] == {"items": "tuple[_List_items, ...]"}
    assert found["Page"] == {"page": "int", "low": "int | None"}


def test_docstrings_survive_quotes() -> None:
    """Whatever a spec's text holds."""
    odd = Protocol("odd", link="can")
    odd.message(
        "M", id=1, payload=Struct("x" / Byte * 'say """no\\" "'), doc='"quoted" \\ """', source="a\nb"
    )
    assert set(classes(print_stub(odd, "odd"))) == {"_Typed", "M"}


@pytest.mark.parametrize("name", INSTALLED)
def test_installed_stubs_are_what_is_generated(name: str) -> None:
    """The checked-in stub and its module equal the generated text; else `aces spec stubs` writes them."""
    from aces_tools.main import main

    assert main(["spec", "stubs", name, "--check"]) == 0, (
        f"stale; to write them anew: aces spec stubs {name} -o"
    )


@pytest.mark.parametrize("name", INSTALLED)
def test_installed_record_modules_work(name: str) -> None:
    """`from aces_protocols.NAME.records import MESSAGE` gives the type of its records."""
    protocol = load_protocol(name)
    module = importlib.import_module(
        list_protocols()[name].value.partition(":")[0].rpartition(".")[0] + ".records"
    )
    for message, kind in records_of(protocol.variant()).items():
        assert issubclass(kind, getattr(module, message))
    assert not hasattr(module, "NoSuchMessage")
    assert issubclass(Record, object)


def test_stubs_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For a protocol of one's own: both files beside the spec, importable, and checked."""
    from aces_tools.main import main

    path = tmp_path / "lamp_spec.py"
    path.write_text(
        "from construct import Byte, Struct\nfrom aces_bus.protocol import Protocol\n"
        "one = Protocol('one', link='can')\none.message('On', id=1, payload=Struct('x' / Byte))\n"
    )
    assert main(["spec", "stubs", str(path), "--check"]) == 1
    assert main(["spec", "stubs", str(path), "-o"]) == 0
    assert main(["spec", "stubs", str(path), "--check"]) == 0
    assert (tmp_path / "lamp_spec_records.pyi").exists()
    monkeypatch.syspath_prepend(tmp_path)
    module = importlib.import_module("lamp_spec_records")
    assert module.On.__name__ == "On"
    (tmp_path / "lamp_spec_records.pyi").write_text("stale\n")
    assert main(["spec", "stubs", str(path), "--check"]) == 1


def test_stubs_elsewhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """-o FILE.pyi writes there, importing the spec by its full name; without -o it is printed; other names are refused."""
    from aces_tools.main import main

    assert main(["spec", "stubs", "robotis", "-o", str(tmp_path / "r.pyi")]) == 0
    assert "from aces_protocols.robotis.spec import robotis" in (tmp_path / "r.py").read_text()
    capsys.readouterr()
    assert main(["spec", "stubs", "robotis"]) == 0
    assert capsys.readouterr().out == (tmp_path / "r.pyi").read_text()
    assert main(["spec", "stubs", "robotis", "-o", str(tmp_path / "r.txt")]) == 2
    assert main(["spec", "stubs", "robotis:x"]) == 2
    assert main(["spec", "stubs", "robotis", "-o", str(tmp_path / "no" / "r.pyi")]) == 2
    assert main(["spec", "new", "robotis"]) == 2

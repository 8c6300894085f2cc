"""`aces spec import`: a database as spec source that declares the same protocol, formatted, and safe to run.

1. Two protocols are the same when their plans, identifiers, kinds and lengths are; decoding follows from those.
2. Files that were drawn, damaged and hostile are read; what the file says is in no case run.
"""

from __future__ import annotations

import ast
import json
import random
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from aces_bus import Frame, make_scanner
from aces_bus.errors import AcesError
from aces_bus.protocol import Protocol
from aces_bus.protocol.exchange import load_database, print_source
from aces_bus.protocol.exchange.import_dbc import protocol_name
from aces_bus.protocol.plan.flatten import flatten
from aces_tools.main import main
from tests.protocol.test_dbc_equal import databases
from tests.tools.conftest import Aces

pytest.importorskip("cantools")
RUFF = shutil.which("ruff") or shutil.which("ruff", path=str(Path(sys.executable).parent))

HEAD = 'VERSION ""\n\nNS_ :\n\tCM_\n\nBS_:\n\nBU_: ECU Gate\n\n'
CAR = """BO_ 100 Speed: 5 ECU
 SG_ speed : 0|16@1+ (0.01,-10) [0|250] "km/h" Gate
 SG_ gear : 16|3@1- (1,0) [0|0] "" Gate
 SG_ temperature : 31|8@0+ (0.5,-40) [-40|87] "°C" Gate
BO_ 300 Mux: 8 ECU
 SG_ page M : 0|4@1+ (1,0) [0|0] "" Gate
 SG_ first m0 : 8|8@1+ (1,0) [0|0] "" Gate
 SG_ inner m1M : 8|8@1+ (1,0) [0|0] "" Gate
 SG_ deep m2 : 16|32@1- (1,0) [0|0] "" Gate
SG_MUL_VAL_ 300 first page 0-0;
SG_MUL_VAL_ 300 inner page 1-1, 3-5;
SG_MUL_VAL_ 300 deep inner 2-9, 200-200;
SIG_VALTYPE_ 300 deep : 1;
CM_ BO_ 100 "How fast it goes.
On every road.";
CM_ SG_ 100 speed "measured at the \\"left\\" wheel";
CM_ SG_ 100 gear "of the gear box";
VAL_ 100 gear -1 "reverse" 0 "neutral" ;
VAL_ 100 temperature 255 "not available" 254 "error" ;
"""
EDS = """[DeviceInfo]
[1000]
ParameterName=Device type
ObjectType=0x7
DataType=0x0007
AccessType=rw
[6041]
ParameterName=Statusword
DataType=0x0006
AccessType=rw
[1800]
SubNumber=2
ParameterName=TPDO
ObjectType=0x9
[1800sub0]
ParameterName=n
DataType=0x0005
AccessType=rw
DefaultValue=1
[1800sub1]
ParameterName=id
DataType=0x0007
AccessType=rw
DefaultValue=$NODEID+0x180
[1A00]
SubNumber=2
ParameterName=map
ObjectType=0x9
[1A00sub0]
ParameterName=n
DataType=0x0005
AccessType=rw
DefaultValue=1
[1A00sub1]
ParameterName=1
DataType=0x0007
AccessType=rw
DefaultValue=0x60410010
"""


def run_source(text: str) -> Protocol:
    """The protocol that a module's source declares."""
    module = ModuleType("imported")
    exec(compile(text, "imported.py", "exec"), module.__dict__)
    (protocol,) = (one for one in vars(module).values() if isinstance(one, Protocol))
    return protocol


def facts(protocol: Protocol) -> list[Any]:
    """All that decoding and encoding depend on."""
    return [
        (
            replace(flatten(m), place=""),
            m.identifier.constant,
            [(c.name, list(c.values), c.shift, c.doc) for c in m.identifier.captures],
            (m.extended, m.remote, m.fd, tuple(m.lengths or ()), m.direction, m.doc),
        )
        for m in protocol.declared
    ]


def same(one: Protocol, other: Protocol) -> None:
    for mine, theirs in zip(facts(one), facts(other), strict=True):
        assert mine == theirs
    assert (one.name, one.bitrate, one.doc) == (other.name, other.bitrate, other.doc)


def is_formatted(text: str) -> None:
    """Assert that `ruff format` with its defaults leaves a source as it is."""
    if RUFF is None:
        pytest.skip("ruff is not installed")
    command = [RUFF, "format", "--isolated", "--diff", "-"]
    run = subprocess.run(command, input=text, capture_output=True, text=True, encoding="utf-8")
    assert run.returncode == 0, run.stdout + run.stderr


TRUCK = """BO_ 2566844926 EEC1: 8 Engine
 SG_ speed : 24|16@1+ (0.125,0) [0|8031.875] "rpm" Vector__XXX
BO_ 2364540158 Request: 8 Engine
 SG_ group : 0|24@1+ (1,0) [0|0] "" Vector__XXX
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_ "VFrameFormat" BO_ 2566844926 3;
BA_ "VFrameFormat" BO_ 2364540158 3;
"""


KCD = """<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0"><Document/><Bus name="b">
<Message id="0x64" name="Speed" length="4">
<Signal name="speed" offset="0" length="16"><Value unit="km/h" slope="0.01"/></Signal>
<Signal name="gear" offset="16" length="3"><LabelSet><Label name="reverse" value="7"/></LabelSet></Signal>
</Message></Bus></NetworkDefinition>
"""
SYM = """FormatVersion=6.0 // Do not edit this line!
Title="car"

{SIGNALS}
Sig=speed unsigned 16 /u:km/h /f:0.01

{SENDRECEIVE}

[Speed]
ID=064h
Len=4
Sig=speed 0
"""


@pytest.mark.parametrize("name", ["car.dbc", "truck.dbc", "car.kcd", "car.sym", "drive.eds"])
def test_the_source_declares_what_the_file_declares(name: str, tmp_path: Path, aces: Aces) -> None:
    """Same plans, identifiers and lengths; the source is formatted; -o writes what stdout shows."""
    path = tmp_path / name
    texts = {
        "car.dbc": HEAD + CAR,
        "truck.dbc": HEAD + TRUCK,
        "drive.eds": EDS,
        "car.kcd": KCD,
        "car.sym": SYM,
    }
    path.write_text(texts[name], encoding="utf-8")
    result = aces("spec", "import", path)
    assert (result.status, result.err) == (0, "")
    protocol = load_database(path).protocol
    same(run_source(result.out), protocol)
    is_formatted(result.out)
    assert aces("spec", "import", path, "-o", tmp_path / "made.py").messages == [
        f"wrote {tmp_path / 'made.py'}"
    ]
    assert (tmp_path / "made.py").read_text(encoding="utf-8") == result.out
    again = aces("spec", "import", path, "-o", tmp_path / "made.py")
    assert again.status == 2
    assert "--force" in again.err


def test_it_reads_like_a_spec(tmp_path: Path, aces: Aces) -> None:
    """The language's own helpers, and nothing that the file does not say."""
    path = tmp_path / "car.dbc"
    path.write_text(HEAD + CAR, encoding="utf-8")
    source = aces("spec", "import", path).out
    for line in (
        'car = Protocol("car", link="can", source="car.dbc")',
        "    id=0x064,",
        "        / Enumeration(bits(3, signed=True), reverse=-1, neutral=0)",
        '        * "of the gear box",',
        '        "first" / Multiplexed("page", 0, bits(8, 8)),',
        '        "deep" / Multiplexed("inner", {2, 3, 4, 5, 6, 7, 8, 9, 200}, float_bits(32)),',
        "            doc='measured at the \"left\" wheel',",
    ):
        assert line in source.splitlines(), source


def test_decoding_is_that_of_the_file(tmp_path: Path, aces: Aces) -> None:
    """`aces decode -p made.py` prints what `-p car.dbc` prints."""
    path, made, log = tmp_path / "car.dbc", tmp_path / "made.py", tmp_path / "a.log"
    path.write_text(HEAD + CAR, encoding="utf-8")
    aces("spec", "import", path, "-o", made)
    log.write_text("(1.0) can0 064#102703FF50\n(2.0) can0 12C#0405000080bf0000\n")
    wanted = aces("decode", log, "-p", path, "--format", "jsonl")
    assert wanted.summary["decoded"] == 2
    assert aces("decode", log, "-p", made, "--format", "jsonl").out == wanted.out


@given(text=databases(), seed=st.integers(0, 2**32))
@settings(max_examples=10)
def test_drawn_databases(text: str, seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Byte orders, signs, scales, floats, value tables, multiplexers in multiplexers: the same plans and records."""
    path = tmp_path_factory.getbasetemp() / "imported.dbc"
    path.write_text(text, encoding="utf-8")
    imported = load_database(path)
    source = print_source(imported.protocol, imported.problems)
    made = run_source(source)
    same(made, imported.protocol)
    is_formatted(source)
    rng = random.Random(seed)
    frames = [
        Frame(
            m.identifier.constant,
            rng.randbytes(next(iter(m.lengths or [0]))),
            is_extended_id=m.extended,
            is_fd=m.fd,
        )
        for m in imported.protocol.declared
    ]
    one, other = (
        make_scanner([p.variant()], include_unknown=True).feed(frames) for p in (made, imported.protocol)
    )
    assert list(map(str, one)) == list(map(str, other))


# ---------------------------------------------------------------------- damaged and hostile files


def test_faults_have_line_and_column(tmp_path: Path, aces: Aces) -> None:
    """Of a damaged DBC each fault is named where it is, on stderr and in the source; the rest loads."""
    body = CAR.replace("(0.01,-10) [0", "(0.01,-10 [0").replace(
        "SG_MUL_VAL_ 300 f", "FOO_ 1;\nSG_MUL_VAL_ 300 f"
    )
    path = tmp_path / "car.dbc"
    path.write_text(HEAD + body, encoding="utf-8")
    result = aces("spec", "import", path)
    assert result.status == 0
    first = HEAD.count("\n") + 2
    assert result.err.startswith(f"{path}:{first}:32: cannot be read at '[0|250]'")
    assert ":1: cannot be read at 'FOO_' (FOO_ 1;)\n" in result.err
    assert f"#   line {first}: cannot be read" in result.out
    made = run_source(result.out)
    assert flatten(made["Speed"]).fields
    assert aces("spec", "import", path, "--strict").status == 1
    about = json.loads(aces("spec", "import", path, "--json").out)
    assert about["problems"][0]["line"] == first
    assert about["problems"][0]["column"] == 32
    assert about["source"] == result.out


def test_what_a_spec_has_no_word_for_is_named(tmp_path: Path, aces: Aces) -> None:
    """Attributes, environment variables, groups and comments of nodes: a line each, with the first place."""
    more = """EV_ Speed: 0 [0|100] "" 0 1 DUMMY_NODE_VECTOR0 Vector__XXX;
CM_ BU_ ECU "the engine";
CM_ "the whole";
BA_DEF_ SG_ "GenSigStartValue" INT 0 100;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_ "GenSigStartValue" SG_ 100 speed 5;
BA_ "GenSigStartValue" SG_ 100 gear 0;
SIG_GROUP_ 100 both 1 : speed gear;
"""
    path = tmp_path / "car.dbc"
    path.write_text(HEAD + CAR + more, encoding="utf-8")
    line = (HEAD + CAR).count("\n") + 1
    result = aces("spec", "import", path)
    assert result.status == 0
    for number, said in (
        (line, "environment variables: not taken over"),
        (line + 1, "comments of nodes: not taken over"),
        (line + 2, "comments of the whole file: not taken over"),
        (line + 5, "the attribute GenSigStartValue: not taken over (2 times)"),
        (line + 7, "groups of signals: not taken over"),
    ):
        assert f"{path}:{number}: {said}" in result.err.splitlines()
        assert f"#   line {number}: {said}" in result.out.splitlines()
    same(run_source(result.out), load_database(path).protocol)


HOSTILE = (
    '"""\nimport os\nos.abort()\n"""',
    "'''\nraise SystemExit\n'''",
    "\\\" + __import__('os').abort() + \\\"",
    "\\\\",
    "x\r\nraise SystemExit",
    "\u2028raise SystemExit\u2029\x85\x0b\x0c",
    "\u202e)doc=x",
    "# -*- coding: utf-7 -*-",
    "{0}%s$x`rm`",
)


@pytest.mark.parametrize("text", HOSTILE)
def test_text_of_a_file_is_never_code(text: str, tmp_path: Path) -> None:
    """Comments, units, names of values and of the file itself are strings, whatever they hold."""
    dbc = text.replace('"', '\\"').replace('\\\\"', '\\"')
    body = f"""BO_ 100 Speed: 8 ECU
 SG_ speed : 0|16@1+ (1,0) [0|0] "{dbc}" Gate
 SG_ mode : 16|8@1+ (1,0) [0|0] "" Gate
CM_ BO_ 100 "{dbc}";
CM_ SG_ 100 speed "{dbc}";
CM_ SG_ 100 mode "{dbc}";
VAL_ 100 mode 1 "{dbc}" 2 "b" ;
{text}
"""
    path = tmp_path / "car.dbc"
    path.write_text(HEAD + body, encoding="utf-8", newline="")
    try:
        imported = load_database(path)
    except AcesError:
        return
    source = print_source(imported.protocol, imported.problems)
    tree = ast.parse(source)
    calls = {
        node.func.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
    }
    assert calls <= {"BitLayout", "Enumeration", "Multiplexed", "Protocol", "Quantity", "bits", "float_bits"}
    assert len(tree.body) == 3 + 1 + len(imported.protocol.declared)
    assert all(line.isprintable() for line in source.split("\n"))
    assert "coding" not in "".join(source.split("\n")[:2])
    same(run_source(source), imported.protocol)
    is_formatted(source)


@given(st.text(min_size=1, max_size=12))
def test_names_of_a_file_are_names_of_python(name: str) -> None:
    """A protocol called anything at all gives a variable that hides no word of the source."""
    protocol = Protocol(protocol_name(f"{name}.dbc"), link="can", doc=name, source=name)
    same(run_source(print_source(protocol)), protocol)


@pytest.mark.parametrize("name", ["bits", "Protocol", "print", "Struct", "class"])
def test_a_file_called_like_a_word_of_the_language(name: str, tmp_path: Path, aces: Aces) -> None:
    """`bits.dbc` makes a variable `bits_`."""
    path = tmp_path / f"{name}.dbc"
    path.write_text(HEAD + CAR, encoding="utf-8")
    source = aces("spec", "import", path).out
    assert f"\n{name}_ = Protocol(" in source
    same(run_source(source), load_database(path).protocol)


def test_what_is_no_database(tmp_path: Path, aces: Aces) -> None:
    """A line on stderr and status 2."""
    assert aces("spec", "import", tmp_path / "missing.dbc").status == 2
    (tmp_path / "a.txt").write_text("x")
    result = aces("spec", "import", tmp_path / "a.txt")
    assert (result.status, len(result.err.splitlines())) == (2, 1)


def test_stubs_of_a_database_say_what_to_do(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Stubs need a Python file: for a database the command names the one that makes it, without a traceback."""
    path = tmp_path / "car.dbc"
    path.write_text(
        'VERSION ""\nBO_ 100 Speed: 8 ECU\n SG_ v : 0|16@1+ (0.1,0) [0|100] "km/h" ECU\n', "utf-8"
    )
    assert main(["spec", "stubs", str(path)]) == 2
    assert f"aces spec import {path} > car.py" in capsys.readouterr().err

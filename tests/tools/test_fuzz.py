"""`aces fuzz`: what it runs, finds, draws, saves and repeats."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from aces_tools import fuzz as verb

from .conftest import Aces

GOOD = """
from construct import Byte, Int16ul, Struct, this
from aces_bus.protocol import Enumeration, Protocol, Sum

good = Protocol("good", link="serial", dialects={"a": "one", "b": "other"})
head = Struct("length" / Byte, "kind" / Byte)
packet = good.framing(sync=b"\\xaa", header=head, size=this.length + 4, max_size=40, check=Sum())
packet("Level", match={"kind": 1}, payload=Struct("level" / Int16ul, "mode" / Enumeration(Byte, off=0, on=1)))
packet("Reset", match={"kind": 2}, dialect="b")
"""

#: What is above a thousand does not come back.
CLIPPED = """
from construct import Adapter, Byte, Int16ul, Struct
from aces_bus.protocol import IdField, Protocol

bad = Protocol("bad", link="can")

class Clipped(Adapter):
    def _decode(self, obj, context, path):
        return min(obj, 1000)

    def _encode(self, obj, context, path):
        return obj

bad.message("Level", id=0x100 + IdField("tank", range(4)), payload=Struct("level" / Clipped(Int16ul), "other" / Byte))
"""


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of one's own with two specs."""
    (tmp_path / "good.py").write_text(GOOD)
    (tmp_path / "bad.py").write_text(CLIPPED)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_a_good_protocol_passes_and_says_what_was_reached(aces: Aces, here: Path) -> None:
    """Status 0, a table of messages, and one line that sums up."""
    result = aces("fuzz", "good.py", "--examples", "256", "--seed", "1")
    assert result.status == 0
    assert re.search(r"^good: 2/2 messages, 2/2 fields, 2/2 named values, 4/4 templates$", result.out, re.M)
    assert re.search(r"^  Level +\d+ +2/2 +2/2 +-$", result.out, re.M)
    assert re.search(r"^  framing good: accepted \d+, cut off \d+, .*wrong check \d+$", result.out, re.M)
    assert "nothing was left out" in result.out
    assert result.summary["examples"] == 256
    assert result.err.endswith("seed=1: no failure\n")


@pytest.mark.slow
def test_what_was_never_reached_is_named(aces: Aces, here: Path) -> None:
    """A single example reaches little; the rest is listed."""
    out = aces("fuzz", "good.py", "--seed", "1", "--examples", "1").out
    assert re.search(r"never reached: .*(Level|Reset)", out)


@pytest.mark.slow
def test_a_dialect_is_fuzzed_alone(aces: Aces, here: Path) -> None:
    """In dialect `a` there is one message."""
    assert "1/1 messages" in aces("fuzz", "good.py:a", "--examples", "96", "--seed", "1").out


def test_a_failure_is_drawn_saved_and_repeated(aces: Aces, here: Path) -> None:
    """The smallest frame is shown; each line under "again" gives the same failure."""
    result = aces("fuzz", "bad.py", "--seed", "5", "--law", "round trip", "--examples", "640")
    assert result.status == 1
    assert "FAILED law 1 (round trip) of bad, any direction" in result.out
    frame = re.search(r"^     0  100#(\w{6})$", result.out, re.M)
    assert frame is not None
    assert int.from_bytes(bytes.fromhex(frame[1])[:2], "little") > 1000
    assert "law    Level tank=0 level=1000 other=0" in result.out
    again = [line.split()[1:] for line in result.out.splitlines() if line.startswith("    aces fuzz")]
    assert len(again) == 2
    for line in again:
        repeated = aces(*line)
        assert repeated.status == 1
        assert frame[0] in repeated.out
    (decode,) = (line.split()[1:] for line in result.out.splitlines() if line.startswith("    aces decode"))
    assert "Level" in aces(*decode).out
    assert len(list((here / ".aces" / "failures").iterdir())) == 2


@pytest.mark.slow
def test_a_corpus_is_kept_and_judged_first(aces: Aces, here: Path) -> None:
    """What failed fails at once the next time, and what reached something new is kept."""
    first = aces("fuzz", "bad.py", "--seed", "5", "--law", "1", "--examples", "640", "--corpus", "corpus")
    assert first.status == 1
    kept = sorted(path.name for path in (here / "corpus").glob("*.json"))
    assert any("law1" in name for name in kept)
    assert any("scene" in name for name in kept)
    second = aces("fuzz", "bad.py", "--law", "1", "--examples", "0", "--corpus", "corpus", "-q")
    assert second.status == 1
    assert second.summary["examples"] == len(kept)
    assert sorted(path.name for path in (here / "corpus").glob("*.json")) == kept


def test_any_capture_is_replayed(aces: Aces, here: Path) -> None:
    """Frames of a log and bytes of a line go through the laws like any scene."""
    (here / "some.log").write_text("(0.1) can0 101#D00700\n(0.2) can0 7FF#00\n")
    result = aces("fuzz", "bad.py", "--replay", "some.log", "--law", "1")
    assert result.status == 1
    (here / "some.bin").write_bytes(bytes.fromhex("AA 03 01 10 00 01") * 30)
    assert aces("fuzz", "good.py", "--replay", "some.bin").status == 0


def test_json_says_everything(aces: Aces, here: Path) -> None:
    """One object: numbers, failures with their commands, what was reached."""
    result = aces("fuzz", "bad.py", "good.py", "--seed", "5", "--examples", "640", "--json", "--most", "1")
    (said,) = result.objects
    assert result.status == 1
    assert (said["names"], said["seed"], said["interrupted"]) == (["bad.py", "good.py"], 5, False)
    (failure,) = said["failures"]
    assert (failure["law"], failure["wire"]) == (1, "bad")
    assert Path(failure["capture"]).exists()
    assert failure["commands"][0].startswith("aces fuzz bad.py good.py --law 1 --seed 5:")
    assert said["protocols"]["good"]["messages"]["of"] == 2
    assert json.loads(Path(failure["scene"]).read_text())["protocol"] == "bad"


@pytest.mark.slow
def test_several_processes_do_the_same_examples(aces: Aces, here: Path) -> None:
    """With --jobs, as many examples, bytes and frames, and the same coverage."""
    one = aces("fuzz", "good.py", "--examples", "128", "--seed", "9")
    two = aces("fuzz", "good.py", "--examples", "128", "--seed", "9", "--jobs", "2")
    assert (one.status, two.status) == (0, 0)
    assert (one.summary["bytes_and_frames"], one.summary["checks"]) == (
        two.summary["bytes_and_frames"],
        two.summary["checks"],
    )
    assert one.out == two.out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere"], "no protocol named 'nowhere'"),
        (["missing.py"], "no such file"),
        (["good.py", "--law", "12"], "no law named '12'"),
        (["good.py", "--seed", "x"], "--seed x: a number"),
        (["good.py", "--seed", "1:-4"], "examples count from 0"),
        (["good.py", "--examples", "-1"], "--examples: '-1' is not a whole number"),
        (["good.py", "--for", "0"], "--for: '0' is not a duration"),
        (["good.py", "--for", "nan"], "--for: 'nan' is not a duration"),
        (["good.py", "--jobs", "-1"], "--jobs: '-1' is not a whole number"),
        (["good.py", "--replay", "absent.json"], "absent.json: No such file"),
        (["good.py", "--replay", "wrong.json"], "wrong.json: not a scene"),
        (["good.py", "--corpus", "good.py"], "good.py: Not a directory"),
        (["can0=good.py"], "a channel makes no difference"),
    ],
)
def test_a_wrong_call_says_what_is_wrong(aces: Aces, here: Path, arguments: list[str], said: str) -> None:
    """Status 2 and one line."""
    (here / "wrong.json").write_text("[1]")
    result = aces("fuzz", *arguments)
    assert result.status == 2
    assert said in result.err
    assert result.err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of POSIX")
def test_ctrl_c_ends_with_the_summary(here: Path) -> None:
    """Status 130, the numbers so far, and no process left."""
    program = "from aces_tools.main import main; import sys; sys.exit(main(sys.argv[1:]))"
    command = [
        sys.executable,
        "-c",
        program,
        "fuzz",
        "good.py",
        "--for",
        "5min",
        "--jobs",
        "2",
        "--corpus",
        "kept",
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        limit = time.monotonic() + 120
        while not (here / "kept").exists() and time.monotonic() < limit:
            time.sleep(0.02)  # until it is at work: it keeps its first scenes at once
        running.send_signal(signal.SIGINT)
        _, err = running.communicate(timeout=120)
    assert running.returncode == 130, err
    assert "Traceback" not in err
    assert err.splitlines()[-1].startswith("interrupted: examples=")


def test_help_names_the_laws_and_imports_little(aces: Aces) -> None:
    """`aces fuzz --help` tells every law; the verb's module itself imports nothing heavy."""
    out = aces("fuzz", "--help").out
    for name in ("round trip", "oracle", "chunking", "resynchronisation", "accounting", "bounded", "calm"):
        assert name in out
    assert verb.EXAMPLES == 20_000
    program = "import sys, aces_tools.fuzz; print(sorted({'numpy', 'construct', 'hypothesis'} & sys.modules.keys()))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"

"""`aces decode` on CAN recordings: what is printed, what is counted, what is said."""

from __future__ import annotations

import csv
import io
import json
import math
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from .conftest import LOG, Aces

FRAMES = 12


# ---------------------------------------------------------------------- record lines


def test_record_lines_have_the_keys_in_order(aces: Aces, log: Path, arm: str) -> None:
    """A decoded frame is one JSON object with the documented keys in the documented order, separated by blanks."""
    result = aces("decode", log, "-p", arm, "--format", "jsonl")
    assert result.out.splitlines()[0] == (
        f'{{"source": "{log}", "time": 1436509052.0, "channel": "can0", "direction": "from device", "id": 96, '
        '"extended": false, "fd": false, "protocol": "arm", "message": "Encoder", '
        '"fields": {"board": 0, "position": [10, -10]}}'
    )
    assert len(result.objects) == FRAMES


def test_what_is_not_decoded_says_why(aces: Aces, log: Path, arm: str) -> None:
    """Unknown, malformed and error frames and replies without request have a reason and their bytes, and no fields."""
    lost = [o for o in aces("decode", log, "-p", arm, "--format", "jsonl").objects if o["message"] is None]
    assert [o["reason"].partition(",")[0] for o in lost] == [
        "unknown",
        "malformed: length 2",
        "unknown: needs request Get",
        "error frame",
    ]
    assert [o["raw"] for o in lost] == ["deadbeef", "0102", "0100ffff", "0004000000000000"]
    assert all("fields" not in o and o["protocol"] is None for o in lost)
    assert list(lost[0]) == [
        *("source", "time", "channel", "direction", "id", "extended", "fd"),
        *("protocol", "message", "reason", "raw"),
    ]


def test_values_are_what_json_has(aces: Aces, log: Path, arm: str) -> None:
    """Enumerations print their name or number, flags a list with unnamed bits as hexadecimal, infinities and NaN null."""
    first, second = [
        o for o in aces("decode", log, "-p", arm, "--format", "jsonl").objects if o["message"] == "State"
    ]
    assert first["fields"] == {
        "board": 0,
        "mode": "torque",
        "error": ["hot", "cold"],
        "angle": 1.0,
        "load": -1.0,
    }
    assert second["fields"]["mode"] == 1
    assert second["fields"]["error"] == ["0x80"]
    assert second["fields"]["load"] is None


def test_a_reply_is_told_by_its_request(aces: Aces, log: Path, arm: str) -> None:
    """The same bytes are unknown before their request and decoded after it."""
    result = aces("decode", log, "-p", arm, "--format", "jsonl")
    assert [o["message"] for o in result.objects if o["id"] == 0x1C0] == [None, "Gains"]


@pytest.mark.parametrize(("suffix", "direction"), [("", None), (" R", "rx"), (" T", "tx")])
def test_the_suffix_of_candump_is_kept(
    aces: Aces, tmp_path: Path, arm: str, suffix: str, direction: str | None
) -> None:
    """`bus_direction` is there exactly when the log says it."""
    log = tmp_path / "a.log"
    log.write_text(f"(1.5) can0 060#0000000000000000{suffix}\n(1.6) can0 7FF#00{suffix}\n")
    for one in aces("decode", log, "-p", arm, "--format", "jsonl").objects:
        assert one.get("bus_direction") == direction
        assert ("bus_direction" in one) is (direction is not None)


def test_kinds_of_frames(aces: Aces, tmp_path: Path, arm: str) -> None:
    """Extended, FD and remote frames say what they are."""
    log = tmp_path / "a.log"
    log.write_text("(1.0) can0 1FFF0001##1010000000200000003000000\n(1.0) can0 700#R\n(1.0) can0 701#R4\n")
    wide, ask, other = aces("decode", log, "-p", arm, "--format", "jsonl").objects
    assert (wide["id"], wide["extended"], wide["fd"], wide["fields"]) == (
        0x1FFF0001,
        True,
        True,
        {"words": [1, 2, 3]},
    )
    assert (ask["message"], ask["fields"], ask["remote"]) == ("Ask", {}, True)
    assert (other["message"], other["raw"], other["remote"]) == (None, "", True)
    assert "remote" not in wide


def test_bytes_are_hexadecimal(aces: Aces, tmp_path: Path, arm: str) -> None:
    """Bytes, and texts with control characters, survive as JSON."""
    log = tmp_path / "a.log"
    log.write_text("(1.0) can0 400#00FF10\n(1.0) can0 600#1B5B410A22000000\n")
    raw, name = aces("decode", log, "-p", arm, "--format", "jsonl").objects
    assert raw["fields"] == {"data": "00ff10"}
    assert name["fields"] == {"name": '\x1b[A\n"'}


# ---------------------------------------------------------------------- counting


def test_the_summary_accounts_for_every_frame(aces: Aces, log: Path, arm: str) -> None:
    """The last line on stderr has the bins in the documented form, and they sum to the frames."""
    result = aces("decode", log, "-p", arm)
    assert result.status == 0
    assert result.err.splitlines()[-1] == (
        "frames=12 decoded=8 unknown=2 malformed=1 filtered=0 errors=1 lines_unreadable=1"
    )


def test_totals_are_over_all_files(aces: Aces, log: Path, arm: str) -> None:
    """Two files, one summary: twice the numbers, and requests of the first do not reach into the second."""
    result = aces("decode", log, log, "-p", arm, "-q")
    assert result.err.splitlines()[-1] == (
        "frames=24 decoded=16 unknown=4 malformed=2 filtered=0 errors=2 lines_unreadable=2"
    )


def sums(summary: dict[str, int]) -> bool:
    """Whether the bins sum to the input."""
    bins = ("decoded", "unknown", "malformed", "skipped", "filtered", "errors", "pending")
    return summary.get("frames", summary.get("bytes")) == sum(summary.get(name, 0) for name in bins)


@pytest.mark.parametrize(
    ("options", "decoded", "filtered"),
    [
        (["--message", "Encoder"], 1, 7),
        (["--message", "Encoder,Encoder3"], 2, 6),
        (["--message", "Encoder", "--message", "State"], 3, 5),
        (["--where", "board=0"], 4, 4),
        (["--where", "board=0", "--where", "kp>0"], 1, 7),
        (["--where", "position<0"], 1, 7),
        (["--message", "State", "--where", "error=hot"], 1, 7),
    ],
)
def test_selected_records(
    aces: Aces, log: Path, arm: str, options: list[str], decoded: int, filtered: int
) -> None:
    """--message and --where move decoded frames to `filtered`; what was lost stays in its bin, and is not printed."""
    result = aces("decode", log, "-p", arm, "--format", "jsonl", *options)
    assert (result.summary["decoded"], result.summary["filtered"]) == (decoded, filtered)
    assert (result.summary["unknown"], result.summary["malformed"], result.summary["errors"]) == (2, 1, 1)
    assert len(result.objects) == decoded
    assert sums(result.summary)


@pytest.mark.parametrize(
    ("filters", "passing"),
    [
        (["060:7FF"], 2),
        (["300:7FC"], 2),
        (["060~7FF"], 9),
        (["can1"], 2),
        (["can0,060:7FF", "can1"], 4),
        (["#FFFFFFFF,7FF:7FF"], 2),
    ],
)
def test_filters_of_candump(aces: Aces, log: Path, arm: str, filters: list[str], passing: int) -> None:
    """A frame that no filter lets pass is `filtered`, whatever it was."""
    options = [word for text in filters for word in ("--filter", text)]
    result = aces("decode", log, "-p", arm, "--format", "jsonl", *options)
    assert len(result.objects) == passing
    assert result.summary["filtered"] == FRAMES - passing
    assert sums(result.summary)


def test_filters_apply_after_recognition(aces: Aces, log: Path, arm: str) -> None:
    """A reply is still told by a request that is not shown."""
    result = aces("decode", log, "-p", arm, "--format", "jsonl", "--filter", "1C0:7FF")
    assert [o["message"] for o in result.objects] == [None, "Gains"]


@pytest.mark.parametrize(("unknown", "messages"), [("show", 12), ("hide", 8), ("only", 4)])
def test_what_is_not_decoded_can_be_left_out(
    aces: Aces, log: Path, arm: str, unknown: str, messages: int
) -> None:
    """--unknown chooses what is printed and changes nothing in the counts."""
    result = aces("decode", log, "-p", arm, "--format", "jsonl", "--unknown", unknown)
    assert len(result.objects) == messages
    assert result.summary == aces("decode", log, "-p", arm, "-q").summary


def test_strict(aces: Aces, log: Path, arm: str, tmp_path: Path) -> None:
    """--strict exits 1 and says what was lost; where nothing was, it changes nothing."""
    result = aces("decode", log, "-p", arm, "-q", "--strict")
    assert result.status == 1
    assert "--strict: 2 unknown, 1 malformed, 1 unreadable line" in result.messages
    good = tmp_path / "good.log"
    good.write_text("(1.0) can0 060#0000000000000000\n(1.1) can0 20000004#0004000000000000\n")
    assert aces("decode", good, "-p", arm, "--strict").status == 0
    assert (
        aces("decode", log, "-p", arm, "--strict", "-q", "--filter", "300:7FF").status == 1
    )  # the unreadable line


# ---------------------------------------------------------------------- what goes wrong


def test_unreadable_lines_are_named(aces: Aces, tmp_path: Path, arm: str) -> None:
    """The first ones with file, line, reason and excerpt; then how many more."""
    log = tmp_path / "a.log"
    log.write_text("(1.0) can0 060#0000000000000000\n" + "".join(f"rubbish {n}\n" for n in range(10)))
    result = aces("decode", log, "-p", arm, "-q")
    assert result.messages[0].startswith(f"{log}:2: ")
    assert "rubbish 0" in result.messages[0]
    assert result.messages[3] == f"{log}: and 7 more unreadable lines"
    assert result.summary["lines_unreadable"] == 10


def test_a_missing_file_spoils_nothing_else(aces: Aces, log: Path, arm: str, tmp_path: Path) -> None:
    """One line about it, the others decoded, status 2."""
    result = aces("decode", tmp_path / "no.log", log, tmp_path, "-p", arm, "--format", "jsonl")
    assert result.status == 2
    assert len(result.objects) == FRAMES
    assert [m for m in result.messages if "no such file" in m]
    assert [m for m in result.messages if "folder" in m]
    assert result.summary["frames"] == FRAMES


@pytest.mark.parametrize("content", [bytes(range(256)) * 4, b"\x1f\x8b" + bytes(100), b"time,x\n1,2\n" * 300])
def test_a_file_that_is_no_log(aces: Aces, tmp_path: Path, arm: str, content: bytes) -> None:
    """A binary or other file is refused with one line, without counts behind it."""
    path = tmp_path / "x.log"
    path.write_bytes(content)
    result = aces("decode", path, "-p", arm)
    assert result.status == 2
    assert result.err.startswith(f"aces: {path}")
    assert result.err.count("\n") == 1


@pytest.mark.parametrize("content", ["", "\n\n", "# only a remark\n"])
def test_an_empty_log_is_no_fault(aces: Aces, tmp_path: Path, arm: str, content: str) -> None:
    """Nothing in, nothing out, and still a summary."""
    path = tmp_path / "x.log"
    path.write_text(content)
    result = aces("decode", path, "-p", arm, "--strict")
    assert (result.status, result.out) == (0, "")
    assert result.summary["frames"] == 0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--message", "Encodre"], "did you mean 'Encoder'?"),
        (["--where", "positon=3"], "did you mean 'position'?"),
        (["--where", "mode=torqe"], "did you mean 'torque'?"),
        (["--where", "error=hott"], "did you mean 'hot'?"),
        (["--where", "position"], "field=value"),
        (["--where", "position<many"], "needs a number"),
        (["--where", "position=many"], "not a number"),
        (["--where", "data=xyz"], "hexadecimal"),
        (["--where", "meta.tim=3"], "did you mean 'time'?"),
        (["--filter", "060"], "mask"),
        (["--filter", "can0,zz:7FF"], "not a filter"),
        (["-p", "no_such_protocol"], "there are:"),
        (["--format", "xml"], "jsonl"),
        (["--direction", "up"], "to"),
    ],
)
def test_a_wrong_option_names_what_would_work(
    aces: Aces, log: Path, arm: str, options: list[str], said: str
) -> None:
    """One line, status 2, nothing decoded."""
    result = aces("decode", log, "-p", arm, *options)
    assert result.status == 2
    assert result.out == ""
    assert result.err.count("\n") == 1
    assert said in result.err


def test_an_interface_that_never_occurs_is_said(aces: Aces, log: Path, arm: str) -> None:
    """A filter that is taken for an interface's name does not filter everything without a word."""
    result = aces("decode", log, "-p", arm, "--filter", "encoder")
    assert result.summary["filtered"] == FRAMES
    assert any("'encoder'" in m and "can0" in m for m in result.messages)


def test_nothing_decoded_gives_a_hint(aces: Aces, tmp_path: Path, arm: str) -> None:
    """A capture of which nothing is decoded asks whether the protocol is right."""
    log = tmp_path / "a.log"
    log.write_text("(1.0) can0 7FF#00\n")
    assert any("right protocol" in m for m in aces("decode", log, "-p", arm).messages)


def test_two_protocols_that_claim_a_frame_warn_once(aces: Aces, log: Path, arm: str, spec: Path) -> None:
    """The order of -p decides; the first frame that both claim is told, once."""
    other = spec.with_name("other.py")
    other.write_text(
        "from construct import Byte, Struct\nfrom aces_bus.protocol import Protocol\n"
        "other = Protocol('other', link='can')\n"
        "other.message('Eight', id=0x060, payload=Struct('first' / Byte, 'more' / Byte[7]))\n"
        "other.message('Never', id=0x123)\n"
    )
    first = aces("decode", log, log, "-p", arm, "-p", other, "--format", "jsonl")
    assert len([m for m in first.messages if "both claim" in m]) == 1
    assert "0x060" in next(m for m in first.messages if "both claim" in m)
    assert first.objects[0]["message"] == "Encoder"
    assert aces("decode", log, "-p", other, "-p", arm, "--format", "jsonl").objects[0]["message"] == "Eight"
    calm = aces("decode", log, "-p", arm, "-p", other, "--filter", "300:7FF", "-q")
    assert any("both claim" in m for m in calm.messages)


def test_any_two_of_several_protocols_may_clash(aces: Aces, tmp_path: Path) -> None:
    """A frame that the second and the third claim warns too."""
    for name, identifier in (("one", 1), ("two", 2), ("three", 2)):
        (tmp_path / f"{name}.py").write_text(
            f"from aces_bus.protocol import Protocol\n{name} = Protocol({name!r}, link='can')\n"
            f"{name}.message('M{name}', id={identifier}, length=0)\n"
        )
    (tmp_path / "a.log").write_text("(1.0) can0 002#\n")
    options = [word for name in ("one", "two", "three") for word in ("-p", tmp_path / f"{name}.py")]
    result = aces("decode", tmp_path / "a.log", *options, "--format", "jsonl")
    assert result.objects[0]["message"] == "Mtwo"
    assert any(m.startswith("two and three both claim identifier 0x002") for m in result.messages)


def test_protocols_that_share_only_what_does_not_occur_are_calm(
    aces: Aces, tmp_path: Path, arm: str, spec: Path
) -> None:
    """No warning without such a frame."""
    log = tmp_path / "a.log"
    log.write_text("(1.0) can0 300#0000000000000000\n")
    result = aces("decode", log, "-p", arm, "-p", f"{spec}:arm:old@three", "-q")
    assert result.summary["decoded"] == 1
    assert not [m for m in result.messages if "both claim" in m]


def test_a_direction_limits_the_messages(aces: Aces, log: Path, arm: str) -> None:
    """On CAN, --direction leaves out messages that go the other way, and says nothing of frames that are not decoded."""
    objects = aces("decode", log, "-p", arm, "--direction", "from", "--format", "jsonl").objects
    assert {o["direction"] for o in objects if o["message"]} == {"from device", None}
    assert {o["direction"] for o in objects if not o["message"]} == {None}
    assert "Get" not in {o["message"] for o in objects}


# ---------------------------------------------------------------------- dialects and configurations


def test_configuration_and_dialect(aces: Aces, log: Path, spec: Path) -> None:
    """-p takes dialect and configuration, also for a protocol of a file."""
    ids = {o["id"]: o for o in aces("decode", log, "-p", f"{spec}:arm@three", "--format", "jsonl").objects}
    assert ids[0x62]["message"] == "Encoder3"
    assert ids[0x60]["message"] is None
    old = aces("decode", log, "-p", f"{spec}:arm:old", "--format", "jsonl", "--unknown", "only").objects
    assert 0x300 in {o["id"] for o in old}


def test_a_configuration_of_ones_own(aces: Aces, log: Path, spec: Path, tmp_path: Path) -> None:
    """-p NAME@robot.toml reads the tables from a file, on their own or on top of a shipped one."""
    robot = tmp_path / "robot.toml"
    robot.write_text('base = "two"\n[channels]\n0x00 = 3\n')
    result = aces("decode", log, "-p", f"{spec}:arm@{robot}", "--format", "jsonl")
    assert next(o["reason"] for o in result.objects if o["id"] == 0x60).startswith(
        "malformed: length 8, Encoder3"
    )
    assert [o["message"] for o in result.objects if o["id"] == 0x62] == ["Encoder3"]


# ---------------------------------------------------------------------- comma-separated values


def rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(text)))


def test_one_message_is_a_column_a_field(aces: Aces, log: Path, arm: str) -> None:
    """With one --message each record is a row and each value a column."""
    result = aces("decode", log, "-p", arm, "--format", "csv", "--message", "State")
    assert (
        result.out.splitlines()[0]
        == "source,time,channel,direction,id,protocol,message,board,mode,error,angle,load"
    )
    first, second = rows(result.out)
    assert (first["id"], first["mode"], first["error"], first["angle"]) == (
        "0x300",
        "torque",
        "hot|cold",
        "1.0",
    )
    assert (second["mode"], second["error"]) == ("1", "0x80")
    assert math.isnan(float(second["load"]))


def test_several_messages_are_a_row_a_value(aces: Aces, log: Path, arm: str) -> None:
    """Otherwise each value is a row, with its unit; what is lost has its reason as field."""
    found = rows(aces("decode", log, "-p", arm, "--format", "csv").out)
    assert [(r["field"], r["value"], r["unit"]) for r in found[:3]] == [
        ("board", "0", ""),
        ("position.0", "10", "count"),
        ("position.1", "-10", "count"),
    ]
    lost = [r for r in found if not r["message"]]
    assert (lost[0]["field"], lost[0]["value"]) == ("unknown", "deadbeef")
    assert len(lost) == 4
    assert [r["message"] for r in found if r["id"] == "0x700"] == ["Ask"]  # no fields, and yet a row


def test_the_header_is_there_without_records(aces: Aces, tmp_path: Path, arm: str) -> None:
    """An empty result is a table without rows."""
    (tmp_path / "a.log").write_text("(1.0) can0 7FF#00\n")
    result = aces("decode", tmp_path / "a.log", "-p", arm, "--format", "csv", "--message", "Encoder")
    assert result.out == "source,time,channel,direction,id,protocol,message,board,position.0,position.1\n"


def test_commas_and_quotes_survive(aces: Aces, tmp_path: Path, arm: str) -> None:
    """A text with separators is one cell."""
    (tmp_path / "a.log").write_text("(1.0) can0 600#2C220A2C41000000\n")
    found = rows(aces("decode", tmp_path / "a.log", "-p", arm, "--format", "csv", "--message", "Name").out)
    assert found[0]["name"] == ',"\n,A'


def test_conditional_values_are_empty_cells(aces: Aces, tmp_path: Path, arm: str) -> None:
    """A field that is not there is an empty cell in CSV and null in JSON."""
    (tmp_path / "a.log").write_text(
        "(1.0) can0 500#00010000\n(1.0) can0 500#01010000\n(1.0) can0 500#02010000\n"
    )
    found = rows(aces("decode", tmp_path / "a.log", "-p", arm, "--format", "csv", "--message", "Pages").out)
    assert [(r["low"], r["high"]) for r in found] == [("0.5", ""), ("", "1"), ("", "")]
    objects = aces("decode", tmp_path / "a.log", "-p", arm, "--format", "jsonl").objects
    assert [(o["fields"]["low"], o["fields"]["high"]) for o in objects] == [
        (0.5, None),
        (None, 1),
        (None, None),
    ]


# ---------------------------------------------------------------------- where it goes


@pytest.mark.parametrize(
    ("suffix", "is_right"),
    [
        (".jsonl", lambda text: json.loads(text.splitlines()[0])["message"] == "Encoder"),
        (".csv", lambda text: text.startswith("source,time,")),
        (".txt", lambda text: "Encoder" in text.splitlines()[1]),
    ],
)
def test_the_suffix_of_the_output_chooses_the_format(
    aces: Aces, log: Path, arm: str, tmp_path: Path, suffix: str, is_right: Callable[[str], bool]
) -> None:
    """--output writes a file and nothing on stdout."""
    out = tmp_path / f"out{suffix}"
    result = aces("decode", log, "-p", arm, "--output", out)
    assert result.out == ""
    assert is_right(out.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", ["out.xlsx", "out.csv.gz", "out.blf"])
def test_a_suffix_that_names_no_format_is_refused(
    aces: Aces, log: Path, arm: str, tmp_path: Path, name: str
) -> None:
    """No text under a name that promises something else; --format says that it is meant."""
    out = tmp_path / name
    result = aces("decode", log, "-p", arm, "--output", out)
    assert (result.status, out.exists()) == (2, False)
    assert f"no format has the suffix {out.suffix!r}; there are .jsonl " in result.err
    assert aces("decode", log, "-p", arm, "--output", out, "--format", "text").status == 0
    assert "Encoder" in out.read_text()


def test_an_input_is_not_overwritten(aces: Aces, log: Path, arm: str, tmp_path: Path) -> None:
    """--output of one of the inputs is refused, under whatever name."""
    other = tmp_path / "link.log"
    os.link(log, other)
    result = aces("decode", log, "-p", arm, "--output", other)
    assert result.status == 2
    assert log.read_text() == LOG


def test_an_output_that_cannot_be_written(aces: Aces, log: Path, arm: str, tmp_path: Path) -> None:
    """One line, status 2."""
    result = aces("decode", log, "-p", arm, "--output", tmp_path / "no" / "such.csv")
    assert result.status == 2
    assert "cannot be written: there is no folder" in result.err


def test_a_file_without_frames_is_named(aces: Aces, log: Path, arm: str, tmp_path: Path) -> None:
    """Among several files nobody could tell which it was; and it is not an error."""
    empty = tmp_path / "empty.log"
    empty.write_bytes(b"# begun, and not a frame came\n")
    result = aces("decode", log, empty, "-p", arm, "-q")
    assert (result.status, result.summary["frames"]) == (0, FRAMES)
    assert f"{empty}: holds no frames" in result.messages


def test_a_channel_of_a_protocol_that_does_not_occur_is_named(aces: Aces, log: Path, arm: str) -> None:
    """With the channels that there are: a BLF has no can0."""
    result = aces("decode", log, "-p", f"can7={arm}", "-p", f"can0={arm}", "-q")
    assert "-p: no frame came from 'can7' (there are: can0, can1)" in result.messages
    assert "can0'" not in result.err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--from", "100"], "--from"),
        (["--filter", "can9,1:2", "--to", "5"], "--to, --filter"),
        (["--where", "board=77"], "--where"),
    ],
)
def test_what_let_nothing_pass_is_named(
    options: list[str], said: str, aces: Aces, log: Path, arm: str
) -> None:
    """Instead of an empty output that nobody explains."""
    result = aces("decode", log, "-p", arm, "-q", *options)
    assert f"nothing that was decoded passed {said}" in result.messages


def test_files_may_stand_on_both_sides_of_options(aces: Aces, log: Path, arm: str) -> None:
    """`aces decode a.log -p arm b.log` decodes both."""
    assert aces("decode", log, "-p", arm, log, "-q").summary["frames"] == 2 * FRAMES


@pytest.mark.parametrize("more", [(), ("-o", "out.parquet")])
def test_where_offers_fields_of_the_wanted_messages(
    aces: Aces, log: Path, arm: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: tuple[str, ...]
) -> None:
    """With --message a field that only other messages have is refused, and not offered."""
    monkeypatch.chdir(tmp_path)
    result = aces("decode", log, "-p", arm, "--message", "Encoder", "--where", "mode=torque", *more)
    assert result.status == 2
    assert "no field named 'mode'" in result.err
    assert "mode" not in result.err.partition("there are: ")[2]


def test_a_file_that_is_not_there_has_no_summary(aces: Aces, arm: str, tmp_path: Path) -> None:
    """Nothing was counted, so no counts are printed behind the reason."""
    result = aces("decode", tmp_path / "nowhere.log", "-p", arm)
    assert result.status != 0
    assert "no such file" in result.err
    assert "frames=" not in result.err

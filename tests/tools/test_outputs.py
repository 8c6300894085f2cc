"""A file's name and its content agree, whatever verb writes it: what does not is refused before anything is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.tools.conftest import Aces

LIVE = ["sniff", "-i", "aces", "-c", "nobody", "-p", "{arm}", "-o"]
LIVE_TABLES = (
    "with -p there are .jsonl .ndjson .csv .txt .text .log .out .parquet .pq .sqlite .sqlite3 .db .mcap"
)


@pytest.mark.parametrize(
    ("arguments", "name", "said"),
    [
        *((LIVE, f"live.{suffix}", LIVE_TABLES) for suffix in ("arrow", "npz", "blf", "xyz", "csv/")),
        (
            ["sniff", "-i", "aces", "-o"],
            "live.parquet",
            "is for decoded messages; name the protocol: -p NAME",
        ),
        (
            ["sniff", "-i", "aces", "-o"],
            "live.xyz",
            "no format has the suffix '.xyz'; there are .log .candump",
        ),
        (
            [*LIVE[:-1], "--format", "jsonl", "-o"],
            "live.parquet",
            "the suffix says parquet, and --format jsonl",
        ),
        ([*LIVE[:-1], "--format", "jsonl", "-o"], "live.csv", "the suffix says csv, and --format jsonl"),
        (
            ["decode", "{log}", "-p", "{arm}", "-o"],
            "x.xyz",
            "no format has the suffix '.xyz'; there are .jsonl",
        ),
        (["decode", "{log}", "-p", "{arm}", "--format", "sqlite", "-o"], "x.mcap", "the suffix says mcap"),
        (["convert", "{log}"], "x.xyz", "the suffix names no format; there are .log"),
        (
            ["convert", "--format", "candump", "{log}"],
            "x.blf.gz",
            "the suffix says blf, and --format candump",
        ),
        (["plot", "{log}", "-p", "{arm}", "Encoder.position", "-o"], "x.xyz", "one of .png, .svg, .pdf"),
        (["demo", "-o"], "x.xyz", "one of .png, .svg, .pdf"),
        (["spec", "export", "{arm}", "--format", "dbc", "-o"], "x.lua", "name it .dbc"),
        (["spec", "export", "{arm}", "--format", "wireshark", "-o"], "x.dbc", "name it .lua"),
        (["spec", "import", "{log}", "-o"], "x.dbc", "name it .py"),
        (["spec", "stubs", "{arm}", "-o"], "x.xyz", "ends in .pyi"),
        (["spec", "show", "{arm}", "State", "--svg"], "x.png", "name it .svg"),
        (["spec", "explain", "{arm}", "001#00", "--svg"], "x.png", "name it .svg"),
        (["robot", "import", "{log}", "-o"], "x.json", "name it .toml"),
        (["robot", "import", "{log}", "--json", "-o"], "x.toml", "name it .json"),
        (["discover", "-p", "hubo", "--bus", "unix:x", "-o"], "x.json", "name it .toml"),
        (["run", "-r", "hubo2", "--virtual", "--for", "1ms", "--log"], "x.xyz", "use one of .txt, .csv"),
    ],
)
def test_a_name_that_promises_something_else(
    aces: Aces, log: Path, arm: str, tmp_path: Path, arguments: list[str], name: str, said: str
) -> None:
    """Status 2, one line that names what works, and no file."""
    before = set(tmp_path.iterdir())
    result = aces(*(one.format(arm=arm, log=log) for one in arguments), f"{tmp_path}/{name}")
    assert result.status == 2
    assert said in result.err
    assert len(result.err.splitlines()) == 1
    assert set(tmp_path.iterdir()) <= before | {tmp_path / "__pycache__"}

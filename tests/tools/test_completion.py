"""Completion scripts and manual pages: what is checked in is what the verbs say, and bash completes with it."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from aces_tools import shell
from aces_tools.shell import SCRIPTS

Aces = Callable[..., Any]
Golden = Callable[[str, str], None]
FILES = Path(shell.__file__).parent / "files"


def test_what_is_checked_in_is_what_the_verbs_say(golden: Golden) -> None:
    """After a change of a verb's options or help: make golden."""
    pytest.importorskip("shtab")
    from aces_tools.shell.generate import generated

    texts = generated()
    for name, text in texts.items():
        golden(f"../../tools/aces_tools/shell/files/{name}", text)
    assert {path.relative_to(FILES).as_posix() for path in FILES.rglob("*") if path.is_file()} == set(texts)


def test_the_script_of_each_shell_is_printed(aces: Aces) -> None:
    """`aces completion SHELL` prints it; without a shell it says which there are."""
    for name, file in SCRIPTS.items():
        assert aces("completion", name).out == (FILES / file).read_text(encoding="utf-8")
    assert aces("completion").messages == ["of which shell? bash, zsh, fish"]


@pytest.mark.slow
def test_names_are_those_that_are_installed(aces: Aces, monkeypatch: pytest.MonkeyPatch) -> None:
    """Protocols, drivers and robots of all packages; the devices of the robot on the line, or of $ACES_ROBOT."""

    def names(kind: str, words: str = "") -> list[str]:
        return list(aces("completion", "--list", kind, "--words", words).out.split())

    assert {"hubo", "robotis"} <= set(names("protocols"))
    assert {"hubo_motor", "odrive"} <= set(names("drivers"))
    assert {"hubo2plus", "so101"} <= set(names("robots"))
    monkeypatch.delenv("ACES_ROBOT", raising=False)
    assert names("devices", "aces device ") == ["fuzz"]
    assert names("devices", "aces device -r nonesuch ") == ["fuzz"]
    assert {"JMC3", "RKN", "fuzz"} <= set(names("devices", "aces device -r hubo2plus 'J"))
    fuzzed = set(names("devices", "aces device fuzz -r hubo2plus "))
    assert "RKN" in fuzzed
    assert "fuzz" not in fuzzed
    assert "odrive" in names("devices", "aces device fuzz --twin od")
    assert "hubo2plus" in names("robots", "aces bus budget ")
    assert "hubo2plus" not in names("channels", "aces bus load ")
    monkeypatch.setenv("ACES_ROBOT", "hubo2plus")
    assert {"JMC3", "RKN"} <= set(names("devices"))


@pytest.mark.slow
def test_what_a_device_can_do_is_completed(aces: Aces, monkeypatch: pytest.MonkeyPatch) -> None:
    """Behind its name its actions, behind these what they take: of a joint, a device, and neither."""
    monkeypatch.setenv("ACES_ROBOT", "hubo2plus")

    def names(kind: str, words: str) -> list[str]:
        return list(aces("completion", "--list", kind, "--words", words).out.split())

    assert names("actions", "aces device --bus upper=can0 RKN ho")[:3] == ["get", "watch", "set"]
    assert {"enable", "home", "set_gains"} <= set(names("actions", "aces device RKN "))
    assert names("actions", "aces device nonesuch ") == names("actions", "aces device ") == []
    assert {"position", "velocity"} <= set(names("values", "aces device RKN get "))
    assert names("values", "aces device RKN set pos") == ["position="]
    assert {"kp=", "ki=", "kd="} <= set(names("values", "aces device RKN set_gains "))
    assert "joint=" not in names("values", "aces device RKN home ")
    assert "joint=" in names("values", "aces device JMC3 home ")
    assert names("values", "aces device RKN no_such ") == []


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
def test_bash_completes(tmp_path: Path) -> None:
    """Verbs, actions, options, choices, names and files."""
    program = tmp_path / "aces"
    program.write_text(
        "#!/bin/sh\necho hubo; echo hubovia\n", encoding="utf-8"
    )  # what `aces completion --list` prints
    program.chmod(0o755)
    (tmp_path / "huge.dbc").touch()
    lines = [
        "aces de",
        "aces decode --wh",
        "aces decode -p hu",
        "aces spec ch",
        "aces decode --unknown o",
        "aces decode hug",
        "aces device fuzz --tw",
        "aces bus budget hug",
    ]
    typed = "\n".join(f"complete_line {line!r}" for line in lines)
    script = f"""
PATH=.:$PATH
source {FILES / "aces.bash"}
complete_line() {{
  COMP_LINE="$1"; COMP_POINT=${{#1}}; read -ra COMP_WORDS <<< "$1"; COMP_CWORD=$((${{#COMP_WORDS[@]}}-1)); COMPREPLY=()
  $(complete -p aces | sed 's/.*-F \\([^ ]*\\).*/\\1/') aces "${{COMP_WORDS[COMP_CWORD]}}" "${{COMP_WORDS[COMP_CWORD-1]}}"
  echo "${{COMPREPLY[@]}}"
}}
{typed}
"""
    done = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.splitlines() == [
        "decode devices device demo", "--where", "hubo hubovia huge.dbc", "check", "only", "huge.dbc",
        "--twin", "huge.dbc",
    ]  # fmt: skip
    assert done.stderr == ""


def test_each_verb_has_a_manual_page() -> None:
    """And each page its name, synopsis and options; `aces.1` lists all of them."""
    pages = {path.stem: path.read_text(encoding="utf-8") for path in (FILES / "man").glob("*.1")}
    contents = pages.pop("aces")
    for name, text in pages.items():
        assert f"aces\\-{name.removeprefix('aces-').replace('-', chr(92) + '-')}" in contents
        assert ".SH SYNOPSIS" in text
        assert "\\-q, \\-\\-quiet" in text

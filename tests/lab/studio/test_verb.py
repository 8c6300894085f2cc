"""`aces studio`: wrong calls end before anything is served."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from aces_bus.errors import CallerError
from aces_lab.studio.server import bound_socket, require_nicegui
from aces_tools.main import main


def test_a_missing_library_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without NiceGUI one sentence says what to install."""
    monkeypatch.setitem(sys.modules, "nicegui", None)
    with pytest.raises(CallerError, match=r"pip install 'aces-bus\[studio\]'"):
        require_nicegui()


def test_it_listens_on_this_machine_alone() -> None:
    """The socket is of loopback; a port that is taken is named, with what would work."""
    with bound_socket(0) as first:
        host, port = first.getsockname()
        assert host == "127.0.0.1"
        with pytest.raises(CallerError, match=rf"--port {port} cannot be served .*--port 0"):
            bound_socket(port)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["missing.log", "other.log"], "missing.log: no such file"),
        (["udp:14550"], "name one: -p NAME"),
        (["walk.log", "-o", "walk.txt"], "-o walk.txt"),
        (["walk.log", "-p", "nothing_such"], "nothing_such"),
        (["spec.py", "-o", "spec.py"], "spec.py"),
    ],
)
def test_a_wrong_call_says_what_is_wrong(
    words: list[str],
    reason: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Files that are not there, bytes without a protocol, and an output that is an input end with status 2."""
    pytest.importorskip("nicegui", reason="needs NiceGUI: the extra [studio]")
    monkeypatch.chdir(tmp_path)
    for name in ("walk.log", "spec.py"):
        Path(name).write_text("(1.0) can0 123#00\n", encoding="ascii")
    assert main(["studio", *words, "--no-browser"]) == 2
    assert reason in capsys.readouterr().err

"""A draft that is tried before it is written: it loads, passes the rules and laws of `aces spec check`, and decodes what it
was guessed from.

1. A message that does not is declared as bytes, with the reason; what is wrong beside messages is an error, and no draft.
2. The laws are tried for `LAWS_S`, on the scenes that `aces spec check` draws first.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from aces_bus import FrameTable, make_column_scanner
from aces_bus._lazy import np
from aces_bus.errors import AcesError
from aces_bus.protocol import Protocol
from aces_bus.protocol.files import load_file
from aces_bus.protocol.lint import check_protocol
from aces_tools.authoring.check import prove

from .traffic import MessageGuess

#: Seconds that the laws are tried for, drafts that are tried, and frames that must decode.
LAWS_S, ROUNDS, FRAMES = 1.0, 4, 20_000
_HEAD = re.compile(r'^    "(\w+)",$')


class CheckedDraft(NamedTuple):
    """A source, the messages that it declares as bytes with the reasons, and what is wrong with it nevertheless."""

    source: str
    as_bytes: Mapping[str, str]
    wrong: str = ""


def checked_draft(
    source_of: Callable[[Mapping[str, str]], str],
    name: str,
    messages: Sequence[MessageGuess] = (),
    frames: FrameTable | None = None,
) -> CheckedDraft:
    """Return the draft that `source_of` makes of messages that shall be bytes (name → reason), with as few as will do.

    `name` is that of the protocol. `frames` are some that the `messages` were guessed from.
    """
    as_bytes: dict[str, str] = {}
    source, wrong = "", ""
    for _ in range(ROUNDS):
        source = source_of(as_bytes)
        found = list(_faults(source, name, messages, frames))
        new = {message: text for message, text in found if message and message not in as_bytes}
        others = [text for message, text in found if not message]
        wrong = others[0] if others else ""
        if not new:
            break
        as_bytes |= new
    return CheckedDraft(source, as_bytes, wrong)


def _faults(
    source: str, name: str, messages: Sequence[MessageGuess], frames: FrameTable | None
) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with a draft: a message, or "", and in words."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "draft.py"
        path.write_text(source, encoding="utf-8")
        try:
            protocol = getattr(load_file(str(path)), name)
            assert isinstance(protocol, Protocol)
        except AcesError as error:
            yield _message_at(source, str(error)), _said(str(error), folder)
            return
        findings = [finding for finding in check_protocol(protocol) if finding.level != "note"]
        for finding in findings or prove(protocol, name, LAWS_S).findings:
            yield finding.message or "", _said(finding.text, folder)
        if not findings and frames is not None:
            yield from _undecoded(protocol, messages, frames)


def _said(text: str, folder: str) -> str:
    return " ".join(text.replace(f"{folder}/", "").split())


def _message_at(source: str, text: str) -> str:
    """Return the message at the line of a draft that an error names, "" where it is at none."""
    line = re.search(r"draft\.py:(\d+)", text)
    for code in reversed(source.splitlines()[: int(line[1])] if line is not None else []):
        if (head := _HEAD.match(code)) is not None:
            return head[1]
    return ""


def _undecoded(
    protocol: Protocol, messages: Sequence[MessageGuess], frames: FrameTable
) -> Iterator[tuple[str, str]]:
    """Yield the messages of single frames of which some do not decode."""
    frames = frames.take(slice(0, FRAMES))
    scanner = make_column_scanner([protocol.variant()], include_unknown=True)
    tables = [*scanner.feed(frames), *scanner.close()]
    lost = np.unique(np.concatenate([np.zeros(0, np.int64), *(t.row for t in tables if not t.message)]))
    for message in messages:
        if not message.transport:
            own = np.isin(frames.key[lost], message.keys)
            if message.length is not None:
                own &= frames.length[lost] == message.length
            if own.any():
                yield message.name, f"{int(own.sum())} of its frames do not decode by them"

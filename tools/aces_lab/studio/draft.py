"""The spec that is drawn: a Python file that the command line named, as `aces spec import` would write it.

1. A message that is drawn is one statement of the file. Saving replaces or appends those statements that were drawn on, and
   leaves every other line as it is, comments too.
2. A statement that says more than can be drawn (an enumeration, a check, a comment of its own) is not drawn on: its file
   is edited instead.
3. The file is run by other processes alone: `aces spec export` and `aces spec check`. Whoever changed it outside has it
   run again by a click that says so.
"""

from __future__ import annotations

import ast
import asyncio
import difflib
import json
import keyword
import os
import re
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from aces_bus.errors import AcesError, CallerError
from aces_bus.frames import EXTENDED, FD
from aces_bus.protocol import BitLayout, Protocol, Quantity, bits
from aces_bus.protocol.exchange import print_source

from .fields import DrawnField, as_written

#: What a child process may take (s).
PATIENCE_S = 120.0
#: How long the laws are asked of the spec when it is checked.
LAWS = "1s"
TITLE = '"""Drawn in `aces studio`: yours to edit from here on."""'


@dataclass(frozen=True)
class DrawnMessage:
    """A message: `key` is its identifier with its flags (`aces_bus.frames`), `size` in bytes."""

    name: str
    key: int
    size: int
    fields: tuple[DrawnField, ...] = ()

    @property
    def usual_name(self) -> str:
        """The name of a message that nobody has named."""
        return f"Message{self.key & 0x1FFF_FFFF:03X}"

    def with_field(self, field: DrawnField) -> DrawnMessage:
        """Return the message with a field, in place of the one of its name. Raises `CallerError` for one that cannot be."""
        field.check(self.size)
        others = [other for other in self.fields if other.name != field.name]
        taken = {at: other.name for other in others for at in other.positions}
        if shared := [at for at in field.positions if at in taken]:
            byte, bit = divmod(shared[0], 8)
            raise CallerError(
                f"{field.name} and {taken[shared[0]]} share byte {byte} bit {bit}: remove one first"
            )
        return replace(
            self, fields=tuple(sorted([*others, field], key=lambda f: min(map(as_written, f.positions))))
        )

    def without(self, name: str) -> DrawnMessage:
        """Return the message without a field."""
        return replace(self, fields=tuple(field for field in self.fields if field.name != name))


class Draft:
    """The file at `path`, with what was drawn since it was read. `recordings` are what it is held against."""

    def __init__(self, path: str, recordings: Sequence[str] = ()) -> None:
        self.path, self.recordings = Path(path), recordings
        self.messages: dict[int, DrawnMessage] = {}
        #: Messages of the file that are not drawn on, by their key: why.
        self.closed: dict[int, str] = {}
        self._drawn: set[int] = set()
        self._text = self._on_disk()
        #: True while the file holds what was not read yet.
        self.is_unread = bool(self._text)

    def _on_disk(self) -> str:
        try:
            return self.path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return ""
        except (OSError, UnicodeDecodeError) as error:
            raise CallerError(f"{self.path}: cannot be read ({error})") from None

    @property
    def is_changed_outside(self) -> bool:
        """True if the file is not what was read or saved last."""
        return self._on_disk() != self._text

    @property
    def is_saved(self) -> bool:
        """True if nothing was drawn since the file was read or saved."""
        return not self._drawn

    @property
    def state(self) -> str:
        """Say whether what was drawn is in the file."""
        if self._drawn:
            return "not saved"
        return "saved" if self._text else "nothing drawn yet"

    def message(self, key: int, size: int) -> DrawnMessage:
        """Return the message of an identifier, a new one where there is none; at least `size` bytes long."""
        found = self.messages.get(key)
        if found is None:
            found = DrawnMessage("", key, size)
            found = replace(found, name=found.usual_name)
        return found

    def draw(self, message: DrawnMessage) -> None:
        """Take a message in place of the one with its key. Raises `CallerError` for one that cannot be declared."""
        if self.is_unread:
            raise CallerError(f"{self.path}: is there already; read it first, or its messages would be lost")
        if message.key in self.closed:
            raise CallerError(self.closed[message.key])
        if not message.name.isidentifier() or keyword.iskeyword(message.name):
            raise CallerError(f"{message.name!r} is not a name of a message: write letters, digits and _")
        if any(other.name == message.name and other.key != message.key for other in self.messages.values()):
            raise CallerError(f"another message is called {message.name}")
        try:
            _statement(message, "draft")
        except AcesError as error:
            raise CallerError(re.sub(r"^\S+:\d+: ", "", str(error))) from None
        self.messages[message.key] = message
        self._drawn.add(message.key)

    # ------------------------------------------------------------------ the file

    def source(self) -> str:
        """Return the text of the file with what was drawn."""
        text = self._text or self._begun()
        tree = ast.parse(text)
        own = _protocol_name(tree)
        places = [node for _, node in _messages(tree, own)]
        lines = text.splitlines()
        added: list[str] = []
        edits: list[tuple[int, int, list[str]]] = []
        words: set[str] = set()
        for key in sorted(self._drawn):
            message = self.messages[key]
            statement, used = _statement(message, own)
            words |= used
            node = next((node for node in places if _key_of(node) == key), None)
            if node is not None:
                edits.append((node.lineno - 1, node.end_lineno or node.lineno, statement))
            else:
                added += ["", *statement]
        for begin, end, statement in sorted(edits, reverse=True):
            lines[begin:end] = statement
        lines = [*lines, *added]
        if missing := words - _imported(tree):
            _import(lines, tree, missing)
        return "\n".join(lines) + "\n"

    def _begun(self) -> str:
        """Return the text of a file without messages."""
        name = re.sub(r"\W", "_", self.path.stem).lower() or "draft"
        if not name.isidentifier() or keyword.iskeyword(name) or name in ("bits", "annotations"):
            name = f"spec_{name}"
        return print_source(Protocol(name, link="can")).replace(
            '"""Made by `aces spec import` from a database: yours to edit from here on."""', TITLE
        )

    def diff(self) -> str:
        """Return what saving would change, as a unified diff."""
        before, after = self._text.splitlines(), (self.source() if self._drawn else self._text).splitlines()
        return "\n".join(difflib.unified_diff(before, after, "saved", "drawn", lineterm=""))

    def save(self) -> None:
        """Write the file, whole or not at all. Raises `CallerError` where it was changed outside."""
        if self.is_changed_outside:
            raise CallerError(f"{self.path} was changed outside: read it again first")
        text = self.source()
        beside = self.path.with_name(f".{self.path.name}.{os.getpid()}")
        try:
            beside.write_text(text, encoding="utf-8")
            os.replace(beside, self.path)
        except OSError as error:
            beside.unlink(missing_ok=True)
            raise CallerError(f"{self.path}: cannot be written ({error.strerror or error})") from None
        self._text, self._drawn = text, set()

    # ------------------------------------------------------------------ other processes

    async def read(self) -> str:
        """Run the file in another process, and take its messages; what was drawn and not saved is forgotten. Returns
        what is wrong with it, "" for nothing.
        """
        text = self._on_disk()
        status, output, said = await run_aces("spec", "export", str(self.path), "--format", "dbc")
        if status:
            return said
        self.messages, self.closed, self._drawn, self._text = {}, {}, set(), text
        self.is_unread = False
        for message in messages_of_dbc(output):
            self.messages[message.key] = message
            if not self._is_drawable(message):
                self.closed[message.key] = (
                    f"{message.name} says more in {self.path.name} than can be drawn: edit it there"
                )
        return ""

    def _is_drawable(self, message: DrawnMessage) -> bool:
        """Return whether the statement of a message in the file is the one that would be written."""
        tree = ast.parse(self._text)
        own = _protocol_name(tree)
        node = next((node for name, node in _messages(tree, own) if name == message.name), None)
        if node is None:
            return False
        try:
            lines, _ = _statement(message, own)
        except AcesError:
            return False
        printed = ast.get_source_segment(self._text, node) or ""
        return "#" not in printed and ast.dump(node) == ast.dump(ast.parse("\n".join(lines)).body[0])

    def check_words(self) -> list[str]:
        """Return the words of the command that checks the file."""
        against = [word for name in self.recordings for word in ("--against", name)]
        return ["spec", "check", str(self.path), *against, "--for", LAWS]

    async def check(self) -> str:
        """Check the saved file against the recordings in another process; returns lines of findings."""
        _, output, said = await run_aces(*self.check_words(), "--json")
        try:
            results = json.loads(output)
        except ValueError:
            return said
        lines = [
            f"{found['level']}: {found['text']} [{found['rule']}]"
            for result in results
            for found in result["findings"]
            if found["rule"] != "gap"
        ]
        lines += [result["complaint"] for result in results if result["complaint"]]
        return "\n".join(lines or ["nothing found"])

    async def examples(self) -> str:
        """Propose worked examples of the saved file out of the recordings, in another process."""
        suggest = [word for name in self.recordings for word in ("--suggest", name)]
        _, output, said = await run_aces("spec", "check", str(self.path), *suggest)
        return output or said


async def run_aces(*words: str) -> tuple[int, str, str]:
    """Run `aces` with these words in a process of its own; returns status, output, and what it said."""
    program = await asyncio.create_subprocess_exec(
        sys.executable,
        *("-m", "aces_tools", *words),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        env={**os.environ, "ACES_NOTES": "off", "NO_COLOR": "1"},
    )
    try:
        output, errors = await asyncio.wait_for(program.communicate(), PATIENCE_S)
    except TimeoutError:
        program.kill()
        await program.wait()
        return 2, "", f"{shlex.join(['aces', *words])}: no end within {PATIENCE_S:g} s"
    return (
        program.returncode or 0,
        output.decode("utf-8", "replace"),
        errors.decode("utf-8", "replace").strip(),
    )


# ---------------------------------------------------------------------- statements of a file


def _statement(message: DrawnMessage, own: str) -> tuple[list[str], set[str]]:
    """Return the lines that declare a message of the protocol `own`, and the words that they import."""
    protocol = Protocol("draft", link="can")
    items = []
    for field in message.fields:
        order = "lsb" if field.order == "little" else "msb"
        at = field.start if order == "lsb" else as_written(field.positions[-1])
        number = bits(field.length, at, signed=field.signed, order=order)
        is_plain = field.scale == 1 and not field.offset and not field.unit
        scale, offset = (
            int(value) if value == int(value) else value for value in (field.scale, field.offset)
        )
        quantity = number if is_plain else Quantity(number, unit=field.unit, scale=scale, offset=offset)
        items.append(field.name / quantity)
    protocol.message(
        message.name,
        id=message.key & 0x1FFF_FFFF,
        extended=bool(message.key & EXTENDED),
        fd=bool(message.key & FD),
        payload=BitLayout(message.size, *items),
    )
    text = print_source(protocol)
    tree = ast.parse(text)
    (node,) = (node for _, node in _messages(tree, _protocol_name(tree)))
    segment = ast.get_source_segment(text, node) or ""
    return f"{own}{segment[segment.index('.') :]}".splitlines(), _imported(tree)


def _protocol_name(tree: ast.Module) -> str:
    """Return the variable that a file's protocol is assigned to."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call) and len(node.targets) == 1:
            target = node.targets[0]
            if ast.unparse(node.value.func).endswith("Protocol") and isinstance(target, ast.Name):
                return target.id
    raise CallerError("the file has no line NAME = Protocol(…): edit it instead of drawing on it")


def _messages(tree: ast.Module, own: str) -> list[tuple[str, ast.Expr]]:
    """Return names and statements of the messages that a file declares."""
    found: list[tuple[str, ast.Expr]] = []
    for node in tree.body:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            call = node.value
            if (
                ast.unparse(call.func) == f"{own}.message"
                and call.args
                and isinstance(call.args[0], ast.Constant)
            ):
                found.append((str(call.args[0].value), node))
    return found


def _key_of(node: ast.Expr) -> int | None:
    """Return the key of the identifier that a message's statement declares; None where that is not a plain number."""
    assert isinstance(node.value, ast.Call)
    words = {word.arg: word.value for word in node.value.keywords}
    number = words.get("id")
    if not isinstance(number, ast.Constant) or not isinstance(number.value, int):
        return None
    flags = {"extended": EXTENDED, "fd": FD}
    return number.value | sum(bit for name, bit in flags.items() if name in words)


def _import(lines: list[str], tree: ast.Module, words: set[str]) -> None:
    """Add words of ours to the lines of a file: to its line that imports others, or behind all imports."""
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    for node in imports:
        is_one_line = node.lineno == node.end_lineno and "#" not in lines[node.lineno - 1]
        if node.module == "aces_bus.protocol" and is_one_line and not any(a.asname for a in node.names):
            every = sorted(
                words | {alias.name for alias in node.names}, key=lambda w: (not w[0].isupper(), w)
            )
            lines[node.lineno - 1] = f"from aces_bus.protocol import {', '.join(every)}"
            return
    at = max((node.end_lineno or 0 for node in imports), default=0)
    lines.insert(at, f"from aces_bus.protocol import {', '.join(sorted(words))}")


def _imported(tree: ast.Module) -> set[str]:
    """Return the names that a file imports from ours."""
    return {
        alias.name
        for node in tree.body
        if isinstance(node, ast.ImportFrom) and node.module == "aces_bus.protocol"
        for alias in node.names
    }


def messages_of_dbc(text: str) -> list[DrawnMessage]:
    """Return the messages of a DBC as they would be drawn; multiplexed signals and floats are left out."""
    from cantools.database.can import Database

    database = Database(strict=False)
    database.add_dbc_string(text)
    found: list[DrawnMessage] = []
    for message in database.messages:
        fields = []
        for signal in message.signals:
            if signal.multiplexer_ids or signal.is_float:
                continue
            is_big = signal.byte_order == "big_endian"
            start = as_written(as_written(signal.start) + signal.length - 1) if is_big else signal.start
            given = (signal.is_signed, float(signal.scale), float(signal.offset), signal.unit or "")
            fields.append(
                DrawnField(signal.name, start, signal.length, "big" if is_big else "little", *given)
            )
        fields.sort(key=lambda field: min(map(as_written, field.positions)))
        key = message.frame_id | (EXTENDED if message.is_extended_frame else 0) | (FD if message.is_fd else 0)
        found.append(DrawnMessage(message.name, key, message.length, tuple(fields)))
    return found

"""Slips of the pen in shipped specs: each mutation changes one number, name or word of a spec's source.

1. A mutation is a pure function of the source and a seed; examples, docs and sources of facts are left alone.
2. A mutant is a package of its own: its modules are copied, one of them changed, and imported under a name of its own.
"""

from __future__ import annotations

import ast
import importlib
import random
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count, pairwise
from pathlib import Path

import aces_protocols
from aces_bus.protocol import Protocol

#: Keywords whose values are not a part of what a spec says about bytes.
PROSE = ("doc", "source", "examples", "dialects", "bitrate", "baud", "unit", "gap", "within")
_COUNT = count()
#: Constructs that read as many bytes in another order, or with another sign.
ORDERS = {f"Int{n}{s}{a}": f"Int{n}{s}{b}" for n in (16, 24, 32) for s in "us" for a, b in ("lb", "bl")}
SIGNS = {f"Int{n}{a}{o}": f"Int{n}{b}{o}" for n in (8, 16, 24, 32) for a, b in ("us", "su") for o in "lb"}
#: Words of context: without one, a spec may be a sound spec of a more talkative protocol.
CONTEXT = ("dialect", "reply_to", "when", "not_next")


@dataclass(frozen=True)
class Mutation:
    """One place to be changed: of which protocol, in which module and line, of what kind; `number` counts the places."""

    protocol: str
    module: str
    line: int
    kind: str
    owner: str
    number: int

    def __str__(self) -> str:
        return f"{self.protocol}/{self.module}:{self.line}: {self.kind} ({self.owner})"

    @property
    def text(self) -> str:
        """The module with the change."""
        tree = ast.parse((folder_of(self.protocol) / self.module).read_text(encoding="utf-8"))
        _, _, _, change = next(site for n, site in enumerate(_sites(tree)) if n == self.number)
        change()
        return ast.unparse(ast.fix_missing_locations(tree))


def folder_of(protocol: str) -> Path:
    """Where a shipped protocol's spec is."""
    (root,) = aces_protocols.__path__
    return Path(root) / protocol


def mutations(protocol: str) -> list[Mutation]:
    """All mutations of a protocol's spec, in the order of its modules and lines."""
    found: list[Mutation] = []
    for path in sorted(folder_of(protocol).glob("*.py")):
        if path.stem not in ("__init__", "records"):
            tree = ast.parse(path.read_text(encoding="utf-8"))
            for number, (kind, owner, node, _) in enumerate(_sites(tree)):
                found.append(Mutation(protocol, path.name, getattr(node, "lineno", 0), kind, owner, number))
    ways = [mutation for mutation in found if mutation.kind == "missing direction"]
    # The direction of a protocol's only message tells it from nothing.
    return found if len(ways) > 1 else [mutation for mutation in found if mutation not in ways]


def drawn(
    protocols: list[str], wanted: int, seed: int, *, in_turn: bool = False, context: bool = False
) -> list[Mutation]:
    """`wanted` mutations, of all places alike, or every kind in turn; with `context`, of words of context alone."""
    dice = random.Random(seed)
    kinds: dict[str, list[Mutation]] = {}
    for protocol in protocols:
        for mutation in mutations(protocol):
            if context == (mutation.kind.removeprefix("missing ") in CONTEXT):
                kinds.setdefault(mutation.kind, []).append(mutation)
    for several in kinds.values():
        dice.shuffle(several)
    if not in_turn:
        return dice.sample([mutation for several in kinds.values() for mutation in several], wanted)
    found: list[Mutation] = []
    while len(found) < wanted and kinds:
        for kind in sorted(kinds):
            found.append(kinds[kind].pop())
            if not kinds[kind]:
                del kinds[kind]
    return found[:wanted]


def declared(mutation: Mutation | str, folder: Path) -> Protocol:
    """The protocol of a mutant (or a shipped one, by its name), declared anew; raises what its import raises."""
    name = mutation if isinstance(mutation, str) else mutation.protocol
    package = f"mutant_{next(_COUNT)}_of_{name}"
    home = folder / package
    shutil.copytree(folder_of(name), home, ignore=shutil.ignore_patterns("__pycache__"))
    if isinstance(mutation, Mutation):
        (home / mutation.module).write_text(mutation.text, encoding="utf-8")
    sys.path.insert(0, str(folder))
    try:
        importlib.invalidate_caches()
        made = getattr(importlib.import_module(f"{package}.spec"), name)
    finally:
        sys.path.remove(str(folder))
        for module in [m for m in sys.modules if m == package or m.startswith(f"{package}.")]:
            del sys.modules[module]
    assert isinstance(made, Protocol)
    return made


# ---------------------------------------------------------------------- the places

#: Kind, the message or name that it belongs to, the node, and the change.
Found = tuple[str, str, ast.AST, Callable[[], None]]


def _sites(tree: ast.Module) -> Iterator[Found]:
    """Every place that can be changed, in the order of the source."""
    for statement in tree.body:
        owner = ""
        if isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
            owner = statement.targets[0].id
        for node in _walk(statement):
            if isinstance(node, ast.Call):
                first = node.args[0] if node.args else None
                if isinstance(first, ast.Constant) and isinstance(first.value, str):
                    owner = first.value
                yield from ((kind, owner, node, change) for kind, change in _of_call(node, tree))
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
                yield from ((kind, owner, node, change) for kind, change in _of_name(node, tree))


def _walk(node: ast.AST) -> Iterator[ast.AST]:
    """The nodes below, without what is prose."""
    yield node
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.keyword) and child.arg in PROSE:
            continue
        if isinstance(child, (ast.FunctionDef, ast.ImportFrom, ast.Import)):
            continue
        yield from _walk(child)


Change = tuple[str, Callable[[], None]]


def _of_name(node: ast.Name, tree: ast.Module) -> Iterator[Change]:
    for kind, table in (("byte order", ORDERS), ("sign", SIGNS)):
        if node.id in table:
            yield kind, _renamed(node, table[node.id], tree)


def _renamed(node: ast.Name, name: str, tree: ast.Module) -> Callable[[], None]:
    def change() -> None:
        node.id = name
        here = next(
            n for n, s in enumerate(tree.body) if isinstance(s, ast.ImportFrom) and s.module != "__future__"
        )
        tree.body.insert(here, ast.ImportFrom("construct", [ast.alias(name)], 0))

    return change


def _of_call(node: ast.Call, tree: ast.Module) -> Iterator[Change]:
    name = node.func.id if isinstance(node.func, ast.Name) else ""
    words = {keyword.arg: keyword for keyword in node.keywords if keyword.arg}
    if name == "bits":
        at = node.args[1] if len(node.args) > 1 else words["at"].value if "at" in words else None
        if at is not None and _number(at) is not None:
            yield "shifted bit", _more(at)
    if name == "Split":
        for pair in node.args:
            if isinstance(pair, ast.Tuple):
                yield "shifted bit", _one_further(pair)
    if (
        name in ("Bytes", "Reserved", "Array", "BitLayout")
        and node.args
        and _number(node.args[0]) is not None
    ):
        yield "length", _more(node.args[0])
    for word in ("length", "size"):
        if word in words and (number := _last_number(words[word].value)) is not None:
            yield "length", _more(number)
    for word in ("id", "opcode", "instruction"):
        if word in words and (number := _last_number(words[word].value)) is not None:
            yield "opcode off by one", _more(number)
            if (other := _another(tree, word, _number(number))) is not None:
                yield "duplicate identifier", _set(number, other)
    if "match" in words and isinstance(words["match"].value, ast.Dict):
        for value in words["match"].value.values:
            if (number := _last_number(value)) is not None:
                yield "opcode off by one", _more(number)
    if "check" in words and isinstance(words["check"].value, ast.Call):
        check = words["check"].value
        over = ast.parse("slice(3, None)", mode="eval").body
        rest = [keyword for keyword in check.keywords if keyword.arg != "over"]
        yield "check range", lambda: setattr(check, "keywords", [*rest, ast.keyword("over", over)])
    for word in ("scale", "offset"):
        if word in words and (number := _last_number(words[word].value)) is not None:
            yield "scale", _set(number, (_number(number) or 1) * 10)
    if name in ("Enumeration", "Flags"):
        for keyword in node.keywords:
            if _number(keyword.value) is not None:
                yield "enumeration value", _more(keyword.value)
    for word in ("direction", *CONTEXT):
        if word in words:
            yield f"missing {word}", _without(node, words[word])
    if "sync" in words and isinstance(words["sync"].value, ast.Constant):
        sync = words["sync"].value
        if isinstance(sync.value, bytes):
            yield "sync byte", _set(sync, sync.value[:-1] + bytes([sync.value[-1] ^ 1]))
    if name == "Const" and node.args and isinstance(node.args[0], ast.Constant):
        said = node.args[0].value
        if isinstance(said, bytes):
            yield "constant", _set(node.args[0], bytes([said[0] ^ 1]) + said[1:])
    if name in ("Struct", "BitLayout"):
        fields = [n for n, item in enumerate(node.args) if isinstance(item, ast.BinOp)]
        if name == "Struct":  # a layout's fields say themselves where they are
            for one, other in pairwise(fields):
                yield "fields swapped", _swapped(node, one, other)
        if len(fields) > 1:
            yield "field left out", _dropped(node, fields[-1])


def _number(node: ast.AST) -> int | float | None:
    is_number = isinstance(node, ast.Constant) and isinstance(node.value, (int, float))
    return node.value if is_number and not isinstance(node.value, bool) else None  # type: ignore[attr-defined]


def _last_number(node: ast.AST) -> ast.AST | None:
    """The number itself, or the one in `this.length + 4` and `0x60 + Board`."""
    if _number(node) is not None:
        return node
    if isinstance(node, ast.BinOp):
        return next((side for side in (node.right, node.left) if _number(side) is not None), None)
    return None


def _another(tree: ast.Module, word: str, own: int | float | None) -> int | float | None:
    """A number that another message of the module has under the same keyword."""
    values = [
        _number(number)
        for node in ast.walk(tree)
        if isinstance(node, ast.keyword) and node.arg == word
        if (number := _last_number(node.value)) is not None
    ]
    return next((value for value in values if value is not None and value != own), None)


def _more(node: ast.AST) -> Callable[[], None]:
    return _set(node, int(_number(node) or 0) + 1)


def _one_further(pair: ast.Tuple) -> Callable[[], None]:
    """The first of a pair, a number or an expression, is one more."""

    def change() -> None:
        pair.elts[0] = ast.BinOp(pair.elts[0], ast.Add(), ast.Constant(1))

    return change


def _set(node: ast.AST, value: object) -> Callable[[], None]:
    return lambda: setattr(node, "value", value)


def _without(node: ast.Call, keyword: ast.keyword) -> Callable[[], None]:
    return lambda: node.keywords.remove(keyword)


def _dropped(node: ast.Call, index: int) -> Callable[[], None]:
    return lambda: node.args.__delitem__(index)


def _swapped(node: ast.Call, one: int, other: int) -> Callable[[], None]:
    def change() -> None:
        node.args[one], node.args[other] = node.args[other], node.args[one]

    return change

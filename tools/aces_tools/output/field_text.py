"""Fields of records as texts for people: a token a field, each in its column.

1. A function that is generated from a message's plan prints its fields as one text (`TokenPrinter`); it gives what the way
   by tokens (`RecordTokens`) gives, which is for lines that are coloured or cut.

Left out, because they would only distract: reserved bits that are zero, bytes up to the end where there are none, and
fields that a selector says are not there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from aces_bus.protocol import FlagSet, Record
from aces_bus.protocol.plan import nodes as p
from aces_bus.protocol.record import FieldValue

from .printing import KEPT, LinePrinter, Read, has_few_values
from .shape import RecordLeaf, nameless_number, record_leaves
from .value_text import Show, number_format, step_format, unit_mark, value_printer

GAP = "  "
WIDEST_FIELD = 40
#: A field with the gap before it.
WIDEST_TOKEN = len(GAP) + WIDEST_FIELD


class PrintedField(NamedTuple):
    """A field as it is printed; `pad` are the blanks that keep the next one in its column."""

    label: str
    value: str
    unit: str
    style: str
    pad: int = 0


class RecordTokens:
    """The fields of one message as tokens."""

    def __init__(self, plan: p.MessagePlan) -> None:
        self._entries = [
            (leaf, f"{leaf.path}=", value_printer(leaf.node), unit_mark(leaf.node), _Width())
            for leaf in record_leaves(plan, is_split=False)
        ]

    def tokens(self, record: Record) -> list[PrintedField]:
        out: list[PrintedField] = []
        for leaf, label, shown, unit, width in self._entries:
            value = leaf.get(record)
            if value is None:
                if leaf.conditional or leaf.node.is_of_request:
                    continue
                text, mark = "unknown", ""
            elif not value and leaf.node.is_quiet:
                continue
            else:
                text, mark = shown(value), unit
            style = "flags" if isinstance(value, FlagSet) and value else "value"
            out.append(PrintedField(label, text, mark, style, width.pad(len(label) + len(text) + len(mark))))
        return out


class TokenPrinter(LinePrinter):
    """Prints the function that gives the fields of a message's records as text, each behind a gap: what `RecordTokens`
    gives, in columns. The widest token of each field so far is a variable of the function's module."""

    def __init__(self, plan: p.MessagePlan) -> None:
        super().__init__(plan)
        leaves = record_leaves(plan, is_split=False)
        #: The local name of each token.
        self._tokens = [self.names.new(leaf.identifier) for leaf in leaves]
        self._most = [self.names.new(f"most_{leaf.identifier}") for leaf in leaves]
        sure = [number for number, leaf in enumerate(leaves) if not self._absent(leaf)]
        last = sure[-1] if sure else -1
        more = len(leaves) - last - 1
        if widths := self._most[: len(leaves) if more else max(last, 0)]:
            self.setup.append(f"{' = '.join(widths)} = 0")
            self.body.line(f"global {', '.join(widths)}")
        for number, leaf in enumerate(leaves[: last + 1]):
            self._before_sure(number, leaf, is_last=number == last)
        line = f"f'{''.join(f'{{{name}}}' for name in self._tokens[: last + 1])}'"
        if not more:
            self.body.line(f"return {line}")
            return
        self.body.lines(f"line = {line}", "pad = 0")
        if last >= 0:
            self._widen(last)
            self.body.line(f"pad = {self._most[last]} - n")
        for number, leaf in enumerate(leaves[last + 1 :], last + 1):
            self._behind(number, leaf)
        self.body.line("return line")

    def _absent(self, leaf: RecordLeaf) -> str:
        """Return the test for a value that is left out, which is `v` then; empty where it never is."""
        if leaf.node.is_quiet:
            return f"not (v := {self.read(leaf)})"
        is_optional = leaf.conditional or leaf.node.is_of_request
        return f"(v := {self.read(leaf)}) is None" if is_optional else ""

    def _before_sure(self, number: int, leaf: RecordLeaf, *, is_last: bool) -> None:
        """Print a token that is always there: either others follow it, or it is the last such token."""
        body, name, most = self.body, self._tokens[number], self._most[number]
        absent = self._absent(leaf)
        value = "v" if absent else self.read(leaf)
        if absent:
            body.lines(f"if {absent}:", f"    {name} = ''", "else:")
            body.depth += 1
        if not is_last and has_few_values(leaf.node):
            texts = self._bound(f"padded_{leaf.identifier}", Padded(token_of(leaf)), shown=leaf.path)
            body.line(f"{name} = {texts}[{value}]")
        else:
            body.line(f"{name} = {self._token(leaf, value)}")
            if not is_last:
                body.line(f"if (n := len({name})) < {most}: {name} = {name}.ljust({most})")
                body.line(f"elif n > {most}: {most} = min(n, {WIDEST_TOKEN})")
        if absent:
            body.depth -= 1

    def _behind(self, number: int, leaf: RecordLeaf) -> None:
        """Print a token behind the last sure one: pad to its column only where the token exists."""
        body, name = self.body, self._tokens[number]
        body.line(f"if not ({self._absent(leaf)}):")
        body.depth += 1
        body.line(f"{name} = {self._token(leaf, 'v')}")
        self._widen(number)
        body.lines(f"line += ' ' * pad + {name}", f"pad = {self._most[number]} - n")
        body.depth -= 1

    def _widen(self, number: int) -> None:
        most = self._most[number]
        self.body.line(f"if (n := len({self._tokens[number]})) > {most}: {most} = min(n, {WIDEST_TOKEN})")

    def _token(self, leaf: RecordLeaf, value: str) -> str:
        """Return the expression of a token."""
        node = leaf.node
        label, unit = _label(leaf), unit_mark(node)
        parts = None if has_few_values(node) else self._numbers(node, value)
        if parts is not None:
            return self.literal([label, *parts, unit])
        number = nameless_number(node)
        if number is None or has_few_values(node):
            return self.shown(leaf.identifier, node, token_of(leaf), value)
        text = self.literal([label, Read(f"v:{step_format(node)}"), unit])
        return f"{text} if (v := {value}) is not None else {self.constant(token_of(leaf)(None))}"

    def _numbers(self, node: p.Node, value: str) -> list[str | Read] | None:
        """Return the text of a number, or of a list of numbers; None where it may be something else."""
        if not node.is_leaf:
            found: list[str | Read] = []
            for number, item in node.children if not node.is_record else ():
                parts = self._numbers(item.node, f"{value}[{number}]")
                if parts is None:
                    return None
                found += [", " if number else "[", *parts, "" if node.unit else unit_mark(item.node)]
            return [*found, "]"] if found else None
        form = number_format(node)
        return None if form is None else [Read(f"{value}:{form}")]


class Padded(dict[Any, str]):
    """The tokens of a field with few values, as wide as the widest so far."""

    def __init__(self, token: Show) -> None:
        super().__init__()
        self._token, self._most = token, 0

    def __missing__(self, value: FieldValue) -> str:
        text = self._token(value)
        if len(text) > self._most:
            self.clear()
            self._most = min(len(text), WIDEST_TOKEN)
        if len(self) >= KEPT:
            return text.ljust(self._most)
        text = self[value] = text.ljust(self._most)
        return text


def token_of(leaf: RecordLeaf) -> Show:
    """Return a function that gives any value's token, behind a gap."""
    label, shown, unit = _label(leaf), value_printer(leaf.node), unit_mark(leaf.node)
    return lambda value: label + ("unknown" if value is None else shown(value) + unit)


def _label(leaf: RecordLeaf) -> str:
    return f"{GAP}{leaf.path}="


class _Width:
    """The widest token of a field so far."""

    def __init__(self) -> None:
        self.most = 0

    def pad(self, length: int) -> int:
        if length > self.most:
            self.most = min(length, WIDEST_FIELD)
        return max(0, self.most - length)

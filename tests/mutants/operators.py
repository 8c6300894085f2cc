"""Faults that can be planted in a source file, each a small change of its text.

1. A mutant replaces one piece of text by another and keeps every line where it is: tracebacks and coverage stay right.
2. The same source has the same mutants in the same order.
3. Annotations, docstrings, decorators, `assert`, `__all__` and what only type checkers run have none.
"""

from __future__ import annotations

import ast
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

#: What becomes of a comparison: its bound moves, or its answer turns.
COMPARISONS: dict[type[ast.cmpop], tuple[str, ...]] = {
    ast.Lt: ("<=", ">="),
    ast.LtE: ("<", ">"),
    ast.Gt: (">=", "<="),
    ast.GtE: (">", "<"),
    ast.Eq: ("!=",),
    ast.NotEq: ("==",),
    ast.Is: ("is not",),
    ast.IsNot: ("is",),
    ast.In: ("not in",),
    ast.NotIn: ("in",),
}
KINDS = (
    "comparison",
    "±1",
    "and/or",
    "not",
    "arguments",
    "deleted",
    "return",
    "slice",
    "constant",
    "exception",
    "guard",
)


@dataclass(frozen=True)
class Mutant:
    """One fault: in `path`, the bytes from `start` to `end` become `after`. `scope` is the function ("" outside of all)."""

    path: str
    line: int
    scope: str
    kind: str
    start: int
    end: int
    before: str
    after: str

    @property
    def name(self) -> str:
        """What it is called from version to version: where it is by name, and what it does."""
        return f"{self.path}::{self.scope} {self.kind}: {_short(self.before)} -> {_short(self.after)}"

    def of(self, source: bytes) -> bytes:
        """The source with the fault, line for line the same."""
        was, now = source[self.start : self.end], self.after.encode()
        return source[: self.start] + now + b"\n" * (was.count(b"\n") - now.count(b"\n")) + source[self.end :]


def _short(text: str) -> str:
    text = " ".join(text.split())
    return text if len(text) <= 60 else text[:57] + "..."


def mutants_of(path: str, source: bytes) -> list[Mutant]:
    """All mutants of a source file, in the order of its text."""
    found = _Finder(path, source)
    found.visit(ast.parse(source))
    unlike = {(one.start, one.end, one.after): one for one in found.mutants}
    return sorted(unlike.values(), key=lambda one: (one.start, one.end, one.after))


class _Finder(ast.NodeVisitor):
    def __init__(self, path: str, source: bytes) -> None:
        self.path, self.source = path, source
        self.mutants: list[Mutant] = []
        self._scope: list[str] = []
        self._functions = 0
        self._begins = [0]
        for line in source.splitlines(keepends=True):
            self._begins.append(self._begins[-1] + len(line))

    # ------------------------------------------------------------------ where things are

    def _at(self, line: int, column: int) -> int:
        return self._begins[line - 1] + column

    def _span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._at(node.lineno, node.col_offset), self._at(node.end_lineno, node.end_col_offset)

    def _text(self, start: int, end: int) -> str:
        return self.source[start:end].decode()

    def _add(self, kind: str, line: int, start: int, end: int, after: str) -> None:
        before = self._text(start, end)
        if before != after:
            scope = ".".join(self._scope) if self._functions else ""
            self.mutants.append(Mutant(self.path, line, scope, kind, start, end, before, after))

    def _replace(self, kind: str, node: ast.expr | ast.stmt, after: str) -> None:
        self._add(kind, node.lineno, *self._span(node), after)

    # ------------------------------------------------------------------ statements

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self._scope.append(node.name)
        for statement in node.body:
            self._statement(statement)
        self._scope.pop()

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.AsyncFunctionDef) -> None:
        names = {getattr(one, "id", getattr(one, "attr", "")) for one in node.decorator_list}
        if "overload" in names or "abstractmethod" in names:
            return
        for default in (*node.args.defaults, *node.args.kw_defaults):
            if default is not None:
                self.visit(default)
        self._scope.append(node.name)
        self._functions += 1
        body = [one for one in node.body if not _is_text(one)]
        if body and not isinstance(body[0], (ast.Return, ast.Raise, ast.Pass)):
            first, start = body[0], self._span(body[0])[0]
            self._add("return", first.lineno, start, start, "return; ")
            if not _is_simple(first):  # nothing may stand before it in its line
                self.mutants.pop()
                self._replace("return", first, "return")
        for statement in body:
            self._statement(statement)
        self._functions -= 1
        self._scope.pop()

    visit_AsyncFunctionDef = visit_FunctionDef

    def _statement(self, node: ast.stmt) -> None:
        if _is_text(node):
            return
        if isinstance(node, ast.Expr):
            can_go = not isinstance(node.value, (ast.Yield, ast.YieldFrom, ast.Await))
        elif isinstance(node, ast.Assign):
            can_go = all(isinstance(one, (ast.Attribute, ast.Subscript)) for one in node.targets)
        else:
            can_go = isinstance(node, (ast.AugAssign, ast.Delete, ast.Break, ast.Continue))
        if can_go:
            self._replace("deleted", node, "pass")
        self.visit(node)

    def generic_visit(self, node: ast.AST) -> None:
        for _, value in ast.iter_fields(node):
            for one in value if isinstance(value, list) else [value]:
                if isinstance(one, ast.stmt):
                    self._statement(one)
                elif isinstance(one, ast.AST):
                    self.visit(one)

    def visit_If(self, node: ast.If) -> None:
        if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            return
        if not node.orelse and isinstance(node.body[-1], (ast.Return, ast.Raise, ast.Continue, ast.Break)):
            self._replace("guard", node.test, "False")
        self.generic_visit(node)

    def visit_Assert(self, node: ast.Assert) -> None:
        """It holds already: what it says is for type checkers."""

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            if isinstance(node.target, (ast.Attribute, ast.Subscript)):
                self._replace("deleted", node, "pass")
            self.visit(node.value)

    def visit_Assign(self, node: ast.Assign) -> None:
        if not any(isinstance(one, ast.Name) and one.id == "__all__" for one in node.targets):
            self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> None:
        if isinstance(node.exc, ast.Call):
            self._replace("exception", node.exc.func, "ArithmeticError")

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> None:
        if node.type is not None:
            kinds = node.type.elts if isinstance(node.type, ast.Tuple) else [node.type]
            for kind in kinds:
                self._replace("exception", kind, "ArithmeticError")
        for statement in node.body:
            self._statement(statement)

    def visit_arg(self, node: ast.arg) -> None:
        """An annotation has no fault that shows."""

    # ------------------------------------------------------------------ expressions

    def visit_Compare(self, node: ast.Compare) -> None:
        left: ast.expr = node.left
        for operator, right in zip(node.ops, node.comparators, strict=True):
            start, end = self._span(left)[1], self._span(right)[0]
            between = self._text(start, end)
            for after in COMPARISONS[type(operator)]:
                self._add("comparison", right.lineno, start, end, _with_operator(between, after))
            left = right
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        words = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            start, end = self._span(left)[1], self._span(right)[0]
            between = self._text(start, end)
            self._add("and/or", left.lineno, start, end, between.replace(*words, 1))
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.Not):
            self._replace("not", node, f"({self._text(*self._span(node.operand))})")
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name = getattr(node.func, "id", getattr(node.func, "attr", ""))
        if name in ("isinstance", "cast", "TypeVar", "getattr", "hasattr"):
            return
        plain = [one for one in node.args if not isinstance(one, (ast.Starred, ast.GeneratorExp))]
        if len(plain) == len(node.args) and name not in ("min", "max"):
            for one, other in zip(node.args, node.args[1:], strict=False):
                if not isinstance(one, ast.Constant) or not isinstance(other, ast.Constant):
                    self._swap(one, other)
        self.generic_visit(node)

    def _swap(self, one: ast.expr, other: ast.expr) -> None:
        (start, middle), (again, end) = self._span(one), self._span(other)
        swapped = self._text(again, end) + self._text(middle, again) + self._text(start, middle)
        self._add("arguments", one.lineno, start, end, swapped)

    def visit_Subscript(self, node: ast.Subscript) -> None:
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        for part in parts:
            if isinstance(part, ast.Slice):
                for bound in (part.lower, part.upper):
                    if bound is not None:
                        text = self._text(*self._span(bound))
                        for sign in "+-":
                            self._replace("slice", bound, f"({text}) {sign} 1")
            self.visit(part)
        self.visit(node.value)

    def visit_Slice(self, node: ast.Slice) -> None:
        for bound in (node.lower, node.upper, node.step):
            if bound is not None and not isinstance(bound, ast.Constant):
                self.visit(bound)

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            self._replace("constant", node, str(not value))
        elif isinstance(value, int):
            for step in (1, -1):
                self._replace("±1", node, f"({value + step})" if value + step < 0 else str(value + step))
            self._replace("constant", node, str(value * 2 + 3))
        elif isinstance(value, float):
            self._replace("constant", node, repr(value * 2 + 3.0))

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """A text for people: positions inside are those of its pieces only from Python 3.12 on."""


def _is_text(node: ast.stmt) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and (isinstance(node.value.value, str) or node.value.value is ...)
    )


def _is_simple(node: ast.stmt) -> bool:
    return not hasattr(node, "body") and not isinstance(node, ast.Match)


def _with_operator(between: str, after: str) -> str:
    """What stands between two operands, with another operator: brackets and line ends around it stay."""
    for operator in ("not in", "is not", "<=", ">=", "==", "!=", "in", "is", "<", ">"):
        at = between.find(operator)
        if at >= 0:
            return between[:at] + after + between[at + len(operator) :]
    return between

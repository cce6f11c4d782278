"""Sources in; deliberate faults out, each a change of one place of a syntax tree, named so that changes elsewhere leave its name alone.

Left alone: docstrings, messages and all other text, `raise` statements, findings, `__repr__`, annotations, decorators, imports.
"""

from __future__ import annotations

import ast
import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.Gt),
    ast.LtE: (ast.Lt, ast.GtE),
    ast.Gt: (ast.GtE, ast.Lt),
    ast.GtE: (ast.Gt, ast.LtE),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
_OPPOSITES = (
    ("min", "max"),
    ("minimum", "maximum"),
    ("fmin", "fmax"),
    ("argmin", "argmax"),
    ("nanmin", "nanmax"),
    ("nanargmin", "nanargmax"),
    ("any", "all"),
    ("floor", "ceil"),
)
OPPOSITES = {**dict(_OPPOSITES), **{other: one for one, other in _OPPOSITES}}
"""Calls that are exchanged."""
MESSAGES = {"AsterismError", "Finding", "cast", "TypeVar", "report", "complain", "getLogger", "warn"}
"""Calls whose arguments are text for people, or types."""
INERT_KEYWORDS = {"strict", "stacklevel", "encoding", "ensure_ascii"}
"""Keywords whose default changes nothing on input that is right."""


@dataclass(frozen=True)
class Fault:
    """One change.

    path    of the file, from the root
    place   the outermost function, `Class.method`, or the name that a statement outside functions binds
    kind    what is changed
    begin   bytes before the change
    line    from 1
    before  the text that is replaced
    after   what stands there instead
    nth     which one of the same changes in the same place
    """

    path: str
    place: str
    kind: str
    begin: int
    line: int
    before: str
    after: str
    nth: int = 0

    @property
    def key(self) -> str:
        """Names the fault in results; the same as long as the same text stands in the same function."""
        return hashlib.sha256(repr((self.path, self.place, self.kind, self.before, self.after, self.nth)).encode()).hexdigest()[:16]

    def apply(self, source: bytes) -> bytes:
        """The source with the fault."""
        old = self.before.encode()
        assert source[self.begin : self.begin + len(old)] == old
        return source[: self.begin] + self.after.encode() + source[self.begin + len(old) :]


def faults_of(path: str, source: bytes) -> list[Fault]:
    """All faults of one file, one for each place and kind: where several changes are of one kind, the key's hash picks one of them."""
    found = _Collector(path, source)
    found.visit(ast.parse(source))
    counted: Counter[tuple[str, ...]] = Counter()
    out = []
    for fault in sorted(found.faults, key=lambda fault: (fault.begin, len(fault.before), fault.kind, fault.after)):
        name = fault.place, fault.kind, fault.before, fault.after
        out.append(Fault(**{**vars(fault), "nth": counted[name]}))
        counted[name] += 1
    chosen: dict[tuple[int, str, str], Fault] = {}
    for fault in out:
        site = fault.begin, fault.before, fault.kind
        if site not in chosen or fault.key < chosen[site].key:
            chosen[site] = fault
    return list(chosen.values())


def sample(root: Path, folders: Sequence[str], seed: int, count: int) -> tuple[list[Fault], int]:
    """So many faults of the Python files under folders (or files) of `root`, by a seed, and how many there are.

    The order is that of a hash of seed and key: a longer sample begins with a shorter one, and other code moves nothing.
    """
    faults = []
    for folder in folders:
        place = root / folder
        for file in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            faults += faults_of(file.relative_to(root).as_posix(), file.read_bytes())
    order = sorted(faults, key=lambda fault: hashlib.sha256(f"{seed} {fault.key}".encode()).digest())
    return order[:count], len(faults)


def is_kernel(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Whether a function is compiled: it is decorated with `kernel`, called or not."""
    names = {getattr(mark.func if isinstance(mark, ast.Call) else mark, "id", "") for mark in node.decorator_list}
    return "kernel" in names


class _Collector(ast.NodeVisitor):
    """Walks a module and collects its faults."""

    def __init__(self, path: str, source: bytes) -> None:
        self.path, self.source = path, source
        self.faults: list[Fault] = []
        self.starts = [0]
        for line in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.classes: list[str] | None = []
        self.place, self.compiled = "", False
        self.flags: set[str] = set()

    def _add(self, kind: str, node: ast.AST, after: str) -> None:
        begin = self.starts[node.lineno - 1] + node.col_offset  # type: ignore[attr-defined]
        end = self.starts[node.end_lineno - 1] + node.end_col_offset  # type: ignore[attr-defined]
        before = self.source[begin:end].decode()
        if before != after:
            self.faults.append(Fault(self.path, self.place, kind, begin, node.lineno, before, after))  # type: ignore[attr-defined]

    def _text(self, node: ast.AST) -> str:
        return ast.unparse(node)

    # What is left alone

    def visit_Raise(self, node: ast.Raise) -> None: ...

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None: ...

    def visit_Import(self, node: ast.Import) -> None: ...

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None: ...

    def visit_Assert(self, node: ast.Assert) -> None: ...

    # Where a fault is

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        """Its body; a field is named as `Class.field`."""
        outer = self.classes
        self.classes = [*(outer or ()), node.name]
        for statement in node.body:
            self._statement(statement)
        self.classes = outer

    def visit_Module(self, node: ast.Module) -> None:
        """Its body, statement by statement."""
        for statement in node.body:
            self._statement(statement)

    def _statement(self, node: ast.stmt) -> None:
        if isinstance(node, ast.If) and "TYPE_CHECKING" in self._text(node.test):
            return
        targets = node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        names = [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            self.place = ".".join([*(self.classes or ()), *names[:1]])
        self.visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        """Defaults and body, under the name of the outermost function."""
        marks = {self._text(mark).partition("(")[0] for mark in node.decorator_list}
        if node.name in ("__repr__", "__str__") or "overload" in marks:
            return
        outer = self.place, self.compiled, self.classes, self.flags
        if self.classes is not None:
            self.place = ".".join([*self.classes, node.name])
        self.compiled, self.classes = self.compiled or is_kernel(node), None
        self.flags = {name for statement in ast.walk(node) if isinstance(statement, ast.Assign) for name in _flags(statement)}
        for default in (*node.args.defaults, *filter(None, node.args.kw_defaults)):
            self.visit(default)
        for statement in node.body:
            self.visit(statement)
        self.place, self.compiled, self.classes, self.flags = outer

    visit_AsyncFunctionDef = visit_FunctionDef  # type: ignore[assignment]

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        """The value, not the annotation."""
        if node.value is not None:
            self.visit(node.value)

    # Faults

    def visit_Compare(self, node: ast.Compare) -> None:
        """A comparison turned, or off by one."""
        for n, op in enumerate(node.ops):
            for other in COMPARISONS[type(op)]:
                ops = [*node.ops[:n], other(), *node.ops[n + 1 :]]
                self._add("comparison", node, f"({self._text(ast.Compare(node.left, ops, node.comparators))})")
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        """Another operator, unless one side is text or a list."""
        texts = ast.JoinedStr | ast.List | ast.Tuple | ast.ListComp
        is_text = any(isinstance(side, texts) or isinstance(getattr(side, "value", None), str) for side in (node.left, node.right))
        other = OPERATORS.get(type(node.op))
        if other is not None and not is_text:
            self._add("operator", node, f"({self._text(ast.BinOp(node.left, other(), node.right))})")
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        """Another operator, unless text or a list is added."""
        other = OPERATORS.get(type(node.op))
        texts = ast.JoinedStr | ast.List | ast.Tuple | ast.ListComp
        if other is not None and not isinstance(node.value, texts):
            self._add("operator", node, self._text(ast.AugAssign(node.target, other(), node.value)))
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        """`and` and `or` exchanged."""
        other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        self._add("and, or", node, f"({self._text(ast.BoolOp(other, node.values))})")
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        """A sign or `not` left out."""
        if isinstance(node.op, ast.USub | ast.Not):
            self._add("sign" if isinstance(node.op, ast.USub) else "condition", node, f"({self._text(node.operand)})")
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        """A number one more or one less; True and False exchanged."""
        if isinstance(node.value, bool):
            self._add("constant", node, str(not node.value))
        elif isinstance(node.value, int | float):
            for by in (1, -1):
                self._add("constant", node, f"({node.value + by!r})")

    def _condition(self, test: ast.expr) -> None:
        self._add("condition", test, f"(not ({self._text(test)}))")

    def visit_If(self, node: ast.If | ast.While | ast.IfExp) -> None:
        """The condition negated."""
        self._condition(node.test)
        self.generic_visit(node)

    visit_While = visit_If  # type: ignore[assignment]
    visit_IfExp = visit_If  # type: ignore[assignment]

    def visit_comprehension(self, node: ast.comprehension) -> None:
        """A filter negated."""
        for test in node.ifs:
            self._condition(test)
        self.generic_visit(node)

    def visit_Return(self, node: ast.Return) -> None:
        """Another value of the same type where that can be told, else None."""
        if node.value is not None:
            after = self._other_value(node.value)
            if after is not None:
                self._add("return", node.value, after)
        self.generic_visit(node)

    def _other_value(self, value: ast.expr) -> str | None:
        """Another value for a returned one; None where there is none to give."""
        if _is_flag(value) or (isinstance(value, ast.Name) and value.id in self.flags):
            return f"(not ({self._text(value)}))"
        if isinstance(value, ast.Tuple) and len(value.elts) > 1:
            first, second, *rest = map(self._text, value.elts)
            return f"({', '.join([second, first, *rest])})" if first != second else None
        if isinstance(value, ast.JoinedStr | ast.Constant) or (isinstance(value, ast.Call) and getattr(value.func, "id", "")[:1].isupper()):
            return None
        return f"(-({self._text(value)}))" if self.compiled else "None"

    def visit_Call(self, node: ast.Call) -> None:
        """An argument left to its default, or the opposite function; messages are left alone."""
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        if name in MESSAGES:
            return
        if name in OPPOSITES:
            text = self._text(node.func)
            self._add("opposite", node.func, text[: len(text) - len(name)] + OPPOSITES[name])
        for n, keyword in enumerate(node.keywords):
            if keyword.arg is not None and keyword.arg not in INERT_KEYWORDS and self._has_default(node.func, name, keyword.arg):
                left = ast.Call(node.func, node.args, [*node.keywords[:n], *node.keywords[n + 1 :]])
                self._add("argument", node, self._text(left))
        if name != "isinstance":
            self.generic_visit(node)

    def _has_default(self, function: ast.expr, name: str, keyword: str) -> bool:
        """Whether a keyword can be left out: of NumPy and of functions of the same file whose signature says so."""
        if self._text(function).startswith(("np.", "numpy.")):
            return keyword not in ("shape", "where")
        return (name, keyword) in _defaults(self.source)

    def visit_Continue(self, node: ast.Continue) -> None:
        """`break` instead."""
        self._add("loop", node, "break")

    def visit_Break(self, node: ast.Break) -> None:
        """`continue` instead."""
        self._add("loop", node, "continue")


def _is_flag(value: ast.expr) -> bool:
    """Whether an expression is true or false by its form."""
    negated = isinstance(value, ast.UnaryOp) and isinstance(value.op, ast.Not)
    return isinstance(value, ast.Compare | ast.BoolOp) or negated or (isinstance(value, ast.Constant) and isinstance(value.value, bool))


def _flags(statement: ast.Assign) -> list[str]:
    """Names that an assignment sets to true or false."""
    return [target.id for target in statement.targets if isinstance(target, ast.Name) and _is_flag(statement.value)]


@cache
def _defaults(source: bytes) -> frozenset[tuple[str, str]]:
    """Function and argument, or class and field, for all that have a default in a file."""
    return frozenset(_walk_defaults(ast.parse(source)))


def _walk_defaults(tree: ast.Module) -> Iterator[tuple[str, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            positional = [*node.args.posonlyargs, *node.args.args]
            for argument in positional[len(positional) - len(node.args.defaults) :]:
                yield node.name, argument.arg
            for argument, default in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True):
                if default is not None:
                    yield node.name, argument.arg
        elif isinstance(node, ast.ClassDef):
            for statement in node.body:
                if isinstance(statement, ast.AnnAssign) and statement.value is not None and isinstance(statement.target, ast.Name):
                    yield node.name, statement.target.id

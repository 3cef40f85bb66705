# SPDX-License-Identifier: Apache-2.0
"""Lists every numeric tolerance, and every swallowed exception, that has no reason beside it.

A reason is a comment on the lines of the statement, a block of comments directly above it (or above the run of asserts
or constants that it stands in), or words in the message of its assert. A named constant is judged where it is defined.
Run by hand: .venv/bin/python tb/model/tolerances.py
"""

import ast
import io
import itertools
import re
import sys
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[2]

# Keywords of numpy, scipy, pytest and math by which a call is told how near is near enough.
KEYWORDS = frozenset(
    "rtol atol abs rel abs_tol rel_tol tol xtol ftol gtol xatol fatol epsrel epsabs places".split()
)
# Calls that compare with a tolerance even where none is given: the default is a number too. pytest.approx is not among
# them: its millionth stands for one reason everywhere, a formula worked out in two ways. That rounds to 1e-15, while a
# factor, a sign or a unit that is wrong moves it by far more than a millionth.
COMPARE = frozenset("isclose allclose assert_allclose assert_array_almost_equal assert_almost_equal".split())
# Calls that turn a difference into a distance.
DISTANCE = frozenset("abs fabs absolute hypot ptp norm".split())
# Literals up to here are taken for tolerances wherever something is compared with them.
SMALL = 1e-3
# What a distance is below this is a range, and no tolerance.
LARGE = 1e6
_WORDS = re.compile(r"[A-Za-z]{2,}\W+[A-Za-z]{2,}")


class Finding(NamedTuple):
    """A line of a file and what is wrong there."""

    path: str
    line: int
    what: str

    def __str__(self) -> str:
        return f"{self.path}:{self.line}: {self.what}"


def _name(call: ast.Call) -> str:
    target = call.func
    return target.attr if isinstance(target, ast.Attribute) else getattr(target, "id", "")


def _numbers(tree: ast.expr) -> list[float]:
    """Numeric literals in an expression, but for indices, exponents and arguments of calls."""
    if isinstance(tree, ast.Constant):
        return [] if isinstance(tree.value, bool | str | bytes | complex | None | type(...)) else [tree.value]
    if isinstance(tree, ast.UnaryOp):
        return _numbers(tree.operand)
    if isinstance(tree, ast.BinOp):
        return [] if isinstance(tree.op, ast.Pow) else _numbers(tree.left) + _numbers(tree.right)
    return []


def _is_distance(tree: ast.expr) -> bool:
    return any(isinstance(node, ast.Call) and _name(node) in DISTANCE for node in ast.walk(tree))


def _compared(node: ast.Compare) -> Iterator[ast.expr]:
    """The sides of a comparison that are tolerances."""
    sides = [node.left, *node.comparators]
    for (left, right), op in zip(itertools.pairwise(sides), node.ops, strict=True):
        if not isinstance(op, ast.Lt | ast.LtE | ast.Gt | ast.GtE):
            continue
        for side, other in ((left, right), (right, left)):
            numbers = [abs(n) for n in _numbers(side) if n]
            near = isinstance(op, ast.Lt | ast.LtE) == (side is right)
            small = any(n <= SMALL for n in numbers)
            if small or (near and _is_distance(other) and min(numbers, default=LARGE) < LARGE):
                yield side


class _Python:
    """Findings of one module."""

    def __init__(self, path: str, text: str) -> None:
        self.path, self.lines, self.found = path, text.splitlines(), list[Finding]()
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        comments = (token for token in tokens if token.type == tokenize.COMMENT)
        self.comments = {
            c.start[0] for c in comments if not re.match(r"#\s*(fmt|type|noqa|ruff)\b", c.string)
        }
        self.run_of: dict[int, int] = {}  # line of an assert or a constant: line of the first one of its run
        self.named: dict[str, list[ast.stmt]] = {}  # constants and where they get a number
        self.used: set[str] = set()  # names that are used as tolerances
        tree = ast.parse(text)
        self._visit(tree, tree)  # type: ignore[arg-type]
        for name in sorted(self.used):
            for statement in self.named.get(name, []):
                if not self._reasoned(statement):
                    self._report(statement, f"tolerance {name} without a reason")

    def _visit(self, node: ast.AST, statement: ast.stmt) -> None:
        if isinstance(node, ast.stmt | ast.mod | ast.ExceptHandler | ast.match_case):  # what holds statements
            statement = node if isinstance(node, ast.stmt) else statement
            for _, block in ast.iter_fields(node):
                if isinstance(block, list):
                    self._note_runs(block)
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None and _numbers(node.value):
            for target in getattr(node, "targets", None) or [node.target]:  # type: ignore[union-attr]
                if isinstance(target, ast.Name):
                    self.named.setdefault(target.id, []).append(node)
        elif isinstance(node, ast.Call):
            self._call(node, statement)
        elif isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            for side in _compared(node):
                self._tolerance(side, "", statement, literal=True)
            for side in sides:
                if isinstance(side, ast.Name) and any(_is_distance(s) for s in sides if s is not side):
                    self.used.add(side.id)
        elif isinstance(node, ast.ExceptHandler):
            self._handler(node)
        for child in ast.iter_child_nodes(node):
            self._visit(child, statement)

    def _note_runs(self, block: list[Any]) -> None:
        for before, node in zip([None, *block], block, strict=False):
            constant = isinstance(node, ast.Assign | ast.AnnAssign) and node.col_offset == 0
            if constant or isinstance(node, ast.Assert):
                joined = type(before) is type(node) and before.end_lineno == node.lineno - 1
                self.run_of[node.lineno] = self.run_of[before.lineno] if joined else node.lineno

    def _call(self, node: ast.Call, statement: ast.stmt) -> None:
        name, given = _name(node), [k for k in node.keywords if k.arg in KEYWORDS]
        for keyword in given:
            self._tolerance(keyword.value, f"{keyword.arg}=", statement)
        if name in COMPARE and not given and len(node.args) <= 2:
            self._unless_reasoned(node, f"default tolerance of {name} without a reason", statement)
        if name == "suppress" and not self._commented(node.lineno, node.end_lineno):
            self._report(node, "exception suppressed without a reason")

    def _handler(self, node: ast.ExceptHandler) -> None:
        names = {getattr(n, "id", "") for n in ast.walk(node.type)} if node.type else {"Exception"}
        raises = any(isinstance(n, ast.Raise) for n in ast.walk(node))
        broad = names & {"Exception", "BaseException"} and not raises
        silent = all(isinstance(n, ast.Pass | ast.Continue) for n in node.body)
        if (silent or broad) and not self._commented(node.lineno, node.body[-1].end_lineno):
            kind = "swallowed" if silent else "caught whatever it is"
            self._report(node, f"exception {kind} without a reason")

    def _tolerance(self, value: ast.expr, what: str, statement: ast.stmt, literal: bool = False) -> None:
        if isinstance(value, ast.Name):
            self.used.add(value.id)
        elif literal or any(n != 0 for n in _numbers(value)):
            self._unless_reasoned(value, f"tolerance {what}{ast.unparse(value)} without a reason", statement)

    def _unless_reasoned(self, node: ast.expr, what: str, statement: ast.stmt) -> None:
        if not (self._reasoned(statement) or self._commented(node.lineno, node.end_lineno)):
            self._report(node, what)

    def _reasoned(self, statement: ast.stmt) -> bool:
        if isinstance(statement, ast.Assert) and statement.msg is not None:
            said = "".join(str(n.value) for n in ast.walk(statement.msg) if isinstance(n, ast.Constant))
            if _WORDS.search(said):
                return True
        last, body = statement.end_lineno or statement.lineno, getattr(statement, "body", None)
        if isinstance(body, list) and body:
            last = max(statement.lineno, body[0].lineno - 1)
        return self._commented(self.run_of.get(statement.lineno, statement.lineno), last, statement.lineno)

    def _commented(self, first: int, last: int | None, begin: int | None = None) -> bool:
        """A comment directly above line `first`, or on the lines from `begin` (default: first) to `last`."""
        above = first - 1 in self.comments and self.lines[first - 2].lstrip().startswith("#")
        return above or any(n in self.comments for n in range(begin or first, (last or first) + 1))

    def _report(self, node: Any, what: str) -> None:
        self.found.append(Finding(self.path, node.lineno, what))


def in_python(path: str, text: str) -> list[Finding]:
    """Findings of a Python module."""
    return _Python(path, text).found


# Files in which a tolerance may be.
PLACES = ("models", "tb", "scripts")


def files() -> list[Path]:
    """Every file of ours that could hold a tolerance."""
    paths = (path for place in PLACES for path in (ROOT / place).rglob("*.py"))
    return sorted(path for path in paths if "__pycache__" not in path.parts)


def findings(paths: Iterable[Path]) -> list[Finding]:
    """All findings in some files."""
    return [
        finding
        for path in paths
        for finding in in_python(str(path.relative_to(ROOT)), path.read_text(encoding="utf-8"))
    ]


def main() -> int:
    """Print the findings; 1 if there are any."""
    found = findings(files())
    print("".join(f"{finding}\n" for finding in found), end="")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""Lists every numeric tolerance, and every swallowed exception, that has no reason beside it.

A reason is a comment on the lines of the statement, a block of comments directly above it (or above the run of asserts
or constants that it stands in), or words in the message of its assert. A named constant is judged where it is defined.
Run by hand: .venv/bin/python tb/model/tolerances.py
"""

from __future__ import annotations

import ast
import io
import itertools
import re
import sys
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

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
# Options of ngspice that say how near is near enough.
SPICE_OPTION = re.compile(
    r"\b(reltol|abstol|vntol|chgtol|trtol|pivtol|pivrel|gmin)\s*=\s*[-+.\d]", re.IGNORECASE
)
SPICE_KEYS = frozenset("reltol abstol vntol chgtol trtol pivtol pivrel gmin".split())
# Literals up to here are taken for tolerances wherever something is compared with them.
SMALL = 1e-3
# What a distance is below this is a range, and no tolerance.
LARGE = 1e6
_LITERAL = re.compile(r"\b\d+(\.\d*)?e-\d+", re.IGNORECASE)
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
            if any(n <= SMALL for n in numbers) or (
                near and _is_distance(other) and min(numbers, default=LARGE) < LARGE
            ):
                yield side


class _Python(ast.NodeVisitor):
    """Findings of one module."""

    def __init__(self, path: str, text: str) -> None:
        self.path, self.lines = path, text.splitlines()
        self.found: list[Finding] = []
        self.comments: set[int] = set()
        for token in tokenize.generate_tokens(io.StringIO(text).readline):
            if token.type == tokenize.COMMENT and not re.match(r"#\s*(fmt|type|noqa|ruff)\b", token.string):
                self.comments.add(token.start[0])
        self.statement: ast.stmt | None = None
        self.run_of: dict[int, int] = {}  # line of an assert or a constant: line of the first one of its run
        self.named: dict[str, list[ast.stmt]] = {}  # constants and where they get a number
        self.used: set[str] = set()  # names that are used as tolerances

    def check(self, tree: ast.Module) -> list[Finding]:
        self.visit(tree)
        for name in sorted(self.used):
            for statement in self.named.get(name, []):
                if not self._reasoned(statement):
                    self._report(statement, f"tolerance {name} without a reason")
        return self.found

    def visit(self, node: ast.AST) -> None:
        outer = self.statement
        if isinstance(node, ast.stmt):
            self.statement = node
        if isinstance(node, ast.stmt | ast.mod | ast.ExceptHandler | ast.match_case):  # what holds statements
            for _, block in ast.iter_fields(node):
                if isinstance(block, list):
                    self._note_runs(block)
        super().visit(node)
        self.statement = outer

    def _note_runs(self, block: list[ast.AST]) -> None:
        for before, node in zip([None, *block], block, strict=False):
            constant = isinstance(node, ast.Assign | ast.AnnAssign) and node.col_offset == 0
            if constant or isinstance(node, ast.Assert):
                joined = type(before) is type(node) and before.end_lineno == node.lineno - 1  # type: ignore
                self.run_of[node.lineno] = self.run_of[before.lineno] if joined else node.lineno  # type: ignore

    def visit_Assign(self, node: ast.Assign) -> None:
        for target in node.targets:
            if isinstance(target, ast.Name) and _numbers(node.value):
                self.named.setdefault(target.id, []).append(node)
        self.generic_visit(node)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if isinstance(node.target, ast.Name) and node.value is not None and _numbers(node.value):
            self.named.setdefault(node.target.id, []).append(node)
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name = _name(node)
        given = [k for k in node.keywords if k.arg in KEYWORDS]
        for keyword in given:
            self._tolerance(keyword.value, f"{keyword.arg}=")
        if name in COMPARE and not given and len(node.args) <= 2:
            self._unless_reasoned(node, f"default tolerance of {name} without a reason")
        if name == "suppress" and not self._near(node):
            self._report(node, "exception suppressed without a reason")
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        for side in _compared(node):
            self._tolerance(side, "", literal=True)
        for side in [node.left, *node.comparators]:
            if isinstance(side, ast.Name) and any(
                _is_distance(other) for other in [node.left, *node.comparators] if other is not side
            ):
                self.used.add(side.id)
        self.generic_visit(node)

    def visit_Dict(self, node: ast.Dict) -> None:
        for key in node.keys:
            if isinstance(key, ast.Constant) and key.value in SPICE_KEYS:
                self._unless_reasoned(node, f"ngspice option {key.value} without a reason")
                break
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        if isinstance(node.value, str) and SPICE_OPTION.search(node.value):
            self._unless_reasoned(node, "ngspice tolerance in a string without a reason")

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> None:
        names = (
            {getattr(n, "id", "") for n in ast.walk(node.type)} if node.type is not None else {"everything"}
        )
        broad = names & {"everything", "Exception", "BaseException"}
        raises = any(isinstance(n, ast.Raise) for n in ast.walk(node))
        silent = all(isinstance(n, ast.Pass | ast.Continue) for n in node.body)
        if (silent or (broad and not raises)) and not self._commented(
            node.lineno, node.body[-1].end_lineno or 0
        ):
            kind = "swallowed" if silent else "caught whatever it is"
            self._report(node, f"exception {kind} without a reason")
        self.generic_visit(node)

    def _tolerance(self, value: ast.expr, what: str, literal: bool = False) -> None:
        if isinstance(value, ast.Name):
            self.used.add(value.id)
        elif literal or any(n != 0 for n in _numbers(value)):
            self._unless_reasoned(value, f"tolerance {what}{ast.unparse(value)} without a reason")

    def _unless_reasoned(self, node: ast.AST, what: str) -> None:
        if self.statement is not None and not (self._reasoned(self.statement) or self._near(node)):
            self._report(node, what)

    def _near(self, node: ast.AST) -> bool:
        return self._commented(node.lineno, node.end_lineno)  # type: ignore[attr-defined]

    def _reasoned(self, statement: ast.stmt) -> bool:
        if isinstance(statement, ast.Assert) and statement.msg is not None:
            said = "".join(str(n.value) for n in ast.walk(statement.msg) if isinstance(n, ast.Constant))
            if _WORDS.search(said):
                return True
        last = statement.end_lineno or statement.lineno
        body = getattr(statement, "body", None)
        if isinstance(body, list) and body:
            last = max(statement.lineno, body[0].lineno - 1)
        return self._commented(self.run_of.get(statement.lineno, statement.lineno), last, statement.lineno)

    def _commented(self, first: int, last: int | None, begin: int | None = None) -> bool:
        """A comment directly above line `first`, or on the lines from `begin` (default: first) to `last`."""
        above = first - 1 in self.comments and self.lines[first - 2].lstrip().startswith("#")
        return above or any(n in self.comments for n in range(begin or first, (last or first) + 1))

    def _report(self, node: ast.AST, what: str) -> None:
        self.found.append(Finding(self.path, node.lineno, what))  # type: ignore[attr-defined]


def in_python(path: str, text: str) -> list[Finding]:
    """Findings of a Python module."""
    return _Python(path, text).check(ast.parse(text))


def in_c(path: str, text: str) -> list[Finding]:
    """Findings of C or SystemVerilog: comparisons with, and factors of, literals with a negative exponent."""
    found, above = [], False
    inside = False
    for number, line in enumerate(text.splitlines(), 1):
        begins_inside = inside
        if "/*" in line or inside:
            inside = line.rfind("*/") < line.rfind("/*") if "/*" in line else "*/" not in line
        comment = begins_inside or "/*" in line or "//" in line
        code = (
            re.sub(r'/\*.*?\*/|//.*|/\*.*|^.*\*/|"[^"]*"', "", line) if not (begins_inside and inside) else ""
        )
        compares = re.search(r"[<>]|\breturn\b|\bfabs\b", code)
        if (
            compares
            and any(float(m.group()) <= SMALL for m in _LITERAL.finditer(code))
            and not (comment or above)
        ):
            found.append(Finding(path, number, f"tolerance in `{line.strip()}` without a reason"))
        above = comment and not code.strip()
    return found


def in_spice(path: str, text: str) -> list[Finding]:
    """Findings of a deck: tolerances of ngspice, which a comment above or behind `;` or `$` explains."""
    found, above = [], False
    for number, line in enumerate(text.splitlines(), 1):
        comment = line.startswith("*") and _WORDS.search(line)
        if not comment and SPICE_OPTION.search(line) and not (above or re.search(r"[;$]\s*\w", line)):
            found.append(Finding(path, number, f"tolerance in `{line.strip()}` without a reason"))
        above = comment
    return found


READERS = {".py": in_python, ".c": in_c, ".cpp": in_c, ".sv": in_c, ".sp": in_spice, ".inc": in_spice}
PLACES = ("models", "tb", "scripts", "spice")


def files() -> list[Path]:
    """Every file of ours that could hold a tolerance."""
    return sorted(
        path
        for place in PLACES
        for path in (ROOT / place).rglob("*")
        if path.suffix in READERS and "__pycache__" not in path.parts and path.is_file()
    )


def findings(paths: Iterable[Path]) -> list[Finding]:
    """All findings in some files."""
    return [
        finding
        for path in paths
        for finding in READERS[path.suffix](str(path.relative_to(ROOT)), path.read_text(encoding="utf-8"))
    ]


def main() -> int:
    """Print the findings; 1 if there are any."""
    found = findings(files())
    print("".join(f"{finding}\n" for finding in found), end="")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

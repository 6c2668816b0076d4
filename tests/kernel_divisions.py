"""Finds divisions in a kernel that nothing in sight keeps from being a division by zero.

A denominator is fine when it is visibly not 0 (a number, a CONSTANT, dt_s, max(..., 0.1), a sum of such with what
cannot be negative, a product of such, a local name made of such) or when a comparison of it stands round the division
or, in front of it, leaves the function or the loop. A reader of source, not a prover: it finds the forgotten guard.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator

PARAMETERS = ("p", "params", "parameters")
EXITS = (ast.Return, ast.Continue, ast.Break)


def unguarded_divisions(function: ast.FunctionDef, never_zero: set[str]) -> list[tuple[int, str]]:
    """(line, denominator) of each; `never_zero` are record fields that their class declares so."""
    return list(_block(function.body, [], _Reader(function, never_zero)))


def _block(statements: list[ast.stmt], tests: list[ast.expr], reader: _Reader) -> Iterator[tuple[int, str]]:
    """Walk a block; `tests` are the comparisons that hold or failed on the way to here."""
    tests = list(tests)
    for statement in statements:
        if isinstance(statement, ast.If | ast.While):
            yield from _expression(statement.test, tests, reader)
            inside = [*tests, statement.test]
            yield from _block(statement.body, inside, reader)
            yield from _block(statement.orelse, inside, reader)
            if isinstance(statement, ast.If) and _settles(statement):
                tests.append(statement.test)
        elif isinstance(statement, ast.For):
            yield from _expression(statement.iter, tests, reader)
            yield from _block(statement.body, tests, reader)
        else:
            yield from _expression(statement, tests, reader)


def _settles(branch: ast.If) -> bool:
    """True when behind the branch its question is answered: it leaves, or gives the value it asked about."""
    if isinstance(branch.body[-1], EXITS) or (branch.orelse and isinstance(branch.orelse[-1], EXITS)):
        return True
    asked = {node.id for node in ast.walk(branch.test) if isinstance(node, ast.Name)}
    given = {node.id for node in ast.walk(branch) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    return bool(asked & given)


def _expression(node: ast.AST, tests: list[ast.expr], reader: _Reader) -> Iterator[tuple[int, str]]:
    if isinstance(node, ast.FunctionDef):
        return
    if isinstance(node, ast.IfExp):
        yield from _expression(node.test, tests, reader)
        for branch in (node.body, node.orelse):
            yield from _expression(branch, [*tests, node.test], reader)
        return
    if isinstance(node, ast.BoolOp):
        for i, value in enumerate(node.values):
            yield from _expression(value, [*tests, *node.values[:i]], reader)
        return
    denominator = _denominator(node)
    if denominator is not None and not reader.is_safe(denominator, tests):
        yield denominator.lineno, ast.unparse(denominator)
    for child in ast.iter_child_nodes(node):
        yield from _expression(child, tests, reader)


def _denominator(node: ast.AST) -> ast.expr | None:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div | ast.FloorDiv | ast.Mod):
        return node.right
    if isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Div | ast.FloorDiv):
        return node.value
    return None


class _Reader:
    """What one function says of its values."""

    def __init__(self, function: ast.FunctionDef, never_zero: set[str]) -> None:
        self.never_zero = never_zero
        self.given: dict[str, list[ast.expr]] = {}
        for node in ast.walk(function):
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                for target in targets:
                    self._bind(target, node.value)
            elif isinstance(node, ast.AugAssign) and isinstance(node.target, ast.Name):
                self._bind(node.target, ast.Constant(0))

    def _bind(self, target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Name):
            self.given.setdefault(target.id, []).append(value)
        elif isinstance(target, ast.Tuple):
            values = value.elts if isinstance(value, ast.Tuple) else [ast.Constant(0)] * len(target.elts)
            for part, one in zip(target.elts, values, strict=False):
                self._bind(part, one)

    def is_safe(self, value: ast.expr, tests: list[ast.expr], depth: int = 0) -> bool:
        """Not 0 by itself, or compared with something in `tests`; products and names are taken apart."""
        if self.is_positive(value) or _is_compared(value, tests):
            return True
        if isinstance(value, ast.UnaryOp):
            return self.is_safe(value.operand, tests, depth)
        if isinstance(value, ast.Call) and _called(value) in ("float", "abs", "sqrt"):
            return self.is_safe(value.args[0], tests, depth)
        if isinstance(value, ast.BinOp) and isinstance(value.op, ast.Mult | ast.Div):
            return self.is_safe(value.left, tests, depth) and self.is_safe(value.right, tests, depth)
        if isinstance(value, ast.Name) and value.id in self.given and depth < 8:
            return all(self.is_safe(one, tests, depth + 1) for one in self.given[value.id])
        return False

    def is_positive(self, value: ast.expr) -> bool:
        """Visibly above 0 (a negative number counts: only 0 matters at the top)."""
        if isinstance(value, ast.Constant):
            return isinstance(value.value, int | float) and value.value != 0
        if isinstance(value, ast.Name | ast.Attribute):
            name = value.id if isinstance(value, ast.Name) else value.attr
            return name in ("dt_s", "pi", "tau", *self.never_zero) or name.isupper()
        if isinstance(value, ast.Call):
            called = _called(value)
            return called in ("exp", "len") or (called == "max" and any(self.is_positive(one) for one in value.args))
        if isinstance(value, ast.BinOp) and isinstance(value.op, ast.Add):
            left, right = value.left, value.right
            return (self.is_positive(left) and self._not_negative(right)) or (
                self.is_positive(right) and self._not_negative(left)
            )
        if isinstance(value, ast.BinOp) and isinstance(value.op, ast.Mult | ast.Div):
            return self.is_positive(value.left) and self.is_positive(value.right)
        return False

    def _not_negative(self, value: ast.expr) -> bool:
        if self.is_positive(value) or (isinstance(value, ast.Call) and _called(value) in ("abs", "sqrt", "max", "exp")):
            return True
        if isinstance(value, ast.Attribute) and isinstance(value.value, ast.Name):
            return value.value.id in PARAMETERS
        if isinstance(value, ast.BinOp) and isinstance(value.op, ast.Mult):
            square = ast.dump(value.left) == ast.dump(value.right)
            return square or (self._not_negative(value.left) and self._not_negative(value.right))
        if isinstance(value, ast.BinOp) and isinstance(value.op, ast.Add | ast.Div):
            return self._not_negative(value.left) and self._not_negative(value.right)
        if isinstance(value, ast.Name) and value.id in self.given:
            return all(not isinstance(one, ast.Name) and self._not_negative(one) for one in self.given[value.id])
        return False


def _called(call: ast.Call) -> str:
    return call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")


def _is_compared(value: ast.expr, tests: list[ast.expr]) -> bool:
    """True when a comparison has the value (or its abs) as a side, or, for a difference, its two sides."""
    sides = {ast.dump(value), ast.dump(ast.Call(ast.Name("abs", ast.Load()), [value], []))}
    ends: set[str] = set()
    if isinstance(value, ast.BinOp) and isinstance(value.op, ast.Sub):
        ends = {ast.dump(value.left), ast.dump(value.right)}
    for test in tests:
        for node in ast.walk(test):
            if isinstance(node, ast.Compare):
                found = {ast.dump(side) for side in (node.left, *node.comparators)}
                if found & sides or (ends and ends <= found):
                    return True
    return False

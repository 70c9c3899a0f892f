"""Conditions on the columns of captures (``where=``): parsed, checked node by node and computed here. Nothing is run.

The part of pandas' queries that chooses captures, with the same results. Text that is not understood is refused with
its place, so that a condition from anywhere can read the columns and do nothing else.
"""

from __future__ import annotations

import ast
import operator
import re
import warnings
from collections.abc import Callable
from functools import reduce
from typing import TypeGuard

import numpy as np
import pandas as pd

from bench.errors import InputError

ALLOWED = (
    "allowed on columns, text and numbers: == != < <= > >= in [...] and or not + - * / // % "
    ".isin .between .str.startswith .str.endswith .str.contains"
)
LONGEST = 10_000  # characters
DEEPEST = 100  # levels of brackets and operators
LINE = 300  # characters of a message
# What means something else to pandas than to Python, outside of quotes. No alternative looks back, so that it takes
# time in proportion to the text.
SPECIAL = re.compile(
    r"""(?P<refused>\"{3}|'{3}|\#)"""
    r"""|(?P<text>'(?:[^'\\\r\n]|\\[^\r\n])*'|"(?:[^"\\\r\n]|\\[^\r\n])*")"""
    r"""|`(?P<column>[^`\r\n]+)`"""
    r"""|(?P<word>[&|\r\n])"""
    r"""|(?P<open>['"`])"""
)
WORDS = {"&": " and ", "|": " or ", "\r": " ", "\n": " "}
COMPARISONS: dict[type, Callable] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
ARITHMETIC: dict[type, Callable] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
}
TEXT_METHODS = ("startswith", "endswith", "contains")


def chosen(where: str, captures: pd.DataFrame, name: str) -> np.ndarray:
    """Which captures satisfy a condition, bool [captures].

    Args:
        where: such as ``variant == 'rough' and subject in ['1', '2']``.
        captures: one row per capture.
        name: of the corpus, for messages.

    Raises:
        InputError: it is no condition on these columns, or no capture satisfies it.
    """
    if len(where) > LONGEST:
        raise InputError(f"where= has {len(where)} characters; give at most {LONGEST}, or a column of your own")
    shown = repr(where) if len(repr(where)) <= 70 else f"{repr(where)[:66]}...'"
    try:
        found = _Condition(where, captures, name).value()
    except _Refused as e:
        raise InputError(_line(f"where={shown}: {e}")) from e
    if not _is_condition(found):
        raise InputError(_line(f"where={shown} is not a condition; write one such as \"subject != '3'\""))
    if not found.any():
        raise InputError(_line(f"where={shown} selects none of the {len(captures)} captures of {name}"))
    return found.to_numpy()


def _line(message: str) -> str:
    return message if len(message) <= LINE else f"{message[: LINE - 3]}..."


def _is_condition(value: object) -> TypeGuard[pd.Series]:
    return isinstance(value, pd.Series) and value.dtype == bool


def _is_number(value: object) -> TypeGuard[int | float | pd.Series]:
    if isinstance(value, pd.Series):
        return pd.api.types.is_numeric_dtype(value) and not pd.api.types.is_bool_dtype(value)
    return isinstance(value, int | float) and not isinstance(value, bool)


class _Refused(Exception):
    """What is wrong, and where."""


class _Condition:
    """A condition and the columns it is about.

    Raises:
        _Refused: it cannot be read, or (by `value`) it is not of the allowed kind.
    """

    def __init__(self, where: str, captures: pd.DataFrame, name: str) -> None:
        self.where, self.captures, self.name = where, captures, name
        self.quoted: dict[str, str] = {}  # stand-ins of columns in backticks
        self.text = ""  # what Python parses
        self.origin: list[int] = []  # where each of its characters comes from
        self._translate()
        self.tree = self._parsed()

    def value(self) -> object:
        """What it amounts to."""
        return self._value(self.tree)

    def _translate(self) -> None:
        """As pandas does: & and | are `and` and `or`, backticks quote the name of a column."""
        stand_in = "_column"
        while stand_in in self.where:
            stand_in += "_"
        at = 0
        for found in SPECIAL.finditer(self.where):
            self._take(self.where[at : found.start()], at)
            at = found.end()
            kind, piece = found.lastgroup, found[0]
            if kind == "refused":
                raise self._refused("a comment" if piece == "#" else "three quotes in a row", found.start())
            if kind == "open":
                raise self._refused(f"{piece} is not closed", found.start())
            if kind == "column":
                word = f"{stand_in}{len(self.quoted)}"
                self.quoted[word] = found["column"]
                self._take(word, found.start(), fixed=True)
            else:
                self._take(WORDS.get(piece, piece), found.start(), fixed=piece in WORDS)
        self._take(self.where[at:], at)
        blank = len(self.text) - len(self.text.lstrip())
        self.text, self.origin = self.text[blank:], self.origin[blank:]

    def _take(self, piece: str, start: int, fixed: bool = False) -> None:
        self.text += piece
        self.origin += [start] * len(piece) if fixed else range(start, start + len(piece))

    def _parsed(self) -> ast.expr:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # Python's advice is about programs
                tree = ast.parse(self.text, mode="eval").body
        except (RecursionError, MemoryError) as e:
            raise _Refused("too deeply nested; write a shorter condition") from e
        except SyntaxError as e:
            raise self._refused(str(e.msg), self._origin((e.offset or len(self.text) + 1) - 1)) from e
        except ValueError as e:  # NUL, or half a character
            raise _Refused("holds a character that is no text; take it out") from e
        level: list[ast.AST] = [tree]
        for _ in range(DEEPEST):
            level = [child for node in level for child in ast.iter_child_nodes(node)]
        if level:
            raise _Refused("too deeply nested; write a shorter condition")
        return tree

    def _origin(self, position: int) -> int:
        """Position in what the user wrote, of a position in what Python parsed."""
        return self.origin[min(position, len(self.origin) - 1)] if self.origin else 0

    def _refused(self, what: str, position: int) -> _Refused:
        short = what if len(what) <= 58 else f"{what[:55]}..."
        return _Refused(f"character {position + 1}: {short}; {ALLOWED}")

    def _place(self, byte: int) -> int:
        """Position in what the user wrote of a byte, which is what Python counts."""
        return self._origin(len(self.text.encode()[:byte].decode()))

    def _no(self, what: str, node: ast.expr) -> _Refused:
        return self._refused(what, self._place(node.col_offset))

    def _unknown(self, node: ast.expr) -> _Refused:
        written = self.where[self._place(node.col_offset) : self._place((node.end_col_offset or 1) - 1) + 1]
        return self._no(f"{written if len(written) <= 36 else written[:33] + '...'!r} cannot be used", node)

    def _value(self, node: ast.expr) -> object:
        """A column, or a literal."""
        try:
            match node:
                case ast.Constant(value=bool() | int() | float() | str() as literal):
                    return literal
                case ast.Name():
                    return self._column(node)
                case ast.BoolOp():
                    both = operator.and_ if isinstance(node.op, ast.And) else operator.or_
                    return reduce(both, [self._condition(part) for part in node.values])
                case ast.UnaryOp(op=ast.Not() | ast.Invert()):
                    return ~self._condition(node.operand)
                case ast.UnaryOp(op=ast.USub()):
                    return -self._number(node.operand)
                case ast.BinOp() if type(node.op) in ARITHMETIC:
                    return ARITHMETIC[type(node.op)](self._number(node.left), self._number(node.right))
                case ast.Compare():
                    sides = [node.left, *node.comparators]
                    pairs = zip(sides[:-1], node.ops, sides[1:], strict=True)
                    return reduce(operator.and_, [self._compared(*pair) for pair in pairs])
                case ast.Call():
                    return self._called(node)
        except _Refused:
            raise
        except Exception as e:  # pandas raises a dozen types where values do not fit together
            raise self._no(f"cannot be computed ({' '.join(str(e).split()) or type(e).__name__})", node) from e
        raise self._unknown(node)

    def _column(self, node: ast.Name) -> pd.Series:
        name = self.quoted.get(node.id, node.id)
        if name not in self.captures:
            known = ", ".join(map(str, self.captures.columns))
            place = self._place(node.col_offset) + 1
            raise _Refused(f"character {place}: no column {name[:40]!r}; the columns of {self.name[:40]} are {known}")
        return self.captures[name]

    def _condition(self, node: ast.expr) -> pd.Series:
        value = self._value(node)
        if not _is_condition(value):
            raise self._no("is not a condition", node)
        return value

    def _number(self, node: ast.expr) -> int | float | pd.Series:
        value = self._value(node)
        if not _is_number(value):
            raise self._no("is not a number", node)
        return value

    def _compared(self, left: ast.expr, op: ast.cmpop, right: ast.expr) -> pd.Series:
        if isinstance(op, ast.In | ast.NotIn):
            found = self._series(left).isin(self._list(right))
            return found if isinstance(op, ast.In) else ~found
        if type(op) not in COMPARISONS:
            raise self._no("'is' cannot be used", left)
        if isinstance(op, ast.Eq | ast.NotEq):
            for column, other in ((left, right), (right, left)):
                if isinstance(other, ast.List | ast.Tuple) and isinstance(column, ast.Name):
                    found = self._column(column).isin(self._list(other))
                    return found if isinstance(op, ast.Eq) else ~found
        one, two = self._value(left), self._value(right)
        if not (isinstance(one, pd.Series) or isinstance(two, pd.Series)):
            raise self._no("compares no column", left)
        return COMPARISONS[type(op)](one, two)

    def _series(self, node: ast.expr) -> pd.Series:
        value = self._value(node)
        if not isinstance(value, pd.Series):
            raise self._no("is not a column", node)
        return value

    def _list(self, node: ast.expr) -> list:
        if not isinstance(node, ast.List | ast.Tuple):
            raise self._no("is not a list; write one such as ['1', '2']", node)
        return [self._literal(one) for one in node.elts]

    def _literal(self, node: ast.expr) -> bool | int | float | str:
        inner = node.operand if isinstance(node, ast.UnaryOp) else node
        if not isinstance(inner, ast.Constant):
            raise self._no("is not text or a number", node)
        return self._value(node)  # type: ignore[return-value]  # a literal, or its negative

    def _called(self, node: ast.Call) -> pd.Series:
        """One of the five methods, on a column, with literals."""
        match node:
            case ast.Call(func=ast.Attribute(value=ast.Name() as column, attr="isin"), args=[one], keywords=[]):
                return self._column(column).isin(self._list(one))
            case ast.Call(
                func=ast.Attribute(value=ast.Name() as column, attr="between"), args=[low, high], keywords=[]
            ):
                return self._column(column).between(self._literal(low), self._literal(high))
            case ast.Call(
                func=ast.Attribute(value=ast.Attribute(value=ast.Name() as column, attr="str"), attr=method),
                args=[ast.Constant(value=str() as part)],
                keywords=[],
            ) if method in TEXT_METHODS:
                words = self._column(column).str
                how = {"regex": False} if method == "contains" else {}
                return getattr(words, method)(part, na=False, **how)
        raise self._unknown(node)

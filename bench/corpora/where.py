"""Conditions on the columns of captures (``where=``).

They mean what they mean to pandas, but can do nothing except compare.
"""

from __future__ import annotations

import ast
import re
import warnings
from functools import reduce
from operator import and_, eq, ge, gt, le, lt, ne, or_
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from bench.corpora.spellings import known_spelling
from bench.errors import InputError, shorten

ALLOWED = (
    "allowed on columns, text and numbers: == != < <= > >= in [...] and or not .isin .between "
    ".str.startswith .str.endswith .str.contains"
)
NO_CONDITION = "this is not a condition, such as \"subject != '3'\""
MOST_CHARACTERS = 300  # of a message
# What Python and pandas read differently, outside text: & and |, and columns in backticks. A
# condition is one line, and a comment would end it.
SPECIAL = re.compile(
    r"""'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|`(?P<column>[^`]+)`|(?P<word>[&|\r\n#])"""
)
WORDS = {"&": " and ", "|": " or ", "\r": " ", "\n": " "}
COMPARISONS = {ast.Eq: eq, ast.NotEq: ne, ast.Lt: lt, ast.LtE: le, ast.Gt: gt, ast.GtE: ge}
TEXT_METHODS = {"startswith": {}, "endswith": {}, "contains": {"regex": False}}


def where_mask(where: str, captures: pd.DataFrame, name: str) -> np.ndarray:
    """Captures that satisfy a condition, bool [captures].

    Args:
        where: the condition.
        captures: table of the captures.
        name: name of the corpus, for messages.

    Raises:
        InputError: it is no condition on these columns, or no capture satisfies it.
    """
    try:
        mask = _evaluate(where, captures)
    except (RecursionError, MemoryError):
        reason = "too deeply nested; write a shorter condition"
    except SyntaxError as e:
        reason = f"{str(e.msg)[:60]}; {ALLOWED}"
    except KeyError as e:
        columns = ", ".join(map(str, captures))
        reason = f"no column {str(e.args[0])[:40]!r}; the columns of {name[:40]} are {columns}"
    except InputError as e:
        reason = str(e)
    except Exception as e:  # pandas raises a dozen types where values do not fit together
        reason = f"cannot be computed ({' '.join(str(e).split()) or type(e).__name__})"
    else:
        if mask.any():
            return mask.to_numpy()
        reason = f"selects none of the {len(captures)} captures of {name}"
    raise InputError(shorten(f"where={shorten(repr(where), 70)}: {reason}", MOST_CHARACTERS))


def _evaluate(where: str, captures: pd.DataFrame) -> pd.Series:
    """The mask of a condition.

    Raises:
        SyntaxError: something in it is not allowed.
        KeyError: there is no such column.
    """
    columns: dict[str, pd.Series] = {}

    def translate(match: re.Match) -> str:
        if match["word"] == "#":
            raise SyntaxError("a comment cannot be used")
        if match["word"]:
            return WORDS[match["word"]]
        if not match["column"]:
            return match[0]
        name = f"_column{len(columns)}"
        columns[name] = captures[match["column"]]
        return name

    text = SPECIAL.sub(translate, where).strip()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Python's advice is about programs
        tree = ast.parse(text, mode="eval").body
    mask = _mask(tree, captures.assign(**columns))
    if not (isinstance(mask, pd.Series) and mask.dtype == bool):
        raise SyntaxError(NO_CONDITION)
    return mask


def _mask(node: ast.expr, table: pd.DataFrame) -> pd.Series:
    """The captures that satisfy a part of a condition; text is searched literally."""
    match node:
        case ast.BoolOp(op=operator, values=parts):
            combine = and_ if isinstance(operator, ast.And) else or_
            return reduce(combine, (_mask(part, table) for part in parts))
        case ast.UnaryOp(op=ast.Not() | ast.Invert(), operand=part):
            return ~_mask(part, table)
        case ast.Name(id=name):
            if table[name].dtype == bool:
                return table[name]
            raise SyntaxError(NO_CONDITION)
        case ast.Compare(left=left, ops=operators, comparators=others):
            sides = zip([left, *others], operators, others, strict=False)
            return reduce(and_, (_compare(*side, table) for side in sides))
        case ast.Call(
            func=ast.Attribute(value=ast.Name(id=name), attr="isin" | "between" as method),
            args=values,
            keywords=[],
        ):
            literals = [_evaluate_literal(value) for value in values]
            _check_values(table[name], literals, method == "isin")
            return getattr(table[name], method)(*literals)
        case ast.Call(
            func=ast.Attribute(
                value=ast.Attribute(value=ast.Name(id=name), attr="str"), attr=method
            ),
            args=[ast.Constant(value=str(text))],
            keywords=[],
        ) if method in TEXT_METHODS:
            return getattr(table[name].str, method)(text, na=False, **TEXT_METHODS[method])
    raise SyntaxError(f"{ast.unparse(node)[:36]!r} cannot be used")


def _compare(left: ast.expr, operator: ast.cmpop, right: ast.expr, table: pd.DataFrame) -> Any:
    """Compare columns, text and numbers; equal to a list is what is in it, as pandas reads it."""
    one, other = (
        table[side.id] if isinstance(side, ast.Name) else _evaluate_literal(side)
        for side in (left, right)
    )
    equality = isinstance(operator, ast.Eq | ast.NotEq | ast.In | ast.NotIn)
    for column, value in ((one, other), (other, one)):
        if isinstance(column, pd.Series):
            _check_values(column, value, equality)
    if isinstance(operator, ast.In | ast.NotIn) and not isinstance(other, list | tuple):
        raise SyntaxError(f"{ast.unparse(right)[:36]!r} is not a list such as ['1', '2']")
    if isinstance(one, list | tuple):
        one, other = other, one
    if isinstance(other, list | tuple) and equality:
        return one.isin(other) ^ isinstance(operator, ast.NotEq | ast.NotIn)
    if type(operator) not in COMPARISONS:
        raise SyntaxError("'is' cannot be used")
    return COMPARISONS[type(operator)](one, other)


def _check_values(column: pd.Series, value: Any, equality: bool) -> None:
    """Refuse another type than the column's and, for equality, another spelling of its values."""
    if isinstance(value, pd.Series):
        if is_numeric_dtype(column) != is_numeric_dtype(value):
            raise InputError(f"{column.name} and {value.name}: one holds text, the other numbers")
    elif isinstance(value, list | tuple):
        for each in value:
            _check_values(column, each, equality)
    elif is_numeric_dtype(column):
        if isinstance(value, str):
            number = value if re.fullmatch(r"-?\d+(\.\d+)?", value) else "a number"
            raise InputError(f"{column.name} holds numbers; write {number}")
    else:
        spelling = known_spelling(str(value), {*column.dropna().astype(str)})
        if not isinstance(value, str):
            raise InputError(f"{column.name} holds text; write {spelling or str(value)!r}")
        if equality and spelling is not None:
            raise InputError(f"{column.name} has no {value!r}; write {spelling!r}")


def _evaluate_literal(node: ast.expr) -> Any:
    """Text, a number, or a list of these."""
    try:
        return ast.literal_eval(node)
    except ValueError:
        raise SyntaxError(f"{ast.unparse(node)[:36]!r} cannot be used") from None

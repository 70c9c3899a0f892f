"""Conditions on the columns of captures (``where=``), which mean what they mean to pandas and can do nothing else."""

from __future__ import annotations

import ast
import re
import warnings
from functools import reduce
from operator import and_, eq, ge, gt, le, lt, ne, or_
from typing import Any

import numpy as np
import pandas as pd

from bench.errors import InputError, shorten

ALLOWED = (
    "allowed on columns, text and numbers: == != < <= > >= in [...] and or not .isin .between .str.startswith "
    ".str.endswith .str.contains"
)
NO_CONDITION = "this is not a condition, such as \"subject != '3'\""
LONGEST = 10_000  # characters
LINE = 300  # characters of a message
# What Python and pandas read in different ways: & and |, and names of columns in backticks; not within text.
SPECIAL = re.compile(
    r"""'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|`(?P<column>[^`]+)`|(?P<word>[&|\r\n#])"""
)
WORDS = {"&": " and ", "|": " or ", "\r": " ", "\n": " "}
COMPARISONS = {ast.Eq: eq, ast.NotEq: ne, ast.Lt: lt, ast.LtE: le, ast.Gt: gt, ast.GtE: ge}


def captures_where(where: str, captures: pd.DataFrame, name: str) -> np.ndarray:
    """Captures of a corpus of this name that satisfy a condition, bool [captures]."""
    if len(where) > LONGEST:
        raise InputError(
            f"where= has {len(where)} characters; give at most {LONGEST}, or a column of your own"
        )
    try:
        mask = _evaluated(where, captures)
    except (RecursionError, MemoryError):
        reason = "too deeply nested; write a shorter condition"
    except SyntaxError as e:
        reason = f"{str(e.msg)[:60]}; {ALLOWED}"
    except KeyError as e:
        reason = f"no column {str(e.args[0])[:40]!r}; the columns of {name[:40]} are {', '.join(map(str, captures))}"
    except Exception as e:  # pandas raises a dozen types where values do not fit together
        reason = f"cannot be computed ({' '.join(str(e).split()) or type(e).__name__})"
    else:
        if mask.any():
            return mask.to_numpy()
        reason = f"selects none of the {len(captures)} captures of {name}"
    raise InputError(shorten(f"where={shorten(repr(where), 70)}: {reason}", LINE))


def _evaluated(where: str, captures: pd.DataFrame) -> pd.Series:
    """The mask; a `SyntaxError` says what is not allowed, a `KeyError` which column there is not."""
    quoted: dict[str, pd.Series] = {}

    def translated(match: re.Match) -> str:
        if match["word"] == "#":
            raise SyntaxError("a comment cannot be used")
        if column := match["column"]:
            quoted[f"_column{len(quoted)}"] = captures[column]
            return list(quoted)[-1]
        return WORDS.get(match[0], match[0])

    text = SPECIAL.sub(translated, where).strip()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Python's advice is about programs
        tree = ast.parse(text, mode="eval").body
    mask = _mask(tree, captures.assign(**quoted))
    if not (isinstance(mask, pd.Series) and mask.dtype == bool):
        raise SyntaxError(NO_CONDITION)
    return mask


def _mask(node: ast.expr, table: pd.DataFrame) -> pd.Series:
    """The captures that satisfy a condition; text is searched literally."""
    match node:
        case ast.BoolOp(op=op, values=parts):
            return reduce(
                and_ if isinstance(op, ast.And) else or_, (_mask(part, table) for part in parts)
            )
        case ast.UnaryOp(op=ast.Not() | ast.Invert(), operand=part):
            return ~_mask(part, table)
        case ast.Name(id=name):
            if table[name].dtype == bool:
                return table[name]
            raise SyntaxError(NO_CONDITION)
        case ast.Compare(left=left, ops=ops, comparators=others):
            pairs = zip([left, *others], ops, others, strict=False)
            return reduce(and_, (_compared(one, op, other, table) for one, op, other in pairs))
        case ast.Call(
            func=ast.Attribute(value=ast.Name(id=name), attr=method), args=values, keywords=[]
        ):
            if method in ("isin", "between"):
                return getattr(table[name], method)(*map(_literal, values))
        case ast.Call(
            func=ast.Attribute(
                value=ast.Attribute(value=ast.Name(id=name), attr="str"), attr=method
            ),
            args=[ast.Constant(value=str(text))],
            keywords=[],
        ) if method in ("startswith", "endswith", "contains"):
            literally = {"regex": False} if method == "contains" else {}
            return getattr(table[name].str, method)(text, na=False, **literally)
    raise SyntaxError(f"{ast.unparse(node)[:36]!r} cannot be used")


def _compared(one: ast.expr, op: ast.cmpop, other: ast.expr, table: pd.DataFrame) -> Any:
    """A comparison of columns, text and numbers; equal to a list is what is in it, as pandas reads it."""
    left, right = (
        table[side.id] if isinstance(side, ast.Name) else _literal(side) for side in (one, other)
    )
    if isinstance(op, ast.In | ast.NotIn) and not isinstance(right, list | tuple):
        raise SyntaxError(f"{ast.unparse(other)[:36]!r} is not a list such as ['1', '2']")
    if isinstance(left, list | tuple):
        left, right = right, left
    if isinstance(right, list | tuple) and isinstance(op, ast.Eq | ast.NotEq | ast.In | ast.NotIn):
        return left.isin(right) ^ isinstance(op, ast.NotEq | ast.NotIn)
    if type(op) not in COMPARISONS:
        raise SyntaxError("'is' cannot be used")
    return COMPARISONS[type(op)](left, right)


def _literal(node: ast.expr) -> Any:
    """Text, a number, or a list of these."""
    try:
        return ast.literal_eval(node)
    except ValueError:
        raise SyntaxError(f"{ast.unparse(node)[:36]!r} cannot be used") from None

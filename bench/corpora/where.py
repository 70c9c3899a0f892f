"""Conditions on the columns of captures (``where=``): pandas evaluates those that pass an allow-list."""

from __future__ import annotations

import ast
import re
import warnings

import numpy as np
import pandas as pd

from bench.errors import InputError

ALLOWED = (
    "allowed on columns, text and numbers: == != < <= > >= in [...] and or not + - * / // % "
    ".isin .between .str.startswith .str.endswith .str.contains"
)
LONGEST = 10_000  # characters
LINE = 300  # characters of a message
# What Python and pandas read in different ways: & and |, and names of columns in backticks; not within text.
SPECIAL = re.compile(r"""'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|`(?P<column>[^`]+)`|(?P<word>[&|\r\n#])""")
WORDS = {"&": " and ", "|": " or ", "\r": " ", "\n": " "}
ARITHMETIC = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.FloorDiv, ast.Mod)
COMPARISONS = (ast.Eq, ast.NotEq, ast.Lt, ast.LtE, ast.Gt, ast.GtE)


def chosen(where: str, captures: pd.DataFrame, name: str) -> np.ndarray:
    """Captures of a corpus of this name that satisfy a condition, bool [captures].

    Raises:
        InputError: it is no condition on these columns, or no capture satisfies it.
    """
    if len(where) > LONGEST:
        raise InputError(f"where= has {len(where)} characters; give at most {LONGEST}, or a column of your own")
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
    message = f"where={repr(where) if len(repr(where)) <= 70 else repr(where)[:66] + '...'}: {reason}"
    raise InputError(message if len(message) <= LINE else f"{message[: LINE - 3]}...")


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
    table = captures.assign(**quoted)
    _kind(tree, table)
    mask = table.eval(ast.unparse(tree), engine="python")  # what was checked, not what was written
    if not (isinstance(mask, pd.Series) and mask.dtype == bool):
        raise SyntaxError("this is not a condition, such as \"subject != '3'\"")
    return mask


def _kind(node: ast.expr, table: pd.DataFrame) -> str:
    """What an expression is: ``condition``, ``number`` or ``text``; text is searched literally."""
    match node:
        case ast.Constant(value=bool() | str()):
            return "text"
        case ast.Constant(value=int() | float()):
            return "number"
        case ast.Name(id=name):
            column = table[name]
            return (
                "condition" if column.dtype == bool else "number" if pd.api.types.is_numeric_dtype(column) else "text"
            )
        case ast.BoolOp(values=parts) if {_kind(part, table) for part in parts} == {"condition"}:
            return "condition"
        case ast.UnaryOp(op=ast.Not() | ast.Invert(), operand=part) if _kind(part, table) == "condition":
            return "condition"
        case ast.UnaryOp(op=ast.USub(), operand=part) if _kind(part, table) == "number":
            return "number"
        case ast.BinOp(op=op, left=left, right=right) if isinstance(op, ARITHMETIC):
            if _kind(left, table) == _kind(right, table) == "number":
                return "number"
        case ast.Compare(left=left, ops=ops, comparators=others):
            for op, one, other in zip(ops, [left, *others], others, strict=False):
                _check_compared(one, op, other, table)
            return "condition"
        case ast.Call(func=ast.Attribute(value=ast.Name() as column, attr="isin"), args=[values], keywords=[]):
            if _kind(column, table) and _are_literals(values):
                return "condition"
        case ast.Call(func=ast.Attribute(value=ast.Name() as column, attr="between"), args=[_, _], keywords=[]):
            if _kind(column, table) and _are_literals(ast.List(node.args)):
                return "condition"
        case ast.Call(
            func=ast.Attribute(value=ast.Attribute(value=ast.Name() as column, attr="str"), attr=method),
            args=[ast.Constant(value=str())],
            keywords=[],
        ) if _kind(column, table) and method in ("startswith", "endswith", "contains"):
            literally = [ast.keyword("regex", ast.Constant(False))] if method == "contains" else []
            node.keywords = [ast.keyword("na", ast.Constant(False)), *literally]
            return "condition"
    raise SyntaxError(f"{ast.unparse(node)[:36]!r} cannot be used")


def _check_compared(one: ast.expr, op: ast.cmpop, other: ast.expr, table: pd.DataFrame) -> None:
    if isinstance(op, ast.In | ast.NotIn):
        if not _are_literals(other):
            raise SyntaxError(f"{ast.unparse(other)[:36]!r} is not a list such as ['1', '2']")
        _kind(one, table)
    elif not isinstance(op, COMPARISONS):
        raise SyntaxError("'is' cannot be used")
    else:
        for side in (one, other):
            if not (isinstance(op, ast.Eq | ast.NotEq) and _are_literals(side)):
                _kind(side, table)


def _are_literals(node: ast.expr) -> bool:
    """Whether this is a list of text and numbers."""
    inner = [e.operand if isinstance(e, ast.UnaryOp) else e for e in getattr(node, "elts", ())]
    return isinstance(node, ast.List | ast.Tuple) and all(
        isinstance(e, ast.Constant) and isinstance(e.value, bool | int | float | str) for e in inner
    )

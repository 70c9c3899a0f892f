"""Signatures of the Python API, made of the keys of commands, for ``help()`` and completion."""

from __future__ import annotations

import inspect
import keyword
from collections.abc import Callable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any

from bench.ground.typed import Option

TYPES = {"yes": "bool", "count": "int", "counts": "int", "number": "float"}  # else text
KEYS = inspect.Parameter.KEYWORD_ONLY


class KeySignature(inspect.Signature):
    """The signature of a function whose ``**values`` are keys; they are read when it is.

    Args:
        function: a function of `bench`.
        options: gives the options of its keys.
    """

    def __init__(self, function: Callable, options: Callable[[], Mapping[str, Option]]) -> None:
        self._typed, self._options = inspect.signature(function), options
        super().__init__([], return_annotation=self._typed.return_annotation)

    @cached_property
    def parameters(self) -> MappingProxyType[str, inspect.Parameter]:  # type: ignore[override]
        """The typed parameters, one for each key, and ``**values``."""
        *typed, values = self._typed.parameters.values()
        names = {parameter.name for parameter in typed}
        for option in self._options().values():
            name = option.key.replace(".", "__")
            if name not in names and not keyword.iskeyword(name):
                typed.append(
                    inspect.Parameter(
                        name, KEYS, default=option.default, annotation=_annotation(option)
                    )
                )
        return MappingProxyType({each.name: each for each in (*typed, values)})


def _annotation(option: Option) -> str:
    """The type of the values of a key; parts may be objects, and most keys take lists."""
    if option.part_group:
        return "object"
    if option.type == "amount" or option.type not in {*TYPES, "text"}:
        return "str | float | Sequence[str | float] | None"
    name = TYPES.get(option.type, "str")
    return name if name == "bool" else f"{name} | Sequence[{name}] | None"


def set_signatures(
    functions: Mapping[Any, Callable[[], Mapping[str, Option]]],
) -> None:
    """Give functions the signatures of their keys."""
    for function, options in functions.items():
        function.__signature__ = KeySignature(function, options)

"""The command ``bench``. Heavy modules are imported by the commands that need them."""

from __future__ import annotations

import errno
import gc
import io
import os
import sys

from bench.errors import ClusterError, HiddenError, InputError, StoreError, nearest
from bench.grammar.options import keys, rooms
from bench.ground.registry import imported, load, names
from bench.ground.scratch import scratch

LONGEST = 300  # characters of a message
GARBAGE = 50_000  # new objects between two looks for circles of them; Python's 700 take a seventh of a report's time
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def main(arguments: list[str] | None = None) -> int:
    """Entry point: what a user can mend is one line, with exit code 2 for wrong input and 1 for what failed."""
    arguments = sys.argv[1:] if arguments is None else arguments
    gc.set_threshold(GARBAGE)
    _open_output()
    try:
        code = _done(arguments)
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # whoever read the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt as e:
        print(
            f"bench: {str(e) or 'interrupted; the same command starts again from the beginning'}",
            file=sys.stderr,
        )
        return 130
    except (InputError, HiddenError, StoreError, ClusterError, MemoryError, OSError) as e:
        code, text = _failure(e)
        print(_line(text), file=sys.stderr)
        return code


def _failure(error: Exception) -> tuple[int, str]:
    """The exit code of an error, and what to say; one that no user can mend is raised again."""
    if isinstance(error, MemoryError):
        return 1, f"memory ran out ({error or 'no details'}); use less data or fewer jobs"
    if not isinstance(error, OSError):
        return 2 if isinstance(error, InputError | HiddenError) else 1, str(error)
    if error.errno == errno.ENAMETOOLONG:
        return 2, f"{error.filename}: the name is too long; choose a shorter one"
    if error.errno not in FULL:
        raise error
    where = f" ({error.filename})" if error.filename else ""
    return 1, f"no space is left{where}; free some and repeat the command, which continues"


def _done(arguments: list[str]) -> int:
    """Do a command; its exit code."""
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        from bench.grammar.described import overview

        print(overview())
        return 0
    if arguments[0] == "--version":
        from importlib.metadata import version

        print(f"touchbench {version('touchbench')}")
        return 0
    name, *rest = arguments
    if name not in (known := [name for name in names("commands") if " " not in name]):
        raise InputError(f"no command is called {name!r}; {nearest(name, known)}")
    if {"-h", "--help"} & {*rest}:
        print(_help(name, rest), end="")
        return 0
    _check(name, rest)
    command = load("commands", name)
    with scratch():
        if command.makes:
            from bench.commands.run import command as run

            return run(name, rest)
        return imported(
            f"{command.module}:{name}" if command.module else f"bench.commands.{name}:command"
        )(rest)


def _help(name: str, arguments: list[str]) -> str:
    """The help of a command; where its arguments name parts, the parameters of these."""
    from bench.grammar.described import help_of, help_of_parts

    known = keys(name)
    words = [a for a in arguments if (key := a.partition("=")[0]) in rooms() and key in known]
    return help_of_parts(words, rooms()) if words else help_of(name)


def _check(name: str, arguments: list[str]) -> None:
    """Refuse options as most programs have them, NUL characters, and a working folder that was deleted."""
    for i, argument in enumerate(arguments):
        if "\0" in argument:
            raise InputError("an argument contains a NUL character; remove it")
        if argument.startswith("--") and argument.strip("-"):
            key, equals, value = argument.lstrip("-").replace("-", "_").partition("=")
            value = (
                value
                if equals
                else next((a for a in arguments[i + 1 :] if not a.startswith("-")), "VALUE")
            )
            what = f": {key}={value}" if key in keys(name) else f"; {nearest(key, keys(name))}"
            raise InputError(f"{argument}: options are written key=value, without dashes{what}")
    try:
        os.getcwd()  # where it is gone, nothing relative can be found
    except OSError as e:
        raise InputError(
            f"the working folder is missing ({e.strerror}); change to another one"
        ) from e


def _open_output() -> None:
    """Let standard output take whatever is printed: where it is closed, and names of files that are no text."""
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # for as long as the process lives
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors in (
        "strict",
        "surrogateescape",
    ):
        sys.stdout.reconfigure(errors="backslashreplace")


def _line(text: str) -> str:
    """An error in one line; a long one loses its middle, as what to do stands at the end."""
    text = " ".join(text.split())
    text = "".join(
        c if c.isprintable() else repr(c)[1:-1] for c in text
    )  # what a terminal would obey
    most = LONGEST - len("bench: ")
    kept = (most - 3) // 2
    return f"bench: {text if len(text) <= most else f'{text[:kept]} … {text[-kept:]}'}"

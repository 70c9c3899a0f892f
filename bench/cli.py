"""The command ``bench``. Whatever is heavy is imported by the command that needs it."""

from __future__ import annotations

import errno
import importlib
import io
import os
import sys

from bench.commands.help import COMMANDS, GROUPS
from bench.errors import ClusterError, HiddenError, InputError, StoreError, nearest
from bench.registry import check_rooms, names
from bench.scratch import scratch

LONGEST = 300  # characters of a message
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def main(arguments: list[str] | None = None) -> int:
    """Entry point; an `InputError` is one line and exit code 2, a store that fails one line and 1."""
    arguments = sys.argv[1:] if arguments is None else arguments
    _open_output()
    try:
        if not arguments or arguments[0] in ("-h", "--help", "help"):
            print("bench: which recogniser of touch gestures should I ship?\n")
            print(_overview())
            return 0
        if arguments[0] == "--version":
            from importlib.metadata import version

            print(f"touchbench {version('touchbench')}")
            return 0
        check_rooms()
        name, *rest = arguments
        if name not in COMMANDS:
            raise InputError(f"no command is called {name!r}; {nearest(name, COMMANDS)}")
        if {"-h", "--help"} & set(rest):
            print(_help(name), end="")
            return 0
        _check_dashes(rest)
        if any("\0" in argument for argument in rest):
            raise InputError("an argument holds a NUL character; take it out")
        module, function = COMMANDS[name][0].split(":")
        _check_place()
        with scratch():
            code = getattr(importlib.import_module(module), function)(rest)
        sys.stdout.flush()
        return code
    except (InputError, HiddenError) as e:
        print(_line(e), file=sys.stderr)
        return 2
    except (StoreError, ClusterError) as e:
        print(_line(e), file=sys.stderr)
        return 1
    except BrokenPipeError:  # whoever read the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as e:
        if e.errno == errno.ENAMETOOLONG:
            print(_line(ValueError(f"{e.filename}: the name is too long; choose a shorter one")), file=sys.stderr)
            return 2
        if e.errno not in FULL:
            raise
        where = f" ({e.filename})" if e.filename else ""
        said = f"no space is left{where}; make room and repeat the command, it goes on"
        print(_line(ValueError(said)), file=sys.stderr)
        return 1
    except MemoryError as e:
        print(_line(ValueError(f"memory ran out ({e or 'no more is given'}); ask for less")), file=sys.stderr)
        return 1
    except KeyboardInterrupt as e:
        print(f"bench: {e or 'interrupted'}", file=sys.stderr)
        return 130


def _overview() -> str:
    """All commands, those to begin with first."""
    grouped = {name for group in GROUPS.values() for name in group}
    more = tuple(name for name in COMMANDS if name not in grouped)
    lines = []
    for title, group in {**GROUPS, "more": more}.items():
        lines += [f"{title}:", *(f"  bench {name:12}{COMMANDS[name][1]}" for name in group), ""]
    return "\n".join([*lines, "bench COMMAND --help says more of each."])


def _check_dashes(arguments: list[str]) -> None:
    """Say how an option is written here that was typed as most programs want it.

    Raises:
        InputError: there is one.
    """
    for place, argument in enumerate(arguments):
        if argument.startswith("--") and argument.strip("-"):
            key, equals, value = argument.lstrip("-").replace("-", "_").partition("=")
            value = value if equals else next((a for a in arguments[place + 1 :] if not a.startswith("-")), "VALUE")
            raise InputError(f"{argument}: options are written key=value, without dashes: {key}={value}")


def _open_output() -> None:
    """Let standard output take whatever is printed: where it is closed, and names of files that are no text."""
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # for as long as the process lives
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="backslashreplace")


def _check_place() -> None:
    """Find out whether the working folder was deleted, where nothing relative can be found.

    Raises:
        InputError: it was.
    """
    try:
        os.getcwd()
    except OSError as e:
        raise InputError(f"the working folder is gone ({e.strerror}); change to another") from e


def _line(error: Exception) -> str:
    """An error in one line; a long one loses its middle, as what to do stands at the end."""
    said = " ".join(str(error).split())
    said = "".join(c if c.isprintable() else repr(c)[1:-1] for c in said)  # what a terminal would obey
    most = LONGEST - len("bench: ")
    kept = (most - 3) // 2
    return f"bench: {said if len(said) <= most else f'{said[:kept]} … {said[-kept:]}'}"


def _help(name: str) -> str:
    text = COMMANDS[name][2]
    if name == "run":
        rooms = {room: ", ".join(names(room)) for room in ("protocols", "models", "features")}
        text = text.format(data="synth (generated)", **rooms)
    return text

"""The command ``bench``. Heavy modules are imported by the commands that need them."""

from __future__ import annotations

import errno
import gc
import io
import os
import sys
from typing import Any

from bench.errors import ClusterError, HiddenError, InputError, StoreError, suggest_names
from bench.grammar.options import key_options, parse_arguments, part_groups
from bench.ground.registry import import_object, load_part, registered_parts
from bench.ground.scratch import use_scratch_folder, why_data_folder_failed
from bench.ground.typed import expand_home

LONGEST_LINE = 300  # characters of a message
GARBAGE = 50_000  # new objects between two collections; Python's 700 slow a report by a seventh
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class OutputClosed(BaseException):
    """The reader of standard output has closed it."""


class _Output(io.FileIO):
    """Standard output: a closed pipe of it is told from those of a user's system."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError as e:
            raise OutputClosed from e


class _Errors(io.FileIO):
    """Standard error: what nobody reads is dropped, and the command goes on."""

    is_read = True

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            _Errors.is_read = False
            return len(data)


def main(arguments: list[str] | None = None) -> int:
    """Run a command and return its exit code.

    An error that a user can mend is printed in one line, with exit code 2 for wrong input and 1 for
    a failure.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    gc.set_threshold(GARBAGE)
    _accept_all_output()
    try:
        exit_code = _run_command(arguments)
        sys.stdout.flush()
        return exit_code
    except OutputClosed:  # its reader has seen enough
        _discard_output()
        return 0
    except KeyboardInterrupt as e:
        _print_error(str(e) or "interrupted; the same command starts again from the beginning")
        return 130
    except (InputError, HiddenError, StoreError, ClusterError, MemoryError, OSError) as e:
        exit_code, message = _exit_code_and_message(e)
        _print_error(message)
        if isinstance(e, OSError):  # else Python tries to write it again at the end
            _discard_output()
        return exit_code


def _discard_output() -> None:
    """Write what is still in the buffer of standard output to nowhere."""
    buffer = getattr(sys.stdout, "buffer", None)
    raw = getattr(buffer, "raw", buffer)
    if isinstance(raw, _Output):
        os.dup2(os.open(os.devnull, os.O_WRONLY), raw.fileno())


def _print_error(message: str) -> None:
    """Print a message on standard error, or where nobody reads that, on standard output."""
    print(_as_error_line(message), file=sys.stderr)
    if not _Errors.is_read:
        print(_as_error_line(message))


def _exit_code_and_message(error: Exception) -> tuple[int, str]:
    """The exit code and the message of an error; raise again one that no user can mend."""
    if isinstance(error, MemoryError):
        return 1, f"memory ran out ({error or 'no details'}); use less data or fewer jobs"
    if not isinstance(error, OSError):
        return 2 if isinstance(error, InputError | HiddenError) else 1, str(error)
    if error.errno == errno.ENAMETOOLONG:
        return 2, f"{error.filename}: the name is too long; choose a shorter one"
    if error.errno not in DISK_FULL:
        if message := why_data_folder_failed(error):
            return 2, message
        raise error
    path = error.filename2 or error.filename  # of a copy, the one that is written
    place = f" ({path})" if path else ""
    return 1, f"no space is left{place}; free some and repeat the command, which continues"


def _run_command(arguments: list[str]) -> int:
    """Run a command, or print help or the version; return the exit code."""
    if not arguments or arguments[0] in ("-h", "--help", "help"):
        from bench.grammar.help import help_overview

        print(help_overview())
        return 0
    if arguments[0] == "--version":
        from importlib.metadata import version

        print(f"touchbench {version('touchbench')}")
        return 0
    name, *arguments = map(expand_home, arguments)
    names = [part for part in registered_parts("commands") if " " not in part]
    if name not in names:
        raise InputError(f"no command is called {name!r}; {suggest_names(name, names)}")
    if {"-h", "--help"} & {*arguments}:
        print(_help_text(name, arguments), end="")
        return 0
    _check_arguments(name, arguments)
    command = load_part("commands", name)
    with use_scratch_folder():
        if command.module:
            return import_object(f"{command.module}:{name}")(arguments)
        if command.takes_words:
            return import_object(f"bench.commands.{name}:command")(arguments)
        file = ""
        if name == "run" and arguments and arguments[0].endswith(".toml"):
            file, *arguments = arguments
        values = parse_arguments(arguments, key_options(name, arguments))
        if command.makes:
            return import_object("bench.commands.run:command")(name, values, file)
        return import_object(f"bench.commands.{name}:command")(values)


def _help_text(name: str, arguments: list[str]) -> str:
    """The help of a command, or of the parts that its arguments name."""
    from bench.grammar.help import command_help, parts_help

    part_keys = part_groups().keys() & key_options(name).keys()
    part_arguments = [a for a in arguments if a.partition("=")[0] in part_keys]
    return parts_help(part_arguments, part_groups()) if part_arguments else command_help(name)


def _check_arguments(name: str, arguments: list[str]) -> None:
    """Refuse dashes, NUL characters, and a working folder that was deleted."""
    for i, argument in enumerate(arguments):
        if "\0" in argument:
            raise InputError("an argument contains a NUL character; remove it")
        if argument.startswith("--") and argument.strip("-"):
            key, _, value = argument.lstrip("-").replace("-", "_").partition("=")
            values = [value, *(a for a in arguments[i + 1 :] if not a.startswith("-")), "VALUE"]
            advice = f"; {suggest_names(key, key_options(name))}"
            if key in key_options(name):
                advice = f": {key}={next(filter(None, values))}"
            raise InputError(f"{argument}: options are written key=value, without dashes{advice}")
    try:
        os.getcwd()  # without it, no relative path can be found
    except OSError as e:
        reason = f"the working folder is missing ({e.strerror})"
        raise InputError(f"{reason}; change to another one") from e


def _accept_all_output() -> None:
    """Print to nowhere if standard output is closed, and escape names of files that are no text."""
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # for as long as the process lives
    if sys.stdout is sys.__stdout__:
        sys.stdout = _reopen(sys.stdout, _Output)
    if sys.stderr is not None and sys.stderr is sys.__stderr__:
        sys.stderr = _reopen(sys.stderr, _Errors)
    strict = ("strict", "surrogateescape")
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors in strict:
        sys.stdout.reconfigure(errors="backslashreplace")


def _reopen(stream: Any, kind: type[io.FileIO]) -> io.TextIOWrapper:
    """Open the file behind a stream of text again, as another kind of file."""
    file: Any = kind(stream.fileno(), "wb", closefd=False)
    if not stream.write_through:  # as without PYTHONUNBUFFERED
        file = io.BufferedWriter(file)
    names = ("encoding", "errors", "line_buffering", "write_through")
    return io.TextIOWrapper(file, **{name: getattr(stream, name) for name in names})


def _as_error_line(message: str) -> str:
    """A message in one line without control characters; a long one loses its middle.

    Its end says what to do.
    """
    text = " ".join(message.split())
    text = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
    most = LONGEST_LINE - len("bench: ")
    if len(text) > most:
        half = (most - 3) // 2
        text = f"{text[:half]} … {text[-half:]}"
    return f"bench: {text}"

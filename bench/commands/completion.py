"""The command ``bench completion``: a script for a shell, and what that script asks for at each TAB.

A TAB starts this once and must be answered at once, so nothing heavy is imported: keys are read off the help texts,
values off the registry and the data folder.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from bench.commands.help import COMMANDS
from bench.costs import BUDGETS, COSTS
from bench.errors import InputError, nearest
from bench.registry import names
from bench.scratch import home

KEY = re.compile(r"(?<![\w.])((?:[a-z]+\.)?[a-z_]+)=")
ANSWER = "answer"  # bench completion answer WORD... prints what the last of the words may become
SHELLS = {
    "bash": """\
_bench() {
    local words word
    read -ra words <<< "${COMP_LINE:0:COMP_POINT}"
    [[ ${COMP_LINE:COMP_POINT-1:1} == " " ]] && words+=("")
    word=${words[${#words[@]}-1]}
    mapfile -t COMPREPLY < <(bench completion answer "${words[@]:1}" 2>/dev/null)
    if [[ $word == *=* && $COMP_WORDBREAKS == *=* ]]; then  # bash completes what stands behind the =
        COMPREPLY=("${COMPREPLY[@]#"${word%"${word##*=}"}"}")
    fi
    if [[ ${#COMPREPLY[@]} -eq 0 ]]; then
        compopt -o default  # a file
    elif [[ ${#words[@]} -gt 2 ]]; then
        compopt -o nospace
    fi
}
complete -F _bench bench
""",
    "zsh": """\
_bench() {
    local -a found
    found=(${(f)"$(bench completion answer "${(@)words[2,CURRENT]}" 2>/dev/null)"})
    if (( ! $#found )); then
        _files
    elif (( CURRENT > 2 )); then
        compadd -S '' -- $found
    else
        compadd -- $found
    fi
}
(( $+functions[compdef] )) || { autoload -Uz compinit && compinit }
compdef _bench bench
""",
    "fish": """\
function __bench_answer
    set -l words (commandline -opc) (commandline -ct)
    bench completion answer $words[2..-1] 2>/dev/null
end
complete -c bench -f -a "(__bench_answer)"
complete -c bench -n "not string length -q -- (__bench_answer)" -F
""",
}
LISTED = {  # values of keys that are no names of the registry
    "bits": ("32", "8"),
    "inner": ("3", "loso"),
    "labels": ("no", "yes"),
    "model.device": ("cpu", "cuda"),
    "model.person": ("centre", "scale", "pool"),
    "model.repair": ("stuck", "dead", "offset"),
    "model.scale": ("peak",),
    "run": ("true", "false"),
    "start": ("onset", "middle"),
    "stopping": ("yes", "no"),
    "update": ("true", "false"),
}
PLUS = {"model.faults", "model.person", "model.repair"}  # keys whose names a + joins; elsewhere a comma makes a list


def completion(arguments: list[str]) -> int:
    """Print the script of a shell, or the answer to a TAB.

    Raises:
        InputError: the shell is not known.
    """
    match arguments:
        case [word, *words] if word == ANSWER:
            print("".join(f"{line}\n" for line in answer(words)), end="")
        case [shell] if shell in SHELLS:
            print(SHELLS[shell], end="")
        case [shell, *_]:
            raise InputError(f"bench completion {shell}: {nearest(shell, SHELLS)}")
        case _:
            raise InputError("bench completion: say for which shell: bash, zsh or fish")
    return 0


def answer(words: list[str]) -> list[str]:
    """What the last word may become, in full.

    Args:
        words: behind ``bench``, the last one as far as it is typed.
    """
    *before, word = words or [""]
    if not before:
        return [name for name in (*COMMANDS, *(["--help", "--version"] if word else [])) if name.startswith(word)]
    command = before[0]
    if command not in COMMANDS:
        return []
    key, equals, value = word.partition("=")
    if not equals:
        given = {w.partition("=")[0] for w in before[1:]}
        said = _words(before) or [f"{k}=" for k in keys(before) if k not in given]
        return [each for each in [*said, *(["--help"] if word else [])] if each.startswith(word)]
    joint = "+" if key in PLUS else ","
    done, comma, last = value.rpartition(joint)
    return [f"{key}={done}{comma}{v}" for v in values(key) if v.startswith(last) and v not in done.split(joint)]


def keys(before: list[str]) -> list[str]:
    """The keys of a command: those that head a line of its help, or that its usage names.

    Args:
        before: the words that are typed, a command and what follows.
    """
    text = COMMANDS[before[0]][2]
    usage = f"bench {' '.join(before[:2])}" if before[0] == "data" else f"bench {before[0]}"
    found: list[str] = []
    for line in text.splitlines():
        if line.startswith(usage):
            found += KEY.findall(line.split("  ")[0])
        elif heads := re.match(rf"  ((?:{KEY.pattern}\S*\s+)+)", line):
            found += KEY.findall(heads[1])
    if "max_flash" in found:
        found += BUDGETS
    if "Keys of bench run" in text:
        found += keys(["run"])
    if "model" in found and before[0] != "choose":  # which takes those of the protocol alone
        told = [line for line in COMMANDS["run"][2].splitlines() if not line.startswith("  bench")]
        found += re.findall(r"\b(model\.[a-z]+)=", "\n".join(told))
    return [key for key in dict.fromkeys(found) if key != "key"]


def values(key: str) -> Iterable[str]:
    """What a key may be, as far as it is a name."""
    rooms = {"model": "models", "features": "features", "protocol": "protocols"}
    if key in rooms:
        return sorted(names(rooms[key]))
    if key in ("data", "protocol.source"):
        return ["synth", *corpora()]
    if key in ("faults", "model.faults"):
        return faults()
    return COSTS if key == "by" else LISTED.get(key, ())


def corpora() -> list[str]:
    """Names of imported corpora."""
    return sorted(path.parent.name for path in (home() / "corpora").glob("*/current"))


def faults() -> list[str]:
    """Names of faults, of which the help has all; their code takes most of a second to load."""
    listed = re.search(r"faults= +(.*?);\s+default all", COMMANDS["stress"][2], flags=re.DOTALL)
    return re.findall(r"[a-z_]+", listed[1]) if listed else []


def _words(before: list[str]) -> list[str]:
    """Words without a key that may come next."""
    match before:
        case ["completion"]:
            return list(SHELLS)
        case ["data"]:
            return ["import", "show", "verify", "export"]
        case ["data", "import"]:
            return list(names("corpora"))
        case ["data", "show" | "verify" | "export"]:
            return ["synth", *corpora()]
    return []

"""The command ``bench completion``: a script for a shell, and the completions at each TAB.

A TAB starts this once and must be answered at once, so nothing heavy is imported: keys come from `bench.options`,
values from there, the registry and the data folder.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from bench.errors import InputError, nearest
from bench.options import Option, commands, options
from bench.registry import names
from bench.scratch import home
from bench.words import FAULTS, LATER

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
            raise InputError("bench completion: the shell is missing; give bash, zsh or fish")
    return 0


def answer(words: list[str]) -> list[str]:
    """List all completions of the last word.

    Args:
        words: typed words after ``bench``, the last one perhaps incomplete.
    """
    *before, word = words or [""]
    if not before:
        return [name for name in (*commands(), *(["--help", "--version"] if word else [])) if name.startswith(word)]
    if before[0] not in commands():
        return []
    table = _options(before)
    key, equals, value = word.partition("=")
    if not equals:
        typed = {w.partition("=")[0] for w in before}
        choices = _words(before) or [f"{k}=" for k in table if k not in typed]
        return [each for each in [*choices, *(["--help"] if word else [])] if each.startswith(word)]
    joint = table[key].joint if key in table else ","
    done, comma, last = value.rpartition(joint)
    return [f"{key}={done}{comma}{v}" for v in values(key, table) if v.startswith(last) and v not in done.split(joint)]


def _options(before: list[str]) -> dict[str, Option]:
    """The keys that may follow: those of the command, or of an action of ``bench data``, and what many models take."""
    table = options("-".join(before[:2])) if before[0] == "data" else options(before[0])
    if "model" in table and before[0] != "choose":  # which takes those of the protocol alone
        table |= {key: option for key, option in options("run").items() if key.startswith("model.")}
    return table


def values(key: str, table: Mapping[str, Option]) -> Iterable[str]:
    """List the possible names for a key."""
    if key in table and table[key].room:
        return sorted(names(table[key].room))
    if key in ("data", "protocol.source"):
        return ["synth", *corpora()]
    if key == "model.faults":
        return [*FAULTS.split(), *LATER.split()]
    if key in table and table[key].type == "yes":
        return ("yes", "no")
    return table[key].values if key in table else ()


def corpora() -> list[str]:
    """Names of imported corpora."""
    return sorted(path.parent.name for path in (home() / "corpora").glob("*/current"))


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

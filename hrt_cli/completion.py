"""Completion in the shell: scripts for bash, zsh and fish, and the paths that an option or argument takes.

A script asks the program itself, by `_HRT_COMPLETE`, which answers a line each: kind, value and help, tabs between.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click
from click.shell_completion import BashComplete, CompletionItem, FishComplete, ShellComplete, ZshComplete

VARIABLE = "_HRT_COMPLETE"

_BASH = """\
# Completion of hrt in bash. Needs bash 4.4 or later.
%(complete_func)s() {
    local IFS=$'\\n' kind value help
    COMPREPLY=()
    while IFS=$'\\t' read -r kind value help; do
        [[ -n $kind ]] || continue
        [[ $kind == path ]] && compopt -o filenames
        COMPREPLY+=("$value")
    done < <(COMP_WORDS="${COMP_WORDS[*]}" COMP_CWORD=$COMP_CWORD %(complete_var)s=bash_complete "$1" 2>/dev/null)
}
complete -o nosort -F %(complete_func)s %(prog_name)s
"""

_ZSH = """\
#compdef %(prog_name)s
# Completion of hrt in zsh.
%(complete_func)s() {
    local -a plain described files
    local kind value help
    while IFS=$'\\t' read -r kind value help; do
        if [[ -z $kind ]]; then
            continue
        elif [[ $kind == path ]]; then
            files+=("$value")
        elif [[ -n $help ]]; then
            described+=("${value//:/\\\\:}:$help")
        else
            plain+=("$value")
        fi
    done < <(COMP_WORDS="${words[*]}" COMP_CWORD=$((CURRENT-1)) %(complete_var)s=zsh_complete %(prog_name)s 2>/dev/null)
    (( $#described )) && _describe -V %(prog_name)s described
    (( $#plain )) && compadd -V %(prog_name)s -a plain
    (( $#files )) && compadd -f -a files
}
if [[ $zsh_eval_context[-1] == loadautofunc ]]; then
    %(complete_func)s "$@"
else
    compdef %(complete_func)s %(prog_name)s
fi
"""

_FISH = """\
# Completion of hrt in fish.
function %(complete_func)s
    set -lx COMP_WORDS (commandline -cp)
    set -lx COMP_CWORD (commandline -t)
    set -lx %(complete_var)s fish_complete
    for line in (%(prog_name)s 2>/dev/null)
        test -n "$line"; or continue
        set -l parts (string split \\t -- $line)
        if test -n "$parts[3]"
            printf '%%s\\t%%s\\n' $parts[2] $parts[3]
        else
            echo -- $parts[2]
        end
    end
end
complete --no-files --command %(prog_name)s --arguments '(%(complete_func)s)'
"""


def script(shell: str, group: click.Command) -> str:
    """Return the script that makes a shell (bash, zsh or fish) complete `hrt`."""
    source: str = _SHELLS[shell](group, {}, "hrt", VARIABLE).source()
    return source


def register() -> None:
    """Let `hrt` answer the scripts' questions."""
    from click.shell_completion import add_completion_class

    for name, shell in _SHELLS.items():
        add_completion_class(shell, name)


def paths(incomplete: str, suffixes: Sequence[str], *, folders_only: bool = False) -> list[CompletionItem]:
    """Return the paths that begin as a user has typed, `~` understood: folders, and files with one of some suffixes.

    Parameters
    ----------
    suffixes : sequence of str
        With their dot, in lower case; none for all files. Where nothing bears them, all files are returned.
    """
    typed, name = os.path.split(incomplete)
    try:
        entries = sorted(os.scandir(os.path.expanduser(typed) or "."), key=lambda entry: entry.name)
    except OSError:
        return []
    shown = [each for each in entries if each.name.startswith(name) and (name.startswith(".") or each.name[0] != ".")]
    folders = [each for each in shown if each.is_dir()]
    files = [] if folders_only else [each for each in shown if not each.is_dir()]
    fitting = [each for each in files if not suffixes or Path(each.name).suffix.lower() in suffixes]
    found = folders + (fitting if fitting or folders else files)
    # A line of the answer holds one path, so what would break it is left out.
    names = [each.name for each in found if not set(each.name) & set("\n\t")]
    return [CompletionItem(os.path.join(typed, each), type="path") for each in sorted(names)]


def class_names(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Return the names of the classes of the `--world` that was given before, as its world.json has them."""
    import json

    world = json.loads(Path(ctx.params["world"], "world.json").read_text(encoding="utf-8"))
    names = [str(each["name"]) for each in world["classes"].values()]
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


class _Quiet(ShellComplete):
    """What the three shells share: one format of answers, and none where the line cannot be understood."""

    def get_completions(self, args: list[str], incomplete: str) -> list[CompletionItem]:
        try:
            return super().get_completions(args, incomplete)
        except Exception:  # a broken plugin or file must not print into what is being typed
            return []

    def format_completion(self, item: CompletionItem) -> str:
        help_text = " ".join((item.help or "").split())
        return f"{item.type}\t{item.value}\t{help_text}"


class _Bash(_Quiet, BashComplete):
    source_template = _BASH

    def source(self) -> str:
        return ShellComplete.source(self)  # the base class asks bash for its version


class _Zsh(_Quiet, ZshComplete):
    source_template = _ZSH


class _Fish(_Quiet, FishComplete):
    source_template = _FISH

    def format_completion(self, item: CompletionItem) -> str:
        # fish adds no space after a slash, and cannot be told that something is a path.
        if item.type == "path" and os.path.isdir(os.path.expanduser(str(item.value))):
            item = CompletionItem(f"{item.value}/", type="path")
        return super().format_completion(item)


_SHELLS: dict[str, Any] = {"bash": _Bash, "zsh": _Zsh, "fish": _Fish}
SHELLS = tuple(_SHELLS)
"""The shells that are known."""

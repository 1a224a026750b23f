"""`hrt completion`: the script by which a shell completes `hrt`."""

from __future__ import annotations

import click

from hrt_cli.completion import SHELLS, script
from hrt_cli.manual import Command
from hrt_cli.progress import Console


@click.command(
    cls=Command,
    files="""\b
      bash  hrt completion bash > ~/.local/share/bash-completion/completions/hrt
      zsh   hrt completion zsh > FOLDER/_hrt       (FOLDER: one of $fpath)
      fish  hrt completion fish > ~/.config/fish/completions/hrt.fish""",
    epilog="""\b
Example:
  hrt completion bash
""",
)
@click.argument("shell", type=click.Choice(SHELLS), metavar="SHELL")
@click.pass_context
def completion(ctx: click.Context, shell: str) -> None:
    """Print the script that lets bash, zsh or fish complete commands, options, their values and files.

    SHELL is bash (4.4 or later), zsh or fish. Save the script where the shell looks for it, as below, or run it, as by
    eval "$(hrt completion bash)". Files are offered by what an
    option or argument takes: rasters for an orthomosaic, logs for a drive.
    """
    Console().result(script(shell, ctx.find_root().command).rstrip("\n"), {}, only_here=True)

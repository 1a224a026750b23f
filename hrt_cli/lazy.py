"""A group of commands that are imported only when they are run, so that `--help` stays quick."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from hrt_cli.errors import HrtError
from hrt_cli.manual import write_example

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from click.shell_completion import CompletionItem

Table = Mapping[str, tuple[str, str]]
"""Command -> (module:attribute, the first paragraph of its help, so that the group's help imports none of them)."""


class LazyGroup(click.Group):
    """A group that imports a subcommand only when it is run, from a table or from installed plugins.

    Parameters
    ----------
    table : Table
    plugins : str
        The entry-point group that plugins register in; empty for none.
    stages : mapping of str to tuple of str
        Title -> the commands under it in the help; those that none names stand under `Commands`.
    """

    def __init__(
        self,
        *args: Any,
        table: Table,
        plugins: str = "",
        stages: Mapping[str, tuple[str, ...]] | None = None,
        **kwargs: Any,
    ) -> None:
        super().__init__(*args, **kwargs)
        self._table, self._plugin_group, self._stages = table, plugins, dict(stages or {})

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: D102
        return [*self._table, *sorted(set(self._plugins()) - set(self._table))]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: D102
        if cmd_name not in self._table:
            plugin = self._plugins().get(cmd_name)
            return None if plugin is None else _load(plugin)
        module, _, attribute = self._table[cmd_name][0].partition(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that is meant, or tell which one may have been."""
        name = args[0]
        known = ctx.resilient_parsing or name.startswith("-") or self.get_command(ctx, name) is not None
        if not known:
            from difflib import get_close_matches

            near = get_close_matches(name.lower(), self.list_commands(ctx))
            hint = f" Did you mean {' or '.join(repr(each) for each in near)}?" if near else ""
            raise click.UsageError(f"No such command {name!r}.{hint}", ctx)
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete the name of a command, without importing any, or else an option."""
        from click.shell_completion import CompletionItem

        texts = self._texts()
        found = [CompletionItem(name, help=texts[name]) for name in texts if name.startswith(incomplete)]
        return [*found, *click.Command.shell_complete(self, ctx, incomplete)]

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands stage by stage, and then the plugins."""
        texts = self._texts()
        staged = {name for names in self._stages.values() for name in names}
        stages = {title: [name for name in names if name in texts] for title, names in self._stages.items()}
        stages["Commands"] = [name for name in self._table if name not in staged]
        stages["Plugins"] = [name for name in texts if name not in self._table]
        widest = max(map(len, texts), default=0)
        for title, names in stages.items():
            if names:
                with formatter.section(title):
                    formatter.write_dl([(name.ljust(widest), texts[name]) for name in names])

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the example as the last section."""
        write_example(self.epilog, formatter)

    def _texts(self) -> dict[str, str]:
        """Return what each command does, of plugins as their package says it; none is imported."""
        plugins = self._plugins()
        names = [*self._table, *sorted(set(plugins) - set(self._table))]
        return {name: self._table[name][1] if name in self._table else _summary(plugins[name]) for name in names}

    def _plugins(self) -> dict[str, EntryPoint]:
        if not self._plugin_group:
            return {}
        from importlib.metadata import entry_points

        return {point.name: point for point in entry_points(group=self._plugin_group)}


def _summary(plugin: EntryPoint) -> str:
    try:
        package: Any = plugin.dist
        summary = package.metadata["Summary"] or ""
        return f"{' '.join(summary.split())} (plugin {package.name} {package.version})".strip()
    except Exception:  # a package whose metadata are damaged is still listed
        return "(plugin)"


def _load(plugin: EntryPoint) -> click.Command:
    try:
        command = plugin.load()
    except Exception as error:
        where = f"{plugin.name!r} ({plugin.value})"
        raise HrtError(f"the plugin {where} cannot be loaded: {type(error).__name__}: {error}") from error
    if not isinstance(command, click.Command):
        raise HrtError(f"the plugin {plugin.name!r} ({plugin.value}) is not a click command")
    return command

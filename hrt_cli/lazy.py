"""A group of commands that are imported only when they are run, so that `--help` stays quick."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from hrt_cli.errors import HrtError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Table = Mapping[str, tuple[str, str]]
"""Command -> (module:attribute, the first paragraph of its help, so that the group's help imports none of them)."""


class LazyGroup(click.Group):
    """A group that imports a subcommand only when it is run, from a table or from installed plugins.

    Parameters
    ----------
    table : Table
    plugins : str
        The entry-point group that plugins register in; empty for none.
    """

    def __init__(self, *args: Any, table: Table, plugins: str = "", **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._table, self._plugin_group = table, plugins

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: D102
        return [*self._table, *sorted(set(self._plugins()) - set(self._table))]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: D102
        if cmd_name not in self._table:
            plugin = self._plugins().get(cmd_name)
            return None if plugin is None else _load(plugin)
        module, _, attribute = self._table[cmd_name][0].partition(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: D102
        rows = [(name, self._table[name][1] if name in self._table else "(plugin)") for name in self.list_commands(ctx)]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def _plugins(self) -> dict[str, EntryPoint]:
        if not self._plugin_group:
            return {}
        from importlib.metadata import entry_points

        return {point.name: point for point in entry_points(group=self._plugin_group)}


def _load(plugin: EntryPoint) -> click.Command:
    try:
        command = plugin.load()
    except Exception as error:
        where = f"{plugin.name!r} ({plugin.value})"
        raise HrtError(f"the plugin {where} cannot be loaded: {type(error).__name__}: {error}") from error
    if not isinstance(command, click.Command):
        raise HrtError(f"the plugin {plugin.name!r} ({plugin.value}) is not a click command")
    return command

"""The command `export`. It imports its job when it is called."""

from __future__ import annotations

from collections.abc import Iterable

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.options.records import ExportOptions


@command("export")
def export(options: ExportOptions) -> Iterable[Event]:
    """Write gains and map as files of Apollo or Autoware.

    What the target has no place for, and where it will behave differently, is listed in not_exported.md.
    """
    from tunefree_hil.jobs.export.export import export as start

    return start(options)

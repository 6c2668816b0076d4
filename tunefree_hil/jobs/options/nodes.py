"""The options that `ecu`, `controller` and `collector` share: where a node finds its bench."""

from __future__ import annotations

from typing import NamedTuple

from tunefree_hil.jobs.options.option import DEFAULT_SESSION, BenchBus, Bus, Realtime, Session


class NodeLink(NamedTuple):
    """Where a node finds its bench."""

    bus: Bus = "auto"
    bench_bus: BenchBus = ""
    session: Session = DEFAULT_SESSION
    realtime: Realtime = False

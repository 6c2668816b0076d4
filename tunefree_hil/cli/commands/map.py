"""The command `map`: learns the open-loop map from logs."""

from __future__ import annotations

from collections.abc import Iterable

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.learn.options import MapOptions


@command("map")
def map_logs(options: MapOptions) -> Iterable[Event]:
    """Learn the open-loop map from logs.

    The map gives the acceleration for every pedal position and speed, as the calibration.npz that the controller uses.
    """
    from tunefree_hil.jobs.learn.map import map_logs as start

    return start(options)

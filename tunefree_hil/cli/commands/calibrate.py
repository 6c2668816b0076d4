"""The command `calibrate`: actuators and physical constants from logs."""

from __future__ import annotations

from collections.abc import Iterable

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.learn.options import CalibrateOptions


@command("calibrate")
def calibrate(options: CalibrateOptions) -> Iterable[Event]:
    """Identify actuators and physical constants from logs.

    Each has its interval. A parameter that the logs do not identify keeps the value of the data sheet with a wider
    interval, and is reported. The model folder can be used by drive and tune directly. At the end, the logs are
    analysed for what the model misses of them, which `gap` needs: this takes a minute or two, and longer for a model
    that is far from its logs. Run the same command again to continue after an interruption.
    """
    from tunefree_hil.jobs.learn.calibrate import calibrate as start

    return start(options)

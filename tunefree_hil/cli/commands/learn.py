"""The command that trains a plant: learn."""

from __future__ import annotations

from collections.abc import Iterable

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.learn.options import LearnOptions


@command("learn")
def learn(options: LearnOptions) -> Iterable[Event]:
    """Learn a vehicle from logs.

    Whole drives are held out for the evaluation. Run the same command again to continue after an interruption. Needs
    torch: pip install '.[learn]'; the model that it writes runs without.
    """
    from tunefree_hil.jobs.learn.learn import learn as start

    return start(options)

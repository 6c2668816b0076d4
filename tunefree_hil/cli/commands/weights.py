"""The command that regresses the weights of a score: weights."""

from __future__ import annotations

from collections.abc import Iterable

from tunefree_hil.base.events import Event
from tunefree_hil.cli.options import command
from tunefree_hil.jobs.weights.options import WeightsOptions


@command("weights")
def weights(options: WeightsOptions) -> Iterable[Event]:
    """Regress the weights of a score from pairs of drives.

    The human drive of a pair should have the lower score. Whole roads are held out to say how well the weights rank.
    Run the same command again to continue after an interruption. Exit status 2 where the pairs contradict each other.
    """
    from tunefree_hil.jobs.weights.weights import weights as start

    return start(options)

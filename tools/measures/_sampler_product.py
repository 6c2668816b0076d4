"""The process of a sampler of the product for `tools/measure samplers`, with the messages of _sampler_peers.py.

Its points are values of the parameters, in the order of the space, and the first message has the space as well. The
suggestions are those of `tune`: `suggest_slots` over the filled slots of the study.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from tools.measures._sampler_peers import Point, serve
from tunefree_hil.tune.space import space_from_data
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.trial import Trial
from tunefree_hil.tune.trial_loop import suggest_slots

PACKAGES = ("optuna", "torch", "botorch", "cmaes", "numpy")


class ProductSampler:
    """A study without a file."""

    def __init__(self, message: Mapping[str, Any]) -> None:
        space = space_from_data(message["space"])
        first = dict(zip(space.names, message["first"], strict=True))
        self._settings = StudySettings(
            space, message["seed"], message["method"], "measured", first, message["in_flight"]
        )
        self._done: list[Trial] = []
        self._running: list[dict[str, float]] = []

    def ask(self, count: int) -> list[Point]:
        """The parameters of the next slots."""
        slots = range(len(self._done), len(self._done) + count)
        suggested = suggest_slots(self._settings, self._done, slots)
        self._running = [suggested[slot] for slot in slots]
        return [[point[name] for name in self._settings.space.names] for point in self._running]

    def tell(self, scores: Sequence[float]) -> None:
        """Fill the slots that were asked for last."""
        for point, score in zip(self._running, scores, strict=True):
            slot = len(self._done)
            self._done.append(Trial(slot, slot, point, score, {}))


if __name__ == "__main__":
    serve(ProductSampler, PACKAGES)

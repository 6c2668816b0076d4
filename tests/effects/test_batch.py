"""The whole catalogue in one compiled graph: off it is nothing, on it is what plain Python says, values are data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.effects.shared import EFFECTS, strong
from tools.measures.parity import differing
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Batch, Job
from tunefree_hil.bench.simulator import Simulator
from tunefree_hil.episode.recording import Recording

NAMES = tuple(EFFECTS)
CALM = ("steer_dead_band", "steer_offset", "head_wind", "report_latency", "tyre_relaxation", "brake_fade")  # is driven


def plain(bench: Bench, names: tuple[str, ...], effects: Mapping[str, Mapping[str, float]]) -> Recording:
    """The drive in plain Python, in this process."""
    [scenario] = bench.scenarios.values()
    return Simulator(bench, extra_effects=names).drive(Job(parameters_of(bench), scenario, effects=effects)).recording


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.timeout(600)
def test_one_graph_drives_any_of_them(tmp_path: Path) -> None:
    bench = load(write_bench(tmp_path))
    [scenario] = bench.scenarios.values()
    some = {name: strong(name) for name in CALM}
    chosen: list[dict[str, dict[str, float]]] = [{}, some, {"tyre_relaxation": {"length_m": 0.2}}]
    with Batch(bench, extra_effects=NAMES) as batch:
        jobs = [Job(parameters_of(bench), scenario, effects=effects) for effects in chosen]
        driven = [one.recording for one in batch.drive(jobs, columns=True)]
    expected = [plain(bench, (), {}), plain(bench, CALM, some), plain(bench, NAMES, chosen[2])]
    for ours, theirs in zip(driven, expected, strict=True):
        assert ours is not None and differing(ours, theirs) == {}
    assert differing(expected[0], expected[1]) and differing(expected[0], expected[2])

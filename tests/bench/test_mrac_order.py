"""MRAC of order 3 and 4, both forms: the compiled batch over the real bus, to the bit."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tools.measures.parity import compared
from tunefree_hil.bench import load, parameters_of
from tunefree_hil.bench.batch import Batch, Job
from tunefree_hil.jobs.running.episode_results import DrivenEpisode, read_episode
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession


@pytest.mark.compiled
@pytest.mark.parametrize(("order", "form"), [(3, "apollo"), (4, "paper")])
def test_the_compiled_batch_is_the_bus(order: int, form: str, tmp_path: Path) -> None:
    more = f'[controller]\nmrac_order = {order}\nmrac_form = "{form}"\nmrac_dead_zone = 0.0\n'
    path = write_bench(tmp_path, duration_s=6.0, more=more)
    bench = load(path)
    [scenario], values = bench.scenarios.values(), parameters_of(bench, {"mrac.enable": 1.0, "mrac.p": 0.003})
    with Batch(bench) as batch:
        [driven] = batch.drive([Job(values, scenario)], columns=True)
    name = f"order-{order}-{os.getpid()}"
    with BenchSession(path, tmp_path / "nodes", BenchLaunch(session=name, bus="tfhub")) as session:
        outcome = session.drive(scenario, scenario.noise_seed, values, tmp_path)
    episode = read_episode(bench, DrivenEpisode(scenario, values, outcome, tmp_path))
    found = compared(episode.recording, episode.grade, driven)
    assert found["differing"] == 0, found
    assert found["values"] > 15_000

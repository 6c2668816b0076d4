"""The compiled batch over the real bus, the process behind it, and what it does with mistakes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from msgspec import structs

from tests.bench.test_every_vehicle import first_benches, shortest
from tests.bench.tiny import write_bench
from tools.measures.parity import compared, differing, parameter_sets
from tunefree_hil.base.errors import InputError, PeerGone
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Batch, Job
from tunefree_hil.jobs.running.episode_results import DrivenEpisode, read_episode
from tunefree_hil.jobs.running.session import BenchLaunch, BenchSession


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return load(write_bench(tmp_path_factory.mktemp("batch")))


@pytest.fixture
def interpreted(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The batch's process without its compiler: slow drives, but at once."""
    monkeypatch.setattr("tunefree_hil.bench.batch.COMPILED", {"TUNEFREE_JIT": "0"})
    yield


def test_jobs_come_back_in_their_order_with_their_seeds(tiny: Bench, interpreted: None) -> None:
    [scenario] = tiny.scenarios.values()
    values = parameters_of(tiny)
    jobs = [Job(values, scenario), Job({**values, "station.kp": 0.5}, scenario), Job(values, scenario, seed=8)]
    with Batch(tiny, threads=2) as batch:
        driven = batch.drive([*jobs, jobs[0]], columns=True)
        again = batch.drive(jobs[1:2])
    ours = [one.recording for one in driven]
    assert all(one is not None for one in ours) and again[0].recording is None
    assert differing(ours[0], ours[3]) == {} and driven[0].grade == driven[3].grade  # type: ignore[arg-type]
    assert differing(ours[0], ours[1]) and differing(ours[0], ours[2])  # type: ignore[arg-type]
    assert again[0].grade == driven[1].grade and driven[0].ticks == tiny.course(scenario).ticks


def test_a_mistake_is_raised_here_and_the_next_job_is_driven(tiny: Bench, interpreted: None) -> None:
    [scenario] = tiny.scenarios.values()
    values = parameters_of(tiny)
    with Batch(tiny, extra_effects=("steer_gain",)) as batch:
        with pytest.raises(InputError, match="payload") as caught:
            batch.drive([Job(values, scenario, effects={"payload": {}})])
        assert caught.value.code == "unknown_effect" and caught.value.hint
        assert batch.drive([]) == [] and len(batch.drive([Job(values, scenario)])) == 1


def test_an_effect_that_does_not_exist_is_refused_before_anything_is_driven(tiny: Bench, interpreted: None) -> None:
    with pytest.raises(InputError, match="no 'wings'"):
        Batch(tiny, extra_effects=("wings",))


def test_a_process_that_dies_is_named_with_what_it_said(tiny: Bench, interpreted: None) -> None:
    [scenario] = tiny.scenarios.values()
    with Batch(tiny) as batch:
        os.kill(batch._helper.process.pid, 9)
        with pytest.raises(PeerGone) as caught:
            batch.drive([Job(parameters_of(tiny), scenario)])
    assert caught.value.code == "batch_lost" and "--backend batch" in caught.value.hint


def test_the_process_ends_with_the_batch(tiny: Bench, interpreted: None) -> None:
    with Batch(tiny) as batch:
        process = batch._helper.process
    assert process.poll() is not None


@pytest.mark.compiled
def test_the_compiled_batch_is_the_bus_on_a_banked_road_in_gusts(tmp_path: Path) -> None:
    path = write_bench(tmp_path)
    with (tmp_path / "scenarios" / "tiny.toml").open("a") as file:
        file.write("bank = { t_s = [0.0, 0.5, 1.5], value = [0.0, 0.06, -0.04] }\n")
        file.write("side_wind = { t_s = [0.0, 0.6, 1.2], value = [0.0, 0.8, 0.0] }\n")
    bench = load(path)
    [gusty], values = bench.scenarios.values(), parameters_of(bench)
    level = structs.replace(gusty, name="level", hash="00" * 32, bank=None, side_wind=None)
    with Batch(replace(bench, scenarios={"tiny": gusty, "level": level}, courses={})) as batch:
        driven, undisturbed = batch.drive([Job(values, gusty), Job(values, level)], columns=True)
    with BenchSession(path, tmp_path / "nodes", BenchLaunch(session=f"gusts-{os.getpid()}", bus="tfhub")) as session:
        outcome = session.drive(gusty, gusty.noise_seed, values, tmp_path)
    episode = read_episode(bench, DrivenEpisode(gusty, values, outcome, tmp_path))
    found = compared(episode.recording, episode.grade, driven)
    assert found["differing"] == 0, found
    assert found["values"] > 5_000
    assert "y_m" in differing(driven.recording, undisturbed.recording)  # type: ignore[arg-type]


@pytest.mark.compiled
@pytest.mark.parametrize("path", first_benches(), ids=lambda path: path.stem)
def test_the_compiled_batch_is_the_bus_bit_for_bit(path: Path, tmp_path: Path) -> None:
    """All of it with a noisy plant, delays and quantisation; a re-plan among them."""
    bench = load(path)
    whole = bench.scenarios[shortest(bench)]
    values = list(parameter_sets(bench, 8).values())[-1]
    words, name = tmp_path / "nodes", f"batch-{os.getpid()}-{path.stem}"
    with Batch(bench) as batch:
        [driven] = batch.drive([Job(values, whole)], columns=True)
    with BenchSession(path, words, BenchLaunch(session=name, bus="tfhub")) as session:
        outcome = session.drive(whole, whole.noise_seed, values, tmp_path)
    episode = read_episode(bench, DrivenEpisode(whole, values, outcome, tmp_path))
    found = compared(episode.recording, episode.grade, driven)
    assert found["differing"] == 0, found
    assert found["values"] > 20_000

"""A bench file's `roads`: made beside the named scenarios, found by hash, refused by key where they are wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import Bench, load, scenario_of_hash
from tunefree_hil.config.load import load_scenario, load_vehicle
from tunefree_hil.jobs import scenarios as scenario_jobs
from tunefree_hil.jobs.doctor import check_bench_file
from tunefree_hil.jobs.identity import resolved_toml
from tunefree_hil.jobs.options.records import ScenariosOptions

ROADS = 'roads = { search = "families:4", verify = "families:3", seed = 2 }'


def with_roads(folder: Path, roads: str = ROADS) -> Path:
    return write_bench(folder, more=roads)


def test_roads_stand_beside_the_named_scenarios(tmp_path: Path) -> None:
    bench = load(with_roads(tmp_path))
    assert bench.spec.scenarios[0] == bench.spec.verify_scenarios[0] == "tiny"
    assert (len(bench.spec.scenarios), len(bench.spec.verify_scenarios)) == (5, 4)
    searched, verified = bench.spec.scenarios[1:], bench.spec.verify_scenarios[1:]
    assert not set(searched) & set(verified)
    for name in searched + verified:
        assert bench.course(bench.scenarios[name]).ticks >= 1500


def test_another_process_finds_them_by_hash(tmp_path: Path) -> None:
    path = with_roads(tmp_path)
    runner, node = load(path), load(path)
    for name in runner.spec.scenarios:
        spec = runner.scenarios[name]
        assert scenario_of_hash(node, bytes.fromhex(spec.hash)[:6]) == spec


def test_a_bench_may_have_roads_alone(tmp_path: Path) -> None:
    path = with_roads(tmp_path)
    text = path.read_text().replace('scenarios = ["tiny"]', "scenarios = []")
    path.write_text(text)
    assert len(load(path).spec.scenarios) == 4
    path.write_text(text.replace('search = "families:4", ', ""))
    with pytest.raises(InputError, match=r"roads\.search"):
        load(path)


def test_the_resolved_file_makes_the_same_roads(tmp_path: Path) -> None:
    bench = load(with_roads(tmp_path))
    for scenarios in (None, list(bench.scenarios.values())[:3]):
        path = tmp_path / "resolved.toml"
        path.write_text(resolved_toml(bench, scenarios))
        again = load(path)
        assert hashes(again) == hashes(bench)


def hashes(bench: Bench) -> set[str]:
    return {spec.hash for spec in bench.scenarios.values()}


@pytest.mark.parametrize(
    ("roads", "key", "message"),
    [
        ('roads = { search = "famlies:4" }', "roads.search", "no set of roads 'famlies'"),
        ('roads = { search = "families:4", verify = "robust:10" }', "roads.verify", "robust has 1000 to 10000"),
        ("roads = { seed = 1 }", "roads", "names no set"),
        ('roads = { search = "families:4", seed = 10000 }', "roads.seed", "10000 does not fit"),
        ('roads = { search = "families:4", sed = 1 }', "roads.sed", "unknown key"),
    ],
)
def test_wrong_roads_are_refused_by_key(tmp_path: Path, roads: str, key: str, message: str) -> None:
    path = with_roads(tmp_path, roads)
    with pytest.raises(InputError) as caught:
        load(path)
    assert (caught.value.file, caught.value.key) == (str(path), key)
    assert message in caught.value.message and caught.value.hint


@pytest.mark.slow
def test_doctor_counts_the_roads(tmp_path: Path) -> None:
    assert any("9 scenarios" in finding.text for finding in check_bench_file(with_roads(tmp_path)))


@pytest.mark.slow
def test_the_command_writes_roads_and_a_figure(tmp_path: Path) -> None:
    *lines, result = scenario_jobs.scenarios(
        ScenariosOptions(vehicle="mkz_bywire", roads="families:3", seed=6, out=tmp_path / "out")
    )
    assert len(lines) == 3 and result.data["sentence"].startswith("3 roads for mkz_bywire, all within its limits")
    for row in result.data["scenarios"]:
        assert row["problems"] == [] and load_scenario(row["path"]).hash == row["hash"]
    assert Path(result.data["figure"]).stat().st_size > 10_000
    assert load_vehicle("mkz_bywire").name in result.data["sentence"]


def test_the_command_needs_a_vehicle() -> None:
    with pytest.raises(InputError, match="roads are made for a vehicle"):
        list(scenario_jobs.scenarios(ScenariosOptions(roads="families:3", seed=6)))

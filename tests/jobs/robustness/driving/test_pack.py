"""A pack has data only, gives the same plan elsewhere, and is written nowhere but into its folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench.tiny import write_bench
from tests.jobs.robustness.made_sweep import make_order
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import calibration_path, load
from tunefree_hil.jobs.robustness.driving.pack import BENCH_FILE, SUFFIXES, hash_code, pack_bench, unpack_bench
from tunefree_hil.jobs.robustness.plan import make_plan

EFFECTS = 'effects = [{ name = "steer_gain", params = { gain_frac = 1.05 } }]\n'
CONTROLLER = "[controller]\ncalibration = '{map}'\nparameters = {{ \"station.kp\" = 0.3 }}\n"


def test_a_bench_that_was_packed_makes_the_same_drives(tmp_path: Path) -> None:
    first = load(write_bench(tmp_path / "a"))
    own_map = tmp_path / "own.npz"
    own_map.write_bytes(calibration_path(first).read_bytes())
    bench = load(write_bench(tmp_path / "b", more=EFFECTS + CONTROLLER.format(map=own_map)))
    plan = make_plan(bench, make_order(bench))
    pack = pack_bench(bench, bench.spec.model)
    assert {Path(name).suffix for name in pack} <= set(SUFFIXES) and "calibration.npz" in pack
    assert all(isinstance(content, bytes) for content in pack.values())
    own_map.unlink()
    other = load(unpack_bench(pack, tmp_path / "elsewhere"))
    again = make_plan(other, plan.order._replace(model="model"))
    assert again.hashes == plan.hashes and again.roads == plan.roads
    for one, two in zip(plan.list_drives(0), again.list_drives(0), strict=True):
        assert plan.make_job(one) == again.make_job(two)


@pytest.mark.parametrize("name", ["../out.toml", "/out.toml", "a/../../out.toml", "plant.py", "run.sh"])
def test_nothing_is_written_outside_and_no_program(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError) as caught:
        unpack_bench({name: b"x", BENCH_FILE: b""}, tmp_path / "inside")
    assert caught.value.code == "bad_pack"
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_a_part_of_the_users_own_is_not_sent(tmp_path: Path) -> None:
    part = tmp_path / "own.py"
    part.write_text("raise AssertionError('it was run')\n")
    bench = load(write_bench(tmp_path, more=f"[controller]\nlateral = '{part}:LATERAL'\n"))
    with pytest.raises(InputError) as caught:
        pack_bench(bench, bench.spec.model)
    assert caught.value.code == "not_on_cluster" and str(part) in caught.value.message


def test_the_hash_of_the_program_is_one_of_its_modules() -> None:
    assert len(hash_code()) == 64 and hash_code() == hash_code()

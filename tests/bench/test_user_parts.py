"""A controller part in Python with a parameter of its own: from the bench file to the Block, in nodes and batch."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.bench.own_part import PART, write_own
from tests.bench.tiny import hash_of, write_bench
from tools.measures._in_process import InProcess
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import (
    Bench,
    ControllerFor,
    follower_of,
    load,
    own_parameters,
    parameters_of,
    part_names,
    part_values,
    require_buildable,
)
from tunefree_hil.bench.simulator import Job, Simulator
from tunefree_hil.control.parameters import NAMES
from tunefree_hil.episode.columns import columns_from_frames

GIVEN = 'parameters = { "mine.gain" = 0.75 }'


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return load(write_own(tmp_path, GIVEN, duration_s=0.3))


def test_the_value_is_the_bench_files_else_the_middle_of_its_box_else_the_parts_own(tmp_path: Path) -> None:
    path = write_own(tmp_path)
    assert own_parameters(load(path)) == {"mine.gain": 2.0}
    path.write_text(
        path.read_text().replace('set = "mrac"', 'parameters = [{ name = "mine.gain", low = 1, high = 9 }]')
    )
    assert own_parameters(load(path)) == {"mine.gain": pytest.approx(3.0)}
    bench = load(write_own(tmp_path, GIVEN))
    assert own_parameters(bench) == {"mine.gain": 0.75}
    assert parameters_of(bench, {"mine.gain": 1.5})["mine.gain"] == 1.5
    assert own_parameters(load(write_bench(tmp_path / "ours"))) == {}


def test_it_has_an_index_of_its_own_and_arrives_in_the_part(tmp_path: Path, bench: Bench) -> None:
    assign, values = ControllerFor(bench), parameters_of(bench)
    by_index = assign.indexed(values)
    assert by_index == {**{i: values[name] for i, name in enumerate(NAMES)}, 16: 0.75}
    assert assign(hash_of(tmp_path), by_index).block.params[1].gain == 0.75
    other = assign(hash_of(tmp_path), {**by_index, 16: 3.0}).block.params[1]
    assert other.gain == 3.0
    assert type(other) is type(assign(hash_of(tmp_path), by_index).block.params[1]), "else it is compiled once more"


def test_who_starts_a_bench_builds_it_first(bench: Bench) -> None:
    scenarios = list(bench.scenarios.values())
    require_buildable(bench, bench.spec.model, scenarios, parameters_of(bench))
    broken = Path(part_names(bench).lateral.rpartition(":")[0])
    broken.write_text(PART.replace("gain: float = 2.0", "strength: float = 2.0"))
    with pytest.raises(InputError, match=r"tunables without a field .*mine\.gain"):
        require_buildable(bench, bench.spec.model, scenarios, parameters_of(bench))


def test_a_parameter_that_no_part_has_is_refused_with_those_there_are(tmp_path: Path) -> None:
    bench = load(write_own(tmp_path, 'parameters = { "mine.gian" = 0.75 }'))
    with pytest.raises(InputError, match=r"no parameter mine\.gian") as caught:
        parameters_of(bench)
    assert (caught.value.file, caught.value.key) == (bench.file, "controller.parameters.mine.gian")
    assert "mine.gain" in caught.value.hint


def test_a_part_that_is_not_there_is_named_with_file_and_key(tmp_path: Path) -> None:
    bench = load(write_own(tmp_path, 'inner = "nowhere.py:CONTROLLER"'))
    with pytest.raises(InputError, match=r"nowhere\.py does not exist") as caught:
        part_values(bench)
    assert (caught.value.file, caught.value.key) == (bench.file, "controller.inner")


def test_it_is_found_beside_the_bench_file_from_anywhere(
    tmp_path: Path, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert part_names(bench).lateral == f"{tmp_path / 'mine.py'}:CONTROLLER"
    (tmp_path / "elsewhere" / "mine.py").write_text("")
    assert part_names(bench).lateral == f"{tmp_path / 'mine.py'}:CONTROLLER", "what lies beside it comes first"


def test_the_batch_drives_it_as_the_nodes_do(bench: Bench) -> None:
    scenario, values = bench.scenarios["tiny"], parameters_of(bench)
    drive, simulator = InProcess(bench).drive(scenario, values), Simulator(bench)
    follower = follower_of(bench, scenario, values)
    over_frames = columns_from_frames(drive.frames, bench.codec, follower, bench.dt_s, ticks=drive.ticks).columns
    recorded = {gain: simulator.drive(Job({**values, "mine.gain": gain}, scenario)).recording for gain in (0.75, 3.0)}
    steer = {gain: one.columns["cmd_steer_rad"].tolist() for gain, one in recorded.items()}
    assert steer[0.75] == over_frames["cmd_steer_rad"].tolist()
    assert steer[0.75] != steer[3.0]

"""Which run folder a tune works in: the unfinished one of the very same wish, one of its own, or the one it is told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import write_bench
from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.config.dump import to_toml
from tunefree_hil.jobs.options.records import TuneOptions
from tunefree_hil.jobs.run_folder import RunFolder, open_run, write_text
from tunefree_hil.jobs.tune.candidates import read_winner
from tunefree_hil.jobs.tune.folder import LOCK, open_run_folder
from tunefree_hil.jobs.tune.options import TunePlan, make_tune_plan
from tunefree_hil.tune.store import exclusive_lock

SHARED = "postgresql://me@host/studies#mine"


@pytest.fixture
def wish(tmp_path: Path) -> TunePlan:
    return make_tune_plan(TuneOptions(write_bench(tmp_path), out=tmp_path / "runs"))


def entered(wish: TunePlan) -> tuple[RunFolder, bool]:
    with open_run_folder(wish) as found:
        return found


def again(wish: TunePlan, **more: Any) -> TunePlan:
    """The same bench file, with other options."""
    return make_tune_plan(wish.options._replace(**more))


def test_a_new_run_says_what_it_is_and_can_be_read_by_itself(wish: TunePlan) -> None:
    run, old = entered(wish)
    assert not old and run.path.name.endswith("-tune-b")
    record = open_run(run.path).record
    assert record["seed"] == wish.settings.seed and record["bench"] == str(wish.bench_file)
    assert record["hashes"] == wish.identity["hashes"] and record["complete"] is False
    (scenario,) = load(run.bench_file()).scenarios.values()
    assert scenario.hash == wish.bench.scenarios["tiny"].hash


def test_a_run_that_was_cut_off_is_gone_on_with_and_what_was_half_written_is_gone(wish: TunePlan) -> None:
    first, _ = entered(wish)
    (first.path / "trials.jsonl.part").write_text("half")
    run, old = entered(wish)
    assert old and run.path == first.path and not (first.path / "trials.jsonl.part").exists()
    first.finish()
    after, old = entered(wish)
    assert not old and after.path != first.path, "that one is done"


def test_a_run_that_goes_on_verifies_on_what_the_bench_file_names_now(wish: TunePlan) -> None:
    first, _ = entered(wish)
    (first.path / "bench.toml").unlink()  # cut off before it was written, by an earlier version
    bench = wish.bench_file
    bench.write_text(bench.read_text().replace('\nverify_scenarios = ["tiny"]', "\nverify_scenarios = []"))
    run, old = entered(again(wish))
    assert old and run.path == first.path
    assert load(run.bench_file()).spec.verify_scenarios == []


def test_a_new_run_is_held_before_anybody_can_find_it(wish: TunePlan, monkeypatch: pytest.MonkeyPatch) -> None:
    found: list[bool] = []

    def looked(path: Path, text: str) -> None:
        found.append((path.parent / "run.json").exists())
        with pytest.raises(InputError, match="another process works on it"), exclusive_lock(path.parent / LOCK):
            pass
        write_text(path, text)

    monkeypatch.setattr("tunefree_hil.jobs.tune.folder.write_text", looked)
    run, _ = entered(wish)
    assert found == [False] and (run.path / "bench.toml").is_file()


@pytest.mark.parametrize("more", [{"seed": 7}, {"sampler": "tpe_relative"}, {"backend": "batch"}, {"realtime": True}])
def test_a_run_of_another_wish_is_left_alone(wish: TunePlan, more: dict[str, Any]) -> None:
    first, _ = entered(wish)
    other, old = entered(again(wish, **more))
    assert not old and other.path != first.path


def test_a_run_to_resume_must_be_of_the_same_files_and_study(wish: TunePlan) -> None:
    first, _ = entered(wish)
    told = again(wish, resume=first.path)
    run, old = entered(told)
    assert old and run.path == first.path
    with pytest.raises(InputError, match="its study is in its study") as caught:
        entered(told._replace(study_address=SHARED))
    assert caught.value.key == "--study"
    scenario = wish.bench_file.parent / "scenarios" / "tiny.toml"
    scenario.write_text(scenario.read_text().replace("noise_seed = 3", "noise_seed = 4"))
    with pytest.raises(InputError, match="files of the run have changed") as caught:
        entered(again(wish, resume=first.path))
    assert caught.value.file == str(first.path)


def test_a_run_of_another_command_is_not_gone_on_with(wish: TunePlan, tmp_path: Path) -> None:
    """The drive's own episodes would be overwritten by the baselines'."""
    same = {**wish.run_record, "command": "drive", "hashes": wish.identity["hashes"]}
    drive = RunFolder.create(tmp_path / "runs", "drive-b", same)
    with pytest.raises(InputError, match="is a run of 'drive'") as caught:
        entered(again(wish, resume=drive.path))
    assert caught.value.key == "--resume" and caught.value.file == str(drive.path)


def test_a_run_that_another_process_works_on_is_refused(wish: TunePlan) -> None:
    """Baselines, confirmation and verification of both would be written into the same episodes."""
    with open_run_folder(wish) as (run, _):
        half = run.path / "trials.jsonl.part"
        half.write_text("half")
        for second in (wish, again(wish, resume=run.path)):
            with pytest.raises(InputError, match="another process works on it"):
                entered(second)
        assert half.exists(), "what it is writing is left alone"
    assert entered(wish)[0].path == run.path


def test_workers_of_one_study_have_a_folder_each_and_take_up_one_that_nobody_holds(wish: TunePlan) -> None:
    worker = wish._replace(study_address=SHARED)
    with open_run_folder(worker) as (first, old_first), open_run_folder(worker) as (second, old_second):
        assert not old_first and not old_second and first.path != second.path
    with open_run_folder(worker) as (run, old):
        assert old and run.path in (first.path, second.path)


def test_the_winner_is_a_complete_vector_once_the_study_is_finished(wish: TunePlan) -> None:
    run, _ = entered(wish)
    with pytest.raises(InputError, match="study is not finished") as caught:
        read_winner(wish.bench, run)
    assert caught.value.file == str(run.path) and "same tune command" in caught.value.hint
    values = {**wish.vectors["mrac_on"], "mrac.p": 0.5}
    (run.path / "best.toml").write_text(to_toml({"parameters": values}))
    assert read_winner(wish.bench, run) == values
    for text, key in (("parameters = [1,", ""), ("slot = 3", "parameters")):
        (run.path / "best.toml").write_text(text)
        with pytest.raises(InputError) as caught:
            read_winner(wish.bench, run)
        assert caught.value.file == str(run.path / "best.toml") and caught.value.key == key


def test_a_folder_that_cannot_be_made_whole_is_said_and_not_tried_again_and_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A disk that is full in the middle of it."""
    made = Path.mkdir

    def full(self: Path, *words: Any, **more: Any) -> None:
        if self.name == "episodes":
            raise OSError(28, "No space left on device")
        made(self, *words, **more)

    monkeypatch.setattr(Path, "mkdir", full)
    with pytest.raises(InputError, match="cannot make the run folder: No space left"):
        RunFolder.create(tmp_path, "a", {})

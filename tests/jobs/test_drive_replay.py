"""Drives over real processes: the run folder they leave, replay, and what a changed or cut run folder gives."""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.bench.tiny import write_bench, write_scenario
from tests.jobs.command import (
    Ended,
    eventually,
    finish,
    new_session,
    no_orphans,
    nodes_of,
    one_message,
    start,
    tunefree,
    tunefree_alone,
)
from tunefree_hil.cli.entry import run as command_line
from tunefree_hil.jobs.run_folder import delete_logs

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Ended:
    """One drive of two seconds over real processes."""
    folder = tmp_path_factory.mktemp("driven")
    done = tunefree_alone("drive", write_bench(folder), "--out", folder / "runs", "--json")
    assert done.status == 0, done.words
    return done


@pytest.fixture
def run(driven: Ended, tmp_path: Path) -> Path:
    """A copy of that run, to be spoiled."""
    return Path(shutil.copytree(driven.data["run"], tmp_path / "run"))


def test_what_a_drive_leaves(driven: Ended) -> None:
    folder = Path(driven.data["run"])
    record = json.loads((folder / "run.json").read_text())
    assert record["complete"] is True and record["schema"] == "tunefree.run/1"
    names = {path.name for path in (folder / "episodes" / "0").iterdir()}
    assert names == {"vehicle.log", "bench.log", "columns.npz", "timing.npz", "episode.json"}
    assert not list(folder.rglob("*.part"))
    assert (folder / "figures" / "tiny.png").is_file() and (folder / "bench.toml").is_file()
    assert driven.data["scenarios"]["tiny"]["outcome"] == "finished"


def test_the_commands_that_it_gives_work_as_pasted(driven: Ended, tmp_path: Path) -> None:
    """From another folder too, with a bench file that lies neither there nor in the checkout."""
    for command in driven.data["next"]:
        words = command.split()
        done = tunefree(*words[words.index("replay") if "replay" in words else words.index("log") :], cwd=tmp_path)
        assert done.status == 0, done.words
        assert done.words.splitlines()[-1].endswith(("all frames equal", "no faults"))


def test_reading_again_is_equal(driven: Ended) -> None:
    assert tunefree("replay", driven.data["run"]).status == 0


def test_scenarios_from_anywhere_are_driven_and_replayed(tmp_path: Path) -> None:
    """Those that are named, each once, in that order, and no other of the bench file."""
    bench = write_bench(tmp_path / "a", scenarios=("tiny", "unnamed"), duration_s=1.0)
    other = write_scenario(tmp_path / "b", "elsewhere", 1.0)
    named = [word for name in (other, "tiny", "tiny") for word in ("--scenario", name)]
    done = tunefree("drive", bench, *named, "--out", tmp_path / "runs", "--json")
    assert done.status == 0, done.words
    assert list(done.data["scenarios"]) == ["elsewhere", "tiny"]
    assert tunefree("replay", done.data["run"], "--verify").status == 0


def change_a_bit(run: Path, can_id: str, tick: int) -> None:
    """Change the lowest bit of the first data byte of a frame in the stored log."""
    log = run / "episodes" / "0" / "vehicle.log"
    rows = log.read_text().splitlines()
    place = next(i for i, row in enumerate(rows) if row.startswith(f"({tick * 0.01:.6f}) ") and f" {can_id}#" in row)
    head, data = rows[place].rsplit("#", 1)
    rows[place] = f"{head}#{int(data[:2], 16) ^ 1:02X}{data[2:]}"
    log.write_text("\n".join(rows) + "\n")


def test_a_changed_log_is_named_by_tick_id_and_signal(run: Path) -> None:
    change_a_bit(run, "062", 123)
    done = tunefree("replay", run, "--verify", "--json")
    assert done.status == 1
    (problem,) = done.data["differing"]
    assert (problem["tick"], problem["can_id"], problem["signal"]) == (123, 0x62, "PCMD")
    assert "tick 123, THROTTLE_CMD (0x62), PCMD" in done.words and "stored log was changed" in done.words
    assert tunefree("replay", run).status == 1


def edit_episode(run: Path, **changes: Any) -> None:
    path = run / "episodes" / "0" / "episode.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def test_a_changed_hash_is_told_from_a_changed_log(run: Path) -> None:
    edit_episode(run, frame_hash="0" * 64)
    done = tunefree("replay", run, "--verify")
    assert done.status == 1 and "episode.json was changed" in done.words


def test_another_drive_is_named_by_its_first_difference(run: Path) -> None:
    """Other noise: the first report that differs is said with both values."""
    edit_episode(run, seed=77)
    done = tunefree("replay", run, "--verify", "--json")
    (problem,) = done.data["differing"]
    assert done.status == 1 and problem["tick"] <= 5 and problem["first"] != problem["second"]
    assert problem["phase"] == 0 and problem["message"] in done.words


def test_a_log_that_was_not_kept_is_still_verified(run: Path) -> None:
    assert tunefree("replay", run, "--episode", "0", "--verify").status == 0
    delete_logs(run / "episodes" / "0")
    assert tunefree("replay", run, "--episode", "0", "--verify").status == 0
    edit_episode(run, seed=77)
    done = tunefree("replay", run, "--episode", "0", "--verify")
    assert done.status == 1 and "was not kept" in done.words


def cut(path: str, size: int) -> Callable[[Path], None]:
    def spoil(run: Path) -> None:
        file = run / path
        file.write_bytes(file.read_bytes()[:size])

    return spoil


def write(path: str, text: str) -> Callable[[Path], None]:
    def spoil(run: Path) -> None:
        (run / path).write_text(text)

    return spoil


def remove(path: str) -> Callable[[Path], None]:
    return lambda run: (run / path).unlink()


LOG, SUMMARY = "episodes/0/vehicle.log", "episodes/0/episode.json"
SPOILT = {
    "log cut off": (cut(LOG, 5000), ["vehicle.log:", "cut off in this line"]),
    "log empty": (cut(LOG, 0), ["vehicle.log", "empty"]),
    "log foreign": (write(LOG, "14:01 the train left\n"), ["vehicle.log:1", "not a candump log"]),
    "summary cut off": (cut(SUMMARY, 40), ["episode.json", "not readable JSON"]),
    "summary empty": (write(SUMMARY, "{}"), ["episode.json", "key frame_hash"]),
    "summary missing": (remove(SUMMARY), ["episode.json", "interrupted"]),
    "record cut off": (cut("run.json", 40), ["run.json", "not readable JSON"]),
    "record missing": (remove("run.json"), ["no run.json"]),
    "record without versions": (write("run.json", '{"schema": "tunefree.run/1"}'), ["versions.tunefree_hil"]),
    "another schema": (write("run.json", '{"schema": "tunefree.run/9"}'), ["key schema", "'tunefree.run/9'"]),
    "bench file missing": (remove("bench.toml"), ["no bench.toml", "interrupted at the start"]),
    "bench file cut off": (cut("bench.toml", 30), ["bench.toml"]),
}


@pytest.mark.parametrize("name", SPOILT)
def test_a_spoilt_run_is_one_message(name: str, run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spoil, parts = SPOILT[name]
    spoil(run)
    assert command_line(["replay", str(run)]) == 2
    one_message(Ended(2, capsys.readouterr().err, {}, [], 0.0), str(run), *parts)


def test_a_file_that_changed_since_is_named(driven: Ended, tmp_path: Path) -> None:
    folder = tmp_path / "home"
    shutil.copytree(Path(driven.data["run"]), tmp_path / "run")
    path = write_scenario(folder, curvature=0.03)
    bench = tmp_path / "run" / "bench.toml"
    old = next(line for line in bench.read_text().splitlines() if "tiny" in line).strip(' ",')
    bench.write_text(bench.read_text().replace(old, str(path)))
    done = tunefree("replay", tmp_path / "run", "--verify")
    assert done.status == 2
    one_message(done, "scenarios changed since", "hashes.scenarios")


def stutter(session: str, chance: random.Random) -> int:
    """Stop one node or another for a few milliseconds, again and again while all live; how often."""
    stops = 0
    while len(nodes := nodes_of(session)) == 3:
        pid = nodes[chance.choice(sorted(nodes))]
        with contextlib.suppress(ProcessLookupError):  # it ended by itself
            os.kill(pid, signal.SIGSTOP)
            time.sleep(chance.uniform(0.001, 0.02))
            os.kill(pid, signal.SIGCONT)
            stops += 1
        time.sleep(chance.uniform(0.0, 0.02))
    return stops


def test_the_frames_do_not_depend_on_who_is_slow(driven: Ended, tmp_path: Path) -> None:
    """Nodes that are stopped at random moments, from before the first to after the last tick: one hash."""
    bench = write_bench(tmp_path)
    hashes = {driven.data["hashes"]["tiny"]}
    for seed in (1, 2):
        session, chance = new_session(), random.Random(seed)
        with no_orphans(session):
            process = start("drive", bench, "--session", session, "--out", tmp_path / "runs", "--json")
            eventually(lambda session=session: len(nodes_of(session)) == 3)
            stops = stutter(session, chance)
            done = finish(process)
        assert done.status == 0, done.words
        assert stops > 10
        hashes.add(done.data["hashes"]["tiny"])
    assert len(hashes) == 1

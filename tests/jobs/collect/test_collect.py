"""Collections over real processes: short ones, one that is killed, one that loses a node, and what is refused."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest

from tests import other_vehicle
from tests.house import ROOT
from tests.jobs.command import (
    Ended,
    eventually,
    finish,
    new_session,
    no_orphans,
    nodes_of,
    start,
    tunefree,
)
from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.events import Event
from tunefree_hil.base.records import CanFrame
from tunefree_hil.bus.bench_channel import ErrorCode
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.cli.entry import run
from tunefree_hil.config.load import load_vehicle
from tunefree_hil.episode.candump import read_candump
from tunefree_hil.jobs.collect.collect import collect, require_stopped
from tunefree_hil.jobs.collect.live_coverage import LiveCounter, WatchOptions, count_logs, make_coverage
from tunefree_hil.jobs.collect.plan import require_area
from tunefree_hil.jobs.options.records import CollectOptions
from tunefree_hil.jobs.run_folder import library_versions, write_json
from tunefree_hil.learn.drives.read import read_drives

WORDS = ("--vehicle", "mkz_bywire", "--model", "mkz_nominal", "--quota-s", "0.2", "--top-mps", "3", "--area-m", "150")
SHORT = ("--drive-s", "12")
PATIENCE_S = 120.0


def words_of(out: Path, *more: Any) -> tuple[Any, ...]:
    return ("collect", *WORDS, *SHORT, "--out", out, "--json", *more)


def hashes(out: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted((out / "logs").glob("*.log"))}


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Ended]:
    """A collection that nobody disturbed."""
    out = tmp_path_factory.mktemp("calm") / "run"
    session = new_session()
    with no_orphans(session):
        done = tunefree(*words_of(out, "--session", session), patience_s=PATIENCE_S)
    assert done.status in (0, 1), done.words
    return out, done


@pytest.mark.slow
def test_a_short_collection_leaves_logs_a_map_and_a_picture(calm: tuple[Path, Ended]) -> None:
    out, done = calm
    assert done.status == 0 and done.data["missing"] == [], done.words
    cover = json.loads((out / "coverage.json").read_text())
    assert cover["cells_full"] == cover["cells_wanted"] == done.data["cells_full"] > 20
    assert cover["beyond_envelope_s"] == 0.0
    assert len(cover["drives"]) == len(hashes(out)) >= 2
    assert all(one["have_s"] >= one["need_s"] for one in cover["cells"])
    assert all(one["excluded"] for one in cover["cells"] if one["need_s"] == 0.0)
    assert (out / "figures" / "coverage.png").stat().st_size > 10_000
    assert json.loads((out / "run.json").read_text())["complete"] is True
    assert "cells full" in done.words and "brake light" not in done.words  # the map is for stdout


@pytest.mark.slow
def test_its_logs_count_the_same_when_read_again(calm: tuple[Path, Ended], tmp_path: Path) -> None:
    out, _ = calm
    wish = WatchOptions("mkz_bywire", "auto", "x", 0.2, 3.0, None, tmp_path / "again")
    events = list(count_logs(sorted((out / "logs").glob("*.log")), wish))
    assert isinstance(events[-1], Event) and events[-1].data["missing"] == []
    first, again = (json.loads((one / "coverage.json").read_text())["cells"] for one in (out, tmp_path / "again"))
    assert [one["have_s"] for one in first] == [one["have_s"] for one in again]


@pytest.mark.slow
def test_frames_as_they_come_count_as_their_log_does(calm: tuple[Path, Ended]) -> None:
    log = calm[0] / "logs" / "drive-001.log"
    vehicle, wish = load_vehicle("mkz_bywire"), WatchOptions("mkz_bywire", "auto", "x", 0.2, None, None, None)
    live, whole, codec = make_coverage(vehicle, wish), make_coverage(vehicle, wish), Codec(vehicle)
    ears = LiveCounter(vehicle, codec, live)
    for one in read_candump(log):
        ears.add_frames([CanFrame(one.can_id, one.data, time_s=one.time_s)])
    whole.add(read_drives([log], codec)[0].get)
    had = sum(whole.counter.have)
    assert sum(abs(a - b) for a, b in zip(live.counter.have, whole.counter.have, strict=True)) <= 2 < had
    before = sum(live.counter.have)
    ears.add_frames(
        [CanFrame(one.can_id, one.data, time_s=one.time_s) for one in read_candump(log)]
    )  # the clock went back
    assert sum(live.counter.have) >= 2 * before - 50


@pytest.mark.slow
def test_killed_and_with_a_node_lost_it_goes_on_to_the_same_logs(calm: tuple[Path, Ended], tmp_path: Path) -> None:
    out, session = tmp_path / "run", new_session()
    with no_orphans(session, 15.0):
        process = start(*words_of(out, "--session", session))
        eventually(lambda: list(out.glob("episodes/2/*")), PATIENCE_S, "the second drive")
        process.kill()
        assert finish(process).status == -signal.SIGKILL
    assert list(hashes(out)) == ["drive-001.log"]
    session = new_session()
    with no_orphans(session):
        process = start(*words_of(out, "--session", session))
        ecu = eventually(lambda: nodes_of(session).get("ecu"), PATIENCE_S, "the ECU")
        eventually(lambda: len(list(out.glob("episodes/2/*"))) > 0, PATIENCE_S, "a drive")
        os.kill(ecu, signal.SIGKILL)
        done = finish(process, PATIENCE_S)
    assert done.status == 0, done.words
    assert "1 existing drives" in done.words
    assert "ecu process was killed" in done.words and "repeated" in done.words
    assert hashes(out) == hashes(calm[0])


@pytest.mark.slow
def test_a_watch_sees_what_is_driven_and_ctrl_c_says_how_to_go_on(tmp_path: Path) -> None:
    out, session = tmp_path / "run", new_session()
    with no_orphans(session):
        process = start(*words_of(out, "--session", session, "--quota-s", "60"))
        eventually(lambda: list(out.glob("episodes/1/*")), PATIENCE_S, "a drive")
        listens = ("--watch", "--bus", "tfhub", "--vehicle", "mkz_bywire", "--seconds", "2.5", "--quota-s", "0.2")
        watched = tunefree("collect", *listens, "--session", session, "--out", tmp_path / "seen", "--json")
        process.send_signal(signal.SIGINT)
        done = finish(process)
    assert watched.status == 0 and sum(one["have_s"] for one in watched.data["cells"]) > 0.2, watched.words
    assert (tmp_path / "seen" / "figures" / "coverage.png").is_file()
    assert done.status == 130 and "state saved" in done.words
    assert f"--out {out}" in done.words and "--top-mps 3" in done.words and "--drive-s 12" in done.words


def refused(out: Path, **more: Any) -> InputError:
    """The error of a collection that is refused."""
    asked = CollectOptions(vehicle="mkz_bywire", model="mkz_nominal", bus="tfhub", out=out)
    with pytest.raises(InputError) as caught:
        list(collect(asked._replace(**more)))
    return caught.value


def test_an_area_that_is_too_small_is_told_how_large_it_must_be(tmp_path: Path) -> None:
    error = refused(tmp_path / "run", area_m=200.0)
    assert error.code == "area_too_small" and "200 m is too small for 21 m/s" in error.message
    needed = int(error.hint.split()[1].rstrip(","))
    assert 200 < needed < 400 and f"a square of {needed} m" in error.message
    require_area(load_vehicle("mkz_bywire"), CollectOptions(area_m=needed))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"model": None}, "mkz_reference"),
        ({"vehicle": None}, "no vehicle or bench file"),
        ({"bench": Path("b.toml"), "vehicle": "mkz_bywire"}, "a bench file and --vehicle"),
        ({"model": other_vehicle.NOMINAL.name}, f"is a model of '{other_vehicle.NAME}'"),
        ({"vehicle": "rav4_2017"}, "command.brake_frac"),
        ({"quota_s": 0.0}, "--quota-s"),
        ({"quota_s": 1e308}, "--quota-s"),
        ({"area_m": float("nan")}, "--area-m"),
        ({"drive_s": -1.0}, "--drive-s"),
        ({"top_mps": 0.1}, "--top-mps"),
    ],
)
def test_what_cannot_be_driven_is_refused(more: dict[str, Any], said: str, tmp_path: Path) -> None:
    error = refused(tmp_path / "run", **more)
    assert said in f"{error.key} {error}"
    assert not (tmp_path / "run").exists()


def test_a_model_of_the_vehicle_as_it_was_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    old = shutil.copytree(ROOT / "bench_configs" / "models" / "mkz_nominal", tmp_path / "old")
    (old / "model.toml").write_text('vehicle_hash = "sha256:00"\n' + (old / "model.toml").read_text())
    error = refused(tmp_path / "run", model=str(old))
    assert error.code == "vehicle_changed" and error.file == f"{old}/model.toml"
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("code", "word", "said"),
    [
        (ErrorCode.NONE, "not_stopped", "did not come to a stop in time"),
        (ErrorCode.DIVERGED, "diverged", ErrorCode.DIVERGED.sentence),
    ],
)
def test_a_drive_that_does_not_end_standing_is_none(code: ErrorCode, word: str, said: str) -> None:
    require_stopped(ErrorCode.STOPPED, "drive-001", Path("episodes/1"))
    with pytest.raises(BenchError) as caught:
        require_stopped(code, "drive-001", Path("episodes/1"))
    assert caught.value.code == word and caught.value.message.startswith("drive-001: ")
    assert said in caught.value.message
    assert caught.value.file == "episodes/1" and "vehicle.log" in caught.value.hint


def test_a_folder_with_another_run_is_not_touched(tmp_path: Path) -> None:
    (tmp_path / "thing.txt").write_text("mine")
    assert "not a run folder" in refused(tmp_path).message
    assert [path.name for path in tmp_path.iterdir()] == ["thing.txt"]
    write_json(tmp_path / "run.json", {"schema": "tunefree.run/1", "versions": library_versions(), "quota_s": 3.0})
    assert "quota_s" in refused(tmp_path).message


def test_a_watch_without_a_vehicle_asks_whose_frames_these_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["collect", "--watch", "--plain"]) == 2
    assert "the vehicle is not given" in capsys.readouterr().err


@pytest.mark.parametrize("mode", [("--watch",), ("--from", "some.log")])
@pytest.mark.parametrize(
    ("option", "value", "said"),
    [
        *(("--quota-s", value, "--quota-s") for value in ("nan", "inf", "0", "-5", "1e308")),
        *(("--top-mps", value, "--top-mps") for value in ("nan", "inf", "0", "-1")),
        ("--top-mps", "0.01", "no cell can be driven with at most 0.01 m/s"),
        ("--seconds", "nan", "--seconds"),
        ("--seconds", "-1", "--seconds"),
    ],
)
def test_a_count_refuses_numbers_that_are_none(
    mode: tuple[str, ...], option: str, value: str, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["collect", *mode, "--vehicle", "mkz_bywire", "--bus", "virtual", "--plain", option, value]
    assert run(words) == 2
    text = capsys.readouterr().err
    assert said in text and "Traceback" not in text and "what to do: give" in text


def test_a_log_of_another_vehicle_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text("(0.010000) can0 123#0011\n")
    with pytest.raises(InputError, match="not one frame of vehicle"):
        list(count_logs([tmp_path / "a.log"], WatchOptions("mkz_bywire", "auto", "x", 1.0, None, None, None)))


def test_a_collection_that_another_process_works_on_is_refused(tmp_path: Path) -> None:
    asked = CollectOptions(vehicle="mkz_bywire", model="mkz_nominal", bus="tfhub", out=tmp_path / "run")
    first = collect(asked)
    assert "run folder" in next(first).message
    with pytest.raises(InputError, match="another process works on it"):
        next(collect(asked))
    del first  # what is not gone on with is closed
    assert "run folder" in next(collect(asked)).message

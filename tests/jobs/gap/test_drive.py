"""`gap --drive`: what is driven goes in beside the logs, the question is asked again, a lost drive is driven again."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

from tests import other_vehicle
from tests.bench.tiny import write_bench
from tests.gap.made_answer import VEHICLE
from tests.gap.made_answer import answer as made_answer
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.collect.plan import DrivePlan
from tunefree_hil.config.load import load_model
from tunefree_hil.config.schema import ValidSpec
from tunefree_hil.gap.experiment_design import MANOEUVRES
from tunefree_hil.gap.selection.reasons import Criterion, Reason, RejectionStage, reason_entry
from tunefree_hil.jobs.gap import drive as module
from tunefree_hil.jobs.gap.drive import has_same_obstacles, run_gap_with_drives
from tunefree_hil.jobs.gap.drive_bench import ManoeuvreJob
from tunefree_hil.jobs.gap.folder import GapFolder
from tunefree_hil.jobs.gap.options import GapDriveOptions, GapOptions
from tunefree_hil.jobs.gap.report import write_page

SET = ["steer_dead_time", "brake_lag", "aero_drag"]


class Bench:
    """In the place of search and drives: `says` is the verdict by the number of logs; the drives write empty logs."""

    def __init__(self) -> None:
        self.says: dict[int, dict[str, Any]] = {}
        self.asked: list[list[str]] = []
        self.driven: list[str] = []
        self.plans: list[DrivePlan] = []
        self.dies = ""

    def gap(self, asked: GapOptions) -> Iterator[Event]:
        yield Event("progress", "suspects", {"resume": "tunefree-hil gap without the drives"})
        folder, path = GapFolder(asked.out), asked.out / "gap.json"
        if not path.is_file():
            self.asked.append([log.name for log in asked.logs])
            whole = {
                "signals": {}, "older": [], "figures": [], "model": None, "model_hash": "m", "vehicle_hash": "v",
                "version": "0", "until": asked.until, "sentence": f"said of {len(asked.logs)} logs",
                "logs": [{"name": log.name, "hash": "h"} for log in asked.logs],
                **self.says[len(asked.logs)],
            }  # fmt: skip
            asked.out.mkdir(parents=True, exist_ok=True)
            write_page(folder.page, whole, [], "again")
            folder.write_answer(whole)
        yield Event("result", "", {**json.loads(path.read_text()), "exit": 0, "next": ["ls"]})

    def drive_jobs(self, run: Any, bench: Any, jobs: Sequence[ManoeuvreJob], wish: GapDriveOptions) -> Iterator[Event]:
        for job in jobs:
            if job.manoeuvre.name == self.dies:
                raise KeyboardInterrupt
            if not job.log.is_file():
                self.driven.append(job.manoeuvre.name)
                self.plans.append(job.plan)
                yield Event("note", f"driving {job.manoeuvre.description}")
                job.log.write_text("")


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    found = Bench()
    monkeypatch.setattr(module, "run_gap", found.gap)
    monkeypatch.setattr(module, "drive_jobs", found.drive_jobs)
    return found


@pytest.fixture
def asked(tmp_path: Path) -> GapOptions:
    return GapOptions([Path("a.log")], VEHICLE.folder, "mkz_nominal", tmp_path / "out")


@pytest.fixture
def wish(tmp_path: Path) -> GapDriveOptions:
    return GapDriveOptions(write_bench(tmp_path), "virtual")


def verdict(name: str, **more: Any) -> dict[str, Any]:
    return made_answer(name, **{"set": SET if name == "set" else [], **more})


def events(asked: GapOptions, wish: GapDriveOptions) -> list[Event]:
    return list(run_gap_with_drives(asked, wish))


def test_a_set_is_driven_apart_and_the_first_answer_is_kept(
    bench: Bench, asked: GapOptions, wish: GapDriveOptions
) -> None:
    bench.says = {1: verdict("set"), 2: verdict("one")}
    found = events(asked, wish)
    data, out = found[-1].data, asked.out
    assert bench.driven == ["steer_steps"] and bench.asked == [["a.log"], ["a.log", "drive-001-steer_steps.log"]]
    assert data["verdict"] == "one" and data["next"][-1].startswith("tunefree-hil drive ")
    written = json.loads((out / "gap.json").read_text())
    assert written["verdict"] == "one" and "exit" not in written and "next" not in written
    (one,) = written["drives"]
    assert (one["round"], one["manoeuvre"], Path(one["log"]).name) == (1, "steer_steps", "drive-001-steer_steps.log")
    assert one["fits"]
    assert json.loads((out / "gap-1.json").read_text())["verdict"] == "set"
    page = (out / "gap.md").read_text()
    assert page.startswith("# said of 2 logs") and "## What the bench drove" in page and "--drive --bench" in page
    assert (out / "gap-1.md").read_text().startswith("# said of 1 logs")
    resumes = {event.data["resume"] for event in found if "resume" in event.data}
    assert len(resumes) == 1 and resumes.pop().endswith(f"--drive --bench {wish.bench} --bus virtual")


def test_the_same_command_says_it_again_and_drives_nothing(
    bench: Bench, asked: GapOptions, wish: GapDriveOptions
) -> None:
    bench.says = {1: verdict("set"), 2: verdict("one")}
    first = events(asked, wish)[-1].data
    again = events(asked, wish)[-1].data
    assert again == first and len(bench.asked) == 2 and bench.driven == ["steer_steps"]


@pytest.mark.parametrize("name", ["one", "none_missing", "none_of_these"])
def test_where_it_is_decided_nothing_is_driven(
    name: str, bench: Bench, asked: GapOptions, wish: GapDriveOptions
) -> None:
    bench.says = {1: verdict(name)}
    data = events(asked, wish)[-1].data
    assert data["verdict"] == name and "drives" not in data and bench.driven == []
    assert not (asked.out / "drives").exists() and not (asked.out / "gap-1.json").exists()


def named(name: str) -> dict[str, Any]:
    return verdict("one", effects=[{**made_answer("one")["effects"][0], "name": name}])


@pytest.mark.parametrize(
    "other",
    [
        verdict("none_of_these"),
        verdict("none_missing"),
        named("powertrain_lag"),
        verdict("set", set=["powertrain_lag", "throttle_gain"]),
    ],
)
def test_what_none_of_the_set_would_be_decides_nothing(
    other: dict[str, Any], bench: Bench, asked: GapOptions, wish: GapDriveOptions
) -> None:
    bench.says = {1: verdict("set"), 2: other}
    found = events(asked, wish)
    data, out = found[-1].data, asked.out
    assert data["verdict"] == "set" and data["set"] == SET and len(bench.asked) == 2
    assert any(one.kind == "warning" and "drives and logs do not match" in one.message for one in found)
    assert "said of 2 logs" in data["words"][-1] and [one["round"] for one in data["drives"]] == [1]
    assert json.loads((out / "gap.json").read_text())["words"] == data["words"]
    assert json.loads((out / "round-1" / "gap.json").read_text())["verdict"] == other["verdict"]
    assert "do not match" in (out / "gap.md").read_text()
    assert not data["drives"][0]["fits"] and "a.log" in data["next"][0] and "drive-001" not in data["next"][0]
    assert events(asked, wish)[-1].data == data


def test_a_name_that_no_log_tells_from_one_of_the_set_decides(
    bench: Bench, asked: GapOptions, wish: GapDriveOptions
) -> None:
    bench.says = {1: verdict("set", set=["aero_drag", "rolling_resistance"]), 2: named("brake_drag")}
    data = events(asked, wish)[-1].data
    assert data["verdict"] == "one" and data["effects"][0]["name"] == "brake_drag"


def test_what_the_data_of_a_model_do_not_cover_is_not_driven_and_that_is_said(
    bench: Bench, asked: GapOptions, wish: GapDriveOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    calm = replace(load_model("mkz_nominal"), valid=ValidSpec(speed_mps=[0.0, 15.0], pedals=[-0.25, 0.3]))
    monkeypatch.setattr(module, "load_checked_model", lambda name, vehicle: calm)
    bench.says = dict.fromkeys(range(1, 9), verdict("set", set=["power_limit", "brake_gain"]))
    found = events(asked, wish)
    assert bench.driven and "full_throttle" not in bench.driven and "stops" not in bench.driven
    said = [one.message.rpartition(": ")[2] for one in found if "not driven" in one.message]
    assert said == [MANOEUVRES["full_throttle"].description, MANOEUVRES["stops"].description]
    assert bench.plans and all(plan.top_mps == 15.0 and plan.bounds is not None for plan in bench.plans)


def test_it_gives_up_after_three_rounds(bench: Bench, asked: GapOptions, wish: GapDriveOptions) -> None:
    bench.says = dict.fromkeys(range(1, 9), verdict("set", set=["steer_lag", "brake_lag", "aero_drag", "friction"]))
    data = events(asked, wish)[-1].data
    assert bench.driven == ["steer_steps", "brake_levels", "gentle"] and len(bench.asked) == 4
    assert [one["round"] for one in data["drives"]] == [1, 2, 3] and data["verdict"] == "set"


def test_what_follows_takes_the_drives_and_the_bench_along(
    bench: Bench, asked: GapOptions, wish: GapDriveOptions
) -> None:
    bench.says = dict.fromkeys(range(1, 9), verdict("set", set=["steer_lag", "steer_dead_time"]))
    for _ in range(2):  # as it ends, and as it is said again
        (command,) = events(asked, wish)[-1].data["next"]
        words = shlex.split(command)
        log = asked.out / "drives" / "logs" / "drive-001-steer_steps.log"
        assert words[2:5] == ["a.log", str(log), "NEXT.log"] and words[words.index("--out") + 1] == f"{asked.out}-2"
        assert words[-5:] == ["--drive", "--bench", str(wish.bench), "--bus", "virtual"]
    assert command in (asked.out / "gap.md").read_text()


def test_it_stops_where_nothing_new_can_be_driven(bench: Bench, asked: GapOptions, wish: GapDriveOptions) -> None:
    bench.says = dict.fromkeys(range(1, 9), verdict("set", set=["steer_lag", "steer_dead_time"]))
    found = events(asked, wish)
    assert bench.driven == ["steer_steps"] and found[-1].data["verdict"] == "set"
    assert any("no further manoeuvre" in event.message for event in found)


def test_logs_that_cannot_tell_are_driven_for_until_the_reason_stays(
    bench: Bench, asked: GapOptions, wish: GapDriveOptions
) -> None:
    lacking = {"brake_lag": {"score": 0.1, "enough": False, "lacks": ["no braking"]}}
    untold = verdict("cannot_test", excitation=lacking, reasons=[shortage(0.0)])
    bench.says = {1: untold, 2: verdict("one")}
    assert events(asked, wish)[-1].data["verdict"] == "one" and bench.driven == ["brake_levels"]
    bench.says = {key: {**untold, "excitation": {}, "words": [str(key)]} for key in range(1, 9)}
    found = events(asked._replace(out=asked.out.with_name("other")), wish)
    assert found[-1].data["verdict"] == "cannot_test" and len(found[-1].data["drives"]) == 3
    assert len(bench.asked) == 4 and any("did not change why" in event.message for event in found)
    bench.says = {key: {**untold, "excitation": {}, "reasons": [shortage(0.1 * key)]} for key in range(1, 12)}
    found = events(asked._replace(out=asked.out.with_name("third")), wish)
    assert len(bench.asked) > 6 and not any("did not change why" in event.message for event in found)


def shortage(brakings: float) -> dict[str, Any]:
    return reason_entry(
        Reason(Criterion.NOT_EXCITED, "brake_lag", brakings, 9.0, key="brakings", stage=RejectionStage.UNTESTABLE)
    )


@pytest.mark.parametrize(
    ("more", "is_same"),
    [
        ({}, True),
        ({"value": 3.0004}, True),  # shown with three digits
        ({"value": 3.1}, False),
        ({"signal": "steer_moves"}, False),
        ({"name": "brake_fade"}, True),
        ({"criterion": "idle_time"}, False),
    ],
)
def test_obstacles_are_the_same_by_what_is_shown_of_them(more: dict[str, Any], is_same: bool) -> None:
    before, after = (verdict("cannot_test", reasons=[entry]) for entry in (shortage(3.0), {**shortage(3.0), **more}))
    assert has_same_obstacles(before, after) == is_same


def test_the_search_alone_is_no_obstacle_and_an_answer_without_reasons_is_no_same_one() -> None:
    old, found = verdict("cannot_test"), verdict("cannot_test", reasons=[shortage(3.0)])
    assert not has_same_obstacles(old, old) and not has_same_obstacles(old, found)
    screened = reason_entry(Reason(Criterion.SCREENED, "aero_drag", 0.5, 1.0, stage=RejectionStage.SCREENING))
    assert has_same_obstacles(found, {**found, "reasons": [*found["reasons"], screened]})


def test_cut_off_in_a_drive_it_goes_on_with_that_drive(bench: Bench, asked: GapOptions, wish: GapDriveOptions) -> None:
    bench.says = {1: verdict("set", set=["report_latency", "steer_dead_time"]), 4: verdict("one")}
    bench.dies = "throttle_steps"
    with pytest.raises(KeyboardInterrupt):
        events(asked, wish)
    assert json.loads((asked.out / "gap.json").read_text())["verdict"] == "set"
    bench.dies = ""
    assert events(asked, wish)[-1].data["verdict"] == "one"
    assert bench.driven == ["steer_steps", "throttle_steps", "brake_levels"] and len(bench.asked) == 2


@pytest.mark.parametrize("whole", [False, True])
def test_drives_of_another_bench_are_not_mixed_in(
    bench: Bench, asked: GapOptions, wish: GapDriveOptions, tmp_path: Path, whole: bool
) -> None:
    bench.says, bench.dies = {1: verdict("set"), 2: verdict("one")}, "" if whole else "steer_steps"
    if whole:
        assert events(asked, wish)[-1].data["verdict"] == "one"
        assert events(asked, wish)[-1].data["verdict"] == "one", "the same is said again"
    else:
        with pytest.raises(KeyboardInterrupt):
            events(asked, wish)
    (tmp_path / "other").mkdir()
    other = write_bench(tmp_path / "other")
    text = other.read_text()
    assert "[[effects]]" not in text
    other.write_text(text + '\n[[effects]]\nname = "steer_lag"\nparams = { tau_s = 0.2 }\n')
    with pytest.raises(InputError, match="effects"):
        events(asked, wish._replace(bench=other))


def test_a_bench_of_another_vehicle_is_refused_before_anything_is_asked(bench: Bench, asked: GapOptions) -> None:
    with pytest.raises(InputError) as caught:
        events(asked, GapDriveOptions(other_vehicle.BENCH, "virtual"))
    assert caught.value.code == "bench_of_other_vehicle" and caught.value.key == "--bench" and bench.asked == []


def test_without_names_there_is_nothing_to_tell_apart(bench: Bench, asked: GapOptions, wish: GapDriveOptions) -> None:
    with pytest.raises(InputError, match="names no effects"):
        events(asked._replace(until="locate"), wish)


def test_the_first_answer_that_is_kept_is_this_ones(bench: Bench, asked: GapOptions, wish: GapDriveOptions) -> None:
    """Asked up to a name before, and to the end now."""
    bench.says = {1: verdict("set"), 2: verdict("one")}
    events(asked._replace(until="name"), wish)
    assert json.loads((asked.out / "gap-1.json").read_text())["until"] == "name"
    (asked.out / "gap.json").unlink()  # as one that goes less far is made again by `gap`
    events(asked, wish)
    assert json.loads((asked.out / "gap-1.json").read_text())["until"] == "verify"

"""gap: logs in, an answer, a repaired model and its proof out; what was kept is not searched for again."""

from __future__ import annotations

import json
import shutil
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from tests import other_vehicle
from tests.gap.made_answer import SECONDS, VEHICLE, candidate, late_drive, made_kept, made_model
from tests.learn.made_drives import made_drive
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.config.load import load_model
from tunefree_hil.gap.result import SearchResult
from tunefree_hil.jobs.gap import gap as module
from tunefree_hil.jobs.gap import report_figures
from tunefree_hil.jobs.gap.folder import ANSWER, PAGE, QUESTION
from tunefree_hil.jobs.gap.gap import _compare_with_older_logs, run_gap
from tunefree_hil.jobs.gap.options import GapOptions
from tunefree_hil.learn.drives.drive import Drive

FIELDS = {
    "schema", "verdict", "effects", "set", "separate_by", "where", "signals", "explained_frac", "excitation",
    "absorbed", "model", "figures", "elapsed_s", "log_hash", "model_hash", "version", "forced", "closed_loop",
}  # fmt: skip


DRAW = report_figures.draw_figures
pytestmark = pytest.mark.slow  # free runs of a car, un-jitted


class Search:
    """In the place of the search: what it gives, how often it was asked, and what the log files hold."""

    def __init__(self) -> None:
        self.kept, self.asked = made_kept(), 0
        self.drives: dict[str, Drive] = {"late.log": late_drive()}
        self.older = made_drive(SECONDS, seed=7, name="before.log")

    def searched(self, *_: Any) -> Generator[Event, None, SearchResult]:
        self.asked += 1
        yield Event("progress", "suspects", {"label": "search", "done": 1, "total": 2})
        return self.kept

    def read(self, logs: Sequence[Path], *_: Any) -> list[Drive]:
        return [self.older if path.name == "before.log" else self.drives[path.name] for path in logs]


@pytest.fixture
def search(monkeypatch: pytest.MonkeyPatch) -> Search:
    """The made answer instead of a search of a minute; no pictures."""
    found = Search()
    monkeypatch.setattr(report_figures, "draw_figures", lambda *_: [])
    monkeypatch.setattr(module, "_run_search", found.searched)
    monkeypatch.setattr("tunefree_hil.learn.drives.read.read_drives", found.read)
    monkeypatch.setattr(module, "load_checked_model", lambda *_: replace(made_model(), hash="a model"))
    return found


def asked(tmp_path: Path, **more: Any) -> GapOptions:
    return GapOptions([Path("late.log")], VEHICLE.folder, "mkz_nominal", tmp_path / "out")._replace(**more)


def result(one: GapOptions) -> dict[str, Any]:
    last = list(run_gap(one))[-1]
    assert last.kind == "result"
    return last.data


def test_what_is_missing_is_named_repaired_and_proved(
    search: Search, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report_figures, "draw_figures", DRAW)
    data = result(asked(tmp_path))
    out = tmp_path / "out"
    written = json.loads((out / ANSWER).read_text())
    assert written.keys() >= FIELDS and written["schema"] == "tunefree.gap/1" and data["exit"] == 0
    assert data["sentence"].startswith("steer_dead_time (delay_s 0.070 s (0.069 to 0.071)) is missing; it closes 100 %")
    model = load_model(out / "model")
    assert [one.name for one in model.effects] == ["steer_dead_time"] and written["model"] == model.folder
    steer = written["signals"]["report.steer_rad"]
    assert steer["floor"] <= steer["after"] < 0.05 * steer["recalibrated"] < steer["before"]
    assert written["explained_frac"]["low"] <= written["explained_frac"]["value"] > 0.9
    assert data["next"][-1].endswith(f"--model {model.folder}") and "tunefree-hil drive" in data["next"][-1]
    names = {Path(path).name for path in written["figures"]}
    assert names == {"where.png", "evidence.png", "shrink.png", "traces.png", "signature.png"}
    assert all(Path(path).read_bytes()[:4] == b"\x89PNG" for path in written["figures"])
    assert "![How the gap shrinks](figures/shrink.png)" in (out / PAGE).read_text()


def test_the_page_begins_with_the_sentence_and_shows_recalibration_alone(search: Search, tmp_path: Path) -> None:
    data = result(asked(tmp_path))
    page = (tmp_path / "out" / PAGE).read_text()
    assert page.splitlines()[0] == f"# {data['sentence']}"
    assert "| recalibration only | repaired | floor |" in page
    assert "brake_fade: 2 brakings by 3 m/s or more, 12 are needed" in page
    assert "| 97 %; 95 % on the holdout blocks |" in page
    assert "`effects.steer_dead_time.delay_s`" in page


def test_the_page_counts_what_the_search_rejected_and_shows_the_strongest(search: Search, tmp_path: Path) -> None:
    entries = [
        rejection(f"effect_{number}", criterion, stage, float(number))
        for number in range(40)
        for criterion, stage in (("screened", "screening"), ("evidence", "forward"), ("error_reduction", "forward"))
    ]
    candidates = [candidate(f"effect_{number}", float(number), False) for number in range(40)]
    search.kept = made_kept(reasons=[{"name": "", "criterion": "nothing_broken"}, *entries], candidates=candidates)
    result(asked(tmp_path))
    page = (tmp_path / "out" / "gap.md").read_text()
    verdict, _, rejected = page.partition("## Rejected candidates")
    assert "nothing broken" in verdict and "effect_3 added" not in verdict
    rejected = rejected.partition("\n## ")[0]
    assert "| is not fitted | 40 | 40 |" in rejected and "| added | 40 | 80 |" in rejected
    shown = [line for line in rejected.splitlines() if line.startswith("- ")]
    assert [line.split()[1] for line in shown] == [f"effect_{number}" for number in (39, 38, 37, 36, 35)]
    assert shown[0] == "- effect_39 added beside grade: its evidence is 39 nats, more than 60 are needed"


def rejection(name: str, criterion: str, stage: str, value: float) -> dict[str, Any]:
    return {"name": name, "criterion": criterion, "value": value, "limit": 60.0, "stage": stage, "beside": ["grade"]}


def test_the_page_says_what_of_recalibration_was_left_and_what_could_have_been_foretold(
    search: Search, tmp_path: Path
) -> None:
    spoilt = {**search.kept.repaired_values, "brake_gain.gain_frac": 1.3}
    search.kept = search.kept._replace(predictable_shares={"steer": 0.1, "yaw_rate": 0.2}, repaired_values=spoilt)
    search.kept.answer["moved"] = ["recalibration moves brake_gain.gain_frac by -2.9 standard deviations"]
    data = result(asked(tmp_path))
    page = (tmp_path / "out" / PAGE).read_text()
    assert "| repaired | of that, unpredictable | floor |" in page
    assert "Of the part that these logs allow to predict: " in page and data["explicable_frac"]
    assert data["does_not_pay"] == ["along"]
    assert (
        "Recalibration leaves the longitudinal parameters unchanged: moving them does not improve the selection" in page
    )
    assert "- recalibration moves brake_gain.gain_frac by -2.9" in page


def test_a_run_that_was_cut_off_goes_on_without_another_search(search: Search, tmp_path: Path) -> None:
    result(asked(tmp_path))
    out = tmp_path / "out"
    before = json.loads((out / ANSWER).read_text())
    (out / ANSWER).unlink()
    (out / "model" / "model.toml").write_text("half of it")  # killed while it wrote
    (out / "part-77-model").mkdir()
    data = result(asked(tmp_path))
    assert not list(out.glob("part-*"))
    after = json.loads((out / ANSWER).read_text())
    assert search.asked == 1 and data["verdict"] == "one"
    assert {**before, "elapsed_s": 0.0} == {**after, "elapsed_s": 0.0} and after["elapsed_s"] >= 12.5


def test_what_was_answered_is_said_again_and_not_made_again(search: Search, tmp_path: Path) -> None:
    first = result(asked(tmp_path))
    text = (tmp_path / "out" / ANSWER).read_bytes()
    again = result(asked(tmp_path))
    assert again == first and (tmp_path / "out" / ANSWER).read_bytes() == text and search.asked == 1


def test_a_folder_of_another_question_is_refused(search: Search, tmp_path: Path) -> None:
    result(asked(tmp_path, until="name"))
    search.drives["late.log"] = late_drive()._replace(log_hash="sha256:other")
    with pytest.raises(InputError, match="another question: logs"):
        result(asked(tmp_path))


def test_a_model_that_is_gone_is_made_and_proved_again(search: Search, tmp_path: Path) -> None:
    first = result(asked(tmp_path))
    shutil.rmtree(tmp_path / "out" / "model")
    (tmp_path / "out").rename(tmp_path / "moved")
    events = list(run_gap(asked(tmp_path, out=tmp_path / "moved")))
    assert any("is gone: it is made and verified again" in one.message for one in events if one.kind == "warning")
    assert search.asked == 1 and events[-1].data["model"] == str(tmp_path / "moved" / "model")
    assert load_model(tmp_path / "moved" / "model").effects and events[-1].data["signals"] == first["signals"]


def test_what_is_cut_off_says_by_which_command_it_goes_on_and_whether_anything_is_kept(
    search: Search, tmp_path: Path
) -> None:
    for stage, saved in (("suspects", False), ("verification", True)):  # the second run finds the search
        search.asked = 0
        said = next(one for one in run_gap(asked(tmp_path, workers=1)) if stage in one.message)
        assert said.data["saved"] is saved and said.data["resume"].endswith("--workers 1")
        if not saved:
            result(asked(tmp_path, until="name"))
    assert search.asked == 0


def test_an_older_log_that_is_asked_about_is_refused(search: Search, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"has the same content as late\.log") as caught:
        result(asked(tmp_path, older=[Path("before.log"), Path("late.log")]))
    assert (caught.value.file, caught.value.key) == ("late.log", "--older") and not (tmp_path / "out").exists()


def test_a_copy_of_a_log_is_refused_as_it_would_prove_what_is_fitted_on_it(search: Search, tmp_path: Path) -> None:
    search.drives["copy.log"] = late_drive()._replace(name="copy.log")
    with pytest.raises(InputError, match=r"has the same content as late\.log") as caught:
        result(asked(tmp_path, logs=[Path("late.log"), Path("copy.log")]))
    assert (caught.value.file, caught.value.key) == ("copy.log", "LOG") and not (tmp_path / "out").exists()


def test_a_folder_that_holds_something_else_is_refused_before_anything_is_read(search: Search, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("kept")
    with pytest.raises(InputError, match="exists already"):
        next(run_gap(asked(tmp_path)))
    assert not (tmp_path / "out" / QUESTION).exists()


@pytest.mark.parametrize(("until", "model"), [("name", False), ("repair", True)])
def test_it_stops_where_it_is_told_to(until: str, model: bool, search: Search, tmp_path: Path) -> None:
    data = result(asked(tmp_path, until=until))
    assert data["until"] == until and data["signals"] == {} and bool(data["model"]) is model
    assert (tmp_path / "out" / "model").exists() is model
    assert not data["next"][-1].endswith(until)
    assert result(asked(tmp_path))["signals"] and search.asked == 1, "the same folder goes on to the proof"


def test_an_older_log_that_gets_worse_keeps_the_model_from_being_saved(search: Search, tmp_path: Path) -> None:
    data = result(asked(tmp_path, older=[Path("before.log")]))
    assert data["exit"] == 1 and data["verdict"] == "one" and data["model"] is None
    assert not (tmp_path / "out" / "model").exists()
    assert any("report.steer_rad of before.log" in words for words in data["worse"])
    assert "no model is written, as it would make" in data["sentence"]
    (older,) = data["older"]
    assert older["signals"]["report.steer_rad"]["after"] > 10.0 * older["signals"]["report.steer_rad"]["before"]
    assert "recorded before the effect appeared" in (tmp_path / "out" / PAGE).read_text()


def test_an_older_log_with_the_effect_is_no_obstacle(search: Search, tmp_path: Path) -> None:
    search.older = late_drive(SECONDS, 9)
    data = result(asked(tmp_path, older=[Path("before.log")]))
    assert data["exit"] == 0 and data["worse"] == [] and data["model"]


def test_an_older_log_of_another_car_is_told_and_may_be_the_effect(search: Search, tmp_path: Path) -> None:
    yaws = {name: 0.4 * search.older.fields[name] for name in ("report.yaw_rate_radps", "ins.yaw_rate_radps")}
    turns = {**yaws, "ins.heading_rad": 0.4 * search.older.fields["ins.heading_rad"]}
    other = search.older._replace(fields={**search.older.fields, **turns})
    said = list(_compare_with_older_logs([search.drives["late.log"]], [other]))
    assert len(said) == 1 and said[0].startswith("before.log (--older) turns 0.") and "in between" in said[0]
    assert list(_compare_with_older_logs([search.drives["late.log"]], [search.older])) == []


def test_a_set_writes_no_model_and_says_what_to_drive(search: Search, tmp_path: Path) -> None:
    names = ["steer_dead_time", "report_latency"]
    search.kept = made_kept("set", set=names, separate_by="steps of the steering")
    data = result(asked(tmp_path))
    assert data["model"] is None and data["effects"] == [] and data["explained_frac"] is None
    assert "one of steer_dead_time and report_latency is missing" in data["sentence"]
    assert "NEXT.log" in data["next"][-1] and f"{tmp_path / 'out'}-2" in data["next"][-1]
    assert "Drive steps of the steering" in (tmp_path / "out" / PAGE).read_text()
    assert data["signals"]["report.steer_rad"]["after"] is None


def test_where_nothing_is_missing_it_says_what_a_calibration_would_do(search: Search, tmp_path: Path) -> None:
    late = {"actuator.steer.dead_time_s": 0.07}
    search.kept = made_kept("none_missing")._replace(recalibrated_values=late, repaired_values=late)
    data = result(asked(tmp_path))
    assert data["model"] is None and not (tmp_path / "out" / "model").exists()
    assert "report.steer_rad" in data["recalibration"] and "`calibrate` on these logs" in data["sentence"]
    assert data["next"][-1].startswith("tunefree-hil calibrate late.log")
    assert "could not have shown brake_fade" in data["sentence"]


def test_another_model_is_refused_with_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a model of 'mkz_bywire'"):
        next(run_gap(asked(tmp_path, vehicle=other_vehicle.NAME)))


@pytest.mark.parametrize("stop", [0.15, 0.08])
def test_a_sensor_at_its_stop_is_left_out_with_a_warning(stop: float, search: Search, tmp_path: Path) -> None:
    """However much of it is cut off: held against the INS it would be a wrong unit."""
    drive, name = late_drive(), "report.yaw_rate_radps"
    search.drives["late.log"] = drive._replace(fields={**drive.fields, name: np.clip(drive.fields[name], -stop, stop)})
    events = list(run_gap(asked(tmp_path)))
    assert any(
        one.kind == "warning" and f"{name} is at the end of its range, {stop:.4g}" in one.message for one in events
    )
    assert name not in events[-1].data["signals"] and "ins.yaw_rate_radps" in events[-1].data["signals"]


@pytest.mark.parametrize("until", ["name", "repair"])
def test_before_the_proof_nothing_is_said_of_its_blocks(until: str, search: Search, tmp_path: Path) -> None:
    """And what goes on is the proof, even where the search knows that those blocks do not show it."""
    search.kept = made_kept(effects=[{**one, "unseen_stirs": 0.0} for one in made_kept().answer["effects"]])
    data = result(asked(tmp_path, until=until))
    (one,) = data["effects"]
    assert one["unseen_shrink"] is None and one["unseen_stirs"] is None and one["shrink"] == 0.97
    assert "another drive" not in data["sentence"] and "NEXT.log" not in data["next"][-1]
    assert data["next"][-1].startswith("tunefree-hil gap late.log")
    (one,) = result(asked(tmp_path))["effects"]
    assert one["unseen_shrink"] == 0.95


def test_one_log_of_several_that_says_no_speed_is_left_out(search: Search, tmp_path: Path) -> None:
    drive = late_drive()
    fields = {name: values for name, values in drive.fields.items() if "speed" not in name and "ins." not in name}
    search.drives["mute.log"] = drive._replace(name="mute.log", fields=fields, log_hash="sha256:mute")
    search.older = search.drives["mute.log"]._replace(name="before.log", log_hash="sha256:before")
    logs = [Path("late.log"), Path("mute.log")]
    events = list(run_gap(asked(tmp_path, logs=logs, older=[Path("before.log")])))
    data, said = events[-1].data, "mute.log holds no speed and is left out"
    assert any(one.kind == "warning" and one.message == said for one in events) and said in data["words"]
    assert [one["name"] for one in data["logs"]] == ["late.log"] and data["model"] and data["older"] == []
    alone = result(asked(tmp_path, logs=[Path("mute.log")], out=tmp_path / "alone"))
    assert alone["verdict"] == "cannot_test"
    assert alone["reasons"] == [{"name": "", "criterion": "no_motion"}]
    left_out = [entry["signal"] for entry in data["reasons"] if entry["criterion"] == "log_without_speed"]
    assert left_out == ["mute.log", "before.log"]


def test_an_older_log_that_says_no_speed_takes_no_log_of_the_same_name_with_it(search: Search, tmp_path: Path) -> None:
    """Every log of a run folder has the same name."""
    drive = late_drive()
    fields = {name: values for name, values in drive.fields.items() if "speed" not in name and "ins." not in name}
    search.older = drive._replace(fields=fields, log_hash="sha256:mute")
    data = result(asked(tmp_path, older=[Path("before.log")]))
    assert search.older.name == "late.log" and data["verdict"] == "one" and data["older"] == []

"""The rows of the exam, the oracle, and a whole small exam with a program that answers by rule: run, killed, scored."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import pytest

from tests.house import ROOT
from tests.tools.gap_exam.drives_for_tests import DOMAIN, vehicle
from tools.gap_exam import cases, report, score
from tools.gap_exam.call import call
from tools.gap_exam.catalogue import EFFECTS, OUTSIDE, kind_of
from tools.gap_exam.driver import CONTROLLER
from tools.gap_exam.files import Run, read_json
from tools.gap_exam.hidden import hidden_of
from tools.gap_exam.oracle import detect
from tools.gap_exam.outcomes import OUTCOMES
from tools.gap_exam.prepare import Frozen, begin, truths_hash
from tools.gap_exam.rows import POOL, Counts, exam_of, sample_of
from tools.gap_exam.seeds import Domain
from tools.gap_exam.session import Wish, chosen, standing

COMMIT = "0123456789" * 4
SMALL = Counts(one=0, free=4, outside=0, two=2, start_b=0, start_c=0, start_d=0, limits=0)


# --- what is asked ------------------------------------------------------------------------------------------------


def test_the_rows_are_those_of_the_issue() -> None:
    exam = exam_of(Domain("exam", COMMIT))
    count = Counter(case.row for case in exam.cases)
    assert count["one"] == 42 * 7 >= 240 and count["free"] >= 300 and count["outside"] == 48
    assert count["two_other"] + count["two_same"] >= 60
    assert count["start_b"] >= 60 and count["start_c"] >= 60 and count["start_d"] >= 24 and count["semi"] >= 48
    assert count["limits"] + count["one"] >= 12 * 42 and count["semi_free"] == 4
    assert [case.number for case in exam.cases] == list(range(len(exam.cases)))
    assert len({case.seed for case in exam.cases}) == len(exam.cases)
    for name in EFFECTS:
        mine = [case for case in exam.cases if case.row == "one" and list(case.effects) == [name]]
        assert len({case.vehicle for case in mine}) == 7, "another vehicle each time"
        steps = [case for case in exam.cases if case.row == "limits" and list(case.effects) == [name]]
        assert len({case.vehicle for case in steps}) == len(steps) and len(steps) + len(mine) >= 12
        assert Counter(case.rung for case in steps) == dict.fromkeys(range(3), 3)
    for name in OUTSIDE:
        assert sum(list(case.effects) == [name] for case in exam.cases) == 6
    for case in exam.cases:
        if case.row.startswith("two"):
            subsystems = {kind_of(name).subsystem for name in case.effects}
            assert len(case.effects) == 2 and len(subsystems) == (1 if case.row == "two_same" else 2)


def test_starting_points_have_the_models_they_need() -> None:
    exam = exam_of(Domain("exam", COMMIT))
    for case in exam.cases:
        if case.source:
            continue
        model = exam.models[case.model]
        assert model.vehicle == case.vehicle and 0 <= case.vehicle < POOL
        with_effect = [bool(spec.effects) for spec in model.logs]
        assert all(with_effect) == (case.row in ("start_b", "start_d"))
        assert (model.kind == "hybrid") == (case.row in ("start_c", "start_d"))
        if case.row in ("start_b", "start_d"):
            assert all(spec.effects == case.effects for spec in model.logs)
        assert case.seed not in {spec.seed for spec in model.logs}
    assert not [name for name in exam.models if not name.startswith("m")], "names say nothing"


def test_half_of_the_effect_free_logs_have_a_background_mismatch() -> None:
    free = [case.vehicle for case in exam_of(Domain("exam", COMMIT)).cases if case.row == "free"]
    shares = Counter(cases.MISMATCHES[number % len(cases.MISMATCHES)] for number in free)
    assert abs(shares[0.0] - len(free) / 2) <= 6 and shares[0.02] > 60 and shares[0.05] > 60


def test_an_exam_is_its_domain_and_nothing_else() -> None:
    one, same = exam_of(Domain("exam", COMMIT)), exam_of(Domain("exam", COMMIT))
    assert truths_hash(one) == truths_hash(same) != truths_hash(exam_of(Domain("dev", "a")))
    vehicles = [
        cases.vehicle_of(domain, 0).car for domain in (Domain("exam", COMMIT), Domain("dev", "a"), Domain("dev", "b"))
    ]
    assert len(set(vehicles)) == 3
    values = [draw for case in one.cases if case.row == "one" for draw in case.effects.values()]
    assert len({json.dumps(value) for value in values}) > 240, "values are drawn, not taken off a grid"


def test_the_sample_is_24_effects() -> None:
    sample = sample_of(Domain("dev", "ci"))
    assert len({tuple(case.effects) for case in sample.cases}) == len(sample.cases) == 24
    assert len(sample.models) <= 4


# --- what can be found ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_oracle_knows_gross_from_slight_and_nothing() -> None:
    def removed(effects: cases.Effects, number: int = 0) -> float:
        return detect(cases.make(vehicle(number), effects, "excited", CONTROLLER, 21, 80.0)).removed

    assert removed({}) == 0.0
    assert removed({"steer_dead_time": {"delay_s": 0.2}}) > 0.3
    assert removed({"brake_gain": {"gain_frac": 1.004}}) < 0.05, "recalibration takes it"
    assert removed({"brake_gain": {"gain_frac": 1.4}}) > 0.3
    assert removed({"yaw_rate_bias": {"bias_radps": 0.02}}, 3) > 0.1
    loss = {"frame_loss": {"burst_s": 0.5, "bursts_per_s": 0.4}}
    assert removed(loss) > 0.05


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_what_a_calibration_has_taken_in_is_no_effect_any_more() -> None:
    """A wide recalibration holds a rate limit and a gain, and no backlash; a tight one holds none of them."""
    for name, value, stays in (
        ("throttle_rate_limit", 0.2, False),
        ("brake_gain", 1.3, False),
        ("powertrain_lag", 0.4, False),
        ("steer_backlash", 0.2, True),
    ):
        made = cases.make(vehicle(), {name: {kind_of(name).parameter: value}}, "excited", CONTROLLER, 21, 80.0)
        assert detect(made).detectable and detect(made, wide=True).detectable == stays, name


@pytest.mark.slow
def test_an_effect_beside_another_is_judged_by_what_it_adds() -> None:
    gross = {"steer_rate_limit": {"rate_radps": 0.7}}
    both = {**gross, "brake_gain": {"gain_frac": 1.3}}
    made = cases.make(vehicle(), both, "excited", CONTROLLER, 21, 80.0)
    assert detect(made, known=hidden_of(gross)).removed > 0.05
    never_met = {**both, "steer_saturation": {"limit_rad": 7.0}}
    met = cases.make(vehicle(), never_met, "excited", CONTROLLER, 21, 80.0)
    assert not detect(met, known=hidden_of(both)).detectable, "a limit that nothing reaches"


# --- a whole exam -----------------------------------------------------------------------------------------------------

PROGRAM = """
import json, pathlib, sys, time
log, vehicle, model, out = sys.argv[1:]
assert (pathlib.Path(vehicle) / "vehicle.dbc").is_file() and (pathlib.Path(model) / "model.toml").is_file()
folder = pathlib.Path(out); folder.mkdir()
text = pathlib.Path(log).read_text()
assert text.count("\\n") > 10000
number = int(pathlib.Path(log).parent.name)
with open(pathlib.Path(__file__).with_name("called"), "a") as called: called.write(f"{number}\\n")
time.sleep(PAUSE)
answers = [{"verdict": "none_missing"}, {"verdict": "one", "effects": [{"name": "payload", "params": {}}]},
           {"verdict": "cannot_test"}]
if number % 4 == 3: sys.exit("no idea")
(folder / "gap.json").write_text(json.dumps({"effects": [], "set": [], "elapsed_s": 1.5, **answers[number % 4]}))
"""
MODEL = "import pathlib, sys; p = pathlib.Path(sys.argv[-1]); p.mkdir(); (p / 'model.toml').write_text('')"


EXAM = exam_of(DOMAIN)


def asked_for() -> list[int]:
    """What `words` asks for: the first four of a part of the pairs."""
    return [case.number for case in chosen(EXAM, Wish(Path("unused"), rows=("two",), part="1/4", logs=4))]


def words(folder: Path, pause: float = 0.0) -> list[str]:
    (folder / "program.py").write_text(PROGRAM.replace("PAUSE", str(pause)))
    (folder / "model.py").write_text(MODEL)
    rows = ["--domain", "dev:tests", "--rows", "two", "--run", str(folder / "run"), "--parallel", "2"]
    gap = f"{sys.executable} {folder / 'program.py'} {{log}} {{vehicle}} {{model}} {{out}}"
    calibrate = f"{sys.executable} {folder / 'model.py'} {{logs}} {{out}}"
    return [
        sys.executable,
        "-m",
        "tools.gap_exam",
        "run",
        *rows,
        "--gap",
        gap,
        "--calibrate",
        calibrate,
        "--part",
        "1/4",
        "--logs",
        "4",
    ]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_an_exam_is_run_killed_gone_on_with_and_scored(tmp_path: Path) -> None:
    """kill -9 in the middle: what is answered stays, what is not is asked again, nothing twice into the answers."""
    process = subprocess.Popen(
        words(tmp_path, 0.3), cwd=ROOT, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    answers = tmp_path / "run" / "answers"
    deadline = time.monotonic() + 120.0
    while len(list(answers.glob("*/run.json"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    process.stderr.close()
    before = {path: path.read_bytes() for path in answers.glob("*/run.json")}
    assert len(before) >= 2
    done = subprocess.run(words(tmp_path), cwd=ROOT, capture_output=True, text=True, timeout=110)
    assert done.returncode == 0, done.stderr
    assert "h left" in done.stderr
    assert all(path.read_bytes() == text for path, text in before.items()), "answers stay as they are"
    assert len(list(answers.glob("*/run.json"))) == len(asked_for()) >= 4
    assert not list((tmp_path / "run" / "cases").glob("*/drive.log")), "answered questions are taken away"
    asked = Counter((tmp_path / "called").read_text().split())
    assert len(asked) == len(asked_for()) and sum(asked.values()) <= len(asked) + 2 + 2

    run = Run(tmp_path / "run")
    marked = score.marked(run, range(read_json(run.exam)["cases"]))
    assert len(marked) == len(asked_for())
    stand = standing(run)
    assert stand["done"] == f"{len(marked)} of {len(EXAM.cases)} done" and not stand["whole"]
    assert stand["rows_done"]["one"] == "0 of 294"
    rows = score.table(marked)
    assert {row.name.removesuffix(", each detectable") for row in rows} == {
        "two effects, other subsystems", "two effects, same subsystem"
    }  # fmt: skip
    for row in rows:
        assert sum(row.outcomes.values()) == row.n and set(row.outcomes) == set(OUTCOMES)
    for one in marked:
        if one.number % 4 == 3:
            assert one.mark.outcome == "failed" and "no idea" in read_json(run.answer(one.number) / "run.json")["words"]
    written = report.write_report(tmp_path / "report", rows, [], score.false_names(marked), "dev:tests")
    assert all(path.stat().st_size > 200 for path in written)

    again = subprocess.run([*words(tmp_path), "--domain", "dev:other"], cwd=ROOT, capture_output=True, text=True)
    assert again.returncode == 2 and "another domain" in again.stderr, "one folder, one frozen exam"


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_an_interrupt_ends_what_is_under_way_and_counts_none_of_it(tmp_path: Path) -> None:
    process = subprocess.Popen(words(tmp_path, 90.0), cwd=ROOT, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 90.0
    while not (tmp_path / "called").is_file() and time.monotonic() < deadline:
        time.sleep(0.1)
    begun = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60.0)
    assert process.returncode == 130 and "the same call goes on" in said
    assert time.monotonic() - begun < 45.0 and not list((tmp_path / "run").glob("answers/*/run.json"))


@pytest.mark.slow
def test_a_program_that_hangs_is_ended_with_all_that_it_started() -> None:
    begun = time.monotonic()
    done = call("sh -c 'sleep 60 & echo begun; sleep 60' {log}", 0.5, log="x")
    assert done.status is None and done.stdout == "begun\n" and time.monotonic() - begun < 20.0
    words = call(
        f"{sys.executable} -c 'import sys; print(sys.argv[1:])' {{logs}} --out {{out}}",
        60.0,
        logs=["a b", "c"],
        out="o",
    )
    assert words.stdout == "['a b', 'c', '--out', 'o']\n" and words.status == 0


def test_a_run_belongs_to_one_exam(tmp_path: Path) -> None:
    run, exam = Run(tmp_path), exam_of(DOMAIN, SMALL, ("free", "two"))
    begin(run, exam)
    begin(run, exam)
    with pytest.raises(Frozen, match="truths"):
        begin(run, exam_of(DOMAIN, SMALL._replace(free=5), ("free", "two")))
    text = run.exam.read_text()
    assert not [name for name in EFFECTS if name in text], "what is public says nothing of the answers"

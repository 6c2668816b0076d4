"""The measure `samplers`: processes of optimisers, rows that survive a kill, and what is compared with what."""

from __future__ import annotations

import importlib
import json
import math
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.house import ROOT
from tools.measures import _sampler_peers as peers
from tools.measures import _sampler_runs as runs
from tools.measures import samplers as measure
from tools.measures._sampler_runs import Problem, Row, RowFile, RunEnd, RunJob, SamplerRun
from tunefree_hil.base.errors import InputError, PeerGone
from tunefree_hil.tune.sampling.points import to_unit
from tunefree_hil.tune.store import exclusive_lock

BENCH = str(ROOT / "bench_configs" / "mkz_complete.toml")
RUN = SamplerRun("cmaes", 7, 4, 0, 12)
FIRST = [0.4] * 5


@pytest.fixture(scope="module")
def problem() -> Problem:
    return runs.load_problem(BENCH, "complete")


def distance(point: Sequence[float]) -> float:
    return 0.1 + sum((share - 0.7) ** 2 for share in point)


def search_peer(method: str, count: int, generations: int, sign: float = 1.0) -> list[list[float]]:
    """Points of a peer in a process of this environment."""
    command = [sys.executable, "-s", "-P", str(runs.HERE / "_sampler_peers.py")]
    message = {"method": method, "seed": 3, "in_flight": count, "budget": 60, "first": FIRST}
    points, scores = list[list[float]](), list[float]()
    with runs.open_optimiser(command, message, method) as optimiser:
        for _ in range(generations):
            answer = optimiser.send({"scores": scores, "count": count})
            assert len(answer["points"]) == count and answer["cpu_s"] >= 0.0
            points += answer["points"]
            scores = [5.0 + sign * distance(point) for point in answer["points"]]
    return points


@pytest.mark.slow
@pytest.mark.parametrize("method", ["cmaes", "optuna_tpe", "optuna_cma"])
@pytest.mark.parametrize("count", [1, 6])
def test_a_peer_begins_with_the_first_point_learns_and_repeats_itself(method: str, count: int) -> None:
    points = search_peer(method, count, 60 // count)
    assert points[0] == FIRST and all(0.0 <= share <= 1.0 for point in points for share in point)
    assert search_peer(method, count, 60 // count) == points
    away = search_peer(method, count, 60 // count, sign=-1.0)
    early, late = slice(1, 6), slice(-18, None)
    assert away[:1] == points[:1] and away != points
    assert np.mean([distance(p) for p in points[late]]) < np.mean([distance(p) for p in away[late]])
    assert len({tuple(point) for point in points[early]}) == 5


@pytest.mark.slow
@pytest.mark.parametrize("method", ["optuna_gp", "botorch"])
def test_a_peer_with_a_gaussian_process_finds_the_minimum(method: str) -> None:
    for module in ("torch", "botorch"):
        pytest.importorskip(module)
    points = search_peer(method, 3, 12)
    assert points[0] == FIRST and len({tuple(np.round(point, 6)) for point in points}) == len(points)
    assert min(distance(point) for point in points[-9:]) < 0.5 * (distance(FIRST) + 0.1)


def test_an_optimiser_that_ends_says_why() -> None:
    command = [sys.executable, "-c", "import sys; sys.stderr.write('no memory left'); sys.exit(3)"]
    lost = pytest.raises(PeerGone, match=r"smac, seed 1 has ended\n +no memory left")
    with lost as caught, runs.open_optimiser(command, {"method": "smac"}, "smac, seed 1"):
        pass
    assert caught.value.code == "optimiser_lost" and "--methods" in caught.value.hint


def test_an_optimiser_ends_with_its_parent_in_the_middle_of_a_suggestion() -> None:
    code = (
        "import sys, time; from tools.measures._sampler_peers import serve; "
        "busy = type('Busy', (), {'ask': lambda self, count: time.sleep(60)}); serve(lambda message: busy(), [])"
    )
    process = subprocess.Popen([sys.executable, "-c", code], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdin is not None and process.stdout is not None
    process.stdin.write(b'{}\n{"scores": [], "count": 1}\n')
    process.stdin.flush()
    assert json.loads(process.stdout.readline()) == {"versions": {}}
    process.stdin.close()
    assert process.wait(20.0) == 0
    process.stdout.close()


def test_what_an_optimiser_leaves_behind_goes_with_it() -> None:
    code = "import json, sys, tempfile; a = json.dumps(tempfile.mkdtemp()); [print(a, flush=True) for _ in sys.stdin]"
    with runs.open_optimiser([sys.executable, "-c", code], {}, "smac") as optimiser:
        folder = Path(str(optimiser.send({})))
        assert folder.is_dir()
    assert not folder.exists()


def test_an_optimiser_that_hangs_is_ended() -> None:
    command = [sys.executable, "-c", "import sys, time; print('waits', file=sys.stderr, flush=True); time.sleep(60)"]
    lost = pytest.raises(PeerGone, match="nevergrad has not answered for 1 s")
    with lost as caught, runs.open_optimiser(command, {}, "nevergrad", patience_s=0.6):
        pass
    assert "waits" in caught.value.message


@pytest.mark.slow
def test_the_process_of_the_product_suggests_what_tune_suggests(problem: Problem) -> None:
    from tunefree_hil.tune.store import StudySettings
    from tunefree_hil.tune.trial import Evaluation
    from tunefree_hil.tune.trial_loop import run_generations

    class MemoryOnly:
        """A study that is nowhere stored."""

        def __init__(self, settings: StudySettings) -> None:
            self.settings, self.filled = settings, list[Any]()

        def trials(self) -> list[Any]:
            return self.filled

        def lock(self) -> Any:
            return importlib.import_module("contextlib").nullcontext()

        def begin(self, points: Any) -> None:
            del points

        def end(self, begun: Any, points: Mapping[int, Any], outcomes: Mapping[int, Any]) -> list[Any]:
            del begun
            trial = importlib.import_module("tunefree_hil.tune.trial").Trial
            return [trial(slot, slot, points[slot], one.score, {}) for slot, one in outcomes.items()]

    def score(values: Mapping[str, float]) -> float:
        return distance(to_unit(problem.space, dict(values)).tolist())

    run = RUN._replace(method="tpe_independent", trials=24)
    settings = StudySettings(problem.space, run.seed, run.method, "measured", problem.first, run.in_flight)
    study = MemoryOnly(settings)
    expected = run_generations(
        study, run.trials, lambda points: [Evaluation(score(values), {}) for values in points.values()]
    )
    points, scores = list[Any](), list[float]()
    with runs.start_optimiser(run, problem) as optimiser:
        while len(points) < run.trials:
            answer = optimiser.send({"scores": scores, "count": run.in_flight})
            asked = [dict(zip(problem.space.names, point, strict=True)) for point in answer["points"]]
            points, scores = points + asked, [score(values) for values in asked]
    assert points == [trial.parameters for trial in expected] and points[0] == problem.first


class ScriptedOptimiser:
    """Points by a rule of the number of the generation and of the scores of the one before."""

    def __init__(self, shift: float = 0.0, from_generation: int = 99) -> None:
        self.generation, self.shift, self.from_generation = 0, shift, from_generation

    def send(self, message: Mapping[str, Any]) -> dict[str, Any]:
        base = 0.05 * self.generation + 0.01 * sum(message["scores"])
        base += self.shift if self.generation >= self.from_generation else 0.0
        self.generation += 1
        return {"points": [[base + 0.01 * (k % 3)] * 11 for k in range(message["count"])], "cpu_s": 0.4}


class CountedScore:
    """A score by the values; it fails after `most` points."""

    def __init__(self, problem: Problem, most: int = 1000) -> None:
        self.problem, self.most, self.count = problem, most, 0

    def __call__(self, points: Sequence[Mapping[str, float]]) -> list[float]:
        self.count += len(points)
        if self.count > self.most:
            raise KeyboardInterrupt
        return [distance(to_unit(self.problem.space, dict(values))[:2].tolist()) for values in points]


def search(
    path: Path, problem: Problem, optimiser: ScriptedOptimiser, most: int = 1000, until_s: float = math.inf
) -> CountedScore:
    score, job = CountedScore(problem, most), RunJob(RUN, BENCH, "complete", path, until_s)
    runs.search_rows(job, problem, score, optimiser, RowFile(path))  # type: ignore[arg-type]
    return score


def test_every_trial_is_a_row(tmp_path: Path, problem: Problem) -> None:
    path = tmp_path / "a.jsonl"
    assert search(path, problem, ScriptedOptimiser()).count == 12
    rows = list(runs.read_rows(path))
    assert [row["k"] for row in rows] == list(range(1, 13))
    assert [row["best"] for row in rows] == np.minimum.accumulate([row["score"] for row in rows]).tolist()
    assert {row["suggest_cpu_s"] for row in rows} == {0.1} and set(rows[0]["point"]) == set(problem.space.names)


@pytest.mark.parametrize(("n_rows", "n_bytes", "n_driven"), [(8, 0, 4), (6, 0, 8), (6, 30, 8), (4, 30, 8)])
def test_a_search_that_was_killed_goes_on_and_drives_nothing_twice(
    tmp_path: Path, problem: Problem, n_rows: int, n_bytes: int, n_driven: int
) -> None:
    """n_rows, n_bytes: what is left of two generations of four, whole rows and the beginning of the next one."""
    whole, path = tmp_path / "whole.jsonl", tmp_path / "cut.jsonl"
    search(whole, problem, ScriptedOptimiser())
    with pytest.raises(KeyboardInterrupt):
        search(path, problem, ScriptedOptimiser(), most=8)
    rows = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*rows[:n_rows], *(row[:n_bytes] for row in rows[n_rows : n_rows + 1])]))
    assert search(path, problem, ScriptedOptimiser()).count == n_driven
    assert path.read_bytes() == whole.read_bytes()


def test_rows_of_other_points_are_thrown_away(tmp_path: Path, problem: Problem) -> None:
    path, other = tmp_path / "a.jsonl", tmp_path / "b.jsonl"
    search(path, problem, ScriptedOptimiser())
    assert search(path, problem, ScriptedOptimiser(0.2, 1)).count == 8
    search(other, problem, ScriptedOptimiser(0.2, 1))
    assert path.read_bytes() == other.read_bytes()


def test_no_trial_begins_when_the_time_is_over(tmp_path: Path, problem: Problem) -> None:
    assert search(tmp_path / "a.jsonl", problem, ScriptedOptimiser(), until_s=0.0).count == 0
    end = runs.run_search(RunJob(RUN, BENCH, "complete", tmp_path / "a.jsonl", 0.0))
    assert end == RunEnd(RUN, [], True)


def test_what_is_known_starts_no_process(tmp_path: Path, problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    search(tmp_path / "a.jsonl", problem, ScriptedOptimiser())
    monkeypatch.setattr(runs, "Objective", None)
    end = runs.run_search(RunJob(RUN._replace(trials=10), BENCH, "complete", tmp_path / "a.jsonl", math.inf))
    assert end.is_known and len(end.rows) == 12


def test_the_file_of_a_run_depends_on_objective_and_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def name(run: SamplerRun, probe: float = 0.1) -> Path:
        return runs.path_of(tmp_path, run, {"probes": [probe]})

    own = RUN._replace(method="random")
    before = {run: name(run) for run in (RUN, own)}
    assert name(RUN._replace(trials=400)) == before[RUN] != name(RUN, 0.2)
    assert name(RUN._replace(budget=50)) != before[RUN] != name(RUN._replace(seed=8))
    monkeypatch.setattr(runs, "peer_code_hash", lambda: "other")
    assert name(RUN) != before[RUN] and name(own) == before[own]


def made_end(method: str, seed: int, scores: Sequence[float], budget: int = 0, in_flight: int = 8) -> RunEnd:
    best = np.minimum.accumulate(scores).tolist()
    made: list[Row] = [
        {"k": k, "score": score, "best": low, "suggest_cpu_s": 1e-3 * k}
        for k, (score, low) in enumerate(zip(scores, best, strict=True), 1)
    ]
    return RunEnd(SamplerRun(method, seed, in_flight, budget, len(scores)), made, False)


def made_request(tmp_path: Path, *methods: str) -> measure.Request:
    return measure.Request(BENCH, "complete", methods, range(1, 4), (2, 4), (8,), tmp_path)


@pytest.fixture
def auto_is_random(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(measure, "choose_auto", lambda problem, cell: "random")


@pytest.mark.usefixtures("auto_is_random")
def test_medians_are_compared_over_the_seeds_that_all_have(tmp_path: Path, problem: Problem) -> None:
    ends = [
        made_end("random", 1, [0.4, 0.3, 0.3, 0.30]),
        made_end("random", 2, [0.4, 0.5, 0.3, 0.36]),
        made_end("random", 3, [0.4, 0.1, 0.1, 0.10]),
        made_end("cmaes", 1, [0.4, 0.4, 0.2, 0.2]),
        made_end("cmaes", 2, [0.4, 0.4, 0.2, 0.3]),
        made_end("cmaes", 3, [0.4, 0.2]),  # cut off
    ]
    found = measure.compare(made_request(tmp_path, "random", "cmaes"), problem, ends)
    early, late = found[measure.Cell(8, 2)], found[measure.Cell(8, 4)]
    assert early["random"].scores == [0.3, 0.4, 0.1] and late["random"].scores == [0.3, 0.3]
    assert early["auto"] == early["random"] and measure.ratio(early, "auto") == 1.0
    assert measure.best_method(late) == "cmaes" and measure.ratio(late, "auto") == pytest.approx(1.5)
    assert late["cmaes"].cpu_ms == pytest.approx(3.5)  # of the third and the fourth suggestion


@pytest.mark.usefixtures("auto_is_random")
def test_a_method_that_asks_for_the_budget_is_compared_at_that_budget(tmp_path: Path, problem: Problem) -> None:
    ends = [made_end("random", 1, [0.4, 0.3, 0.3, 0.3])]
    ends += [made_end("smac", 1, [0.4, 0.1], budget=2), made_end("smac", 1, [0.4, 0.4, 0.4, 0.2], budget=4)]
    found = measure.compare(made_request(tmp_path, "random", "smac"), problem, ends)
    assert [found[measure.Cell(8, budget)]["smac"].scores for budget in (2, 4)] == [[0.1], [0.2]]
    asked = [run for run in made_request(tmp_path, "random", "smac").runs() if run.seed == 1]
    assert [(run.method, run.budget, run.trials) for run in asked] == [("random", 0, 4), ("smac", 2, 2), ("smac", 4, 4)]


def test_a_method_that_hangs_in_flight_is_searched_one_by_one(tmp_path: Path, problem: Problem) -> None:
    request = made_request(tmp_path, "nevergrad", "cmaes")._replace(seeds=range(1, 2), in_flight=(8, 1))
    of_nevergrad = [run for run in request.runs() if run.method == "nevergrad"]
    assert [(run.in_flight, run.budget) for run in of_nevergrad] == [(1, 2), (1, 4)]
    ends = [made_end("nevergrad", 1, [0.4, 0.3, 0.2, 0.1][:budget], budget, in_flight=1) for budget in (2, 4)]
    ends += [made_end(measure.choose_auto(problem, measure.Cell(8, 2)), 1, [0.4] * 4), made_end("cmaes", 1, [0.4] * 4)]
    methods = tuple(dict.fromkeys(end.run.method for end in ends))
    found = measure.compare(request._replace(methods=methods, in_flight=(8,)), problem, ends)
    assert [found[measure.Cell(8, budget)]["nevergrad"].scores for budget in (2, 4)] == [[0.3], [0.1]]


def test_searches_are_ordered_by_seed_and_end_with_a_whole_generation(tmp_path: Path) -> None:
    request = made_request(tmp_path, "random", "cmaes")._replace(in_flight=(8, 1))
    assert [run.seed for run in request.runs()] == sorted(run.seed for run in request.runs())
    assert SamplerRun("random", 1, 8, 0, 50).n_asked == 56 and SamplerRun("random", 1, 1, 0, 50).n_asked == 50


def test_the_methods_of_auto_are_always_measured(tmp_path: Path, problem: Problem) -> None:
    request = made_request(tmp_path)
    chosen = {measure.choose_auto(problem, measure.Cell(8, budget)) for budget in request.budgets}
    assert set(measure.select_methods("auto,cmaes", request, problem)) == chosen | {"cmaes"}
    assert set(peers.PEERS) < set(measure.select_methods("", request, problem))
    with pytest.raises(InputError, match="no method 'tpe'"):
        measure.select_methods("random,tpe", request, problem)


@pytest.mark.usefixtures("auto_is_random")
def test_the_value_is_that_of_the_worst_number_of_trials(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def made(job: RunJob) -> RunEnd:
        course = {"random": [0.4, 0.3, 0.3, 0.3], "cmaes": [0.4, 0.4, 0.4, 0.2]}[job.run.method]
        return made_end(job.run.method, job.run.seed, course)

    monkeypatch.setattr(measure, "run_search", made)
    monkeypatch.setattr(measure, "describe_objective", lambda problem: {})
    monkeypatch.setattr(measure, "make_peers_environment", lambda: None)
    options = {"seeds": 2, "budgets": "2,4", "methods": "random,cmaes", "in_flight": "8", "workers": 1}
    answer = measure.measure(**options, folder=str(tmp_path), figures=str(tmp_path))
    assert answer["value"] == pytest.approx(1.5) and answer["n"] == 2
    detail = answer["detail"]
    assert detail["worst"] == "4 trials, 8 in flight" and json.dumps(detail)
    assert detail["cells"][detail["worst"]]["auto_is"] == "random"
    assert list(detail["cells"][detail["worst"]]["methods"]) == ["cmaes", "auto", "random"]
    assert Path(detail["figure"]).stat().st_size > 10_000


def test_two_measures_do_not_write_the_same_rows(tmp_path: Path) -> None:
    (tmp_path / measure.NAME).mkdir()
    with exclusive_lock(tmp_path / measure.NAME / measure.NAME), pytest.raises(InputError, match="another process"):
        measure.measure(seeds=1, budgets="2", methods="random", in_flight="8", folder=str(tmp_path))


@pytest.mark.slow
def test_the_environment_of_the_peers_sees_this_one_and_says_what_cannot_be_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    installed = peers.installed_versions(["cmaes"])["cmaes"]
    wanted = tmp_path / "list.txt"
    monkeypatch.setattr(runs, "PEER_LIST", wanted)
    wanted.write_text("./no_such_folder\n")
    with pytest.raises(InputError, match="no_such_folder") as caught:
        runs.make_peers_environment(tmp_path / "venv")
    assert caught.value.code == "no_peers" and not (tmp_path / "venv" / "peers.txt").exists()
    wanted.write_text(f"cmaes=={installed}\n")
    python = runs.make_peers_environment(tmp_path / "venv")
    asked = subprocess.run([python, "-s", "-c", "import cmaes; print(cmaes.__file__)"], capture_output=True, text=True)
    assert asked.returncode == 0 and not asked.stdout.startswith(str(tmp_path))
    monkeypatch.setattr("venv.create", None)
    assert runs.make_peers_environment(tmp_path / "venv") == python  # nothing is made again


@pytest.mark.slow
@pytest.mark.compiled
def test_the_objective_is_the_score_of_the_batch(problem: Problem) -> None:
    known = runs.describe_objective(problem)
    assert len(known["probes"]) == runs.PROBES and len(set(known["probes"])) > runs.PROBES // 2
    assert runs.describe_objective(problem) == known

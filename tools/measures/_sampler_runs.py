"""Searches of `tools/measure samplers`: an optimiser in a process of its own, and the compiled batch, which scores.

Every trial is a row of the run's file: {method, seed, in_flight, budget, k, score, best, suggest_cpu_s, point}. A run
that was cut off is done again from its first trial. The optimiser suggests the same points again, and the known ones
are not driven again; where a point differs, the rows from there on are thrown away.
"""

from __future__ import annotations

import hashlib
import json
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, TextIO, cast

import numpy as np

from tools.measures._ledger import ROOT, key_of, meaning
from tools.measures._sampler_peers import PEERS, installed_versions, send_line
from tools.measures._sampler_product import PACKAGES
from tunefree_hil.base.errors import InputError, PeerGone
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Batch
from tunefree_hil.jobs.identity import compute_identity
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors, select_first_vector
from tunefree_hil.jobs.tune.evaluators import BatchEvaluator, VectorCandidate
from tunefree_hil.tune.baselines import make_first_trial
from tunefree_hil.tune.sampling.points import from_unit, to_unit
from tunefree_hil.tune.space import Space, resolve_space

HERE = Path(__file__).resolve().parent
PEER_LIST = HERE / "peers.txt"
PEERS_FOLDER = ROOT / "build" / "peers-venv"
PROBES = 16  # points whose scores tell objectives apart
NEAR = 0.1  # standard deviation of half of them around the first trial, in parts of each range
LINE_S = 20.0  # between two lines about the same run
PATIENCE_S = 900.0  # with an optimiser; eight suggestions of the slowest one take seconds
LAST_LINES = 12  # of an optimiser's output, quoted when it has ended
ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
# SMAC's order of points depends on the hashes of strings
CHILD_VARIABLES = {**ONE_THREAD, "PYTHONHASHSEED": "0"}
PRODUCT_CODE = ("tune/sampling", "tune/space.py", "tune/trial_loop.py")  # what suggestions depend on
NOT_COUNTED = "automatic_choice.py"  # which sampler `auto` is: a new rule needs no new search

Row = dict[str, Any]
Values = dict[str, float]


class Problem(NamedTuple):
    """What is searched: the score of a bench over its scenarios. first: the first trial of every method."""

    bench: Bench
    space: Space
    first: Values


class SamplerRun(NamedTuple):
    """One search. budget: number of trials that the method is told of, 0 for one that does not ask."""

    method: str
    seed: int
    in_flight: int
    budget: int
    trials: int

    @property
    def n_asked(self) -> int:
        """The trials, with the rest of the last generation."""
        return -(-self.trials // self.in_flight) * self.in_flight

    @property
    def label(self) -> str:
        """For people."""
        budget = f" of {self.budget}" if self.budget else ""
        return f"{self.method}{budget}, seed {self.seed}, {self.in_flight} in flight"


class RunJob(NamedTuple):
    """A run as the job of a worker. until_s: time of the monotonic clock at which no further trial begins."""

    run: SamplerRun
    bench: str
    parameters: str
    path: Path
    until_s: float


class RunEnd(NamedTuple):
    """A run with its rows, fewer than its trials where its time was over; is_known: nothing was done."""

    run: SamplerRun
    rows: list[Row]
    is_known: bool


def load_problem(bench_file: str, parameters: str) -> Problem:
    """The bench file with a set of parameters, which are all continuous."""
    bench = load(bench_file)
    space = resolve_space(parameters, [], file=bench.file)
    return Problem(bench, space, make_first_trial(space, select_first_vector(compute_baseline_vectors(bench))))


class Objective:
    """Scores points in the compiled batch, on one thread. Use it in a `with`."""

    def __init__(self, problem: Problem) -> None:
        bench = problem.bench
        self._problem = problem
        self._batch = Batch(bench, threads=1)
        scenarios = [bench.scenarios[name] for name in bench.spec.scenarios]
        self._evaluator = BatchEvaluator(self._batch, bench, scenarios, batch_size=1)

    def __enter__(self) -> Objective:
        return self

    def __exit__(self, *_: object) -> None:
        self._batch.close()

    def score(self, points: Sequence[Values]) -> list[float]:
        """The scores of points that are driven together."""
        bench = self._problem.bench
        candidates = [VectorCandidate(k, parameters_of(bench, point)) for k, point in enumerate(points)]
        return [evaluation.score for evaluation in self._evaluator.evaluate(candidates)]


def describe_objective(problem: Problem) -> dict[str, Any]:
    """What tells one objective from another: files, space, first trial, and the scores of PROBES points.

    Half of the points are anywhere, half near the first trial. So rows outlive changes of code that change no score.
    """
    rng = np.random.default_rng(PROBES)
    first, half = to_unit(problem.space, problem.first), PROBES // 2
    near = np.clip(first + NEAR * rng.standard_normal((half, len(first))), 0.0, 1.0)
    bench = problem.bench
    scenarios = [bench.scenarios[name] for name in bench.spec.scenarios]
    with Objective(problem) as objective:
        scores = objective.score([from_unit(problem.space, unit) for unit in (*rng.random(near.shape), *near)])
    return {
        "identity": compute_identity(bench, bench.spec.model, scenarios)["identity"],
        "space": problem.space.as_data(),
        "first": problem.first,
        "probes": scores,
    }


def path_of(folder: Path, run: SamplerRun, objective: Mapping[str, Any]) -> Path:
    """The file of a run; its name has the hash of all that the rows depend on."""
    code = peer_code_hash() if run.method in PEERS else product_code_hash()
    depends = {**run._asdict(), "trials": 0, "objective": dict(objective), "code": code}
    budget = f"-of-{run.budget}" if run.budget else ""
    return folder / f"{run.method}{budget}-seed{run.seed}-{run.in_flight}-in-flight-{key_of(depends)[:12]}.jsonl"


def peer_code_hash() -> str:
    """SHA-256 over what the points of a peer depend on."""
    code = meaning((HERE / "_sampler_peers.py").read_text(encoding="utf-8"))
    return hashlib.sha256((code + PEER_LIST.read_text(encoding="utf-8")).encode()).hexdigest()


def product_code_hash() -> str:
    """SHA-256 over what the points of a sampler of the product depend on."""
    package = ROOT / "tunefree_hil"
    paths = [path for name in PRODUCT_CODE for path in sorted((package / name).rglob("*.py")) or [package / name]]
    code = [meaning(path.read_text(encoding="utf-8")) for path in paths if path.name != NOT_COUNTED]
    return hashlib.sha256("".join([*code, str(installed_versions(PACKAGES))]).encode()).hexdigest()


def make_peers_environment(folder: Path = PEERS_FOLDER) -> Path:
    """The Python of an environment with exactly peers.txt, made where it is missing or of another list.

    It sees the libraries of this environment too, so that torch is not installed twice.
    """
    python, mark = folder / "bin" / "python", folder / "peers.txt"
    wanted = PEER_LIST.read_text(encoding="utf-8")
    if mark.is_file() and mark.read_text(encoding="utf-8") == wanted:
        return python
    print(f"samplers: installing the peers into {folder}", file=sys.stderr, flush=True)
    import sysconfig
    import venv

    venv.create(folder, clear=True, with_pip=True)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages = folder / "lib" / version / "site-packages"
    (packages / "project.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r", PEER_LIST]
    done = subprocess.run(install, capture_output=True, text=True)
    if done.returncode:
        lines = "\n    ".join(done.stderr.strip().splitlines()[-LAST_LINES:])
        hint = f"see that pip can install {PEER_LIST.name}, or measure without peers: --methods auto,random"
        raise InputError(f"the peers cannot be installed\n    {lines}", code="no_peers", file=str(PEER_LIST), hint=hint)
    mark.write_text(wanted, encoding="utf-8")
    return python


class OptimiserProcess:
    """An optimiser in a process of its own, on one thread. patience_s: longest wait for an answer."""

    def __init__(
        self, process: subprocess.Popen[str], output: TextIO, label: str, patience_s: float = PATIENCE_S
    ) -> None:
        self._process, self._output, self._label, self._patience_s = process, output, label, patience_s
        self._requests, self._answers = cast(TextIO, process.stdin), cast(TextIO, process.stdout)

    def send(self, message: Mapping[str, Any]) -> dict[str, Any]:
        """The answer to a message.

        Raises:
            PeerGone: The process has ended, or has no answer within `patience_s`; with the end of its output.
        """
        try:
            send_line(self._requests, message)
            is_answered = bool(select.select([self._answers], [], [], self._patience_s)[0])
            line = self._answers.readline() if is_answered else ""
        except BrokenPipeError:
            is_answered, line = True, ""
        if not line:
            raise self._lost("has ended" if is_answered else f"has not answered for {self._patience_s:.0f} s")
        return json.loads(line)

    def _lost(self, what: str) -> PeerGone:
        self._process.kill()
        self._process.wait()
        self._output.seek(0)
        lines = "\n    ".join(self._output.read().strip().splitlines()[-LAST_LINES:])
        hint = "the rows so far are kept; leave the method out with --methods, or mend it and call again"
        return PeerGone(self._label, f"{self._label} {what}\n    {lines}", code="optimiser_lost", hint=hint)


@contextmanager
def open_optimiser(
    command: Sequence[str], message: Mapping[str, Any], label: str, patience_s: float = PATIENCE_S
) -> Iterator[OptimiserProcess]:
    """Start an optimiser with its first message; the process ends with the `with`."""
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryFile("w+", encoding="utf-8") as output:
        variables = {**os.environ, **CHILD_VARIABLES, "TMPDIR": folder}
        variables.pop("PYTHONPATH", None)
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=output, text=True, cwd=ROOT, env=variables
        )
        try:
            optimiser = OptimiserProcess(process, output, label, patience_s)
            optimiser.send(message)
            yield optimiser
        finally:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    _close_quietly(pipe)


def _close_quietly(pipe: Any) -> None:
    try:
        pipe.close()
    except BrokenPipeError:
        return


def start_optimiser(run: SamplerRun, problem: Problem) -> Any:
    """`open_optimiser` for the method of a run, which is asked for values or for places in their ranges."""
    message = {"method": run.method, "seed": run.seed, "in_flight": run.in_flight, "budget": run.budget}
    if run.method in PEERS:
        command = [str(make_peers_environment()), "-s", "-P", str(HERE / "_sampler_peers.py")]
        return open_optimiser(command, {**message, "first": to_unit(problem.space, problem.first).tolist()}, run.label)
    command = [sys.executable, "-m", "tools.measures._sampler_product"]
    first = list(problem.first.values())
    return open_optimiser(command, {**message, "first": first, "space": problem.space.as_data()}, run.label)


class RowFile:
    """The rows of a run, appended as they come; a line that was cut off by a kill is dropped."""

    def __init__(self, path: Path) -> None:
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        self.rows: list[Row] = list(read_rows(path))

    def append(self, rows: Sequence[Row]) -> None:
        """Add rows, on disk before this returns."""
        if self._is_cut_off():
            self._rewrite()
        with self.path.open("a", encoding="utf-8") as file:
            file.write("".join(json.dumps(row) + "\n" for row in rows))
            file.flush()
            os.fsync(file.fileno())
        self.rows += rows

    def truncate(self, count: int) -> None:
        """Throw all rows away but the first `count`."""
        self.rows = self.rows[:count]
        self._rewrite()

    def _is_cut_off(self) -> bool:
        return self.path.is_file() and len(self.path.read_bytes().splitlines()) > len(self.rows)

    def _rewrite(self) -> None:
        part = self.path.with_suffix(".part")
        part.write_text("".join(json.dumps(row) + "\n" for row in self.rows), encoding="utf-8")
        part.replace(self.path)


def read_rows(path: Path) -> Iterator[Row]:
    """The complete rows of a file, in the order of their trials."""
    if not path.is_file():
        return
    for line in path.read_bytes().split(b"\n")[:-1]:
        yield json.loads(line)


def run_search(job: RunJob) -> RunEnd:
    """Run a search, or go on with it, until its trials are done or its time is over."""
    rows = RowFile(job.path)
    if len(rows.rows) >= job.run.n_asked or time.monotonic() >= job.until_s:
        return RunEnd(job.run, rows.rows, is_known=True)
    problem = load_problem(job.bench, job.parameters)
    with Objective(problem) as objective, start_optimiser(job.run, problem) as optimiser:
        search_rows(job, problem, objective.score, optimiser, rows)
    return RunEnd(job.run, rows.rows, is_known=False)


def search_rows(
    job: RunJob,
    problem: Problem,
    score: Callable[[Sequence[Values]], list[float]],
    optimiser: OptimiserProcess,
    rows: RowFile,
) -> None:
    """Ask, score and tell generation by generation."""
    run, scores, line_s = job.run, list[float](), time.monotonic()
    for begun in range(0, run.n_asked, run.in_flight):
        if time.monotonic() >= job.until_s:
            return
        answer = optimiser.send({"scores": scores, "count": run.in_flight})
        points = [_values_of(run, problem, point) for point in answer["points"]]
        known = rows.rows[begun : begun + run.in_flight]
        if [row["point"] for row in known] == points:
            scores = [row["score"] for row in known]
            continue
        if known:
            rows.truncate(begun)
        scores = score(points)
        rows.append(_make_rows(run, begun, points, scores, answer["cpu_s"], rows.rows))
        if time.monotonic() - line_s >= LINE_S:
            line_s, text = time.monotonic(), f"trial {len(rows.rows)} of {run.trials}"
            print(f"  {run.label}: {text}, best {rows.rows[-1]['best']:.4f}", file=sys.stderr, flush=True)


def _values_of(run: SamplerRun, problem: Problem, point: Sequence[float]) -> Values:
    if run.method in PEERS:
        return from_unit(problem.space, np.clip(point, 0.0, 1.0))
    return dict(zip(problem.space.names, point, strict=True))


def _make_rows(
    run: SamplerRun, begun: int, points: Sequence[Values], scores: Sequence[float], cpu_s: float, before: Sequence[Row]
) -> list[Row]:
    """Rows of a generation, whose suggestions share their processor time."""
    best, made = before[-1]["best"] if before else float("inf"), list[Row]()
    shared = {"method": run.method, "seed": run.seed, "in_flight": run.in_flight, "budget": run.budget}
    for place, (point, score) in enumerate(zip(points, scores, strict=True)):
        best = min(best, score)
        numbers = {"k": begun + place + 1, "score": score, "best": best, "suggest_cpu_s": cpu_s / len(points)}
        made.append({**shared, **numbers, "point": point})
    return made

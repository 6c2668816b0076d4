"""The process of a peer of `tools/measure samplers`: an optimiser of another project, used as its documents say.

It runs with the Python of the peers' environment and imports nothing of ours. Messages are lines of JSON on standard
input and output. The first is {"method", "seed", "in_flight", "budget", "first"}, answered by {"versions"}; every
other one is {"scores", "count"}: scores of the points of the last answer, and how many points are asked for, answered
by {"points", "cpu_s"}. A point is a list of numbers from 0 to 1; the first point of all is `first`. Scores are better
the lower they are. `cpu_s` is the processor time of learning from the scores and of suggesting, on all threads.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import math
import os
import queue
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, TextIO

Point = list[float]
SMALLEST_SCORE = 1e-6  # a score of 0 has no logarithm
FIT_STEPS = 75  # of the BoTorch fit: its default takes several times as long, for the same points


class SearchTask(NamedTuple):
    """What a peer knows when it starts. budget: number of trials in all; first: the first point, which is given."""

    seed: int
    in_flight: int
    budget: int
    first: Point


class Optimiser(Protocol):
    """A peer: `ask` for points, then `tell` their scores in the same order."""

    def ask(self, count: int) -> list[Point]: ...

    def tell(self, scores: Sequence[float]) -> None: ...


class OptunaPeer:
    """A sampler of Optuna; minimises the score itself."""

    def __init__(self, task: SearchTask, make_sampler: Callable[[Any, int], Any]) -> None:
        self._optuna = importlib.import_module("optuna")
        self._optuna.logging.set_verbosity(self._optuna.logging.WARNING)
        self._study = self._optuna.create_study(sampler=make_sampler(self._optuna, task.seed))
        names = [f"x{i:02d}" for i in range(len(task.first))]
        self._distributions = {name: self._optuna.distributions.FloatDistribution(0.0, 1.0) for name in names}
        self._study.enqueue_trial(dict(zip(names, task.first, strict=True)))
        self._running: list[Any] = []

    def ask(self, count: int) -> list[Point]:
        self._running = [self._study.ask(self._distributions) for _ in range(count)]
        return [[trial.params[name] for name in self._distributions] for trial in self._running]

    def tell(self, scores: Sequence[float]) -> None:
        for trial, score in zip(self._running, scores, strict=True):
            self._study.tell(trial, score)


class BoTorchPeer:
    """A Gaussian process with the logarithm of the expected improvement, as in BoTorch's tutorials.

    It learns the logarithm of the score: a failed drive scores fifty times as much as a good one, and no user of a
    Gaussian process would leave that as it is. The first 2 (parameters + 1) points are `first` and a Sobol sequence.
    """

    def __init__(self, task: SearchTask) -> None:
        self._torch = torch = importlib.import_module("torch")
        torch.set_num_threads(1)
        torch.manual_seed(task.seed)
        for name in ("acquisition", "acquisition.logei", "fit", "models", "optim"):
            importlib.import_module(f"botorch.{name}")
        self._botorch = importlib.import_module("botorch")
        self._likelihoods = importlib.import_module("gpytorch.mlls")
        n_parameters = len(task.first)
        sobol = torch.quasirandom.SobolEngine(n_parameters, scramble=True, seed=task.seed)
        self._start: list[Point] = [list(task.first), *sobol.draw(2 * n_parameters + 1).double().tolist()]
        self._points: list[Point] = []
        self._values: list[float] = []
        self._running: list[Point] = []

    def ask(self, count: int) -> list[Point]:
        begun = len(self._points)
        self._running = self._start[begun : begun + count]
        missing = count - len(self._running)
        if missing:
            self._running = self._running + self._suggest(missing)
        return self._running

    def tell(self, scores: Sequence[float]) -> None:
        self._points += self._running
        self._values += [-math.log(max(score, SMALLEST_SCORE)) for score in scores]

    def _suggest(self, count: int) -> list[Point]:
        torch, botorch = self._torch, self._botorch
        points = torch.tensor(self._points, dtype=torch.double)
        values = torch.tensor(self._values, dtype=torch.double).unsqueeze(-1)
        model = botorch.models.SingleTaskGP(points, values)
        likelihood = self._likelihoods.ExactMarginalLogLikelihood(model.likelihood, model)
        botorch.fit.fit_gpytorch_mll(likelihood, optimizer_kwargs={"options": {"maxiter": FIT_STEPS}})
        pending = torch.tensor(self._running, dtype=torch.double) if self._running else None
        if count == 1 and pending is None:
            improvement = botorch.acquisition.LogExpectedImprovement(model, best_f=values.max())
        else:
            improvement = botorch.acquisition.logei.qLogExpectedImprovement(
                model, best_f=values.max(), X_pending=pending
            )
        bounds = torch.tensor([[0.0], [1.0]], dtype=torch.double).repeat(1, points.shape[1])
        chosen, _ = botorch.optim.optimize_acqf(
            improvement, bounds, q=count, num_restarts=10, raw_samples=512, sequential=count > 1
        )
        return chosen.tolist()


class SmacPeer:
    """SMAC3's facade for hyperparameters: a random forest with expected improvement. It takes the logarithm itself."""

    def __init__(self, task: SearchTask) -> None:
        smac, space = importlib.import_module("smac"), importlib.import_module("ConfigSpace")
        records = importlib.import_module("smac.runhistory.dataclasses")
        self._trial, self._value = records.TrialInfo, records.TrialValue
        self._names = [f"x{i:02d}" for i in range(len(task.first))]
        configurations = space.ConfigurationSpace(dict.fromkeys(self._names, (0.0, 1.0)), seed=task.seed)
        self._folder = tempfile.TemporaryDirectory()
        scenario = smac.Scenario(
            configurations,
            deterministic=True,
            n_trials=task.budget,
            seed=task.seed,
            output_directory=importlib.import_module("pathlib").Path(self._folder.name),
        )
        facade = smac.HyperparameterOptimizationFacade
        self._search = facade(scenario, _refuse_call, overwrite=True, logging_level=False)
        given = space.Configuration(configurations, values=dict(zip(self._names, task.first, strict=True)))
        self._given = [self._trial(given, seed=0)]
        self._running: list[Any] = []

    def ask(self, count: int) -> list[Point]:
        for trial in self._given:
            self._search.runhistory.add_running_trial(trial)
        self._running, self._given = self._given, []
        while len(self._running) < count:
            self._running.append(self._search.ask())
        return [[float(trial.config[name]) for name in self._names] for trial in self._running]

    def tell(self, scores: Sequence[float]) -> None:
        for trial, score in zip(self._running, scores, strict=True):
            self._search.tell(trial, self._value(cost=score), save=False)


class NevergradPeer:
    """Nevergrad's NGOpt, which chooses an optimiser by numbers of parameters, trials and trials in flight."""

    def __init__(self, task: SearchTask) -> None:
        nevergrad = importlib.import_module("nevergrad")
        numpy = importlib.import_module("numpy")
        box = nevergrad.p.Array(init=numpy.array(task.first), lower=0.0, upper=1.0)
        box.random_state.seed(task.seed)
        make = nevergrad.optimizers.registry["NGOpt"]
        self._search = make(box, budget=task.budget, num_workers=task.in_flight)
        self._search.suggest(numpy.array(task.first))
        self._running: list[Any] = []

    def ask(self, count: int) -> list[Point]:
        self._running = [self._search.ask() for _ in range(count)]
        return [candidate.value.tolist() for candidate in self._running]

    def tell(self, scores: Sequence[float]) -> None:
        for candidate, score in zip(self._running, scores, strict=True):
            self._search.tell(candidate, score)


class CmaesPeer:
    """CMA-ES of the package cmaes from the first point on, with a third of the range as its spread.

    The strategy is updated when the scores of a population are there; the first point is one of the first population.
    """

    def __init__(self, task: SearchTask) -> None:
        cmaes, self._numpy = importlib.import_module("cmaes"), importlib.import_module("numpy")
        box = self._numpy.tile([0.0, 1.0], (len(task.first), 1))
        self._search = cmaes.CMA(self._numpy.array(task.first), 1.0 / 3.0, bounds=box, seed=task.seed)
        self._given = [self._numpy.array(task.first)]
        self._running: list[Any] = []
        self._scored: list[tuple[Any, float]] = []

    def ask(self, count: int) -> list[Point]:
        self._running, self._given = self._given, []
        while len(self._running) < count:
            self._running.append(self._search.ask())
        return [point.tolist() for point in self._running]

    def tell(self, scores: Sequence[float]) -> None:
        size = self._search.population_size
        self._scored += zip(self._running, scores, strict=True)
        while len(self._scored) >= size:
            self._search.tell(self._scored[:size])
            self._scored = self._scored[size:]


def _refuse_call(config: Any, seed: int = 0) -> float:  # SMAC looks at the names of the arguments
    raise AssertionError(f"{config} with seed {seed} is scored by the other process")


def _make_optuna_gp(optuna: Any, seed: int) -> Any:
    importlib.import_module("torch")  # Optuna imports it at the first suggestion, which is no cost of suggesting
    return optuna.samplers.GPSampler(seed=seed)


PEERS: Mapping[str, Callable[[SearchTask], Optimiser]] = {
    "optuna_tpe": lambda task: OptunaPeer(task, lambda optuna, seed: optuna.samplers.TPESampler(seed=seed)),
    "optuna_gp": lambda task: OptunaPeer(task, _make_optuna_gp),
    "optuna_cma": lambda task: OptunaPeer(task, lambda optuna, seed: optuna.samplers.CmaEsSampler(seed=seed)),
    "botorch": BoTorchPeer,
    "smac": SmacPeer,
    "nevergrad": NevergradPeer,
    "cmaes": CmaesPeer,
}
PACKAGES = ("optuna", "torch", "botorch", "smac", "nevergrad", "cmaes", "numpy")


def serve(make: Callable[[Mapping[str, Any]], Optimiser], packages: Sequence[str] = PACKAGES) -> None:
    """Answer the messages on standard input; this process ends with it. make: the optimiser of the first message."""
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # what a library prints must not get into the answers
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(lines,), daemon=True).start()
    optimiser = make(json.loads(lines.get()))
    send_line(answers, {"versions": installed_versions(packages)})
    while True:
        request = json.loads(lines.get())
        started_s = time.process_time()
        if request["scores"]:
            optimiser.tell(request["scores"])
        points = optimiser.ask(request["count"]) if request["count"] else []
        send_line(answers, {"points": points, "cpu_s": time.process_time() - started_s})


def _listen(lines: queue.SimpleQueue[str]) -> None:
    """Queue the messages, and end this process with the other one, also in the middle of a suggestion."""
    for line in sys.stdin:
        lines.put(line)
    os._exit(0)


def send_line(pipe: TextIO, message: Mapping[str, Any]) -> None:
    """Write a message as a line of JSON."""
    pipe.write(json.dumps(message) + "\n")
    pipe.flush()


def installed_versions(packages: Sequence[str]) -> dict[str, str]:
    """The versions of those packages that are installed."""
    versions = {}
    for name in packages:
        try:
            versions[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            continue
    return versions


def make_peer(message: Mapping[str, Any]) -> Optimiser:
    """The peer of the first message."""
    task = SearchTask(message["seed"], message["in_flight"], message["budget"], message["first"])
    return PEERS[message["method"]](task)


if __name__ == "__main__":
    warnings.simplefilter("ignore")  # of other projects, about themselves
    serve(make_peer)

"""Searches of the reproduction: by score alone, in the compiled batch, with any sampler and number of trials.

The manual gains are no trial of them, so that ending near those is a finding.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple, Self

from tools.measures._ledger import Ledger, key_of
from tools.measures._rig import Rig, standing
from tunefree_hil.bench import Bench, load, parameters_of
from tunefree_hil.bench.batch import Batch
from tunefree_hil.jobs.tune.candidates import compute_baseline_vectors, select_first_vector
from tunefree_hil.jobs.tune.evaluators import BatchEvaluator, VectorCandidate
from tunefree_hil.tune.journal import open_journal
from tunefree_hil.tune.sampling.records import BY_NAME, Surrogate, is_installed
from tunefree_hil.tune.space import Space, resolve_space
from tunefree_hil.tune.store import StudySettings
from tunefree_hil.tune.trial import Evaluation, Trial
from tunefree_hil.tune.trial_loop import run_generations

IN_FLIGHT = 8  # trials at a time; paper, Table III: TPE in parallel
Report = Callable[[int], None]  # gets the number of finished trials


class SearchSetting(NamedTuple):
    """One search. set_name: of the tuned parameters (control/parameters.py)."""

    set_name: str
    sampler: str
    trials: int
    seed: int

    @property
    def is_gaussian(self) -> bool:
        """Whether the surrogate is a Gaussian process (GPR in the paper), else a Parzen estimator (TPE)."""
        return BY_NAME[self.sampler].surrogate is Surrogate.GPR

    @property
    def label(self) -> str:
        """'tpe_independent, 200 trials'."""
        return f"{self.sampler}, {self.trials} trials"


class SearchResult(NamedTuple):
    """A search that is done, its trials in slot order."""

    setting: SearchSetting
    trials: list[Trial]

    @property
    def winner(self) -> Trial:
        """The lowest score."""
        return min(self.trials, key=lambda trial: trial.score)


def known_settings(settings: tuple[SearchSetting, ...]) -> tuple[SearchSetting, ...]:
    """Those whose sampler is installed."""
    return tuple(setting for setting in settings if is_installed(BY_NAME[setting.sampler]))


class SearchBench:
    """The bench that all searches of a part share; use it in a `with`. The batch starts with the first drive.

    A search that was cut off goes on in its journal, which is found by all that a score depends on.
    """

    def __init__(self, bench_file: str, folder: Path) -> None:
        self.bench: Bench = load(bench_file)
        self.folder = folder
        self._scenarios = [self.bench.scenarios[name] for name in self.bench.spec.scenarios]
        self._open = ExitStack()
        self._batch: Batch | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def space(self, set_name: str) -> Space:
        """Parameters of a set in the published box."""
        return resolve_space(set_name, [], file=self.bench.file)

    def search(self, setting: SearchSetting, report: Report) -> SearchResult:
        """Run or continue a search."""
        identity = key_of(standing(self.bench, self.bench.spec.model, self._scenarios))
        in_flight = 1 if setting.is_gaussian else IN_FLIGHT
        settings = StudySettings(
            space=self.space(setting.set_name),
            seed=setting.seed,
            sampler=setting.sampler,
            bench_hash=identity,
            first={},
            in_flight=in_flight,
        )
        name = f"{setting.set_name}-{setting.sampler}-{setting.trials}-{setting.seed}"
        path = self.folder / f"{name}-{key_of(settings.as_data())[:12]}" / "trials.jsonl"
        path.parent.mkdir(parents=True, exist_ok=True)
        journal = open_journal(path, settings)
        for _ in run_generations(journal, setting.trials, self._evaluate):
            report(len(journal.trials()))
        return SearchResult(setting, journal.trials()[: setting.trials])

    def _evaluate(self, points: Mapping[int, Mapping[str, float]]) -> list[Evaluation]:
        candidates = [VectorCandidate(slot, parameters_of(self.bench, values)) for slot, values in points.items()]
        return BatchEvaluator(self.batch, self.bench, self._scenarios, batch_size=len(candidates)).evaluate(candidates)

    @property
    def batch(self) -> Batch:
        """The compiled batch on the bench's model."""
        if self._batch is None:
            self._batch = self._open.enter_context(Batch(self.bench))
        return self._batch

    def manual(self) -> dict[str, float]:
        """The complete manual vector with MRAC on: the benchmark of the paper."""
        return dict(select_first_vector(compute_baseline_vectors(self.bench)))

    def drive_manual(self, count: int = 1) -> None:
        """Drive the manual set `count` times in one generation; the first call waits for the compiler."""
        self._evaluate(dict.fromkeys(range(count), self.manual()))

    def score_manual(self) -> float:
        """Its score on the bench's model, kept in the work folder."""
        ledger = Ledger(self.folder, "manual")
        with Rig(self.bench, self.bench.spec.model, self.bench.spec.scenarios, ledger, over_bus=False) as rig:
            return float(rig.evaluate(self.manual())["score"])


def trial_rows(result: SearchResult) -> list[dict[str, Any]]:
    """Trials as plain data: parameters and score."""
    return [{**trial.parameters, "score": trial.score} for trial in result.trials]

"""Tune: baselines, then the study over the bus, then the winner on the verify model. Killed anywhere, it goes on."""

from __future__ import annotations

import shlex
import statistics
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import BenchError, InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, is_heavy, load, parameters_of, require_buildable
from tunefree_hil.jobs.candidates import baseline_vectors
from tunefree_hil.jobs.drive import DEFAULT_ROOT, own_session
from tunefree_hil.jobs.harvest import evaluation_of
from tunefree_hil.jobs.identity import identity_of, resolved_toml
from tunefree_hil.jobs.node_links import require_recorder, usable_bus
from tunefree_hil.jobs.run_folder import RunFolder, drop_bulk, open_run, remove_parts, unfinished, write_text
from tunefree_hil.jobs.session import lanes_of, open_lanes
from tunefree_hil.jobs.track import Track
from tunefree_hil.jobs.tune_report import finish_report
from tunefree_hil.jobs.verify import verify_winner
from tunefree_hil.tune.baselines import first_trial
from tunefree_hil.tune.compare import best_baseline
from tunefree_hil.tune.space import resolve
from tunefree_hil.tune.store import Settings
from tunefree_hil.tune.study import Evaluation, Study, open_study


class Wish(NamedTuple):
    """What was asked for, resolved."""

    bench: Bench
    settings: Settings
    trials: int
    bus: str
    bench_bus: str
    join: bool
    session: str
    command: str  # the same command again


def tune(
    bench: Path,
    *,
    trials: int | None,
    set_name: str | None,
    sampler: str | None,
    seed: int | None,
    scale: str,
    bus: str,
    bench_bus: str,
    join: bool,
    session: str,
    out: Path | None,
    resume: Path | None,
    verify: bool,
    study: str | None,
) -> Iterator[Event]:
    """Baselines and trials over the bus of the bench file's model; the same command goes on where it was cut off."""
    if study is not None:
        raise InputError(
            f"a study in {study} is not built yet",
            code="not_built",
            key="--study",
            hint="leave --study out: the study is kept in the run folder's study.db",
        )
    loaded = load(bench)
    _require_buildable(loaded, verify)
    require_recorder(usable_bus(bus, session or own_session(), bench_bus))
    settings, identity = _settings(loaded, set_name, sampler, seed, scale)
    wanted = trials or loaded.spec.tune.trials
    command = _command(bench, trials, set_name, sampler, seed, scale, bus, out, verify)
    wish = Wish(loaded, settings, wanted, bus, bench_bus, join, session or own_session(), command)
    run, old = _run_folder(wish, bench, identity, out or DEFAULT_ROOT, resume)
    yield Event("note", f"{'goes on with' if old else 'run folder'} {run.path}", {"resume": command})
    with open_study(run.path / "study.db", settings) as opened:
        yield from _search(wish, run, bench, opened)
        report = finish_report(loaded, run, opened)
    yield from (Event("note", line) for line in report.lines)
    data = dict(report.data)
    sentence = report.sentence
    if verify and loaded.spec.verify_model:
        found = yield from verify_winner(loaded, run, bus=bus, bench_bus=bench_bus, session=wish.session)
        data["verify"] = found
        sentence += f". On {loaded.spec.verify_model}, unseen: {found['sentence']}"
    run.finish(result={"sentence": sentence})
    data["next"] = [
        f"tunefree-hil verify {run.path}",
        f"tunefree-hil replay {run.path} --verify",
        f"optuna-dashboard sqlite:///{run.path}/study.db",
    ]
    yield Event("result", sentence, {"sentence": sentence, "run": str(run.path), **data})


def _require_buildable(bench: Bench, verify: bool) -> None:
    """Raise InputError for what a node could not build, now rather than after hours."""
    values = parameters_of(bench)
    require_buildable(bench, bench.spec.model, [bench.scenarios[name] for name in bench.spec.scenarios], values)
    if verify and bench.spec.verify_model:
        scenarios = [bench.scenarios[name] for name in bench.spec.verify_scenarios]
        require_buildable(bench, bench.spec.verify_model, scenarios, values)


def _settings(
    bench: Bench, set_name: str | None, sampler: str | None, seed: int | None, scale: str
) -> tuple[Settings, dict[str, Any]]:
    asked = bench.spec.tune
    specs = [] if set_name else asked.parameters
    name = set_name or ("" if specs else asked.set)
    space = resolve(name, specs, scale="" if scale == "log" else scale, file=bench.file)
    identity = identity_of(bench, bench.spec.model, [bench.scenarios[one] for one in bench.spec.scenarios])
    settings = Settings(
        space=space,
        seed=bench.spec.seed if seed is None else seed,
        sampler=sampler or asked.sampler,
        bench_hash=identity["identity"],
        first=first_trial(space),
    )
    return settings, identity


def _command(bench: Path, trials: int | None, set_name: str | None, sampler: str | None, seed: int | None, scale: str,
             bus: str, out: Path | None, verify: bool) -> str:  # fmt: skip
    words = ["tunefree-hil", "tune", str(bench)]
    given = {"--trials": trials, "--set": set_name, "--sampler": sampler, "--seed": seed, "--out": out}
    for option, value in given.items():
        if value is not None:
            words += [option, str(value)]
    words += ["--scale", scale] if scale != "log" else []
    words += ["--bus", bus] if bus != "auto" else []
    words += [] if verify else ["--no-verify"]
    return shlex.join(words)


def _run_folder(
    wish: Wish, bench: Path, identity: dict[str, Any], root: Path, resume: Path | None
) -> tuple[RunFolder, bool]:
    """(folder, whether it is an old one): the one to resume, an unfinished one of the same settings, or a new one."""
    name = f"tune-{bench.stem}" if resume is None else ""
    same = {"command": "tune", "identity": identity["identity"], "settings": wish.settings.described()}
    run = open_run(resume) if resume is not None else unfinished(root, name, same)
    if run is not None:
        if resume is not None and run.record.get("identity") != identity["identity"]:
            raise InputError(
                "the files it was made with have changed since",
                code="changed",
                file=str(resume),
                key="identity",
                hint="bring back the vehicle, model, scenarios and weights, or start a new run",
            )
        remove_parts(run.path)
        return run, True
    record = {**same, "bench": str(bench), "hashes": identity["hashes"], "seed": wish.settings.seed}
    run = RunFolder.create(root, name, record)
    write_text(run.path / "bench.toml", resolved_toml(wish.bench))
    return run, False


def _search(wish: Wish, run: RunFolder, bench: Path, study: Study) -> Iterator[Event]:
    """Drive what is missing: baselines, then slots."""
    vectors = baseline_vectors(wish.bench)
    missing = [name for name in vectors if name not in study.baselines()]
    left = wish.trials - len(study.trials())
    if not missing and left <= 0:
        return
    model = wish.bench.spec.model
    with open_lanes(
        lanes_of(wish.join, wish.bus),
        bench,
        run.words(),
        session=wish.session,
        model=model,
        bus=wish.bus,
        bench_bus=wish.bench_bus,
        join=wish.join,
        jitted_ecu=is_heavy(wish.bench, model),
    ) as lanes:
        yield Event("note", f"bus: {lanes[0].choice.why}; {len(lanes)} benches side by side")
        course = Search(wish, run, Track(lanes, wish.bench, run), study, vectors)
        try:
            yield from course.baselines(missing)
            yield from course.trials()
        finally:
            course.track.close()


class Search:
    """Baselines and trials of one session."""

    def __init__(
        self, wish: Wish, run: RunFolder, track: Track, study: Study, vectors: Mapping[str, dict[str, float]]
    ) -> None:
        self.wish = wish
        self.run = run
        self.track = track
        self.study = study
        self.vectors = vectors
        self.scenarios = [wish.bench.scenarios[name] for name in wish.bench.spec.scenarios]
        best = study.best()
        self._best_slot = best.slot if best else None
        self._times: list[float] = []

    def baselines(self, missing: list[str]) -> Iterator[Event]:
        """Score the baselines that the study does not have yet."""
        order = list(self.vectors)
        for name in missing:
            started = time.monotonic()
            try:
                evaluation = self._evaluate(self.vectors[name], order.index(name))
            except BenchError as error:
                yield Event("warning", f"baseline {name} failed and is driven again: {error.message}")
                evaluation = self._evaluate(self.vectors[name], order.index(name))
            self.study.add_baseline(name, self.vectors[name], evaluation)
            self._times.append(time.monotonic() - started)
            done = len(self.study.baselines())
            yield self._progress(f"{name} scores {evaluation.score:.3f}", "baseline", done, len(order))

    def trials(self) -> Iterator[Event]:
        """Fill the slots; the logs of the best are kept, the others' dropped."""
        for trial in self.study.run(self.wish.trials, self._trial):
            if trial.error:
                yield Event("warning", f"trial {trial.slot + 1} failed and is asked again: {trial.error}")
                continue
            self._keep_best(trial.slot)
            words = ", ".join(f"{name} {value:.4g}" for name, value in trial.parameters.items())
            done = len(self.study.trials())
            yield self._progress(f"{trial.score:.3f} at {words}", "trial", done, self.wish.trials)

    def _trial(self, searched: dict[str, float]) -> Evaluation:
        started = time.monotonic()
        slot = len(self.study.trials())
        evaluation = self._evaluate(parameters_of(self.wish.bench, searched), len(self.vectors) + slot)
        self._times.append(time.monotonic() - started)
        return evaluation

    def _evaluate(self, values: Mapping[str, float], group: int) -> Evaluation:
        episodes = self.track.drive_all(values, self.scenarios, group * len(self.scenarios))
        return evaluation_of(episodes)

    def _keep_best(self, slot: int) -> None:
        """Drop the logs of whichever is no longer the best: this slot, or the one that it beat."""
        best = self.study.best()
        if best is None:
            return
        loser = self._best_slot if best.slot == slot else slot
        self._best_slot = best.slot
        if loser is not None and loser != best.slot:
            for k in episodes_of(len(self.vectors) + loser, len(self.scenarios)):
                drop_bulk(self.run.episode(k))

    def _progress(self, message: str, label: str, done: int, total: int) -> Event:
        each_s = statistics.median(self._times[-10:])
        rest = (total - done) + (self.wish.trials - len(self.study.trials()) if label == "baseline" else 0)
        best, manual = self.study.best(), self.study.baselines()
        data: dict[str, Any] = {"label": label, "done": done, "total": total, "eta_s": each_s * rest, **self.track.pace}
        if best is not None:
            data["best"] = best.score
        if manual:
            data["manual"] = best_baseline(manual).score
        return Event("progress", message, data)


def episodes_of(group: int, scenarios: int) -> range:
    """Numbers of the episodes of one set of parameters: baselines come first, then the slots."""
    return range(group * scenarios, (group + 1) * scenarios)

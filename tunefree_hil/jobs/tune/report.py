"""What a study leaves for people: best.toml, figures, and a comparison with the best manual gains."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import TunefreeError
from tunefree_hil.bench import Bench, parameters_of
from tunefree_hil.config.dump import to_toml
from tunefree_hil.control.parameters import BY_NAME
from tunefree_hil.episode.recording import Recording, load_recording
from tunefree_hil.jobs.learn.report_text import outside_data, outside_words
from tunefree_hil.jobs.report_text import Drives, comparison, early, table
from tunefree_hil.jobs.run_folder import RunFolder, write_text
from tunefree_hil.jobs.tune.candidates import TUNED, baseline_vectors
from tunefree_hil.jobs.tune.confirm import Confirmed
from tunefree_hil.jobs.tune.robustness import Held, held_data, held_table, held_words
from tunefree_hil.tune.compare import Standing, best_baseline
from tunefree_hil.tune.insight import edge_of
from tunefree_hil.tune.journal import slot_key
from tunefree_hil.tune.trial import Scored, Trial

DIFFERS = 1  # exit status


class Report(NamedTuple):
    """Lines for a person, one sentence, and the same as data."""

    lines: list[str]
    sentence: str
    data: dict[str, Any]


def finish_report(
    bench: Bench, run: RunFolder, study: Scored, held: Held, confirmed: Confirmed | None = None
) -> Report:
    """Write best.toml and the figures of a study with at least one trial and one baseline.

    held: what the slower car said, which names the winner; confirmed: of a batch, the winner is one of those that the
    bus confirmed.
    """
    trials = study.trials() if confirmed is None else confirmed.known()
    if not trials:
        raise TunefreeError("the study has no trial", hint="--trials 1 or more")
    best, standing = held.ranked(trials)[0], best_baseline(study.baselines())
    write_text(run.path / "best.toml", _best_toml(bench, best, standing))
    data = {
        "over": "bus",
        "best": {"slot": best.slot, "score": best.score, "parameters": best.parameters},
        "manual": standing._asdict(),
        "baselines": {name: one.score for name, one in study.baselines().items()},
        "held": held_data(held, study, trials),
        "ratio": best.score / standing.score,
        "on_edge": on_edge(study, best),
        "outside": outside_data(bench, bench.spec.model, _winning_drives(bench, run, best.slot)),
        "figures": _figures(bench, run, study, best, standing.name),
    }
    report = Report(_lines(study, best, data), _sentence(study, best, standing, data), data)
    return report if confirmed is None else _with_batch(report, confirmed, best)


def _lines(study: Scored, best: Trial, data: Mapping[str, Any]) -> list[str]:
    """The winner among the baselines, what the slower car said, and the edges that it lies on."""
    rows: dict[str, Drives] = {name: one.scenarios for name, one in study.baselines().items()}
    lines = table({TUNED: best.scenarios, **rows}, {TUNED: best.score, **data["baselines"]})
    lines += held_table(data["held"])
    edges = data["on_edge"]
    return lines + ([f"the winner lies on an edge of its box: {', '.join(edges)}"] if edges else [])


def _sentence(study: Scored, best: Trial, standing: Standing, data: Mapping[str, Any]) -> str:
    shown = ", ".join(f"{name} = {value:.4g}" for name, value in best.parameters.items())
    manual = study.baselines()[standing.name].scenarios
    compared = comparison(standing.name, manual, best.scenarios, (standing.score, best.score))
    more = (held_words(data["held"]), outside_words(data["outside"]))
    return f"{shown}: {'; '.join(one for one in (compared, *more) if one)}"


def _with_batch(report: Report, confirmed: Confirmed, best: Trial) -> Report:
    """The same, with batch and bus beside each other; exit 1 where they differ."""
    scores, key = confirmed.scores(), slot_key(best.slot)
    different = [name for name, one in scores.items() if not one.equal]
    trials = confirmed.trials()
    driven = [trial for trial in trials if slot_key(trial.slot) in scores]
    lines = [
        f"all {len(trials)} trials were driven in the batch; {len(driven)} of them and the baselines, "
        "below, over the bus again (the table above is the bus's)"
    ]
    width = max(len(name) for name in scores)
    lines.append(f"{'':{width}}     batch       bus")
    for name, one in sorted(scores.items(), key=lambda item: item[1].bus):
        words = one.verdict + (", the winner" if name == key else "")
        lines.append(f"{name:{width}}  {one.batch:8.6f}  {one.bus:8.6f}  {words}")
    agreed = f"where all metrics of {len(scores) - len(different)} of {len(scores)} candidates equal the batch's"
    sentence = f"{report.sentence}; found in a batch of {len(trials)} trials, confirmed over the bus, {agreed}"
    data = {
        **report.data,
        "over": "bus",
        "trials_over": "batch",
        "confirmed": {name: {**one._asdict(), "equal": one.equal} for name, one in scores.items()},
        "different": different,
        "exit": DIFFERS if different else 0,
    }
    return Report([*report.lines, *lines], sentence, data)


def _best_toml(bench: Bench, best: Trial, standing: Standing) -> str:
    data = {
        "schema": "tunefree.best/1",
        "bench": bench.file,
        "model": bench.spec.model,
        "slot": best.slot,
        "score": best.score,
        "manual": standing.name,
        "manual_score": standing.score,
        "tuned": best.parameters,
        "parameters": parameters_of(bench, best.parameters),
    }
    return (
        "# The winner of a study. [parameters] is complete: paste it into [controller.parameters] of a bench file.\n"
        + to_toml(data)
    )


def on_edge(study: Scored, best: Trial) -> list[str]:
    """Searched parameters whose winning value lies on an edge of its box."""
    edges = {axis.name: edge_of(axis, best.parameters[axis.name]) for axis in study.settings.space.axes}
    return [f"{name} ({edge} edge)" for name, edge in edges.items() if edge]


def _figures(bench: Bench, run: RunFolder, study: Scored, best: Trial, manual_name: str) -> list[str]:
    from tunefree_hil.figures.bars import write_bars
    from tunefree_hil.figures.tuning.history import write_history
    from tunefree_hil.figures.tuning.scatter import Points, Range, write_scatter

    folder = run.figures()
    trials, baselines = study.trials(), study.baselines()
    manual = baselines[manual_name]
    scores = [trial.score for trial in trials]
    others = {name: one.score for name, one in baselines.items() if name != manual_name}
    written = [write_history(folder / "history.png", scores, {f"manual ({manual_name})": manual.score, **others})]
    axes = study.settings.space.axes
    points = Points(
        parameters={axis.name: [trial.parameters[axis.name] for trial in trials] for axis in axes},
        scores=scores,
        boxes={axis.name: Range(axis.low, axis.high, axis.log, _unit(axis.name)) for axis in axes},
        manual={axis.name: manual.parameters[axis.name] for axis in axes},
    )
    written.append(write_scatter(folder / "parameters.png", points))
    bars = {
        f"manual ({manual_name})": {name: drive["score"] for name, drive in manual.scenarios.items()},
        TUNED: {name: drive["score"] for name, drive in best.scenarios.items()},
    }
    written.append(write_bars(folder / "scenarios.png", bars))
    written += scenario_figures(bench, run, best.slot, manual_name, manual.scenarios, best.scenarios)
    return [str(path) for path in written]


def scenario_figures(
    bench: Bench, run: RunFolder, slot: int, manual_name: str, manual: Drives, tuned: Drives
) -> list[Path]:
    """Manual against tuned, one figure a scenario; one whose columns are gone (an old run) is left out."""
    from tunefree_hil.figures.scenario import Drive, write_scenario

    vectors = list(baseline_vectors(bench))
    written = []
    for place, name in enumerate(_driven_names(bench)):
        groups = {
            f"manual ({manual_name})": (vectors.index(manual_name), manual),
            TUNED: (len(vectors) + slot, tuned),
        }
        drives = []
        for label, (group, grades) in groups.items():
            path = _columns(bench, run, group, place)
            if path.is_file():
                graded = grades[name]
                drives.append(Drive(label, load_recording(path).columns, graded["score"], early(graded["outcome"])))
        if len(drives) == len(groups):
            written.append(write_scenario(run.figures() / f"{name}.png", name, drives))
    return written


def _driven_names(bench: Bench) -> list[str]:
    return [bench.scenarios[name].name for name in bench.spec.scenarios]


def _columns(bench: Bench, run: RunFolder, group: int, place: int) -> Path:
    """columns.npz of a scenario of a candidate: baselines first, then the slots."""
    return run.episode(group * len(bench.spec.scenarios) + place) / "columns.npz"


def _winning_drives(bench: Bench, run: RunFolder, slot: int) -> dict[str, Recording]:
    """The winner's drives by scenario, as far as they are kept here (another worker's are not)."""
    group = len(baseline_vectors(bench)) + slot
    paths = {name: _columns(bench, run, group, place) for place, name in enumerate(_driven_names(bench))}
    return {name: load_recording(path) for name, path in paths.items() if path.is_file()}


def is_kept(bench: Bench, run: RunFolder, slot: int) -> bool:
    """Whether the drives of a trial are in the run folder."""
    group = len(baseline_vectors(bench)) + slot
    return all(_columns(bench, run, group, place).is_file() for place in range(len(bench.spec.scenarios)))


def _unit(name: str) -> str:
    return BY_NAME[name].tunable.unit if name in BY_NAME else ""

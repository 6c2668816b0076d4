"""The report of a study: best.toml, figures, and a comparison of the winner with the best manual gains."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import TunefreeError
from tunefree_hil.bench import Bench, parameters_of
from tunefree_hil.episode.recording import Recording, load_recording
from tunefree_hil.grade.requirements.limits import requirement_limits
from tunefree_hil.grade.requirements.verdict import DecidedGains, decide_verdict, judge_gains
from tunefree_hil.jobs.learn.report_text import describe_outside, measure_outside
from tunefree_hil.jobs.report_text import GradesByScenario, candidate_table, comparison_text
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.tune.candidates import TUNED, compute_baseline_vectors, parameter_unit, road_seed
from tunefree_hil.jobs.tune.confirm import ConfirmedStudy
from tunefree_hil.jobs.tune.robustness import RobustnessResult, robustness_data, robustness_table, robustness_text
from tunefree_hil.jobs.tune.verdict.best_file import PARAMETERS, DrivenOn, write_best
from tunefree_hil.jobs.tune.verdict.text import requirement_table, road_oscillation_text
from tunefree_hil.jobs.tune.verdict.trade import FIGURE, draw_trade, read_traded, trade_data, trade_table, trade_text
from tunefree_hil.tune.compare import BestBaseline, find_best_baseline
from tunefree_hil.tune.insight import Edge, find_edge
from tunefree_hil.tune.journal import slot_key
from tunefree_hil.tune.trial import ScoredStudy, Trial

EXIT_DIFFERENT = 1  # exit status
TRADE = "trade"  # key of the data of a study of several objectives


class TuneReport(NamedTuple):
    """A report as lines, as one sentence without the verdict, and as data. decided: On the searched roads."""

    lines: list[str]
    sentence: str
    data: dict[str, Any]
    decided: DecidedGains


def write_tune_report(
    bench: Bench,
    run: RunFolder,
    study: ScoredStudy,
    robustness: RobustnessResult,
    confirmed: ConfirmedStudy | None = None,
) -> TuneReport:
    """Write best.toml and the figures of a study with at least one trial and one baseline.

    Args:
        bench: The bench of the search.
        run: Run folder of the tune.
        study: The scored trials.
        robustness: Result of the robustness check, which decides the winner.
        confirmed: Of a batch, the confirmed study; the winner is one of its confirmed trials.
    """
    trials = study.trials() if confirmed is None else confirmed.confirmed_trials()
    if not trials:
        raise TunefreeError("the study has no trial", hint="--trials 1 or more")
    winner, manual = robustness.rank_trials(trials)[0], find_best_baseline(study.baselines())
    decided = _decide(bench, study, winner)
    _write_best(bench, run, winner, manual, decided)
    data = {
        "over": "bus",
        "best": {"slot": winner.slot, "score": winner.score, "parameters": winner.parameters},
        "manual": manual._asdict(),
        "baselines": {name: baseline.score for name, baseline in study.baselines().items()},
        "held": robustness_data(robustness, study, trials),
        "ratio": winner.score / manual.score,
        "on_edge": find_winner_edges(study, winner),
        "outside": measure_outside(bench, bench.spec.model, _winning_drives(bench, run, winner.slot)),
        "figures": _write_figures(bench, run, study, winner, manual.name),
        **decided.as_data(),
    }
    if study.settings.objectives:
        traded = read_traded(study)
        data[TRADE] = trade_data(traded, winner.slot)
        data["figures"].append(str(draw_trade(traded, data[TRADE], run.figures() / FIGURE)))
    report = TuneReport(_lines(study, winner, data), _sentence(study, winner, manual, data), data, decided)
    return report if confirmed is None else _add_confirmation(report, confirmed, winner)


def _decide(bench: Bench, study: ScoredStudy, winner: Trial) -> DecidedGains:
    """The verdict of the searched roads, by the requirements; the search kept a reserve to some of them."""
    limits = requirement_limits(bench.vehicle.limits, bench.spec.require) if study.settings.requirements else {}
    manuals = {name: judge_gains(base.score, base.scenarios, limits) for name, base in study.baselines().items()}
    return decide_verdict(judge_gains(winner.score, winner.scenarios, limits), manuals)


def _lines(study: ScoredStudy, winner: Trial, data: Mapping[str, Any]) -> list[str]:
    """Tables of winner and baselines and of the robustness check, and values on an edge of the range."""
    rows: dict[str, GradesByScenario] = {name: baseline.scenarios for name, baseline in study.baselines().items()}
    lines = candidate_table({TUNED: winner.scenarios, **rows}, {TUNED: winner.score, **data["baselines"]})
    lines += requirement_table({TUNED: data["requirements"], **data["manual_requirements"]})
    lines += trade_table(data[TRADE]) if TRADE in data else []
    lines += robustness_table(data["held"])
    edges = data["on_edge"]
    return lines + ([f"the winner is on an edge of its range: {', '.join(edges)}"] if edges else [])


def _sentence(study: ScoredStudy, winner: Trial, manual: BestBaseline, data: Mapping[str, Any]) -> str:
    values = ", ".join(f"{name} = {value:.4g}" for name, value in winner.parameters.items())
    grades = study.baselines()[manual.name].scenarios
    compared = comparison_text(manual.name, grades, winner.scenarios, (manual.score, winner.score))
    swing = road_oscillation_text(winner.scenarios)
    trade = trade_text(data[TRADE]) if TRADE in data else ""
    parts = (compared, trade, swing, robustness_text(data["held"]), describe_outside(data["outside"]))
    return f"{values}: {'; '.join(part for part in parts if part)}"


def _add_confirmation(report: TuneReport, confirmed: ConfirmedStudy, winner: Trial) -> TuneReport:
    """The report with the scores in the batch and over the bus; exit status 1 where they differ."""
    scores, key = confirmed.scores(), slot_key(winner.slot)
    different = [name for name, score in scores.items() if not score.is_equal]
    trials = confirmed.trials()
    driven = [trial for trial in trials if slot_key(trial.slot) in scores]
    lines = [
        f"all {len(trials)} trials were driven in the batch; {len(driven)} of them and the best manual set also over "
        "the bus (the table above has their scores of the bus)"
    ]
    width = max(len(name) for name in scores)
    lines.append(f"{'':{width}}     batch       bus")
    for name, score in sorted(scores.items(), key=lambda item: item[1].bus):
        verdict = score.verdict + (", the winner" if name == key else "")
        lines.append(f"{name:{width}}  {score.batch:8.6f}  {score.bus:8.6f}  {verdict}")
    equal = f"{len(scores) - len(different)} of {len(scores)} candidates have the same metrics in batch and bus"
    sentence = f"{report.sentence}; found in a batch of {len(trials)} trials and confirmed over the bus: {equal}"
    data = {
        **report.data,
        "over": "bus",
        "trials_over": "batch",
        "confirmed": {name: {**score._asdict(), "equal": score.is_equal} for name, score in scores.items()},
        "different": different,
        "exit": EXIT_DIFFERENT if different else 0,
    }
    return TuneReport([*report.lines, *lines], sentence, data, report.decided)


def _write_best(bench: Bench, run: RunFolder, winner: Trial, manual: BestBaseline, decided: DecidedGains) -> None:
    """best.toml before a verification."""
    data = {
        "schema": "tunefree.best/1",
        "bench": bench.file,
        "model": bench.spec.model,
        "slot": winner.slot,
        "score": winner.score,
        "manual": manual.name,
        "manual_score": manual.score,
        "tuned": winner.parameters,
        PARAMETERS: parameters_of(bench, winner.parameters),
    }
    driven = DrivenOn(bench.spec.model, list(winner.scenarios), road_seed(bench), is_verified=False)
    vectors = compute_baseline_vectors(bench)
    write_best(run, data, decided, driven, vectors, road_oscillation_text(winner.scenarios))


def find_winner_edges(study: ScoredStudy, winner: Trial) -> list[str]:
    """Tuned parameters whose value is on an edge of its range."""
    edges = {axis.name: find_edge(axis, winner.parameters[axis.name]) for axis in study.settings.space.axes}
    return [f"{name} ({edge} edge)" for name, edge in edges.items() if edge is not Edge.NONE]


def _write_figures(bench: Bench, run: RunFolder, study: ScoredStudy, winner: Trial, manual_name: str) -> list[str]:
    from tunefree_hil.figures.bars import draw_bars
    from tunefree_hil.figures.style import save
    from tunefree_hil.figures.tuning.history import draw_history
    from tunefree_hil.figures.tuning.scatter import ParameterBox, TrialPoints, draw_scatter

    folder = run.figures()
    trials, baselines = study.trials(), study.baselines()
    manual = baselines[manual_name]
    scores = [trial.score for trial in trials]
    others = {name: baseline.score for name, baseline in baselines.items() if name != manual_name}
    written = [save(draw_history(scores, {f"manual ({manual_name})": manual.score, **others}), folder / "history.png")]
    axes = study.settings.space.axes
    points = TrialPoints(
        parameters={axis.name: [trial.parameters[axis.name] for trial in trials] for axis in axes},
        scores=scores,
        boxes={axis.name: ParameterBox(axis.low, axis.high, axis.log, parameter_unit(axis.name)) for axis in axes},
        manual={axis.name: manual.parameters[axis.name] for axis in axes},
    )
    written.append(save(draw_scatter(points), folder / "parameters.png"))
    bars = {
        f"manual ({manual_name})": {name: drive["score"] for name, drive in manual.scenarios.items()},
        TUNED: {name: drive["score"] for name, drive in winner.scenarios.items()},
    }
    written.append(save(draw_bars(bars), folder / "scenarios.png"))
    written += write_scenario_figures(bench, run, study, winner, manual_name)
    return [str(path) for path in written]


def write_scenario_figures(
    bench: Bench, run: RunFolder, study: ScoredStudy, winner: Trial, manual_name: str
) -> list[Path]:
    """Manual against tuned, one figure a scenario; a scenario without recordings (an old run) is left out."""
    from tunefree_hil.figures.scenario import DrivePicture, draw_scenario
    from tunefree_hil.figures.style import save

    manual_files = _columns_files(bench, run, list(compute_baseline_vectors(bench)).index(manual_name))
    tuned_files = _trial_columns(bench, run, winner.slot)
    manual = study.baselines()[manual_name].scenarios
    written = []
    for name in manual_files:
        groups = {
            f"manual ({manual_name})": (manual_files[name], manual[name]),
            TUNED: (tuned_files[name], winner.scenarios[name]),
        }
        if all(path.is_file() for path, _ in groups.values()):
            drives = [
                DrivePicture(label, load_recording(path).columns, grade["score"], grade["outcome"])
                for label, (path, grade) in groups.items()
            ]
            written.append(save(draw_scenario(name, drives), run.figures() / f"{name}.png"))
    return written


def _columns_files(bench: Bench, run: RunFolder, group: int) -> dict[str, Path]:
    """columns.npz of a candidate by scenario; the groups are the baselines, then the slots."""
    names = [bench.scenarios[name].name for name in bench.spec.scenarios]
    return {name: run.episode(k) / "columns.npz" for k, name in enumerate(names, group * len(names))}


def _trial_columns(bench: Bench, run: RunFolder, slot: int) -> dict[str, Path]:
    return _columns_files(bench, run, len(compute_baseline_vectors(bench)) + slot)


def _winning_drives(bench: Bench, run: RunFolder, slot: int) -> dict[str, Recording]:
    """Recordings of the winner by scenario, as far as they are in this run folder (not those of other workers)."""
    paths = _trial_columns(bench, run, slot)
    return {name: load_recording(path) for name, path in paths.items() if path.is_file()}


def has_recordings(bench: Bench, run: RunFolder, slot: int) -> bool:
    """Whether the drives of a trial are in the run folder."""
    return all(path.is_file() for path in _trial_columns(bench, run, slot).values())

"""Verification: the winner and every baseline on the verify model, over scenarios that the search did not use.

Over the bus first, which decides which is better; then the margins of the winner and of the best baseline in the batch
(jobs/tune/margins.py).
"""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.bench import Bench, load
from tunefree_hil.grade.requirements.limits import requirement_limits
from tunefree_hil.grade.requirements.verdict import DecidedGains, GainsVerdict, decide_verdict, judge_gains
from tunefree_hil.jobs.command_text import shell_command
from tunefree_hil.jobs.drive import new_session_name
from tunefree_hil.jobs.learn.report_text import describe_outside, measure_outside
from tunefree_hil.jobs.options.records import VerifyOptions
from tunefree_hil.jobs.progress import count_data
from tunefree_hil.jobs.report_text import candidate_table, comparison_text
from tunefree_hil.jobs.run_folder import JOINED, RunFolder, open_run, write_json
from tunefree_hil.jobs.running.episode_results import EpisodeResult, evaluation_from_episodes
from tunefree_hil.jobs.running.foreign import joined_controller_name, make_launch
from tunefree_hil.jobs.running.session import choose_lane_count, open_lanes
from tunefree_hil.jobs.running.trial_driver import TrialDriver
from tunefree_hil.jobs.tune.candidates import TUNED, compute_baseline_vectors, read_winner, road_seed
from tunefree_hil.jobs.tune.margins import find_margins, margin_data, margin_table, margin_text, measure_steering
from tunefree_hil.jobs.tune.verdict.best_file import DrivenOn, read_best, write_best
from tunefree_hil.jobs.tune.verdict.text import requirement_table, road_oscillation_text, verdict_reason
from tunefree_hil.tune.trial import Evaluation

EXIT_NOT_BETTER = 1  # exit status
BEFORE_AFTER = "before_after.png"  # in the figures of the run

EpisodesByVector = dict[str, Mapping[str, EpisodeResult]]  # and by scenario


def verify(options: VerifyOptions) -> Iterator[Event]:
    """Verify the winner of a finished tune again.

    Exit status 1 where the gains are not ACCEPTED: they violate a requirement, or a manual set that meets the
    requirements is as good.
    """
    run = open_run(options.run)
    command = run.record.get("command")
    if command != "tune":
        raise InputError(f"is a run of {command!r}", file=str(options.run), hint="give the run folder of a tune")
    bench = load(run.bench_file())
    connection = options._replace(session=options.session or new_session_name())
    result = yield from verify_winner(bench, run, connection)
    data = {"exit": 0 if result["holds"] else EXIT_NOT_BETTER, "run": str(options.run), **result}
    data["next"] = [shell_command("replay", options.run, verify=True)]
    yield Event("result", result["sentence"], data)


def verify_winner(bench: Bench, run: RunFolder, options: VerifyOptions) -> Generator[Event, None, dict[str, Any]]:
    """Drive winner and baselines, and write verify.json and figures of the run.

    Args:
        bench: Its verify_model is driven over its verify_scenarios.
        run: Run folder of the tune.
        options: Bus and session; the field `run` is not used.

    Returns:
        The comparison, as in verify.json.
    """
    model = bench.spec.verify_model
    if not model or not bench.spec.verify_scenarios:
        raise InputError("has no verify_model with verify_scenarios", file=bench.file, key="verify_model")
    vectors = {TUNED: read_winner(bench, run), **compute_baseline_vectors(bench)}
    session = options.session if options.join else f"{options.session}-verify"
    launch = make_launch(bench, model, session=session, bus=options.bus, bench_bus=options.bench_bus, join=options.join)
    n_lanes = choose_lane_count(options.join, options.bus)
    with open_lanes(n_lanes, Path(bench.file), run.node_output(), launch) as lanes:
        driver = TrialDriver(lanes, bench, RunFolder(run.path / "verify", run.record))
        episodes = yield from _drive_vectors(driver, bench, vectors)
        joined = joined_controller_name(lanes) if options.join else run.record.get(JOINED)
    evaluations = {name: evaluation_from_episodes(by_scenario) for name, by_scenario in episodes.items()}
    decided = _decide(bench, evaluations)
    data = _compare(decided, evaluations)
    yield from (Event("note", line) for line in candidate_table(data["scenarios"], data["scores"]))
    table = requirement_table({TUNED: data["requirements"], **data["manual_requirements"]})
    yield from (Event("note", line) for line in table)
    compared = {name: vectors[name] for name in (TUNED, decided.manual)}
    data["margins"] = yield from _report_margins(bench, compared, episodes, data["scores"], joined)
    # whether the data of the tuned model cover what the winner does on the vehicle
    recordings = {name: episode.recording for name, episode in episodes[TUNED].items()}
    data["outside"] = measure_outside(bench, bench.spec.model, recordings)
    swing = road_oscillation_text(evaluations[TUNED].scenarios)
    parts = (data["summary"], swing, margin_text(data["margins"], TUNED), describe_outside(data["outside"]))
    data["summary"] = "; ".join(part for part in parts if part)
    data["sentence"] = f"{data['verdict']}: {data['reason']}; {data['summary']}"
    driven = DrivenOn(model, list(evaluations[TUNED].scenarios), road_seed(bench))
    write_best(run, read_best(run), decided, driven, vectors, swing)
    data["figures"] = _write_figures(run, episodes, data)
    yield Event("note", f"picture of manual and tuned gains: {run.figures() / BEFORE_AFTER}")
    write_json(run.path / "verify.json", {"schema": "tunefree.verify/1", **data})
    return data


def _drive_vectors(
    driver: TrialDriver, bench: Bench, vectors: Mapping[str, Mapping[str, float]]
) -> Generator[Event, None, EpisodesByVector]:
    """The episodes of every vector; closes the driver."""
    scenarios = [bench.scenarios[name] for name in bench.spec.verify_scenarios]
    episodes: EpisodesByVector = {}
    started = time.monotonic()
    with closing(driver):
        for i, (name, values) in enumerate(vectors.items()):
            episodes[name] = driver.drive_scenarios(values, scenarios, i * len(scenarios))
            data = count_data("verify", i + 1, len(vectors), started) | driver.pace
            score = evaluation_from_episodes(episodes[name]).score
            yield Event("progress", f"{name} scores {score:.3f} on {bench.spec.verify_model}", data)
    return episodes


def _report_margins(
    bench: Bench,
    vectors: Mapping[str, Mapping[str, float]],
    driven: EpisodesByVector,
    scores: Mapping[str, float],
    joined: str | None,
) -> Generator[Event, None, dict[str, Any]]:
    """The value of "margins" in verify.json; yields the table as notes, and a warning where batch and bus differ.

    Args:
        vectors: The gains whose margins are measured.
        driven: Episodes of these and other gains.
    """
    episodes = {name: driven[name] for name in vectors}
    scenarios = [bench.scenarios[name] for name in bench.spec.verify_scenarios]
    margin_result = yield from find_margins(bench, bench.spec.verify_model, vectors, scenarios, joined)
    steering = {
        name: measure_steering(episode.recording for episode in by_scenario.values())
        for name, by_scenario in episodes.items()
    }
    over_bus = {
        name: {scenario: episode.grade.score for scenario, episode in by_scenario.items()}
        for name, by_scenario in episodes.items()
    }
    data = margin_data(margin_result, steering, {name: scores[name] for name in vectors}, over_bus)
    yield from (Event("note", line) for line in margin_table(data, TUNED))
    equal_scores = data["same_as_bus"]
    if equal_scores and equal_scores["equal"] < equal_scores["of"]:
        counts = f"{equal_scores['equal']} of {equal_scores['of']}"
        yield Event("warning", f"batch and bus agree in {counts} scores of the nominal car")
    return data


def _decide(bench: Bench, evaluations: Mapping[str, Evaluation]) -> DecidedGains:
    """The verdict by the requirements of the bench file, over the verified roads."""
    limits = requirement_limits(bench.vehicle.limits, bench.spec.require)
    judged = {name: judge_gains(one.score, one.scenarios, limits) for name, one in evaluations.items()}
    return decide_verdict(judged[TUNED], {name: gains for name, gains in judged.items() if name != TUNED})


def _compare(decided: DecidedGains, evaluations: Mapping[str, Evaluation]) -> dict[str, Any]:
    """The winner against the best baseline."""
    tuned, best = evaluations[TUNED], evaluations[decided.manual]
    return {
        "summary": comparison_text(decided.manual, best.scenarios, tuned.scenarios, (best.score, tuned.score)),
        "reason": verdict_reason(decided),
        "holds": decided.verdict is GainsVerdict.ACCEPTED,
        **decided.as_data(),
        "manual": decided.manual,
        "ratio": tuned.score / best.score,
        "scores": {name: evaluation.score for name, evaluation in evaluations.items()},
        "scenarios": {name: evaluation.scenarios for name, evaluation in evaluations.items()},
    }


def _write_figures(run: RunFolder, episodes: EpisodesByVector, data: Mapping[str, Any]) -> list[str]:
    from tunefree_hil.figures.scenario import DrivePicture, draw_scenario
    from tunefree_hil.figures.style import save
    from tunefree_hil.figures.tuning.before_after import RoadPair, draw_before_after
    from tunefree_hil.figures.tuning.margins import draw_margins

    manual, margins = data["manual"], data["margins"]
    written = [] if margins["reason"] else [str(save(draw_margins(margins, TUNED), run.figures() / "margins.png"))]
    pairs = []
    for name in episodes[TUNED]:
        drives = []
        for label, candidate in ((f"manual ({manual})", manual), (TUNED, TUNED)):
            recording, grade, *_ = episodes[candidate][name]
            drives.append(DrivePicture(label, recording.columns, grade.score, grade.outcome))
        written.append(str(save(draw_scenario(f"{name} (verify)", drives), run.figures() / f"verify_{name}.png")))
        pairs.append(RoadPair(name, *drives))
    return [str(save(draw_before_after(pairs), run.figures() / BEFORE_AFTER)), *written]

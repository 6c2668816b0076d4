"""Learns a plant from logs: reads, checks, calibrates the physics, trains, evaluates in free run, writes a folder."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.gap.model.card import read_card
from tunefree_hil.jobs.command_text import changed_options, shell_command
from tunefree_hil.jobs.gap.calibration_logs import analyse_calibration_logs, is_analysed
from tunefree_hil.jobs.learn import calibration
from tunefree_hil.jobs.learn.logs import read_logs
from tunefree_hil.jobs.learn.options import LearnOptions
from tunefree_hil.jobs.learn.steering import copy_steering_map, learn_steering_of_folder
from tunefree_hil.jobs.preconditions import ErrorPlace, require_model_of_vehicle, require_number
from tunefree_hil.jobs.progress import relay_events
from tunefree_hil.learn.drives.drive import Drive, DriveSplit
from tunefree_hil.learn.evaluation.free_run import FreeRunErrors
from tunefree_hil.learn.evaluation.motion import MotionTrack, make_motion_tracks
from tunefree_hil.learn.model_folder import (
    CALIBRATION_EFFECTS,
    CARD_FILE,
    LearnedModel,
    LearningRecord,
    TrainingRecord,
    load_calibration,
    make_card,
    require_new_folder,
    write_learned_model,
)
from tunefree_hil.learn.physics.unknowns import ROAD_SHARE

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec
    from tunefree_hil.learn.training.learners import TrainingPlan
    from tunefree_hil.learn.training.loop import TrainingProgress, TrainingResult

KINDS = ("hybrid", "lstm", "mlp", "rule_based", "paper")
FREE_RUN_STARTS = 200  # of the evaluation
MIN_TRACK_S = 2.5  # shorter tracks are not used
MAX_MINUTES, MAX_SPACING_S = 1e6, 0.5  # limits of the options: two years, half a second


class LearningData(NamedTuple):
    """Drives of a vehicle, and the motion tracks of their training and held-out parts."""

    vehicle: VehicleSpec
    drives: list[Drive]
    split: DriveSplit
    training: list[MotionTrack]
    held_out: list[MotionTrack]


def learn(options: LearnOptions) -> Iterator[Event]:
    """Learn, and write `options.out`; an interrupted training continues from its checkpoint (<out>.part).

    Raises:
        InputError: torch is missing, the logs cannot be learned from, the folder is there already, or the physics is of
            another vehicle.
    """
    from tunefree_hil.config.load import load_vehicle

    _check_options(options)
    vehicle = load_vehicle(options.vehicle)
    require_new_folder(options.out)
    if options.physics is not None:
        load_physics(options.physics, vehicle)
    began = time.monotonic()
    physics, data = yield from _prepare_data(options, vehicle)
    learned, training = yield from _learn_plant(options, physics, data)
    errors = yield from _evaluate(learned, data)
    record = LearningRecord(
        kind=options.kind,
        vehicle=vehicle,
        physics=physics,
        drives=data.drives,
        split=data.split.description,
        seed=options.seed,
        seconds=time.monotonic() - began,
        training=training,
        evaluations=errors,
    )
    card = make_card(record) | read_own_effects(Path(physics.folder), data.drives)
    write_learned_model(options.out, learned, card)
    copy_steering_map(Path(physics.folder), options.out)
    yield from report_result(options)


def _prepare_data(
    options: LearnOptions, vehicle: VehicleSpec
) -> Generator[Event, None, tuple[ModelSpec, LearningData]]:
    """Read and split the logs, and obtain the physics. Returns: the calibrated model, and the data."""
    drives = yield from read_logs(options.logs, vehicle, tolerated=calibration.SHORT_STEERING)
    split = yield from calibration.split_drives_for_fit(drives, vehicle, options.seed)
    physics = yield from obtain_physics(options, vehicle, drives, split)
    road_share = read_road_share(Path(physics.folder), drives)
    tracks = [_make_tracks(parts, vehicle, road_share) for parts in (split.training, split.held_out)]
    return physics, LearningData(vehicle, drives, split, *tracks)


def _learn_plant(
    options: LearnOptions, physics: ModelSpec, data: LearningData
) -> Generator[Event, None, tuple[LearnedModel, TrainingRecord | None]]:
    """Train the net, or learn the map of a rule-based plant. Returns: the plant, and how the training went."""
    arrays, map_arrays, training = None, load_calibration(physics), None
    if options.kind == "rule_based":
        map_arrays = yield from _learn_map_arrays(data.drives, data.vehicle, options.seed)
    else:
        result, plan = yield from _train(options, physics, data)
        arrays, training = result.arrays, _summarise_training(result, plan)
        if result.stopped:
            yield Event("warning", f"the training stopped after {result.steps} steps: {result.stopped}")
    learned = LearnedModel(options.kind, data.vehicle, physics, arrays, map_arrays, options.sample_spacing_s)
    return learned, training


def report_result(options: LearnOptions) -> Iterator[Event]:
    """The result, from the card of the folder that is there; also after an interruption behind its writing."""
    card = read_card(options.out / CARD_FILE)
    _checkpoint_path(options).unlink(missing_ok=True)
    figures = _draw_figures(options, card)
    yield Event(
        "result", "", {**card, "model": str(options.out), "figures": figures, **_summarise_result(options, card)}
    )


def _checkpoint_path(options: LearnOptions) -> Path:
    return options.out.with_name(options.out.name + ".part")


def _check_options(options: LearnOptions) -> None:
    """Check what can be checked before an hour of logs is read."""
    if options.kind not in KINDS:
        raise InputError(f"no kind {options.kind!r}", code="unknown_kind", key="--kind", hint=", ".join(KINDS))
    require_number("--minutes", options.minutes, maximum=MAX_MINUTES, allow_zero=True)
    require_number("--sample-spacing", options.sample_spacing_s, maximum=MAX_SPACING_S)
    from tunefree_hil.learn.training.torch_extra import require_torch

    require_torch(f"learn --kind {options.kind}")


def obtain_physics(
    options: LearnOptions, vehicle: VehicleSpec, drives: list[Drive], split: DriveSplit
) -> Generator[Event, None, ModelSpec]:
    """Load the calibrated model that is named, or make one beside `out`."""
    folder = options.physics or options.out.with_name(options.out.name + "-physics")
    if options.physics is None and not _is_calibrated_on(folder, drives, options.seed):
        require_new_folder(folder)
        yield from calibration.calibrate_into(folder, vehicle, drives, split, options.seed)
    if options.physics is None:
        yield from learn_steering_of_folder(folder, vehicle, drives)
    if options.physics is None and not is_analysed(folder):
        yield from analyse_calibration_logs(folder, vehicle, drives)
    yield Event("note", f"physics: {folder}")
    return load_physics(folder, vehicle)


def load_physics(folder: Path, vehicle: VehicleSpec) -> ModelSpec:
    """Load a calibrated model. Raises InputError where it is not of this vehicle with its current files."""
    from tunefree_hil.config.load import load_model

    model = load_model(folder)
    hint = "name what `tunefree-hil calibrate` wrote for this vehicle, or leave --physics out"
    if model.plant.kind != "physics":
        raise InputError(
            f"is a model of {model.vehicle!r}, kind {model.plant.kind!r}; needed is one of {vehicle.name!r}, 'physics'",
            code="model_of_other_vehicle",
            file=f"{model.folder}/model.toml",
            key="--physics",
            hint=hint,
        )
    require_model_of_vehicle(model, vehicle, ErrorPlace(hint, "--physics"))
    return model


def _is_calibrated_on(folder: Path, drives: list[Drive], seed: int | None) -> bool:
    """Whether a folder was calibrated on the same logs, with the same seed of the split (None: any seed)."""
    if not (folder / CARD_FILE).is_file():
        return False
    card = read_card(folder / CARD_FILE)
    return calibration.has_same_logs(card, drives) and seed in (None, card.get("seed"))


def read_road_share(folder: Path, drives: list[Drive]) -> float:
    """The share of the constant part of the measured acceleration that is road slope and not sensor bias; 0.0 where the
    calibration did not identify it, or had other logs.
    """
    if not _is_calibrated_on(folder, drives, None):
        return 0.0
    entry = read_card(folder / CARD_FILE).get("constants", {}).get(ROAD_SHARE, {})
    return min(max(float(entry["value"]), 0.0), 1.0) if entry.get("known") else 0.0


def read_own_effects(folder: Path, drives: list[Drive]) -> dict[str, Any]:
    """Effects of the calibration logs, from the card of the physics, for a net that is trained on the same logs."""
    if not _is_calibrated_on(folder, drives, None):
        return {}
    card = read_card(folder / CARD_FILE)
    return {CALIBRATION_EFFECTS: card[CALIBRATION_EFFECTS]} if CALIBRATION_EFFECTS in card else {}


def _make_tracks(parts: Sequence[Any], vehicle: VehicleSpec, road_share: float) -> list[MotionTrack]:
    return make_motion_tracks(parts, vehicle, round(MIN_TRACK_S * 1000.0 / vehicle.tick_ms), road_share)


def _train(
    options: LearnOptions, physics: ModelSpec, data: LearningData
) -> Generator[Event, None, tuple[TrainingResult, TrainingPlan]]:
    """Train, with progress events."""
    from tunefree_hil.learn.training.fit import TrackSplit, train_plant
    from tunefree_hil.learn.training.learners import TrainingPlan

    minutes = options.minutes or 0.0
    plan = TrainingPlan(options.kind, options.seed, sample_spacing_s=options.sample_spacing_s, minutes=minutes)
    checkpoint, rest_frac = _checkpoint_path(options), data.vehicle.nominal.rest_pedal_frac
    steps = train_plant(plan, TrackSplit(data.training, data.held_out), physics, rest_frac, checkpoint)
    resume = build_command(options)

    def event_of(step: TrainingProgress) -> Event:
        text = f"loss {step.loss:.3g}, held out {step.score:.3g} (untrained {step.untrained_score:.3g})"
        count = {"label": "step", "done": step.done, "total": step.total, "eta_s": step.eta_s, "resume": resume}
        return Event("progress", text, count)

    result = yield from relay_events(steps, event_of)
    if result.is_resumed:
        yield Event("note", f"continued from {checkpoint}")
    return result, plan


def _summarise_training(result: TrainingResult, plan: TrainingPlan) -> TrainingRecord:
    measure = "position error at the end of the longest free run on held-out stretches, m"
    if plan.kind in ("mlp", "paper"):
        measure = "one-step error on held-out stretches, of the labels' spread"
    return TrainingRecord(
        settings={**plan._asdict(), "steps": result.total},
        score_words=measure,
        score=result.score,
        untrained=result.untrained_score,
        steps=result.steps,
        seconds=round(result.seconds, 1),
        looks=result.evaluations,
        stopped=result.stopped,
    )


def _learn_map_arrays(drives: list[Drive], vehicle: VehicleSpec, seed: int) -> Generator[Event, None, dict[str, Any]]:
    """Learn the open-loop map of the logs, as arrays of calibration.npz."""
    from tunefree_hil.jobs.learn.map import learn_map_with_progress
    from tunefree_hil.learn.open_loop_map.build import gather_samples

    learned = yield from learn_map_with_progress(gather_samples(drives, vehicle), vehicle, seed)
    return {name: getattr(learned.table, name) for name in ("speed_mps", "accel_mps2", "command_frac")}


def _evaluate(learned: LearnedModel, data: LearningData) -> Generator[Event, None, dict[str, FreeRunErrors]]:
    """Compiled free runs of the physics and the learned plant on held-out parts, by kind."""
    from tunefree_hil.learn.model_folder import evaluate_compiled

    yield Event("note", "evaluation: free runs on the held-out parts")
    try:
        return evaluate_compiled(learned, data.held_out, FREE_RUN_STARTS)
    except InputError as error:
        if error.code != "too_short":
            raise
        yield Event("warning", f"not evaluated in free run: {error.message}")
        return {}


def _draw_figures(options: LearnOptions, card: Mapping[str, Any]) -> list[str]:
    from tunefree_hil.figures.learning.training import draw_free_run
    from tunefree_hil.figures.style import save

    if not card["free_run"]:
        return []
    return [str(save(draw_free_run(card["free_run"]), options.out / "figures" / "free_run.png"))]


def _summarise_result(options: LearnOptions, card: Mapping[str, Any]) -> dict[str, Any]:
    """Sentence and next commands of the result."""
    sentence = f"{options.kind} plant in {options.out}"
    rows = card["free_run"].get(options.kind) or {}
    row = rows.get("level") or rows.get("hills")
    if row and "10" in row:
        sentence += f": {row['10']['position_m']['mean']:.2f} m off after 10 s of free run on held-out parts"
        reduced = card["reduction_percent"].get("10")
        if reduced:
            percent = reduced["value"]
            sentence += f", {abs(percent):.0f} % {'less' if percent >= 0.0 else 'more'} than the fitted physics"
    return {"status": "ok", "sentence": sentence, "next": [shell_command("drive", "BENCH", model=options.out)]}


def build_command(options: LearnOptions) -> str:
    """The same command again."""
    changed = changed_options(options, ["logs"], {"sample_spacing_s": "sample_spacing"})
    return shell_command("learn", *options.logs, **changed)

"""Learns a plant from logs: reads, checks, calibrates the physics, trains, judges in free run, writes a folder."""

from __future__ import annotations

import time
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.gap.model.card import read_card
from tunefree_hil.jobs.command_text import given, pasted
from tunefree_hil.jobs.gap.calibration_logs import ask_own_logs, were_asked
from tunefree_hil.jobs.learn import calibration
from tunefree_hil.jobs.learn.logs import read
from tunefree_hil.jobs.preconditions import require_model_of, require_number
from tunefree_hil.jobs.progress import told
from tunefree_hil.learn.compiled_process import Worker
from tunefree_hil.learn.drives.drive import Drive, Split
from tunefree_hil.learn.drives.road_slope import offset_words
from tunefree_hil.learn.evaluation.free_run import Judged
from tunefree_hil.learn.evaluation.motion import Track, tracks_of
from tunefree_hil.learn.model_folder import (
    CARD_FILE,
    OWN_EFFECTS,
    Learned,
    Training,
    calibration_of,
    card_of,
    require_new,
    write_learned,
)
from tunefree_hil.learn.physics.unknowns import ROAD

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec
    from tunefree_hil.learn.training.learners import Wish
    from tunefree_hil.learn.training.loop import Step, Trained

KINDS = ("hybrid", "lstm", "mlp", "rule_based", "paper")
JUDGED_STARTS = 200
LEAST_TRACK_S = 2.5
MOST_MINUTES, MOST_SPACING_S = 1e6, 0.5  # two years; half a second


class Asked(NamedTuple):
    """What the command line says. physics: a calibrated model folder, None to calibrate first, beside `out`."""

    logs: Sequence[Path]
    vehicle: str
    out: Path
    kind: str = "hybrid"
    seed: int = 1
    minutes: float | None = None
    physics: Path | None = None
    sample_spacing_s: float = 0.01


class Data(NamedTuple):
    """What is learned from."""

    drives: list[Drive]
    split: Split
    training: list[Track]
    held_out: list[Track]


def learn(asked: Asked) -> Iterator[Event]:
    """Write `asked.out`. A training that was cut off goes on where its checkpoint (<out>.part) was.

    Raises InputError: torch missing, logs that cannot be learned from, a folder that is there already, physics of
    another vehicle.
    """
    from tunefree_hil.config.load import load_vehicle

    _require(asked)
    vehicle = load_vehicle(asked.vehicle)
    require_new(asked.out)
    if asked.physics is not None:
        physics_in(asked.physics, vehicle)
    began = time.monotonic()
    drives = yield from read(asked.logs, vehicle, excused=calibration.STOPPED)
    split = yield from calibration.split_of(drives, asked.seed)
    for words in offset_words(drives, vehicle):
        yield Event("warning", words)
    physics = yield from physics_of(asked, vehicle, drives, split)
    share = road_share_of(Path(physics.folder), drives)
    data = Data(drives, split, *(_tracks(parts, vehicle, share) for parts in (split.training, split.held_out)))
    part = asked.out.with_name(asked.out.name + ".part")
    arrays, map_arrays, training = None, calibration_of(physics), None
    if asked.kind == "rule_based":
        map_arrays = yield from _map(drives, vehicle, asked.seed)
    else:
        trained, wish = yield from _trained(asked, vehicle, physics, data, part)
        arrays, training = trained.arrays, _said(trained, wish)
        if trained.stopped:
            yield Event("warning", f"the training stopped after {trained.steps} steps: {trained.stopped}")
    learned = Learned(asked.kind, vehicle, physics, arrays, map_arrays, asked.sample_spacing_s)
    judged = yield from _judged(learned, data)
    seconds = time.monotonic() - began
    card = card_of(asked.kind, vehicle, physics, drives, split.words, asked.seed, seconds, training, judged)
    card |= own_effects_of(Path(physics.folder), drives)
    write_learned(asked.out, learned, card)
    yield from finished(asked)


def finished(asked: Asked) -> Iterator[Event]:
    """The result, out of the card of the folder that is there: also for who was cut off when it had been written."""
    card = read_card(asked.out / CARD_FILE)
    asked.out.with_name(asked.out.name + ".part").unlink(missing_ok=True)
    figures = _drawn(asked, card)
    yield Event("result", "", {**card, "model": str(asked.out), "figures": figures, **_ending(asked, card)})


def _require(asked: Asked) -> None:
    """What can be said before an hour of logs is read."""
    if asked.kind not in KINDS:
        raise InputError(f"no kind {asked.kind!r}", code="unknown_kind", key="--kind", hint=", ".join(KINDS))
    require_number("--minutes", asked.minutes, most=MOST_MINUTES, zero=True)
    require_number("--sample-spacing", asked.sample_spacing_s, most=MOST_SPACING_S)
    from tunefree_hil.learn.training.torch_extra import require_torch

    require_torch(f"learn --kind {asked.kind}")


def physics_of(
    asked: Asked, vehicle: VehicleSpec, drives: list[Drive], split: Split
) -> Generator[Event, None, ModelSpec]:
    """The calibrated model: the one that was named, or one made now, kept beside `out` for the next time."""
    folder = asked.physics or asked.out.with_name(asked.out.name + "-physics")
    if asked.physics is None and not _is_of(folder, drives, asked.seed):
        require_new(folder)
        began = time.monotonic()
        with Worker() as worker:
            fitted = yield from calibration.fit_all(worker, split, vehicle)
        card = calibration.card_of(drives, split, vehicle, fitted, asked.seed, time.monotonic() - began)
        calibration.write(folder, vehicle, fitted, split, card)
    if asked.physics is None and not were_asked(folder):
        yield from ask_own_logs(folder, vehicle, drives)
    yield Event("note", f"physics: {folder}")
    return physics_in(folder, vehicle)


def physics_in(folder: Path, vehicle: VehicleSpec) -> ModelSpec:
    """The calibrated model in a folder. Raises InputError where it is not one of this vehicle as it is today."""
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
    require_model_of(model, vehicle, "--physics", hint=hint)
    return model


def _is_of(folder: Path, drives: list[Drive], seed: int | None) -> bool:
    """Whether a folder was calibrated on these very logs, and this split (None: whatever the split)."""
    if not (folder / CARD_FILE).is_file():
        return False
    said = read_card(folder / CARD_FILE)
    same = [one["hash"] for one in said.get("logs", [])] == [one.log_hash for one in drives]
    return same and seed in (None, said.get("seed"))


def road_share_of(folder: Path, drives: list[Drive]) -> float:
    """Of what the accelerometer of these logs says wherever the car heads, the part that is a slope; 0.0 where the
    calibration does not know, or knew other logs.
    """
    if not _is_of(folder, drives, None):
        return 0.0
    said = read_card(folder / CARD_FILE).get("constants", {}).get(ROAD, {})
    return min(max(float(said["value"]), 0.0), 1.0) if said.get("known") else 0.0


def own_effects_of(folder: Path, drives: list[Drive]) -> dict[str, Any]:
    """What explains these very logs beside the physics, as its card says it: a net that is taught by them has no other
    sensors.
    """
    if not _is_of(folder, drives, None):
        return {}
    said = read_card(folder / CARD_FILE)
    return {OWN_EFFECTS: said[OWN_EFFECTS]} if OWN_EFFECTS in said else {}


def _tracks(parts: Sequence[Any], vehicle: VehicleSpec, road_share: float) -> list[Track]:
    return tracks_of(parts, vehicle, round(LEAST_TRACK_S * 1000.0 / vehicle.tick_ms), road_share)


def _trained(
    asked: Asked, vehicle: VehicleSpec, physics: ModelSpec, data: Data, part: Path
) -> Generator[Event, None, tuple[Trained, Wish]]:
    """The training, with its progress."""
    from tunefree_hil.learn.training.fit import fit
    from tunefree_hil.learn.training.learners import Wish

    minutes = asked.minutes or 0.0
    wish = Wish(asked.kind, asked.seed, sample_spacing_s=asked.sample_spacing_s, minutes=minutes)
    steps = fit(wish, data.training, data.held_out, physics, vehicle.nominal.rest_pedal_frac, part)
    resume = again(asked)

    def event_of(step: Step) -> Event:
        words = f"loss {step.loss:.3g}, held out {step.score:.3g} (untrained {step.first:.3g})"
        count = {"label": "step", "done": step.done, "total": step.total, "eta_s": step.eta_s, "resume": resume}
        return Event("progress", words, count)

    trained = yield from told(steps, event_of)
    if trained.resumed:
        yield Event("note", f"went on from {part}")
    return trained, wish


def _said(trained: Trained, wish: Wish) -> Training:
    words = "position error at the end of the longest free run on held-out stretches, m"
    if wish.kind in ("mlp", "paper"):
        words = "one-step error on held-out stretches, of the labels' spread"
    return Training(
        {**wish._asdict(), "steps": trained.total}, words, trained.score, trained.first, trained.steps,
        round(trained.seconds, 1), trained.looks, trained.stopped,
    )  # fmt: skip


def _map(drives: list[Drive], vehicle: VehicleSpec, seed: int) -> Generator[Event, None, dict[str, Any]]:
    """The open-loop map of the logs, as arrays of calibration.npz."""
    from tunefree_hil.jobs.learn.map import learned_map
    from tunefree_hil.learn.open_loop_map.build import gather

    learned = yield from learned_map(gather(drives, vehicle), vehicle, seed)
    return {name: getattr(learned.table, name) for name in ("speed_mps", "accel_mps2", "command_frac")}


def _judged(learned: Learned, data: Data) -> Generator[Event, None, dict[str, Judged]]:
    """Free run of the physics and of what was learned, on held-out stretches, by the kernels: by kind."""
    from tunefree_hil.learn.model_folder import judged_by_kernels

    yield Event("note", "free run of what was learned, on what was held out")
    try:
        return judged_by_kernels(learned, data.held_out, JUDGED_STARTS)
    except InputError as error:
        if error.code != "too_short":
            raise
        yield Event("warning", f"not judged in free run: {error.message}")
        return {}


def _drawn(asked: Asked, card: Mapping[str, Any]) -> list[str]:
    from tunefree_hil.figures.learning.training import write_free_run

    if not card["free_run"]:
        return []
    return [str(write_free_run(asked.out / "figures" / "free_run.png", card["free_run"]))]


def _ending(asked: Asked, card: Mapping[str, Any]) -> dict[str, Any]:
    """Sentence and next commands."""
    sentence = f"{asked.kind} plant in {asked.out}"
    row = (card["free_run"].get(asked.kind) or {}).get("level") or (card["free_run"].get(asked.kind) or {}).get("hills")
    if row and "10" in row:
        sentence += f": {row['10']['position_m']['mean']:.2f} m off after 10 s of free run on held-out stretches"
        reduced = card["reduction_percent"].get("10")
        if reduced:
            less = reduced["value"]
            sentence += f", {abs(less):.0f} % {'less' if less >= 0.0 else 'more'} than the fitted physics"
    return {"status": "ok", "sentence": sentence, "next": [pasted("drive", "BENCH", model=asked.out)]}


def again(asked: Asked) -> str:
    """The command that goes on."""
    return pasted("learn", *asked.logs, **given(asked, ["logs"], {"sample_spacing_s": "sample_spacing"}))

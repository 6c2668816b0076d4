#!/usr/bin/env python3
"""`tools/make_models.py [--vehicle dbc/X]...`: makes the learned models that lie in bench_configs/models, from nothing.

For every vehicle folder that has a model of kind `reference`, which stands for the vehicle: `collect` over the bus on
that model, `calibrate`, `learn`, `map`, each the job that the command of this name runs. What came of it is copied, the
learned maps in the place of the calibrated ones, with a card that says what it was made of and the hash of each file.
Cut off, the same call goes on. Wants torch: pip install '.[learn]'.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import sys
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).resolve().parents[1]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tunefree_hil.base.errors import InputError  # noqa: E402
from tunefree_hil.base.events import Event  # noqa: E402
from tunefree_hil.cli.output import present  # noqa: E402
from tunefree_hil.config.find import available  # noqa: E402
from tunefree_hil.config.learned.steering_map_schema import STEERING_MAP_FILE  # noqa: E402
from tunefree_hil.config.load import load_model, load_vehicle  # noqa: E402
from tunefree_hil.config.schema import ModelSpec, VehicleSpec  # noqa: E402
from tunefree_hil.jobs.learn.report_text import position_error  # noqa: E402
from tunefree_hil.jobs.run_folder import read_json, write_json  # noqa: E402

MODELS = ROOT / "bench_configs" / "models"
WORK = ROOT / "build" / "models"
DRIVEN = "reference"  # kind of the plant that stands for the vehicle, and the end of its name
KINDS = ("hybrid", "lstm")
LEAST_COVERED = 0.8  # share of the cells that must be full
MOST_OFF_M = 15.0  # after 10 s of free run, on unseen drives
LARGEST_BYTES = 200_000
CARD, MAP = "card.json", "calibration.npz"
Steps = Generator[Event, None, Any]


class Asked(NamedTuple):
    """The command line. minutes: None for each kind's own. work: where everything is kept; out: where models go."""

    vehicles: Sequence[str] = ()
    kinds: Sequence[str] = KINDS
    quota_s: float = 10.0
    minutes: float | None = None
    seed: int = 1
    work: Path = WORK
    out: Path = MODELS


class Plan(NamedTuple):
    """One vehicle. place: a folder whose name says all that the collection depends on but the code."""

    asked: Asked
    vehicle: VehicleSpec
    driven: ModelSpec
    place: Path

    @property
    def stem(self) -> str:
        """How names of the vehicle's models begin."""
        return Path(self.driven.folder).name.removesuffix(f"_{DRIVEN}")


def make_models(asked: Asked) -> Iterator[Event]:
    """All vehicles, one after the other. Raises InputError: torch missing, no such model, a result that will not do."""
    from tunefree_hil.learn.training.torch_extra import require_torch

    require_torch("tools/make_models.py")
    made: dict[str, str] = {}
    for plan in plans(asked):
        yield Event("note", f"{plan.vehicle.name}, driven as {plan.driven.plant.kind}: {plan.place}")
        made |= yield from _vehicle(plan)
    sentence = "; ".join(f"{name}: {words}" for name, words in made.items())
    yield Event("result", sentence, {"sentence": sentence, "models": sorted(made)})


def plans(asked: Asked) -> list[Plan]:
    """The vehicles that are asked for, else all that can be driven. Raises InputError where one cannot."""
    folders = asked.vehicles or sorted(str(path.parent) for path in (ROOT / "dbc").glob("*/vehicle.toml"))
    found = []
    for folder in folders:
        vehicle = load_vehicle(folder)
        driven = driven_model(vehicle)
        if driven is not None:
            name = f"{vehicle.name}-{vehicle.hash[:8]}-{driven.hash[:8]}-{asked.quota_s:g}-{asked.seed}"
            found.append(Plan(asked, vehicle, driven, asked.work / name))
        elif asked.vehicles:
            raise InputError(
                f"no model of {vehicle.name!r} is of kind {DRIVEN!r}", code="nothing_to_drive", key="--vehicle",
                hint="for a real vehicle: tunefree-hil collect, calibrate, learn and map on its own logs",
            )  # fmt: skip
    return found


def driven_model(vehicle: VehicleSpec) -> ModelSpec | None:
    """The model that stands for a vehicle; None where there is none."""
    models = (load_model(name) for name in available("model"))
    return next((one for one in models if one.vehicle == vehicle.name and one.plant.kind == DRIVEN), None)


def _vehicle(plan: Plan) -> Steps:
    """Everything of one vehicle; a sentence about each model."""
    from tunefree_hil.jobs.learn.calibrate import calibrate
    from tunefree_hil.jobs.learn.learn import learn
    from tunefree_hil.jobs.learn.map import map_logs
    from tunefree_hil.jobs.learn.options import CalibrateOptions, LearnOptions, MapOptions

    asked, folder, seed = plan.asked, plan.vehicle.folder, plan.asked.seed
    collected = yield from _collected(plan)
    logs = sorted((plan.place / "collect" / "logs").glob("*.log"))
    physics, charted = plan.place / "physics", plan.place / "map"
    yield from _unless_there(physics / CARD, lambda: calibrate(CalibrateOptions(logs, folder, physics, seed)))
    yield from _unless_there(charted / MAP, lambda: map_logs(MapOptions(logs, folder, charted, seed)))
    made = {}
    for kind in asked.kinds:
        learned = plan.place / (f"{kind}-{asked.minutes:g}" if asked.minutes else kind)
        options = LearnOptions(logs, folder, learned, kind, seed, asked.minutes, physics)
        yield from _unless_there(learned / CARD, lambda options=options: learn(options))
        made |= ship(learned, charted / MAP, asked.out / name_of(plan.stem, kind), made_of(plan, kind, collected))
    return made


def name_of(stem: str, kind: str) -> str:
    """Of a model folder: the default kind needs no word."""
    return f"{stem}_learned" + ("" if kind == KINDS[0] else f"_{kind}")


def _collected(plan: Plan) -> Steps:
    """The collection, driven as far as it is not there; what it covers. Raises InputError where that is too little."""
    from tunefree_hil.jobs.collect.collect import collect
    from tunefree_hil.jobs.options.records import CollectOptions as Wish

    asked = plan.asked
    wish = Wish(
        bench=None, vehicle=plan.vehicle.folder, model=plan.driven.folder, bus="tfhub", bench_bus="", session="",
        realtime=False, out=plan.place / "collect", quota_s=asked.quota_s, area_m=400.0, top_mps=None, seed=asked.seed,
    )  # fmt: skip
    plan.place.mkdir(parents=True, exist_ok=True)
    found = yield from _through(collect(wish))
    if found["cells_full"] < LEAST_COVERED * found["cells_wanted"]:
        raise InputError(
            f"only {found['cells_full']} of {found['cells_wanted']} cells are full", code="too_little",
            file=found["run"], key="--quota-s", hint="give another quota, or look why the planner does not get there",
        )  # fmt: skip
    return {key: found[key] for key in ("cells_full", "cells_wanted", "simulated_s", "beyond_envelope_s")}


def _unless_there(last: Path, job: Callable[[], Iterable[Event]]) -> Steps:
    """Run a job whose last file is `last`, unless an earlier call has."""
    if last.is_file():
        yield Event("note", f"{last.parent}: done before")
    else:
        yield from _through(job())


def _through(job: Iterable[Event]) -> Steps:
    """The events of a job but its product for stdout; the data of its result, whose sentence becomes a note."""
    data: dict[str, Any] = {}
    for event in job:
        if event.kind == "result":
            data = event.data
            yield Event("note", str(data.get("sentence") or event.message))
        elif event.kind != "line":
            yield event._replace(data={**event.data, "resume": _again()})
    return data


def _again() -> str:
    return " ".join(["tools/make_models.py", *sys.argv[1:]])


def made_of(plan: Plan, kind: str, collected: Mapping[str, Any]) -> dict[str, Any]:
    """What the card says beside what `learn` has written: how to make it again, on what it was driven, the map."""
    asked = plan.asked
    words = f"tools/make_models.py --vehicle dbc/{plan.vehicle.name} --kinds {kind} --quota-s {asked.quota_s:g}"
    words += (f" --minutes {asked.minutes:g}" if asked.minutes else "") + f" --seed {asked.seed}"
    driven = {"model": Path(plan.driven.folder).name, "hash": f"sha256:{plan.driven.hash}", **collected}
    return {"made_by": words, "driven": driven}


def ship(learned: Path, charted: Path, target: Path, made: Mapping[str, Any]) -> dict[str, str]:
    """Copy a learned folder with the maps of pedals and steering to `target`, whole or not at all.

    Returns: its name and a sentence.

    Raises InputError where it is too large, or too far off in free run to tune anything on.
    """
    part, old = (target.with_name(f"{word}-{target.name}") for word in ("part", "part-old"))
    for folder in (part, old):
        shutil.rmtree(folder, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        steering = charted.parent.glob(STEERING_MAP_FILE)  # none where the logs do not tell it: `map` has said so
        for path in (learned / "model.toml", *learned.glob("*.npz"), charted, *steering):
            shutil.copy(path, part / path.name)
        files = hashes_of(part)
        card = read_json(learned / CARD) | {**made, "map": map_card(charted), "files": files}
        write_json(part / CARD, card)
        load_model(part)
        off_m, size = position_error(card), size_of(part)
        _refuse(learned, off_m, size)
        same = target.is_dir() and hashes_of(target) == files
        if target.exists():
            target.rename(old)
        part.rename(target)
    finally:
        if old.exists() and not target.exists():
            old.rename(target)
        for folder in (part, old):
            shutil.rmtree(folder, ignore_errors=True)
    words = f"{size / 1000.0:.0f} kB" + (f", {off_m:.2f} m off after 10 s of free run" if off_m is not None else "")
    return {target.name: words + (", byte for byte what was there" if same else "")}


def _refuse(learned: Path, off_m: float | None, size: int) -> None:
    why = f"has {size} bytes, more than {LARGEST_BYTES}" if size > LARGEST_BYTES else ""
    if off_m is not None and off_m > MOST_OFF_M:
        why = f"is {off_m:.1f} m off after 10 s of free run on unseen drives, more than {MOST_OFF_M:g} m"
    if why:
        raise InputError(why, code="not_shipped", file=str(learned), hint="train longer, or collect more")


def hashes_of(folder: Path) -> dict[str, str]:
    """Of all files but the card, by name."""
    paths = (path for path in sorted(folder.iterdir()) if path.is_file() and path.name != CARD)
    return {path.name: f"sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}" for path in paths}


def size_of(folder: Path) -> int:
    """Bytes of all files."""
    return sum(path.stat().st_size for path in folder.iterdir())


def map_card(charted: Path) -> dict[str, Any]:
    """The card inside a learned map, without the logs, which are the plant's."""
    import numpy as np

    with np.load(charted, allow_pickle=False) as archive:
        card = json.loads(str(archive["card"]))
    return {key: value for key, value in card.items() if key != "logs"}


def parsed(words: Sequence[str]) -> tuple[Asked, bool]:
    """The command line, and whether it is to be plain."""
    says = argparse.ArgumentParser(prog="tools/make_models.py", description=(__doc__ or "").partition(": ")[2])
    says.add_argument("--vehicle", action="append", default=[], help="vehicle folder; default: all that can be driven")
    says.add_argument("--kinds", default=",".join(KINDS), help="with commas between (default: %(default)s)")
    says.add_argument("--quota-s", type=float, default=10.0, help="s of driving in every cell (default: %(default)g)")
    says.add_argument("--minutes", type=float, help="of each training; default: steps, the same everywhere")
    says.add_argument("--seed", type=int, default=1)
    says.add_argument("--work", type=Path, default=WORK, help="logs and all that comes between (default: build/models)")
    says.add_argument("--out", type=Path, default=MODELS, help="where the models go (default: bench_configs/models)")
    says.add_argument("--plain", action="store_true", help="one line an event")
    had = says.parse_args(words)
    kinds = tuple(had.kinds.split(","))
    return Asked(had.vehicle, kinds, had.quota_s, had.minutes, had.seed, had.work, had.out), had.plain


def main(words: list[str]) -> int:
    """Exit status as the command line's."""
    asked, plain = parsed(words)
    return present("make_models", lambda: make_models(asked), plain=plain, as_json=False)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""The worst drives of the winner: pictures, and the files with which `drive` makes the same drives over the bus."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.bench import model_of
from tunefree_hil.bench.batch import Driven, Job
from tunefree_hil.bench.scaling import scaled
from tunefree_hil.config.dump import plain, to_toml
from tunefree_hil.figures.robustness import DRIVE_PANELS
from tunefree_hil.figures.scenario import DrivePicture, draw_scenario
from tunefree_hil.figures.style import save
from tunefree_hil.jobs.command_text import shell_command
from tunefree_hil.jobs.identity import resolved_toml
from tunefree_hil.jobs.robustness.driving.chunk import open_sweep_batch
from tunefree_hil.jobs.robustness.plan import SweepDrive, SweepPlan
from tunefree_hil.jobs.run_folder import write_text
from tunefree_hil.learn.model_folder import model_toml_from_spec, write_model_copy
from tunefree_hil.roads import write_roads

FOLDER = "worst"  # in the folder of a sweep
MAX_ROADS = 4
MODEL_HEAD = "# Written by tunefree_hil robustness: {model}, with the dead times, lags and numbers of car {car}.\n"


class WorstRoad(NamedTuple):
    """A drive that was made again. figure: '' where it was not drawn."""

    drive: SweepDrive
    command: str
    figure: str


def draw_worst_roads(plan: SweepPlan, texts: Mapping[SweepDrive, str], manual: str, out: Path) -> Iterator[WorstRoad]:
    """Drive the worst drives of the winner again, with their columns, beside a manual set.

    Args:
        texts: What each of them came to, the worst first.
        manual: Name of the set; '' for none.
        out: Folder of the sweep.
    """
    if not texts:
        return
    with open_sweep_batch(plan) as batch:
        for drive in texts:
            others = [drive._replace(vector=plan.names.index(manual))] if manual else []
            driven = batch.drive([plan.make_job(one) for one in (drive, *others)], columns=True)
            road = plan.roads[drive.road].spec.name
            labels = ["tuned", *([f"manual ({manual})"] if manual else [])]
            pictures = [_picture(label, result) for label, result in zip(labels, driven, strict=True)]
            figure = draw_scenario(road, pictures, DRIVE_PANELS, texts[drive])
            path = save(figure, out / "figures" / f"{FOLDER}_{road}.png")
            yield WorstRoad(drive, write_drive(plan, drive, out / FOLDER / road), str(path))


def write_drive(plan: SweepPlan, drive: SweepDrive, folder: Path) -> str:
    """Write a bench file, the road and, where it is another one, the model. Returns the command that drives them."""
    job, car = plan.make_job(drive), plan.cars[drive.car]
    shutil.rmtree(folder, ignore_errors=True)
    write_roads(folder, [job.scenario])
    model = plan.order.model
    if job.scale:
        spec = model_of(plan.bench, model)
        data = model_toml_from_spec(scaled(spec, job.scale))
        # an effect without parameters keeps its empty table
        data["effects"] = [{"params": {}, **effect} for effect in data.get("effects", [])]
        model = str(folder / "model")
        head = MODEL_HEAD.format(model=Path(spec.folder).name, car=car.number)
        write_model_copy(folder / "model", spec, head, data)
    write_text(folder / "bench.toml", to_toml(_bench_data(plan, job)))
    return shell_command("drive", folder / "bench.toml", model=model, seed=job.seed)


def _bench_data(plan: SweepPlan, job: Job) -> dict[str, Any]:
    """The bench of the sweep with one road, the gains of a set and the effects of a car."""
    data = tomllib.loads(resolved_toml(plan.bench))
    data = {key: value for key, value in data.items() if key not in ("roads", "ensemble")}
    effects = [{"name": name, "params": dict(params)} for name, params in job.effects.items()]
    data |= {"scenarios": [job.scenario.name], "verify_scenarios": []}
    data["effects"] = [*plain(list(plan.bench.spec.effects)), *effects]
    data["controller"]["parameters"] = dict(job.values)
    return data


def _picture(label: str, driven: Driven) -> DrivePicture:
    columns = driven.recording.columns if driven.recording is not None else {"t_s": []}
    if driven.grade is None:
        return DrivePicture(label, columns, None, driven.error)
    return DrivePicture(label, columns, driven.grade.score, driven.grade.outcome)

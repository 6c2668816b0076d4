"""Reads and checks a bench file and the files that it names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.open_loop_map import MAP_FILE, Refusal, read_triples
from tunefree_hil.bus.dbc.check_vehicle import check_vehicle, one_error
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.config.check_drive import check_drive
from tunefree_hil.config.check_vehicle import check_fields
from tunefree_hil.config.find import available
from tunefree_hil.config.load import load_bench, load_model, load_scenario, load_vehicle, load_weights
from tunefree_hil.config.schema import BenchSpec, ModelSpec, ScenarioSpec, VehicleSpec, WeightsSpec, with_scenarios
from tunefree_hil.episode.feasible import limits_of, require_feasible
from tunefree_hil.episode.scenario import build_course
from tunefree_hil.roads import held_out_roads, road_set, search_roads, verify_roads
from tunefree_hil.roads.drive_ability import DriveAbility, ability_from_map

KEPT_COURSES = 1024  # 0.25 MB for a drive of 20 s; more than a search has, and sweeps over more roads pass through


@dataclass(frozen=True)
class Bench:
    """A bench file with everything it names, read and checked.

    The names of made roads follow those of the file in `spec.scenarios` and `spec.verify_scenarios`.
    """

    spec: BenchSpec
    vehicle: VehicleSpec
    codec: Codec
    weights: WeightsSpec
    scenarios: Mapping[str, ScenarioSpec]
    dt_s: float
    courses: dict[str, Course] = field(default_factory=dict)

    @property
    def file(self) -> str:
        """Path of the bench file."""
        return self.spec.path

    def course(self, scenario: ScenarioSpec) -> Course:
        """The scenario's course, cached. Raises InputError where the vehicle cannot drive it."""
        course = self.courses.get(scenario.hash)
        if course is None:
            course = build_course(scenario, self.dt_s)
            require_feasible(scenario, course, limits_of(self.vehicle))
            for old in list(self.courses)[: 1 - KEPT_COURSES]:  # a copy, because another thread may add one meanwhile
                self.courses.pop(old, None)
            self.courses[scenario.hash] = course
        return course


def load(path: Path | str) -> Bench:
    """Read a bench file and the files that it names. Raises InputError that names file and key."""
    spec = load_bench(path)
    vehicle = whole_vehicle(spec.vehicle, spec.path)
    names = dict.fromkeys([*spec.scenarios, *spec.verify_scenarios])
    scenarios = {name: load_scenario(name, spec.path) for name in names}
    if spec.roads is not None:
        drive = drive_ability_of(spec, vehicle)
        searched, verified = search_roads(vehicle, spec.roads, drive), verify_roads(vehicle, spec.roads, drive)
        scenarios |= {road.name: road for road in searched + verified}
        spec = with_scenarios(
            spec,
            [*spec.scenarios, *(road.name for road in searched)],
            [*spec.verify_scenarios, *(road.name for road in verified)],
        )
    _refuse_namesakes(spec, scenarios)
    dt_s = vehicle.tick_ms * 1e-3
    return Bench(spec, vehicle, Codec(vehicle), load_weights(spec.weights, spec.path), scenarios, dt_s)


def drive_ability_of(spec: BenchSpec, vehicle: VehicleSpec) -> DriveAbility | None:
    """What the drive gives, from the open-loop map of the model that is tuned on; None where it has no map."""
    path = Path(load_model(spec.model, spec.path).folder) / MAP_FILE
    if not path.is_file():
        return None
    refusal = Refusal("no_calibration", "bad_calibration", "learn the map again")
    return ability_from_map(read_triples(path, refusal), vehicle.nominal.rest_pedal_frac)


def held_out_roads_of(bench: Bench, text: str) -> list[ScenarioSpec]:
    """The roads of a set, such as 'families:10', that neither the search nor the verification of a bench drives."""
    spec = bench.spec
    seed = spec.seed if spec.roads is None else spec.roads.seed
    return held_out_roads(bench.vehicle, text, seed, drive_ability_of(spec, bench.vehicle))


def fresh_roads_of(bench: Bench, name: str, count: int, seed: int) -> list[ScenarioSpec]:
    """The roads of a set for the vehicle of a bench, with a seed of the caller's."""
    return road_set(bench.vehicle, name, count, seed, drive=drive_ability_of(bench.spec, bench.vehicle))


def whole_vehicle(name: Path | str, near: Path | str | None = None) -> VehicleSpec:
    """A vehicle folder that can be driven.

    Raises one InputError with all mistakes: in vehicle.toml, against its DBC, and missing entries.
    """
    vehicle = load_vehicle(name, near, check=False)
    problems = check_fields(vehicle)
    known = {(problem.key, problem.message) for problem in problems}
    problems += [one for one in check_vehicle(vehicle) if (one.key, one.message) not in known]
    refused_keys = {problem.key for problem in problems}
    problems += [one for one in check_drive(vehicle) if one.key not in refused_keys]
    if problems:
        raise one_error(problems)
    return vehicle


def _refuse_namesakes(spec: BenchSpec, scenarios: Mapping[str, ScenarioSpec]) -> None:
    """Results are stored by the name in the scenario."""
    known: dict[str, ScenarioSpec] = {}
    for scenario in scenarios.values():
        first = known.setdefault(scenario.name, scenario)
        if first.path != scenario.path:
            raise InputError(
                f"{first.path} and {scenario.path} both have the name {scenario.name!r}",
                code="same_name",
                file=spec.path,
                key="scenarios",
                hint="give one of them another `name`",
            )


def model_of(bench: Bench, name: str) -> ModelSpec:
    """A model folder of this bench's vehicle.

    Raises InputError when it was made for another vehicle, or before the folder of this one was changed.
    """
    model = load_model(name, bench.file)
    if model.vehicle != bench.vehicle.name:
        raise InputError(
            f"is a model of {model.vehicle!r}, the bench's vehicle is {bench.vehicle.name!r}",
            code="model_of_other_vehicle",
            file=f"{model.folder}/model.toml",
            key="vehicle",
            hint="name a model of the bench's vehicle",
        )
    require_current(model, bench.vehicle)
    return model


def require_current(model: ModelSpec, vehicle: VehicleSpec) -> None:
    """Raises InputError for a model that was made before the vehicle's folder was changed."""
    if model.vehicle_hash and model.vehicle_hash.removeprefix("sha256:") != vehicle.hash:
        raise InputError(
            f"was made before the folder of vehicle {vehicle.name!r} was changed (hash now sha256:{vehicle.hash})",
            code="vehicle_changed",
            file=f"{model.folder}/model.toml",
            key="vehicle_hash",
            hint="learn or calibrate the model again; where you know that the change does not matter, put the new hash",
        )


def scenario_of_hash(bench: Bench, start: bytes) -> ScenarioSpec:
    """The scenario file whose content hash begins with `start`. Raises InputError that lists the files."""
    wanted = start.hex()
    for scenario in bench.scenarios.values():
        if scenario.hash.startswith(wanted):
            return scenario
    known = []
    for name in available("scenario", bench.file):
        try:
            scenario = load_scenario(name, bench.file)
        except InputError:
            known.append(f"{name} (not readable)")  # not the file asked for, so not an error here
            continue
        if scenario.hash.startswith(wanted):
            return scenario
        known.append(f"{name} ({scenario.hash[:12]})")
    raise InputError(
        f"no scenario file has the content hash {wanted}; there are {', '.join(known)}",
        code="unknown_scenario",
        hint="copy the runner's scenario files here, byte for byte",
    )

"""The options of a commission, its plan, and the folders of its stages."""

from __future__ import annotations

import math
import shutil
import tomllib
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.open_loop_map import MAP_FILE
from tunefree_hil.bench import load
from tunefree_hil.bench.load import whole_vehicle
from tunefree_hil.config.dump import plain, to_toml
from tunefree_hil.config.learned.steering_map_schema import STEERING_MAP_FILE
from tunefree_hil.config.load import load_bench, load_model
from tunefree_hil.config.schema import DATA_SHEET_STEERING, BenchSpec, VehicleSpec
from tunefree_hil.jobs.collect.plan import require_area
from tunefree_hil.jobs.command_text import changed_options, shell_command
from tunefree_hil.jobs.commission.settings import tuning_hash, verify_hash
from tunefree_hil.jobs.commission.vehicle import VEHICLE, write_vehicle
from tunefree_hil.jobs.identity import resolved_toml
from tunefree_hil.jobs.learn.report_text import find_benches
from tunefree_hil.jobs.options.records import CollectOptions, CommissionOptions, TuneOptions
from tunefree_hil.jobs.run_folder import write_text

ROOT = Path("runs")
FOLDERS = {  # what each stage writes in the folder of the commission
    "collect": ("collect",),
    "calibrate": ("physics",),
    "learn": ("model", "model.part"),
    "map": ("map",),
    "tune": ("tune", "bench.toml", VEHICLE),
    "verify": ("report.md",),
}
NAMES = tuple(FOLDERS)  # of the stages, in their order
BACKENDS = ("batch", "bus")


class CommissionPlan(NamedTuple):
    """The resolved options.

    template: The bench file with the scenarios.
    identity: What must agree for a commission to be resumed.
    command: The same command again, for a shell.
    """

    options: CommissionOptions
    vehicle: VehicleSpec
    template: BenchSpec
    folder: Path
    identity: dict[str, Any]
    command: str

    @property
    def restart_stage(self) -> str:
        """The first stage to restart, '' for none."""
        return self.options.only or self.options.start_at

    @property
    def collected(self) -> Path:
        """Run folder of the collection."""
        return self.folder / "collect"

    @property
    def logs(self) -> list[Path]:
        """Logs of the collection, in the order in which they were driven."""
        return sorted((self.collected / "logs").glob("*.log"))

    @property
    def physics(self) -> Path:
        """Model folder of the calibrated physics."""
        return self.folder / "physics"

    @property
    def model(self) -> Path:
        """Model folder of the learned plant."""
        return self.folder / "model"

    @property
    def map(self) -> Path:
        """Folder of the learned map."""
        return self.folder / "map"

    @property
    def bench(self) -> Path:
        """The bench file that is tuned: the template with the learned plant and the learned map."""
        return self.folder / "bench.toml"

    def write_bench(self) -> Path:
        """Write `bench`, completely or not at all, and the vehicle folder where the template has effects."""
        data = tomllib.loads(resolved_toml(load(self.template.path)))
        data |= {"vehicle": str(Path(self.vehicle.folder).resolve()), "model": str(self.model.resolve())}
        if data.pop("effects", None):  # effects of the vehicle, which `collect` has driven with them
            data["verify_model"] = str(write_vehicle(self.folder / VEHICLE, self.template).resolve())
        data["controller"] = {
            **data.get("controller", {}),
            "calibration": str((self.map / MAP_FILE).resolve()),
        }
        steering_map = self.map / STEERING_MAP_FILE
        if steering_map.is_file() and self.template.controller.steering_map != DATA_SHEET_STEERING:
            data["controller"]["steering_map"] = str(steering_map.resolve())
        write_text(self.bench, to_toml(data))
        return self.bench

    def set_aside(self, names: Sequence[str]) -> None:
        """Rename the results of stages to NAME-1, NAME-2, ...: nothing is deleted."""
        for path in (self.folder / part for name in names for part in FOLDERS[name]):
            if path.exists():
                number = 1
                while (backup := path.with_name(f"{path.stem}-{number}{path.suffix}")).exists():
                    number += 1
                path.rename(backup)

    def remove_partial_folders(self) -> None:
        """Remove model folders that a killed process was writing (learn/model_folder.py)."""
        for path in self.folder.glob("part-*"):
            shutil.rmtree(path)


def make_plan(options: CommissionOptions) -> CommissionPlan:
    """Resolve and check the options as far as possible, before hours are spent. Raises InputError."""
    vehicle = whole_vehicle(options.vehicle)
    template = _template(options, vehicle)
    bench = load(template.path)
    template = bench.spec  # with the made roads among its scenarios
    if not template.verify_model or not template.verify_scenarios:
        message = "has no verify_model with verify_scenarios: there is no vehicle to commission"
        hint = "the bench file's verify_model is the vehicle"
        raise InputError(message, code="no_vehicle", file=template.path, key="verify_model", hint=hint)
    require_options(options)
    _require_stages(options, vehicle, template)
    folder = options.out or ROOT / f"commission-{vehicle.name}"
    identity = {
        "vehicle": vehicle.name,
        "vehicle_hash": vehicle.hash,
        "model_hash": load_model(template.verify_model, Path(template.path)).hash,
        "effects": plain(template.effects),  # of the vehicle, like its model
        "bench": Path(template.path).name,
        "tuning_hash": tuning_hash(bench),
        "verify_hash": verify_hash(bench),
        "set": options.set_name or template.tune.set or "own",
        "trials": options.trials or template.tune.trials,
        "kind": options.kind,
        "quota_s": options.quota_s,
        "area_m": options.area_m,
        "top_mps": options.top_mps,
        "minutes": options.minutes,
        "seed": options.seed,
        "backend": options.backend,
    }
    return CommissionPlan(options, vehicle, template, folder, identity, format_command(options))


def require_options(options: CommissionOptions) -> None:
    """Raise InputError for an option that no stage can use."""
    from tunefree_hil.jobs.learn.learn import KINDS

    choices = (
        ("--only", options.only, ("", *NAMES)),
        ("--from", options.start_at, ("", *NAMES)),
        ("--backend", options.backend, BACKENDS),
        ("--kind", options.kind, KINDS),
    )
    for key, value, allowed in choices:
        if value not in allowed:
            hint = ", ".join(name for name in allowed if name)
            raise InputError(f"unknown value {value!r}", code="usage", key=key, hint=hint)
    if options.only and options.start_at:
        raise InputError("--only and --from are both given", code="usage", key="--from", hint="give one of them")
    for key, value, most in (
        ("--minutes", options.minutes, math.inf),
        ("--least-covered", options.least_covered, 1.0),
        ("--most-error-m", options.most_error_m, math.inf),
        ("--most-outside", options.most_outside, 1.0),
    ):
        if value is not None and not (math.isfinite(value) and 0.0 <= value <= most):
            end = f" and at most {most:g}" if math.isfinite(most) else ""
            raise InputError(f"{value:g} is not allowed", code="usage", key=key, hint=f"give a number from 0{end}")


def _require_stages(options: CommissionOptions, vehicle: VehicleSpec, template: BenchSpec) -> None:
    """Check what later stages would refuse only after the earlier ones: area, torch, set, bus, controller."""
    from tunefree_hil.jobs.tune.options import make_tune_plan
    from tunefree_hil.learn.training.torch_extra import require_torch

    require_area(vehicle, make_collect_options(options, Path(template.path), None))
    if find_spec("torch") is None:  # not imported: it takes seconds
        require_torch("commission (its stages learn and map)")
    make_tune_plan(make_tune_options(options, Path(template.path)))


def make_collect_options(options: CommissionOptions, bench: Path, out: Path | None) -> CollectOptions:
    """The options of the stage collect."""
    same = ("bus", "bench_bus", "quota_s", "area_m", "top_mps", "seed")
    return CollectOptions(bench=bench, out=out, **{name: getattr(options, name) for name in same})


def make_tune_options(options: CommissionOptions, bench: Path, **more: Any) -> TuneOptions:
    """The options of the stage tune; more: those that the commission does not have."""
    same = ("trials", "set_name", "bus", "bench_bus", "backend")
    return TuneOptions(bench, **{name: getattr(options, name) for name in same}, **more)


def _template(options: CommissionOptions, vehicle: VehicleSpec) -> BenchSpec:
    """The bench file that was given, or the first one of the vehicle."""
    if options.bench is None:
        benches = find_benches(vehicle)
        if not benches:
            hint = "write a bench file with scenarios, verify_scenarios and verify_model"
            raise InputError(f"there is no bench file of {vehicle.name}", code="no_bench", key="--bench", hint=hint)
        return load_bench(benches[0])
    spec = load_bench(options.bench)
    if Path(spec.vehicle).name != vehicle.name:
        message = f"is a bench file of {spec.vehicle!r}, not of {vehicle.name!r}"
        raise InputError(message, file=spec.path, key="vehicle", hint="give a bench file of this vehicle")
    return spec


def format_command(options: CommissionOptions) -> str:
    """The same command again, without the stage to restart."""
    words = changed_options(options, skip=["vehicle", "only", "start_at"], option_names={"set_name": "set"})
    return shell_command("commission", options.vehicle, **words)

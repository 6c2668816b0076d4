"""What a commission is asked for, and where its stages keep what they make."""

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
from tunefree_hil.config.load import load_bench, load_model
from tunefree_hil.config.schema import BenchSpec, VehicleSpec
from tunefree_hil.jobs.collect.plan import Asked as CollectAsked
from tunefree_hil.jobs.collect.plan import require_room
from tunefree_hil.jobs.command_text import given, pasted
from tunefree_hil.jobs.commission.settings import tuning_hash, verify_hash
from tunefree_hil.jobs.commission.vehicle import VEHICLE, write_vehicle
from tunefree_hil.jobs.identity import resolved_toml
from tunefree_hil.jobs.learn.report_text import benches_of
from tunefree_hil.jobs.run_folder import write_text

ROOT = Path("runs")
FOLDERS = {
    "collect": ("collect",),
    "calibrate": ("physics",),
    "learn": ("model", "model.part"),
    "map": ("map",),
    "tune": ("tune", "bench.toml", VEHICLE),
    "verify": ("report.md",),
}  # what each stage writes in the commission's folder
NAMES = tuple(FOLDERS)  # of the stages, in their order
BACKENDS = ("batch", "bus")


class Asked(NamedTuple):
    """The command line of `commission`. bench: None for the first bench file of this vehicle.

    only, start_at: a stage that is to be done again, alone or with all that follow. least_covered: share of the cells;
    most_error_m: after 10 s of free run; most_outside: share of the winner's ticks. They stop a commission.
    """

    vehicle: str
    bench: Path | None = None
    out: Path | None = None
    set_name: str | None = None
    trials: int | None = None
    kind: str = "hybrid"
    quota_s: float = 10.0
    area_m: float = 400.0
    minutes: float | None = None
    seed: int = 1
    bus: str = "auto"
    bench_bus: str = ""
    backend: str = "batch"
    top_mps: float | None = None
    only: str = ""
    start_at: str = ""
    least_covered: float = 0.8
    most_error_m: float = 15.0
    most_outside: float = 0.25


class Plan(NamedTuple):
    """asked, resolved. identity: what makes this commission this one; command: the same again, to be pasted."""

    asked: Asked
    vehicle: VehicleSpec
    template: BenchSpec
    folder: Path
    identity: dict[str, Any]
    command: str

    @property
    def again(self) -> str:
        """The first stage that is to be done again, '' for none."""
        return self.asked.only or self.asked.start_at

    @property
    def collected(self) -> Path:
        """The collection's run folder."""
        return self.folder / "collect"

    @property
    def logs(self) -> list[Path]:
        """The logs of the collection, in the order in which they were driven."""
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
        """The bench file that is tuned: the template's, on the learned plant and the learned map."""
        return self.folder / "bench.toml"

    def write_bench(self) -> Path:
        """Write `bench`, whole or not at all, and the vehicle's folder where the template has effects of its own."""
        data = tomllib.loads(resolved_toml(load(self.template.path)))
        data |= {"vehicle": str(Path(self.vehicle.folder).resolve()), "model": str(self.model.resolve())}
        if data.pop("effects", None):  # they belong to the vehicle, and collect has driven it with them
            data["verify_model"] = str(write_vehicle(self.folder / VEHICLE, self.template).resolve())
        data["controller"] = {
            **data.get("controller", {}),
            "calibration": str((self.map / MAP_FILE).resolve()),
        }
        write_text(self.bench, to_toml(data))
        return self.bench

    def set_aside(self, names: Sequence[str]) -> None:
        """Rename what stages wrote to NAME-1, NAME-2, ...: nothing is lost."""
        for path in (self.folder / part for name in names for part in FOLDERS[name]):
            if path.exists():
                number = 1
                while (other := path.with_name(f"{path.stem}-{number}{path.suffix}")).exists():
                    number += 1
                path.rename(other)

    def tidy(self) -> None:
        """Take away model folders that were being written when a process was killed (learn/model_folder.py)."""
        for path in self.folder.glob("part-*"):
            shutil.rmtree(path)


def make_plan(asked: Asked) -> Plan:
    """Read and check everything that can be, before hours are spent."""
    vehicle = whole_vehicle(asked.vehicle)
    template = _template(asked, vehicle)
    bench = load(template.path)  # everything that it names
    if not template.verify_model or not template.verify_scenarios:
        raise InputError(
            "names no verify_model with verify_scenarios: there is no vehicle to commission",
            code="no_vehicle",
            file=template.path,
            key="verify_model",
            hint="the bench file's verify_model is the vehicle",
        )
    require_options(asked)
    _require_stages(asked, vehicle, template)
    folder = asked.out or ROOT / f"commission-{vehicle.name}"
    identity = {
        "vehicle": vehicle.name,
        "vehicle_hash": vehicle.hash,
        "model_hash": load_model(template.verify_model, Path(template.path)).hash,
        "effects": plain(template.effects),  # of the vehicle, as its model is
        "bench": Path(template.path).name,
        "tuning_hash": tuning_hash(bench),
        "verify_hash": verify_hash(bench),
        "set": asked.set_name or template.tune.set or "own",
        "trials": asked.trials or template.tune.trials,
        "kind": asked.kind,
        "quota_s": asked.quota_s,
        "area_m": asked.area_m,
        "top_mps": asked.top_mps,
        "minutes": asked.minutes,
        "seed": asked.seed,
        "backend": asked.backend,
    }
    return Plan(asked, vehicle, template, folder, identity, again(asked))


def require_options(asked: Asked) -> None:
    """Raises InputError for an option that no stage could use."""
    from tunefree_hil.jobs.learn.learn import KINDS

    chosen = (
        ("--only", asked.only, ("", *NAMES)),
        ("--from", asked.start_at, ("", *NAMES)),
        ("--backend", asked.backend, BACKENDS),
        ("--kind", asked.kind, KINDS),
    )
    for key, value, known in chosen:
        if value not in known:
            hint = ", ".join(one for one in known if one)
            raise InputError(f"there is no {value!r}", code="usage", key=key, hint=hint)
    if asked.only and asked.start_at:
        raise InputError("--only and --from are both given", code="usage", key="--from", hint="give one of them")
    for key, value, most in (
        ("--minutes", asked.minutes, math.inf),
        ("--least-covered", asked.least_covered, 1.0),
        ("--most-error-m", asked.most_error_m, math.inf),
        ("--most-outside", asked.most_outside, 1.0),
    ):
        if value is not None and not (math.isfinite(value) and 0.0 <= value <= most):
            end = f" and at most {most:g}" if math.isfinite(most) else ""
            raise InputError(f"{value:g} does not do", code="usage", key=key, hint=f"give a number from 0{end}")


def _require_stages(asked: Asked, vehicle: VehicleSpec, template: BenchSpec) -> None:
    """What the stages would refuse, some only after others have run: room, torch, set, bus, controller."""
    from tunefree_hil.jobs.tune.options import Asked as TuneAsked
    from tunefree_hil.jobs.tune.options import resolve_wish
    from tunefree_hil.learn.training.torch_extra import require_torch

    require_room(vehicle, collect_wish(asked, Path(template.path), None))
    if find_spec("torch") is None:  # not imported: a collection needs none of it
        require_torch("commission (its stages learn and map)")
    resolve_wish(
        TuneAsked(
            bench=Path(template.path), trials=asked.trials, set_name=asked.set_name, bus=asked.bus,
            bench_bus=asked.bench_bus, backend=asked.backend,
        )
    )  # fmt: skip


def collect_wish(asked: Asked, bench: Path, out: Path | None) -> CollectAsked:
    """What `collect` is asked for."""
    return CollectAsked(
        bench=bench, bus=asked.bus, bench_bus=asked.bench_bus, out=out, quota_s=asked.quota_s, area_m=asked.area_m,
        top_mps=asked.top_mps, seed=asked.seed,
    )  # fmt: skip


def _template(asked: Asked, vehicle: VehicleSpec) -> BenchSpec:
    if asked.bench is None:
        known = benches_of(vehicle)
        if not known:
            raise InputError(
                f"there is no bench file of {vehicle.name}", code="no_bench", key="--bench",
                hint="a bench file says which roads to drive: scenarios, verify_scenarios, verify_model",
            )  # fmt: skip
        return load_bench(known[0])
    spec = load_bench(asked.bench)
    if Path(spec.vehicle).name != vehicle.name:
        raise InputError(
            f"is a bench of {spec.vehicle!r}, not of {vehicle.name!r}", file=spec.path, key="vehicle",
            hint="give a bench file of this vehicle",
        )  # fmt: skip
    return spec


def again(asked: Asked) -> str:
    """The command once more, without the stage that it was to do again."""
    options = given(asked, leave=["vehicle", "only", "start_at"], called={"set_name": "set"})
    return pasted("commission", asked.vehicle, **options)

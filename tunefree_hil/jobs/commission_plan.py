"""What a commission is asked for, and where its stages keep what they make."""

from __future__ import annotations

import shlex
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.bench import load
from tunefree_hil.bench.load import whole_vehicle
from tunefree_hil.config.dump import to_toml
from tunefree_hil.config.load import load_bench
from tunefree_hil.config.schema import BenchSpec, VehicleSpec
from tunefree_hil.jobs.calibrate_words import benches_of
from tunefree_hil.jobs.identity import resolved_toml
from tunefree_hil.jobs.run_folder import write_text

ROOT = Path("runs")
FOLDERS = {
    "collect": ("collect",),
    "calibrate": ("physics",),
    "learn": ("model", "model.part"),
    "map": ("map",),
    "tune": ("tune", "bench.toml"),
    "verify": (),
}  # what each stage writes in the commission's folder


class Asked(NamedTuple):
    """The command line of `commission`. bench: None for the first bench file of this vehicle."""

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
    only: str = ""


class Plan(NamedTuple):
    """asked, resolved. identity: what makes this commission this one; words: the same command again."""

    asked: Asked
    vehicle: VehicleSpec
    template: BenchSpec
    folder: Path
    identity: dict[str, Any]
    words: str

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
        """Write `bench`, whole or not at all."""
        data = tomllib.loads(resolved_toml(load(self.template.path)))
        data |= {"vehicle": str(Path(self.vehicle.folder).resolve()), "model": str(self.model.resolve())}
        data.pop("effects", None)  # they belong to the vehicle, and collect has driven it with them
        data["controller"] = {
            **data.get("controller", {}),
            "calibration": str((self.map / "calibration.npz").resolve()),
        }
        write_text(self.bench, to_toml(data))
        return self.bench

    def set_aside(self, names: Sequence[str]) -> None:
        """Rename what stages wrote to NAME-1, NAME-2, ...: nothing is lost."""
        for name in names:
            for part in FOLDERS[name]:
                path = self.folder / part
                if path.exists():
                    number = 1
                    while (other := path.with_name(f"{path.name}-{number}")).exists():
                        number += 1
                    path.rename(other)


def make_plan(asked: Asked) -> Plan:
    """Read and check everything that can be, before hours are spent."""
    vehicle = whole_vehicle(asked.vehicle)
    template = _template(asked, vehicle)
    load(template.path)  # everything that it names
    if not template.verify_model or not template.verify_scenarios:
        raise InputError(
            "names no verify_model with verify_scenarios: there is no vehicle to commission",
            code="no_vehicle",
            file=template.path,
            key="verify_model",
            hint="the bench file's verify_model is the vehicle",
        )
    folder = asked.out or ROOT / f"commission-{vehicle.name}"
    identity = {
        "vehicle": vehicle.name,
        "bench": Path(template.path).name,
        "set": asked.set_name or template.tune.set or "own",
        "trials": asked.trials or template.tune.trials,
        "kind": asked.kind,
        "quota_s": asked.quota_s,
        "area_m": asked.area_m,
        "minutes": asked.minutes,
        "seed": asked.seed,
        "backend": asked.backend,
    }
    return Plan(asked, vehicle, template, folder, identity, _words(asked))


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


def _words(asked: Asked) -> str:
    """The options again, to be pasted."""
    words = [asked.vehicle]
    for name, value in asked._asdict().items():
        if name in ("vehicle", "only") or value == Asked._field_defaults.get(name):
            continue
        option = "--set" if name == "set_name" else "--" + name.replace("_", "-")
        words += [option, f"{value:g}" if isinstance(value, float) else str(value)]
    return shlex.join(words)

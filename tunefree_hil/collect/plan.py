"""Plan of one drive of a collection: a JSON file beside its scenario, and the planner's parameters made from it."""

from __future__ import annotations

from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.collect.area import DrivingArea
from tunefree_hil.collect.bounds import DriveBounds, limit_envelope
from tunefree_hil.collect.cells import (
    CELL_COUNT,
    FIRST_THROTTLE,
    MIN_SPEED_RATIO,
    TargetCell,
    bands_from_envelope,
    make_target_cells,
    needed_frames,
)
from tunefree_hil.collect.envelope import Envelope, envelope_from_vehicle
from tunefree_hil.collect.features import PlannerParams, signal_sources
from tunefree_hil.collect.gentle_driving import COAST_S, GentleStretch, plan_stretches
from tunefree_hil.collect.pedals import min_push
from tunefree_hil.config.schema import VehicleSpec

SCHEMA = "tunefree.collect_drive/3"
TOO_SLOW = "only reachable at walking pace, where the models are not valid"
TOO_STRONG = "needs more pedal than the model's data cover"
FORWARDS_ONLY = "the planner drives forwards only; a driver can fill it: collect --watch"


class DrivePlan(NamedTuple):
    """Plan of a drive; the fields are the keys of its JSON file.

    quota_s: wanted time a cell. area_m: side of the area. top_mps: highest speed, None for that of the cells. have:
    frames by cell. centre: of the area, None for the first position. first_hold: number of the first hold. stop_s: time
    at which it begins to stop. stretches: [first, end) of the gentle stretches. bounds: within the vehicle's limits.
    coast_s: duration of coasting in a gentle stretch.
    """

    quota_s: float
    area_m: float
    top_mps: float | None
    centre: tuple[float, float] | None
    have: tuple[int, ...]
    first_hold: int
    stop_s: float
    stretches: tuple[int, int] = (0, 0)
    bounds: DriveBounds | None = None
    coast_s: float = COAST_S


def plan_as_dict(plan: DrivePlan) -> dict[str, Any]:
    """Data of the JSON file."""
    return {"schema": SCHEMA, **plan._asdict()}


def plan_from_dict(data: dict[str, Any], file: str) -> DrivePlan:
    """Plan from the data of a JSON file. Raises InputError that names the file where it is invalid."""
    try:
        if data["schema"] != SCHEMA or len(data["have"]) != CELL_COUNT:
            raise ValueError(f"schema {data['schema']!r} with {len(data['have'])} cells")
        centre, bounds = data["centre"], data["bounds"]
        return DrivePlan(
            float(data["quota_s"]),
            float(data["area_m"]),
            None if data["top_mps"] is None else float(data["top_mps"]),
            None if centre is None else (float(centre[0]), float(centre[1])),
            tuple(int(frames) for frames in data["have"]),
            int(data["first_hold"]),
            float(data["stop_s"]),
            (int(data["stretches"][0]), int(data["stretches"][1])),
            None if bounds is None else DriveBounds(*map(float, bounds)),
            float(data["coast_s"]),
        )
    except (LookupError, TypeError, ValueError) as error:
        hint = "it may be from another version; start the collection again"
        raise InputError(f"is not a plan of a drive: {error}", code="bad_plan", file=file, hint=hint) from error


def bounded_envelope(vehicle: VehicleSpec, bounds: DriveBounds | None) -> Envelope:
    """Envelope of a drive, within its bounds."""
    envelope = envelope_from_vehicle(vehicle)
    return envelope if bounds is None else limit_envelope(envelope, bounds)


def plannable_cells(
    vehicle: VehicleSpec, top_mps: float | None, bounds: DriveBounds | None = None
) -> tuple[TargetCell, ...]:
    """All cells, with the reason for those that the planner cannot drive."""
    envelope = bounded_envelope(vehicle, bounds)
    slow_mps = 0.0 if bounds is None else bounds.slow_mps
    cells = make_target_cells(envelope, top_mps, reverse_mps=vehicle.limits.reverse_mps)
    cells = [cell._replace(low_mps=max(cell.low_mps, slow_mps)) for cell in cells]
    return tuple(cell._replace(excluded=cell.excluded or _exclusion_reason(envelope, cell)) for cell in cells)


def _exclusion_reason(envelope: Envelope, target: TargetCell) -> str:
    """Why the planner cannot drive a cell that the vehicle could, or ''."""
    if target.index.backwards:
        return FORWARDS_ONLY
    if target.high_mps < MIN_SPEED_RATIO * target.low_mps:
        return TOO_SLOW
    most = envelope.max_throttle_push if target.index.pedal >= FIRST_THROTTLE else envelope.max_brake_push
    return TOO_STRONG if min_push(target.index) > most else ""


def plannable_stretches(
    vehicle: VehicleSpec,
    quota_s: float,
    drive_s: float,
    area_m: float,
    top_mps: float | None,
    bounds: DriveBounds | None = None,
) -> tuple[GentleStretch, ...]:
    """The gentle stretches that the planner can drive; none without a reported speed."""
    if not signal_sources(vehicle).speed_mps[0]:
        return ()
    stretches = plan_stretches(bounded_envelope(vehicle, bounds), quota_s, drive_s, area_m, top_mps)
    if bounds is None:
        return stretches
    fit = [stretch for stretch in stretches if stretch.speed_mps >= bounds.slow_mps]
    return tuple(stretch._replace(max_mps=bounds.speed_mps) for stretch in fit)


def make_planner_params(vehicle: VehicleSpec, plan: DrivePlan, dt_s: float) -> PlannerParams:
    """Parameters of the planner for a drive."""
    envelope = bounded_envelope(vehicle, plan.bounds)
    targets = plannable_cells(vehicle, plan.top_mps, plan.bounds)
    half_m = 0.5 * plan.area_m
    stretches = plannable_stretches(vehicle, plan.quota_s, plan.stop_s, plan.area_m, plan.top_mps, plan.bounds)
    return PlannerParams(
        envelope,
        bands_from_envelope(envelope),
        targets,
        signal_sources(vehicle),
        plan.have,
        tuple(needed_frames(targets, plan.quota_s, dt_s)),
        half_m,
        None if plan.centre is None else DrivingArea(*plan.centre, half_m),
        round(plan.stop_s / dt_s),
        plan.first_hold,
        tuple(one._replace(coast_s=plan.coast_s) for one in stretches[slice(*plan.stretches)]),
    )

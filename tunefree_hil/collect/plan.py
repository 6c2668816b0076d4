"""What one drive of a collection is told before it begins: a small file beside its scenario, and what it means."""

from __future__ import annotations

from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.collect.area import Ground
from tunefree_hil.collect.bounds import Bounds, within
from tunefree_hil.collect.cells import COUNT, FIRST_THROTTLE, LEAST_WINDOW, Target, bands_of, needs_of, targets_of
from tunefree_hil.collect.envelope import Envelope, envelope_of
from tunefree_hil.collect.features import Params, eyes_of
from tunefree_hil.collect.gentle_driving import COAST_S, Stretch, stretches_of
from tunefree_hil.collect.pedals import least_push
from tunefree_hil.config.schema import VehicleSpec

SCHEMA = "tunefree.collect_drive/3"
TOO_SLOW = "it is driven at walking pace only, where no model is to be judged"
TOO_STRONG = "its pedal is pressed more than the model's data cover"
FORWARDS_ONLY = "the planner drives forwards only; a person can fill it: collect --watch"


class DrivePlan(NamedTuple):
    """quota_s a cell; side of the area; the fastest that may be asked for (None: the cells' own); have: frames by cell.

    centre: middle of the area, None where the drive's first place is it. first_hold: number of its first hold.
    stop_s: when it begins to stop. stretches: [first, end) of the collection's gentle ones.
    bounds: what it stays inside of besides the vehicle's limits. coast_s: how long a gentle stretch coasts.
    """

    quota_s: float
    area_m: float
    top_mps: float | None
    centre: tuple[float, float] | None
    have: tuple[int, ...]
    first_hold: int
    stop_s: float
    stretches: tuple[int, int] = (0, 0)
    bounds: Bounds | None = None
    coast_s: float = COAST_S


def as_dict(plan: DrivePlan) -> dict[str, Any]:
    """Plain data for the file."""
    return {"schema": SCHEMA, **plan._asdict()}


def plan_of(data: dict[str, Any], file: str) -> DrivePlan:
    """The plan in a file's data. Raises InputError that names the file where it is none."""
    try:
        if data["schema"] != SCHEMA or len(data["have"]) != COUNT:
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
            None if bounds is None else Bounds(*map(float, bounds)),
            float(data["coast_s"]),
        )
    except (LookupError, TypeError, ValueError) as error:
        raise InputError(
            f"is no plan of a drive: {error}",
            code="bad_plan",
            file=file,
            hint="written by another version? start the collection anew",
        ) from error


def bounded(vehicle: VehicleSpec, bounds: Bounds | None) -> Envelope:
    """The envelope that a drive plans with."""
    envelope = envelope_of(vehicle)
    return envelope if bounds is None else within(envelope, bounds)


def driven_targets(vehicle: VehicleSpec, top_mps: float | None, bounds: Bounds | None = None) -> tuple[Target, ...]:
    """The cells that the planner can be asked for."""
    envelope = bounded(vehicle, bounds)
    slow_mps = 0.0 if bounds is None else bounds.slow_mps
    found = targets_of(envelope, top_mps, reverse_mps=vehicle.limits.reverse_mps)
    found = [one._replace(low_mps=max(one.low_mps, slow_mps)) for one in found]
    return tuple(one._replace(excluded=one.excluded or _kept_from(envelope, one)) for one in found)


def _kept_from(envelope: Envelope, target: Target) -> str:
    """Why the planner is not asked for a cell that the vehicle could do, or ''."""
    if target.place.backwards:
        return FORWARDS_ONLY
    if target.high_mps < LEAST_WINDOW * target.low_mps:
        return TOO_SLOW
    most = envelope.throttle_most if target.place.pedal >= FIRST_THROTTLE else envelope.brake_most
    return TOO_STRONG if least_push(target.place) > most else ""


def driven_stretches(
    vehicle: VehicleSpec, quota_s: float, drive_s: float, area_m: float, top_mps: float | None,
    bounds: Bounds | None = None,
) -> tuple[Stretch, ...]:  # fmt: skip
    """The gentle stretches that the planner can be asked for: none without a speed to hold."""
    if not eyes_of(vehicle).speed_mps[0]:
        return ()
    found = stretches_of(bounded(vehicle, bounds), quota_s, drive_s, area_m, top_mps)
    if bounds is None:
        return found
    fit = [one for one in found if one.speed_mps >= bounds.slow_mps]
    return tuple(one._replace(most_mps=bounds.speed_mps) for one in fit)


def params_of(vehicle: VehicleSpec, plan: DrivePlan, dt_s: float) -> Params:
    """The planner's params for a drive."""
    envelope = bounded(vehicle, plan.bounds)
    targets = driven_targets(vehicle, plan.top_mps, plan.bounds)
    half_m = 0.5 * plan.area_m
    stretches = driven_stretches(vehicle, plan.quota_s, plan.stop_s, plan.area_m, plan.top_mps, plan.bounds)
    return Params(
        envelope,
        bands_of(envelope),
        targets,
        eyes_of(vehicle),
        plan.have,
        tuple(needs_of(targets, plan.quota_s, dt_s)),
        half_m,
        None if plan.centre is None else Ground(*plan.centre, half_m),
        round(plan.stop_s / dt_s),
        plan.first_hold,
        tuple(one._replace(coast_s=plan.coast_s) for one in stretches[slice(*plan.stretches)]),
    )

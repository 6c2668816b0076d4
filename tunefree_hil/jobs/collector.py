"""The collector: the planner of a collection as the controller process."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.options.nodes import NodeLink

if TYPE_CHECKING:
    from tunefree_hil.bench import Bench
    from tunefree_hil.collect.plan import DrivePlan
    from tunefree_hil.nodes.controller import Assignment


class PlannerAssigner:
    """(scenario, parameters) -> Assignment: the planner for a drive, whose plan is beside its scenario."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench

    def __call__(self, scenario: bytes, parameters: Mapping[int, float]) -> Assignment:
        from tunefree_hil.bench import scenario_of_hash
        from tunefree_hil.collect.plan import make_planner_params
        from tunefree_hil.collect.planner import make_planner
        from tunefree_hil.nodes.controller import Assignment

        spec = scenario_of_hash(self.bench, scenario)
        plan = read_plan(Path(spec.path).with_suffix(".json"))
        block = make_planner(make_planner_params(self.bench.vehicle, plan, self.bench.dt_s))
        return Assignment(block, self.bench.course(spec).ticks, self.bench.dt_s)


def read_plan(path: Path) -> DrivePlan:
    """Read the plan of a drive. Raises InputError for a missing or invalid file."""
    from tunefree_hil.collect.plan import plan_from_dict

    try:
        data = json.loads(path.read_text())
    except (OSError, ValueError) as error:
        hint = "the collector drives the plans of `tunefree-hil collect` only"
        raise InputError(
            f"cannot read the plan of a drive: {error}", code="no_plan", file=str(path), hint=hint
        ) from error
    return plan_from_dict(data, str(path))


def collector(bench: Path, link: NodeLink) -> Iterator[Event]:
    """Serve the drives of a collection until the runner ends the node or the bus is lost."""
    from tunefree_hil.jobs.running.node_main import serve_controller
    from tunefree_hil.nodes.node import Announcement

    announcement = Announcement("collector")
    yield from serve_controller(bench, link, "collector", PlannerAssigner, lambda parts: announcement)

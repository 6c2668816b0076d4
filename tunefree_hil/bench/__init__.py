"""From a bench file to Blocks, codec and scenarios; all concrete choices are made here."""

from tunefree_hil.bench.check import require_buildable
from tunefree_hil.bench.controller import (
    ControllerFor,
    calibration_path,
    follower_of,
    needed_messages,
    parameters_of,
    require_in_box,
)
from tunefree_hil.bench.load import Bench, load, model_of, scenario_of_hash
from tunefree_hil.bench.user_parts import own_parameters, part_names, part_values
from tunefree_hil.bench.vehicle import VehicleFor, is_heavy

__all__ = [
    "Bench",
    "ControllerFor",
    "VehicleFor",
    "calibration_path",
    "follower_of",
    "is_heavy",
    "load",
    "model_of",
    "needed_messages",
    "own_parameters",
    "parameters_of",
    "part_names",
    "part_values",
    "require_buildable",
    "require_in_box",
    "scenario_of_hash",
]

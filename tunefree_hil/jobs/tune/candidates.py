"""The tuned parameter vector and the baselines that it is compared with, complete and in binary32."""

from __future__ import annotations

from collections.abc import Mapping

from tunefree_hil.bench import Bench, own_parameters, parameters_of, part_names
from tunefree_hil.control.parameters import BY_NAME
from tunefree_hil.jobs.run_folder import RunFolder
from tunefree_hil.jobs.running.foreign import unsupported_parameters
from tunefree_hil.jobs.tune.rule_inputs import lateral_loop, rule_inputs
from tunefree_hil.jobs.tune.verdict.best_file import PARAMETERS, read_best
from tunefree_hil.tune.baselines import compute_rule_based, list_manual_vectors, select_first_baseline

TUNED = "tuned"
BENCH_VALUES = "given"  # baseline of a foreign controller: the values of the bench file, as there are no manual gains


def read_winner(bench: Bench, run: RunFolder) -> dict[str, float]:
    """The complete vector of the winner of a tune."""
    return parameters_of(bench, read_best(run)[PARAMETERS])


def compute_baseline_vectors(bench: Bench) -> dict[str, dict[str, float]]:
    """The baselines of the vehicle by name; `rule_based` is computed from data sheet and actuators of the model.

    Parameters of built-in parts beyond the shipped vectors have the parts' own values. A foreign controller with
    parameters in the bench file has one baseline: the values of the bench file.
    """
    if has_foreign_controller(bench):
        return {BENCH_VALUES: parameters_of(bench)}
    shipped = bench.vehicle.manual_gains == "as_shipped"
    vectors = list_manual_vectors(compute_rule_based(rule_inputs(bench), lateral_loop(bench)), shipped=shipped)
    return {name: parameters_of(bench, values) for name, values in vectors.items()}


def has_foreign_controller(bench: Bench) -> bool:
    """Whether the bench file names parameters of a controller that is not built in.

    They are those of a program, of a part of the user ('file.py:EXPORT'), or of a controller that is joined. The
    shipped vectors were not made for it.
    """
    is_own = bool(bench.spec.controller.command) or any(":" in part for part in part_names(bench))
    return bool(own_parameters(bench) if is_own else unsupported_parameters(bench, own_parameters(bench)))


def select_first_vector(vectors: Mapping[str, Mapping[str, float]]) -> Mapping[str, float]:
    """The baseline that is the first trial of a study."""
    return vectors[BENCH_VALUES] if BENCH_VALUES in vectors else select_first_baseline(vectors)


def road_seed(bench: Bench) -> int:
    """The seed of the made roads, else that of the bench file."""
    return bench.spec.seed if bench.spec.roads is None else bench.spec.roads.seed


def parameter_unit(name: str) -> str:
    """Unit of a parameter; '' for one of a foreign controller."""
    return BY_NAME[name].tunable.unit if name in BY_NAME else ""

"""`tunefree-hil weights`: regress the weights of a score from pairs of human and generated drives (paper, eq. 10)."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.config.load import load_weights
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.weight_regression.pairs import DrivePair, make_pair_table
from tunefree_hil.grade.weight_regression.ranking import CRITERIA
from tunefree_hil.jobs.command_text import shell_command
from tunefree_hil.jobs.progress import relay_events
from tunefree_hil.jobs.run_folder import write_json, write_text
from tunefree_hil.jobs.weights.driven_pairs import drive_pairs
from tunefree_hil.jobs.weights.evaluation import (
    ALL,
    REGRESSED,
    RankedPairs,
    RegressionEvaluation,
    evaluate_regression,
    pair_rows,
    pairs_sha256,
    regressed_weights,
)
from tunefree_hil.jobs.weights.options import WeightsOptions
from tunefree_hil.jobs.weights.recorded_pairs import read_pairs
from tunefree_hil.jobs.weights.weights_text import (
    MARK,
    accuracy_lines,
    accuracy_text,
    refusal,
    weight_lines,
    weights_file_text,
)
from tunefree_hil.tune.weight_regression.cross_validation import Regression, RegressionStep, regress

SCHEMA = "tunefree.weights_report/1"


class WeightRegression(NamedTuple):
    """A finished regression: its pairs, the result and its evaluation, and the weights by metric."""

    ranked: RankedPairs
    regression: Regression
    evaluation: RegressionEvaluation
    metrics: dict[str, float]
    margin: float


def weights(options: WeightsOptions) -> Iterator[Event]:
    """Gather pairs, regress, evaluate on held-out groups; write weights file, report and figure."""
    require_options(options)
    base, folder = load_weights(options.base), options.out.with_suffix("")
    pairs = read_pairs(options.pairs, base) if options.pairs is not None else []
    if options.bench is not None:
        pairs = pairs + (yield from drive_pairs(options, folder))
    result = yield from regress_pairs(pairs, base, options)
    evaluation = result.evaluation
    yield from (Event("line", line) for line in accuracy_lines(evaluation))
    if evaluation.refusals and not options.force:
        raise refusal(result.ranked, evaluation)
    yield from (Event("line", line) for line in weight_lines(result.metrics, base))
    provenance = _provenance(result, options)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "report.json", {"schema": SCHEMA, **_report(result, base, provenance)})
    figure = _figure(result, base, folder)
    write_text(options.out, weights_file_text(options.out.stem, base, result.metrics, provenance))
    sentence = f"{accuracy_text(evaluation.accuracies[ALL][REGRESSED])} on held-out groups"
    sentence += f", with {base.name} {100.0 * evaluation.accuracies[ALL][base.name].share:.1f} %; {options.out} written"
    zeros = [name for name, value in result.metrics.items() if value == 0.0]
    if zeros:
        yield Event("warning", f"weight 0, as the human drives are no better there: {', '.join(zeros)}")
    if evaluation.refusals:
        yield Event("warning", "written by --force: the pairs do not determine these weights")
    data = {"sentence": sentence, "weights": str(options.out), "figures": [figure], "next": [_next(options)]}
    yield Event("result", sentence, {**data, "metrics": result.metrics, **provenance})


def require_options(options: WeightsOptions) -> None:
    """Raise InputError for options that do not fit, before anything is driven."""
    if options.pairs is None and options.bench is None:
        hint = "give a file of pairs, or --bench BENCH to drive pairs with a driver model"
        raise InputError("there are no pairs", code="usage", key="PAIRS", hint=hint)
    if options.out.suffix != ".toml":
        raise InputError(
            f"{options.out} does not end in .toml", code="usage", key="--out", hint="such as --out weights/my.toml"
        )
    if options.margin is not None and not options.margin > 0.0:
        hint = "give a number above 0: with 0 all weights could be 0 (paper, Appendix I)"
        raise InputError(f"--margin {options.margin:g} is not above 0", code="usage", key="--margin", hint=hint)
    if options.out.is_file() and not options.out.read_text(encoding="utf-8").startswith(MARK):
        hint = "give another --out"
        raise InputError("is a weights file that was not regressed", code="exists", file=str(options.out), hint=hint)
    if options.pairs is not None and not options.pairs.is_file():
        raise InputError("no such file", code="no_pairs", file=str(options.pairs), hint="give a file of pairs (TOML)")


def regress_pairs(
    pairs: list[DrivePair], base: WeightsSpec, options: WeightsOptions
) -> Generator[Event, None, WeightRegression]:
    """Regress the weights from pairs and evaluate them. Raises InputError where nothing can be held out."""
    ranked = rank_pairs(pairs, base)
    n_other = ranked.n_all - len(ranked.pairs)
    if n_other:
        text = f"{n_other} of {ranked.n_all} pairs are left out: a drive failed or re-planned, whatever the weights"
        yield Event("note", text)
    margin = CRITERIA.margin if options.margin is None else options.margin
    steps = regress(ranked.table, ranked.groups, margin, options.seed)
    regression = yield from relay_events(steps, _step_event)
    evaluation = evaluate_regression(ranked, regression, base, margin, options.seed)
    metrics = regressed_weights(ranked.table, regression.fit.multipliers, base)
    return WeightRegression(ranked, regression, evaluation, metrics, margin)


def rank_pairs(pairs: list[DrivePair], base: WeightsSpec) -> RankedPairs:
    """The pairs that weights decide. Raises InputError for fewer than CRITERIA.min_groups groups of them."""
    decided = [pair for pair in pairs if pair.human.is_decided_by_weights and pair.generated.is_decided_by_weights]
    groups = {pair.group for pair in decided}
    if len(groups) < CRITERIA.min_groups:
        raise InputError(
            f"{len(decided)} of {len(pairs)} pairs came to their end without a re-plan, in {len(groups)} groups;"
            f" {CRITERIA.min_groups} groups are needed to hold one out",
            code="few_groups",
            key="pairs",
            hint="add pairs of other roads or scenarios, or give pairs other `group`s",
        )
    return RankedPairs(decided, make_pair_table(decided, base), len(pairs))


def _step_event(step: RegressionStep) -> Event:
    text = f"regression {step.done} of {step.total}"
    return Event("progress", text, {"label": "regression", "done": step.done, "total": step.total, "eta_s": None})


def _provenance(result: WeightRegression, options: WeightsOptions) -> dict[str, Any]:
    ranked, accuracies = result.ranked, result.evaluation.accuracies[ALL]
    return {
        "n_pairs": len(ranked.pairs),
        "n_groups": len(set(ranked.groups)),
        "pairs_sha256": pairs_sha256(ranked.pairs),
        "base": options.base,
        "seed": options.seed,
        "margin": result.margin,
        "strength": result.regression.choice.strength,
        "held_out_accuracy": {name: round(accuracy.share, 4) for name, accuracy in accuracies.items()},
        "permuted_labels": round(result.evaluation.permuted, 4),
        "refused_for": [str(reason) for reason in result.evaluation.refusals],
    }


def _report(result: WeightRegression, base: WeightsSpec, provenance: dict[str, Any]) -> dict[str, Any]:
    evaluation, regression = result.evaluation, result.regression
    return {
        **provenance,
        "metrics": result.metrics,
        "base_metrics": dict(base.metrics),
        "loss": regression.fit.loss,
        "gap": regression.fit.gap,
        "held_out_losses": list(regression.choice.losses),
        "accuracies": {
            kind: {name: accuracy._asdict() for name, accuracy in by_weights.items()}
            for kind, by_weights in evaluation.accuracies.items()
        },
        "fold_accuracies": {name: list(values) for name, values in evaluation.fold_accuracies.items()},
        "permuted_runs": list(regression.permuted),
        "pairs": pair_rows(result.ranked, evaluation),
    }


def _figure(result: WeightRegression, base: WeightsSpec, folder: Path) -> str:
    from tunefree_hil.figures.style import save
    from tunefree_hil.figures.tuning.weights import WeightsPicture, draw_weights

    evaluation = result.evaluation
    known = {name: values[values == values] for name, values in evaluation.margins.items()}
    picture = WeightsPicture(
        base.name,
        result.metrics,
        {name: base.metrics[name] for name in result.metrics},
        evaluation.fold_accuracies,
        evaluation.permuted,
        {name: known[name] for name in (REGRESSED, base.name)},
        result.margin,
    )
    return str(save(draw_weights(picture), folder / "weights.png"))


def _next(options: WeightsOptions) -> str:
    """The command that uses the weights."""
    return shell_command("compare", "RUN", "RUN", weights=str(options.out))

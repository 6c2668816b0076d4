"""The weights file, the refusal and the sentence of a regression as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from tunefree_hil.base.errors import InputError
from tunefree_hil.config.dump import plain, to_toml
from tunefree_hil.config.schema import WeightsSpec
from tunefree_hil.grade.weight_regression.pairs import find_reversed_pairs
from tunefree_hil.grade.weight_regression.ranking import CRITERIA, AccuracyInterval
from tunefree_hil.jobs.weights.evaluation import ALL, REGRESSED, RankedPairs, RefusalReason, RegressionEvaluation

MARK = "# tunefree.regressed_weights/1"  # first line of a file that may be overwritten
ORIGIN = "# Regressed by `tunefree-hil weights` from pairs of human and generated drives (eq. 10)."
REASONS = {
    RefusalReason.FEW_PAIRS: "there are fewer pairs than weights",
    RefusalReason.CONTRADICTION: "pairs contradict each other",
    RefusalReason.CHANCE: "held-out pairs are not ranked better than by chance",
}


def weights_file_text(name: str, base: WeightsSpec, metrics: Mapping[str, float], provenance: Mapping[str, Any]) -> str:
    """A weights file with the rules of the base weights and where the numbers come from, as comments."""
    fields = {key: value for key, value in plain(base).items() if key not in ("path", "name", "description", "metrics")}
    description = f"Regressed from {provenance['n_pairs']} pairs, from weights {base.name}"
    data = {"schema": fields.pop("schema"), "name": name, "description": description, **fields}
    comments = [MARK, ORIGIN, *(f"# {key} = {value}" for key, value in provenance.items())]
    return "\n".join(comments) + "\n" + to_toml({**data, "metrics": dict(metrics)})


def refusal(ranked: RankedPairs, evaluation: RegressionEvaluation) -> InputError:
    """The error for pairs that do not determine weights; it names those with the largest unmet margin."""
    reasons = "; ".join(REASONS[reason] for reason in evaluation.refusals)
    accuracy = evaluation.accuracies[ALL][REGRESSED]
    n_metrics = len(ranked.table.metrics)
    message = f"{reasons}: {len(ranked.pairs)} pairs for {n_metrics} weights, {accuracy_text(accuracy)} held out"
    worst = "; ".join(_named_pairs(ranked, evaluation))
    hint = "look at the pairs with the largest unmet margin, remove wrong ones or add pairs; --force writes the file"
    return InputError(f"{message}. {worst}", code=str(evaluation.refusals[0]), key="pairs", hint=hint)


def _named_pairs(ranked: RankedPairs, evaluation: RegressionEvaluation) -> list[str]:
    """Reversed pairs first, then those with the largest unmet margin."""
    texts = [
        f"{ranked.pairs[first].name} is in the pairs both ways round"
        for first, _ in find_reversed_pairs(ranked.pairs)[: CRITERIA.n_named]
    ]
    order = np.argsort(-evaluation.unmet, kind="stable")[: CRITERIA.n_named]
    texts += [
        f"{ranked.pairs[row].name} lacks {evaluation.unmet[row]:.2f}" for row in order if evaluation.unmet[row] > 0
    ]
    return texts


def accuracy_text(accuracy: AccuracyInterval) -> str:
    """Such as '93.1 % (89.0 to 96.2, n 240) ranked right'."""
    if accuracy.n == 0:
        return "no pair"
    share, low, high = (100.0 * value for value in (accuracy.share, accuracy.low, accuracy.high))
    return f"{share:.1f} % ({low:.1f} to {high:.1f}, n {accuracy.n}) ranked right"


def accuracy_lines(evaluation: RegressionEvaluation) -> list[str]:
    """A line for each kind of human and weights."""
    lines = [f"{'human':<8}{'weights':<18}held-out pairs whose human drive has the lower score"]
    for kind, by_weights in evaluation.accuracies.items():
        lines += [f"{kind:<8}{name:<18}{accuracy_text(accuracy)}" for name, accuracy in by_weights.items()]
    return [*lines, f"{ALL:<8}{'permuted labels':<18}{100.0 * evaluation.permuted:.1f} % (control, near 50)"]


def weight_lines(metrics: Mapping[str, float], base: WeightsSpec) -> list[str]:
    """A line for each metric: regressed and base weight."""
    lines = [f"{'metric':<28}{'weight':>10}{base.name:>10}"]
    return lines + [f"{name:<28}{value:>10.4g}{base.metrics[name]:>10.4g}" for name, value in metrics.items()]

"""A search's result as data: the part of gap.json that it gives, and search.json, from which a stopped run continues.

Repair, verification, page and figures are made from this and the logs alone. Floats survive JSON bit for bit. The keys
are in docs/reference/files.md.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from tunefree_hil.gap.diagnostics.regions import Region
from tunefree_hil.gap.diagnostics.residual_tests import LinkResidual, Shape
from tunefree_hil.gap.estimation.evidence import non_holdout_blocks
from tunefree_hil.gap.estimation.intervals import AtBound, find_parameters_at_bound
from tunefree_hil.gap.measured.excitation import Excitation
from tunefree_hil.gap.measured.observability import find_untestable_effects
from tunefree_hil.gap.model.graph import load_catalogue
from tunefree_hil.gap.pipeline import Diagnosis, FoundEffect
from tunefree_hil.gap.result_text import diagnosis_texts, few_blocks_text, lacking_text, reason_text
from tunefree_hil.gap.selection.candidate_reasons import excitation_reasons
from tunefree_hil.gap.selection.criteria import CandidateScore
from tunefree_hil.gap.selection.reasons import Criterion, Reason, VerdictKind, reason_entry
from tunefree_hil.gap.workers.worker import FitSummary
from tunefree_hil.learn.model_folder import plain_data

SCHEMA = "tunefree.gap_search/3"
FEW_BLOCKS = 9  # that are searched, in a drive of 105 s; with fewer, a remark is added
MAX_REGIONS = 3  # that are listed
NO_LOCATION: dict[str, Any] = {"link": None, "signal": "", "regime": [], "card": ""}  # where nothing is missed
PLANTS_WITHOUT_NET = ("physics", "reference")  # kinds of plants without a trained network
# Verdicts that hold only as far as the blocks could have shown anything else
LIMITED_BY_BLOCKS = (VerdictKind.ONE, VerdictKind.SEVERAL, VerdictKind.SET, VerdictKind.NONE_MISSING)
KEYS = {  # of search.json, by field of SearchResult
    "answer": "answer",
    "recalibrated_values": "null",
    "repaired_values": "repaired",
    "effect_keys": "free",
    "signal": "signal",
    "regions": "regions",
    "shape": "shape",
    "elapsed_s": "seconds",
    "has_candidates": "named",
    "predictable_shares": "foretold",
}


class SearchResult(NamedTuple):
    """The result of a search, as it is stored in search.json.

    Args:
        answer: as in gap.json.
        recalibrated_values, repaired_values: values by key as gap/model/graph.py takes them, of recalibration alone and
            with the effects.
        effect_keys: the keys that belong to the effects found.
        signal, regions, shape: of the target that shows it best; "" where nothing is broken and no effect was found.
        elapsed_s: duration of the search.
        has_candidates: candidates were tried.
        predictable_shares: by target, of what the model with the effects still misses, the share that is predictable.
    """

    answer: dict[str, Any]
    recalibrated_values: dict[str, float]
    repaired_values: dict[str, float]
    effect_keys: tuple[str, ...]
    signal: str
    regions: tuple[Region, ...]
    shape: Shape | None
    elapsed_s: float
    has_candidates: bool = True
    predictable_shares: dict[str, float] = {}  # noqa: RUF012 - never mutated

    @property
    def verdict(self) -> str | None:
        """The verdict as in gap.json; None where no candidate was tried."""
        return self.answer["verdict"]

    @property
    def names(self) -> list[str]:
        """Names of the effects that were found."""
        return [effect["name"] for effect in self.answer["effects"]]


def make_search_result(diagnosis: Diagnosis, kind: str, elapsed_s: float, has_candidates: bool = True) -> SearchResult:
    """What is stored of a diagnosis.

    Args:
        kind: of the model's plant.
        has_candidates: candidates were tried.
    """
    location, answer = diagnosis.location, answer_entries(diagnosis, kind)
    shares = {name: fit.explained / fit.total for name, fit in diagnosis.lack_of_fit_after.items() if fit.total > 0.0}
    return SearchResult(
        answer=answer,
        recalibrated_values=_values_of(diagnosis.problem.recalibrated),
        repaired_values=_values_of(diagnosis.repaired),
        effect_keys=tuple(free.key for free in diagnosis.repaired.fit.free),
        signal="" if location is None else location.residual.signal,
        regions=() if location is None else location.regions,
        shape=None if location is None else location.shape,
        elapsed_s=elapsed_s,
        has_candidates=has_candidates,
        predictable_shares={name: min(max(share, 0.0), 1.0) for name, share in shares.items()},
    )


def as_json(search: SearchResult) -> dict[str, Any]:
    """The table of search.json."""
    return {"schema": SCHEMA, **plain_data({key: getattr(search, field) for field, key in KEYS.items()})}


def from_json(data: Mapping[str, Any]) -> SearchResult:
    """The result in a table of search.json.

    Raises:
        ValueError: it was not written by `as_json` of this version.
    """
    if data.get("schema") != SCHEMA:
        raise ValueError(f"schema is {data.get('schema')!r}, expected {SCHEMA!r}")
    try:
        fields = {field: data[key] for field, key in KEYS.items()}
        shape = fields["shape"]
        return SearchResult(**fields)._replace(
            effect_keys=tuple(fields["effect_keys"]),
            regions=tuple(Region(**region) for region in fields["regions"]),
            shape=None if shape is None else Shape(**shape),
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"incomplete search: {error}") from error


def answer_entries(diagnosis: Diagnosis, kind: str = "physics") -> dict[str, Any]:
    """The keys of gap.json that a search gives; a number that is not finite is None. kind: of the model's plant.

    Where nothing is missing and no effect could have been seen, the verdict is that these logs cannot tell.
    """
    untestable = {name: reason_text(reason) for name, reason in _untestable_effects(diagnosis).items()}
    verdict = diagnosis.verdict.kind.value
    answer = {
        "verdict": verdict or None,
        "forced": most_likely_name(diagnosis),
        "absorbed": may_be_absorbed(verdict, kind),
        "effects": [_effect_entry(effect) for effect in diagnosis.effects],
        "set": list(diagnosis.set_names),
        "together": joint_effects(diagnosis),
        "separate_by": diagnosis.separate_by,
        "where": _location_entry(diagnosis),
        "excitation": {
            name: _excitation_entry(excitation, untestable.get(name, ""))
            for name, excitation in diagnosis.excitation.items()
        },
        "links": [_link_entry(link) for link in diagnosis.links_before],
        "as_usual": [
            link.signal for link in diagnosis.links_before if link.is_broken and diagnosis.baseline.is_within(link)
        ],
        "untold": untestable,
        "lost": {link.value: reason for link, reason in diagnosis.unobservable_links.items()},
        "not_suspected": {name: reason_text(reason) for name, reason in diagnosis.problem.untestable_effects.items()},
        "candidates": [_candidate_entry(score) for score in diagnosis.candidates],
        "words": [
            *diagnosis_texts(diagnosis),
            *_few_blocks_texts(diagnosis),
            *dict.fromkeys(diagnosis.unobservable_ports.values()),
        ],
        "reasons": [reason_entry(reason) for reason in (*_verdict_reasons(diagnosis), *candidate_reasons(diagnosis))],
        "moved": [bound.text for bound in _parameters_at_bound(diagnosis)],
    }
    is_blind = not any(entry["enough"] for entry in answer["excitation"].values())
    is_blind = is_blind and diagnosis.verdict.kind is VerdictKind.NONE_MISSING
    return answer | (_blind_entries(answer, diagnosis) if is_blind else {})


def _verdict_reasons(diagnosis: Diagnosis) -> tuple[Reason, ...]:
    return (*diagnosis.verdict.reasons, *diagnosis.rejected)


def candidate_reasons(diagnosis: Diagnosis) -> tuple[Reason, ...]:
    """Why each effect of the catalogue is not named: what these logs cannot show, and what the search rejected."""
    reasons = (
        *diagnosis.problem.untestable_effects.values(),
        *_untestable_effects(diagnosis).values(),
        *excitation_reasons(diagnosis.excitation),
    )
    names = diagnosis.verdict.names
    return (*(reason for reason in reasons if reason.name not in names), *diagnosis.rejected_candidates)


def _blind_entries(answer: Mapping[str, Any], diagnosis: Diagnosis) -> dict[str, Any]:
    """Keys where no effect could have been seen."""
    reasons = (Reason(Criterion.NOTHING_VISIBLE), *candidate_reasons(diagnosis))
    return {
        "verdict": VerdictKind.CANNOT_TEST.value,
        "absorbed": False,
        "words": [lacking_text(answer["excitation"])],
        "reasons": [reason_entry(reason) for reason in reasons],
    }


def _untestable_effects(diagnosis: Diagnosis) -> dict[str, Reason]:
    """Why these logs cannot show effects."""
    unmoving = {reason.name: reason for reason in diagnosis.unmoving}
    links, ports = diagnosis.unobservable_links, diagnosis.unobservable_ports
    return {**unmoving, **find_untestable_effects(load_catalogue(), links, ports)}


def _excitation_entry(excitation: Excitation, untestable: str) -> dict[str, Any]:
    """Whether the logs hold what shows an effect. untestable: why they cannot show it anyhow; "" where they can."""
    shortages = [shortage.text for shortage in excitation.shortages]
    lacks = [*shortages, untestable] if untestable else shortages
    return {"score": _finite(excitation.score), "enough": excitation.is_sufficient and not untestable, "lacks": lacks}


def _link_entry(link: LinkResidual) -> dict[str, Any]:
    return {
        "link": link.link.value,
        "signal": link.signal,
        "unit": link.unit,
        "rms": link.rms,
        "noise": link.noise,
        "explicable": link.explainable_rms,
        "share": link.explainable_share,
        "broken": link.is_broken,
    }


def _candidate_entry(score: CandidateScore) -> dict[str, Any]:
    return {
        "name": score.name,
        "evidence": _finite(score.evidence),
        "held_out": [_finite(score.gain.total), _finite(score.gain.low)],
        "shrink": [_finite(share) for share in score.error_reduction],
        "signal": score.target,
        "counts": score.is_accepted,
    }


def _effect_entry(effect: FoundEffect) -> dict[str, Any]:
    bounds = {key: {"low": _finite(one.low), "high": _finite(one.high)} for key, one in effect.params.items()}
    return {
        "name": effect.name,
        "params": {key: {**one._asdict(), **bounds[key]} for key, one in effect.params.items()},
        "faint": effect.is_weak,
        "evidence": _finite(effect.evidence),
        "shrink": _finite(effect.holdout.fit_error_reduction),
        "unseen_shrink": _finite(effect.holdout.holdout_error_reduction),
        "unseen_stirs": _finite(effect.holdout.effect_energy),
    }


def _location_entry(diagnosis: Diagnosis) -> dict[str, Any]:
    location = diagnosis.location
    regions = [] if location is None else [region.text for region in location.regions if region.stands_out]
    return {
        "link": None if diagnosis.link is None else diagnosis.link.value,
        "signal": "" if location is None else location.residual.signal,
        "regime": regions[:MAX_REGIONS],
        "card": "" if location is None else location.text,
    }


def _few_blocks_texts(diagnosis: Diagnosis) -> tuple[str, ...]:
    """A remark that few blocks were searched, where the verdict depends on what else they could have shown."""
    n_blocks = len(non_holdout_blocks(diagnosis.problem.blocks))
    if n_blocks >= FEW_BLOCKS or diagnosis.verdict.kind not in LIMITED_BY_BLOCKS:
        return ()
    return (few_blocks_text(n_blocks),)


def _parameters_at_bound(diagnosis: Diagnosis) -> list[AtBound]:
    """Numbers that recalibration would move further than a calibrated model may be off: something may be missing."""
    return find_parameters_at_bound(diagnosis.repaired.fit, non_holdout_blocks(diagnosis.problem.blocks))


def joint_effects(diagnosis: Diagnosis) -> list[str]:
    """Of a set that stands for several effects at once, those that fit best; each other name may stand in place of one
    of them. Empty where the set is one effect's.
    """
    fitted = dict.fromkeys(free.key.partition(".")[0] for free in diagnosis.repaired.fit.free)
    names = [name for name in fitted if name in diagnosis.set_names]
    return names if len(names) > 1 else []


def most_likely_name(diagnosis: Diagnosis) -> str | None:
    """The most likely name, whatever the verdict; None where no candidate was tried."""
    if diagnosis.effects:
        return diagnosis.effects[0].name
    return max(diagnosis.candidates, key=lambda score: score.evidence).name if diagnosis.candidates else None


def may_be_absorbed(verdict: str, kind: str) -> bool:
    """Whether a learned plant may hide what is not found: its training logs may have had the effect."""
    return kind not in PLANTS_WITHOUT_NET and verdict in ("none_missing", "none_of_these")


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _values_of(model: FitSummary) -> dict[str, float]:
    return {key: float(value) for key, value in model.fit.values.items()}

"""What a model misses on the logs that it was calibrated from, so that a later log is compared with that.

Most models reproduce their calibration logs, and whatever a later log shows is new. A model of a shaking car of 2 kg
misses each later log as it missed those: that counts against no name, and an effect with the same value as in those
logs is not new. `calibrate` analyses the calibration logs once, and card.json keeps the result.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil.base.errors import InputError
from tunefree_hil.gap.diagnostics.residual_tests import LINK_CRITERIA, LinkResidual
from tunefree_hil.gap.model.card import load_model_card
from tunefree_hil.gap.selection.criteria import BASELINE
from tunefree_hil.learn.model_folder import CALIBRATION_EFFECTS

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec

# Keys of card.json
BASELINE_KEY, INCONSISTENT_KEY, UNEXPLAINED_KEY = "usual", "restless", "own_missed"
BURST_KEY, GROSS_KEY, SHARE_KEY = "loud", "gross", "share"
PEDALS = ("throttle_gain.gain_frac", "brake_gain.gain_frac")  # the same force along the car shows in either

Known = tuple[float, float]  # (value, standard deviation), both in the parameter's unit


class BaselineMisfit(NamedTuple):
    """A model's misfit on its calibration logs; shares are of the signal.

    Args:
        misfit: by target, the share missed.
        effects: value and deviation of each effect there, fitted alone, as far as the logs determine it.
        broken: targets that are missed by more than a calibrated model may.
        explaining: effects that together explain the logs, so that nothing is broken.
        inconsistent_gains: gains that differ from block to block there, in standard deviations.
        misfit_unexplained: by target, the share missed without `explaining`.
        burst_share, total_share, explicable_share: by target, as in LinkResidual, whether they break a link or
            not. A card without the last has `misfit` in its place.
    """

    misfit: Mapping[str, float]
    effects: Mapping[str, Mapping[str, Known]]
    broken: frozenset[str] = frozenset()
    explaining: Mapping[str, Mapping[str, Known]] = {}
    inconsistent_gains: Mapping[str, float] = {}
    misfit_unexplained: Mapping[str, float] = {}
    burst_share: Mapping[str, float] = {}
    gross_share: Mapping[str, float] = {}
    explainable_share: Mapping[str, float] = {}

    def excess_inconsistency(self, gains: Mapping[str, float]) -> dict[str, float]:
        """The gains that differ from block to block by more than twice what they did in the calibration logs."""
        known = dict(self.inconsistent_gains)
        known |= dict.fromkeys(PEDALS, max(known.get(key, 0.0) for key in PEDALS))
        factor = BASELINE.max_misfit_factor
        return {key: sigmas for key, sigmas in gains.items() if sigmas > factor * known.get(key, 0.0)}

    def is_known(self, link: LinkResidual) -> bool:
        """Whether no more of a target is missed than of the calibration logs, with or without `explaining`: then it
        does not count against an effect on another signal.
        """
        unexplained = self.misfit_unexplained.get(link.signal, 0.0)
        return self.is_within(link) or self.excess_over(link).misfit_share <= BASELINE.max_misfit_factor * unexplained

    def is_within(self, link: LinkResidual) -> bool:
        """Whether no more of a target is missed than on the calibration logs; its predictable part, its bursts and the
        whole are each compared by itself.
        """
        share = self.explainable_share.get(link.signal, self.misfit.get(link.signal, 0.0))
        return self.excess_over(link).misfit_share <= max(BASELINE.max_misfit_factor * share, link.tolerated_share)

    def burst_limit(self, target: str) -> float:
        """The share of a signal that its bursts have to miss to exceed the baseline."""
        return max(LINK_CRITERIA.max_burst_share, BASELINE.max_misfit_factor * self.burst_share.get(target, 0.0))

    def gross_limit(self, target: str) -> float:
        """The same of the whole misfit, predictable or not."""
        return max(LINK_CRITERIA.max_gross_share, BASELINE.max_misfit_factor * self.gross_share.get(target, 0.0))

    def excess_over(self, link: LinkResidual) -> LinkResidual:
        """A link's residual without the bursts and without the whole where they are within the baseline."""
        burst = link.burst_share if link.burst_share > self.burst_limit(link.signal) else 0.0
        total = link.gross_share if link.gross_share > self.gross_limit(link.signal) else 0.0
        return link._replace(burst_share=burst, gross_share=total)


NO_BASELINE = BaselineMisfit({}, {})


def baseline_from_links(links: Sequence[LinkResidual], effects: Mapping[str, Mapping[str, Known]]) -> BaselineMisfit:
    """The baseline of a model that leaves these residuals on its calibration logs.

    Args:
        effects: value and deviation of each effect there.
    """
    return BaselineMisfit(
        misfit={link.signal: link.misfit_share for link in links},
        effects=effects,
        broken=frozenset(link.signal for link in links if link.is_broken),
        burst_share={link.signal: link.burst_share for link in links},
        gross_share={link.signal: link.gross_share for link in links},
        explainable_share={link.signal: link.explainable_share for link in links},
    )


def baseline_of_model(model: ModelSpec) -> BaselineMisfit:
    """The baseline in a model's card; NO_BASELINE where it reproduces its calibration logs, or they were not analysed.

    Raises:
        InputError: the card cannot be read.
    """
    try:
        return baseline_from_card(load_model_card(model))
    except (AttributeError, TypeError, KeyError, ValueError) as error:
        raise InputError(
            f"{BASELINE_KEY}: {error}",
            code="bad_card",
            file=str(Path(model.folder) / model.plant.card),
            key=BASELINE_KEY,
            hint="calibrate the model again",
        ) from error


def baseline_from_card(card: Mapping[str, Any]) -> BaselineMisfit:
    """The same from a card's table. Raises what reading a malformed table raises."""
    entry = card.get(BASELINE_KEY) or {}
    return BaselineMisfit(
        misfit=_numbers_from(entry, "missed"),
        effects=_estimates_from(entry.get("effects", {})),
        broken=frozenset(str(name) for name in entry["broken"]) if entry else frozenset[str](),
        explaining=_estimates_from(card.get(CALIBRATION_EFFECTS) or {}),
        inconsistent_gains=_numbers_from(card, INCONSISTENT_KEY),
        misfit_unexplained=_numbers_from(card, UNEXPLAINED_KEY),
        burst_share=_numbers_from(entry, BURST_KEY),
        gross_share=_numbers_from(entry, GROSS_KEY),
        explainable_share=_numbers_from(entry, SHARE_KEY),
    )


def card_entries(baseline: BaselineMisfit) -> dict[str, Any]:
    """Keys of card.json; none where there is nothing to keep."""
    entries: dict[str, Any] = {}
    if baseline.explaining:
        entries[CALIBRATION_EFFECTS] = _estimate_entries(baseline.explaining)
    numbers = {INCONSISTENT_KEY: baseline.inconsistent_gains, UNEXPLAINED_KEY: baseline.misfit_unexplained}
    entries |= {key: dict(by_name) for key, by_name in numbers.items() if by_name}
    if baseline.misfit:
        entries[BASELINE_KEY] = {
            "missed": dict(baseline.misfit),
            "broken": sorted(baseline.broken),
            "effects": _estimate_entries(baseline.effects),
            BURST_KEY: dict(baseline.burst_share),
            GROSS_KEY: dict(baseline.gross_share),
            SHARE_KEY: dict(baseline.explainable_share),
        }
    return entries


def group_by_effect(values: Mapping[str, Known]) -> dict[str, dict[str, Known]]:
    """'effect.parameter' -> by effect, by parameter."""
    grouped: dict[str, dict[str, Known]] = {}
    for key, known in values.items():
        name, _, parameter = key.partition(".")
        grouped.setdefault(name, {})[parameter] = known
    return grouped


def _estimate_entries(effects: Mapping[str, Mapping[str, Known]]) -> dict[str, Any]:
    """Estimates as a table; an effect with a number that is not finite is left out."""
    return {
        name: {key: {"value": value, "deviation": sigma} for key, (value, sigma) in params.items()}
        for name, params in effects.items()
        if all(math.isfinite(number) for known in params.values() for number in known)
    }


def _estimates_from(table: Mapping[str, Any]) -> dict[str, dict[str, Known]]:
    return {
        name: {key: (_finite(entry["value"]), _finite(entry["deviation"])) for key, entry in params.items()}
        for name, params in table.items()
    }


def _numbers_from(table: Mapping[str, Any], key: str) -> dict[str, float]:
    return {str(name): _finite(number) for name, number in (table.get(key) or {}).items()}


def _finite(number: Any) -> float:
    value = float(number)
    if not math.isfinite(value):
        raise ValueError(f"{number} is no number to compare with")
    return value

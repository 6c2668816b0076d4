"""The verdict of a search: one name, several, a set, nothing missing, or something that is not in the catalogue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from tunefree_hil.gap.diagnostics.residual_tests import LinkResidual
from tunefree_hil.gap.estimation.nuisance import DRIFT_SIGMAS
from tunefree_hil.gap.measured.command_echo import CommandEcho
from tunefree_hil.gap.model.graph import load_catalogue
from tunefree_hil.gap.selection.baseline_misfit import NO_BASELINE, BaselineMisfit
from tunefree_hil.gap.selection.criteria import EQUIVALENCE, CandidateScore, failed_reasons
from tunefree_hil.gap.selection.equivalence import find_better_rejected
from tunefree_hil.gap.selection.reasons import Criterion, Reason, Verdict, VerdictKind

DAY_SIGMAS = 2.0  # standard deviations of the change from day to day, within which a value may be that change


def find_changed_frames(echoes: Sequence[CommandEcho]) -> tuple[Reason, ...]:
    """Channels whose commands arrive changed, or not at all: no effect of the catalogue does that."""
    return tuple(
        Reason(Criterion.FRAMES_CHANGED, value=echo.unexplained_share, key=echo.channel)
        for echo in echoes
        if echo.is_broken
    )


class Findings(NamedTuple):
    """What a verdict is made from.

    Args:
        links: every target with recalibration done, the worst broken first.
        alone: every candidate scored alone, the best first.
        steps: the effects that the search selected, with their equivalents.
        rejection: why `steps` are not what is missing; None where they may be named.
        changed_frames: of `find_changed_frames`.
        inconsistent_gains: gains that recalibration would move from block to block, in standard deviations.
        baseline: what the model misses on its calibration logs.
    """

    links: Sequence[LinkResidual]
    alone: Sequence[CandidateScore] = ()
    steps: Sequence[CandidateScore] = ()
    rejection: Reason | None = None
    changed_frames: tuple[Reason, ...] = ()
    inconsistent_gains: Mapping[str, float] = {}
    baseline: BaselineMisfit = NO_BASELINE


def decide_verdict(findings: Findings) -> Verdict:
    """Decide by the findings of a search. An effect of several that has equivalents makes a set of all of them."""
    steps = findings.steps
    if findings.changed_frames:
        return Verdict(VerdictKind.NONE_OF_THESE, (), findings.changed_frames)
    if not steps:
        return _nothing_found(findings)
    if findings.rejection is not None:
        return Verdict(VerdictKind.NONE_OF_THESE, (), (findings.rejection,))
    names = tuple(step.name for step in steps)
    if not any(step.equivalents for step in steps):
        kind = VerdictKind.ONE if len(steps) == 1 else VerdictKind.SEVERAL
        weak = tuple(Reason(Criterion.WEAK, step.name, step.evidence) for step in steps if step.is_weak)
        return Verdict(kind, names, weak)
    members = tuple(dict.fromkeys(name for step in steps for name in (step.name, *step.equivalents)))
    if all(step.is_weak and step.evidence < EQUIVALENCE.min_weak_set_nats for step in steps):
        evidence = max(step.evidence for step in steps)
        weak_set = Reason(Criterion.WEAK_SET, members[0], evidence, EQUIVALENCE.min_weak_set_nats, others=members[1:])
        beyond = links_beyond_baseline(findings.links, findings.baseline)
        return _without_name(beyond[0] if beyond else None, weak_set)
    return Verdict(
        VerdictKind.SET,
        members,
        tuple(Reason(Criterion.INDISTINGUISHABLE, step.name, step.evidence, others=step.equivalents) for step in steps),
    )


def decide_location(links: Sequence[LinkResidual], changed_frames: tuple[Reason, ...]) -> Verdict:
    """The verdict where no candidate was tried: NOT_SEARCHED where a link is broken."""
    if changed_frames:
        return Verdict(VerdictKind.NONE_OF_THESE, (), changed_frames)
    return Verdict(VerdictKind.NOT_SEARCHED) if links[0].is_broken else _without_name(None)


def _nothing_found(findings: Findings) -> Verdict:
    """The verdict where no effect was selected; with the criteria that the strongest candidate fails."""
    alone, inconsistent_gains = findings.alone, findings.inconsistent_gains
    strongest = max(alone, key=lambda score: score.evidence, default=None)
    failed = failed_reasons(strongest) if strongest is not None else ()
    beyond = links_beyond_baseline(findings.links, findings.baseline)
    worst = (beyond or findings.links)[0]
    better = find_better_rejected(alone) if alone and alone[0].is_accepted else None
    if better is not None:
        best = alone[0]
        outdone = Reason(Criterion.BETTER_REJECTED, best.name, best.evidence, better.evidence, others=(better.name,))
        return Verdict(VerdictKind.NONE_OF_THESE, (), (outdone, *failed_reasons(better)))
    if worst.is_broken and not beyond:
        within = Reason(Criterion.WITHIN_BASELINE, value=worst.misfit_share, key=worst.signal, link=worst)
        return Verdict(VerdictKind.NONE_OF_THESE, (), (within, *failed))
    if worst.is_broken:
        return _without_name(worst, *failed)
    if inconsistent_gains:
        key, sigmas = max(inconsistent_gains.items(), key=lambda item: item[1])
        inconsistent = Reason(Criterion.RECALIBRATION_INCONSISTENCY, value=sigmas, key=key)
        return Verdict(VerdictKind.NONE_OF_THESE, (), (inconsistent, *failed))
    return _without_name(None, *failed)


def _without_name(worst: LinkResidual | None, *reasons: Reason) -> Verdict:
    """No name: something is missing where a link is broken (`worst`), else nothing."""
    if worst is None:
        return Verdict(VerdictKind.NONE_MISSING, (), (Reason(Criterion.NOTHING_BROKEN), *reasons))
    unexplained = Reason(
        Criterion.UNEXPLAINED, value=worst.misfit_share, limit=worst.tolerated_share, key=worst.signal, link=worst
    )
    return Verdict(VerdictKind.NONE_OF_THESE, (), (unexplained, *reasons))


def links_beyond_baseline(links: Sequence[LinkResidual], baseline: BaselineMisfit) -> list[LinkResidual]:
    """Broken targets that exceed the model's baseline, without the part that is within it, the worst first."""
    beyond = [baseline.excess_over(link) for link in links if link.is_broken and not baseline.is_within(link)]
    return sorted(beyond, key=lambda link: -link.misfit_share)


def find_unexplained_beside(
    links: Sequence[LinkResidual], explained: Mapping[str, float], baseline: BaselineMisfit = NO_BASELINE
) -> tuple[LinkResidual, ...]:
    """Broken targets that the named effects do not work on; each is missed by less than those explain.

    Args:
        links: every target with the effects in the model.
        explained: the targets that the effects explain.
    """
    return tuple(
        baseline.excess_over(link)
        for link in links
        if link.is_broken and link.signal not in explained and not baseline.is_known(link)
    )


def find_day_sized(values: Mapping[str, Mapping[str, float]]) -> tuple[str, ...]:
    """Named effects whose values are no more than what changes from one day to the next.

    Args:
        values: by effect, by parameter. An effect is listed once for each such parameter.
    """
    catalogue = load_catalogue()
    return tuple(
        name
        for name, params in values.items()
        for parameter, value in params.items()
        if abs(value - catalogue[name].neutral[parameter]) < DAY_SIGMAS * DRIFT_SIGMAS.get(f"{name}.{parameter}", 0.0)
    )

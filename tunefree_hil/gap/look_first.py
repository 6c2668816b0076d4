"""Where simulation and measurement part, and no more: recalibration, every link by itself, a card; nobody is named."""

from __future__ import annotations

from collections.abc import Generator, Sequence

from tunefree_hil.base.contracts import Link
from tunefree_hil.config.schema import ModelSpec, VehicleSpec
from tunefree_hil.gap.chain import Opened
from tunefree_hil.gap.clock import echoes
from tunefree_hil.gap.enough import refuse_untold
from tunefree_hil.gap.evidence import judged
from tunefree_hil.gap.excitation import excitation, held_by
from tunefree_hil.gap.graph import effects
from tunefree_hil.gap.locate import Card, Looked, card, echo_words
from tunefree_hil.gap.lost import lost_links, silent_ports
from tunefree_hil.gap.name import Named
from tunefree_hil.gap.sift import looked_at
from tunefree_hil.gap.team import Team
from tunefree_hil.gap.work import Setting

NOBODY_ASKED = ""  # the verdict where links are broken and no name was looked for


def look_first(model: ModelSpec, vehicle: VehicleSpec, drives: Sequence[Opened]) -> Generator[str, None, Named]:
    """The part of `name` before any suspect is asked; `repaired` is the null. Raises as `name` does."""
    refuse_untold(drives)
    team = Team(Setting(model, vehicle, tuple(drives)), workers=1)
    try:
        yield "recalibration alone"
        question = team.open()
        yield "every link by itself"
        left, looked = looked_at(team, question, question.null, judged(question.blocks))
        said = tuple(one for opened in drives for one in echoes(opened))
        strange = echo_words(said)
        shown: Card | None = None
        if looked[0].broken:
            regions, shape = team.ask("seen_of", question.null.fitted, looked[0].signal)
            shown = card(looked[0], shape, regions, question.sizes[looked[0].signal])
    finally:
        team.close()
    link = Link.COMMAND_ECHO if strange else looked[0].link if shown else None
    held = excitation(effects(), held_by(drives, vehicle))
    words = tuple(strange) or (() if shown else ("nothing beyond noise and recalibration",))
    return Named(
        _verdict(looked, strange), (), (), "", link, shown, tuple(looked), held, (), question, question.null,
        left, left, lost_links(drives), words, silent=silent_ports(drives),
    )  # fmt: skip


def _verdict(looked: Sequence[Looked], strange: Sequence[str]) -> str:
    if strange:
        return "none_of_these"
    return NOBODY_ASKED if looked[0].broken else "none_missing"

"""Effects of a port in series."""

from __future__ import annotations

from tunefree_hil.base.contracts import make_effect
from tunefree_hil.gap.model.effect_chain import chain_effects
from tunefree_hil.gap.model.graph import load_catalogue

DT_S = 0.01


def test_a_chain_does_what_its_effects_do_one_after_the_other_and_nothing_without_them() -> None:
    some = {name: load_catalogue()[name] for name in ("steer_gain", "steer_offset")}
    on = {"steer_gain": {"gain_frac": 2.0}, "steer_offset": {"offset_rad": 0.25}}
    blocks = {name: make_effect(effect, on[name]) for name, effect in some.items()}
    neutral = {name: make_effect(effect, {}) for name, effect in some.items()}
    chain = chain_effects(list(some), blocks)
    for these, expected in ((blocks, 1.25), (neutral, 0.5)):
        assert chain.block.step(chain.params(these), chain.state(these, DT_S), 0.5, DT_S)[1] == expected
    empty = chain_effects([], {})
    assert empty.block.step(empty.params({}), empty.state({}, DT_S), 0.5, DT_S)[1] == 0.5

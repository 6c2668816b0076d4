"""Names whoever commands the vehicle beside the controller, or reports beside the ECU: who, which id, how often."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager

from tunefree_hil.base.errors import BenchError
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.link import Owner
from tunefree_hil.bus.tfhub.owner import Stranger

ID_MASK = 0x1FFFFFFF
MOST_NAMED = 5


@contextmanager
def watched(owner: Owner | None, codec: Codec) -> Iterator[None]:
    """An episode inside fails with 'foreign_commander' (or 'foreign_reporter') when a stranger sends a vehicle's id.

    It counts for nothing then, whether or not its nodes noticed; what they said is the error's cause. A bench without a
    hub of ours (`owner` None) does not know its senders.
    """
    if owner is None:
        yield
        return
    owner.guard(codec.by_id)
    commands = {message.key for message in codec.commands}
    try:
        yield
    except BenchError as error:
        named = error_of(_asked(owner), commands)
        if named is None:
            raise
        raise named from error
    named = error_of(owner.strangers(), commands)
    if named is not None:
        raise named


def _asked(owner: Owner) -> list[Stranger]:
    """What the hub has seen; nothing where it was the hub that failed."""
    try:
        return owner.strangers()
    except BenchError:
        return []


def error_of(found: Sequence[Stranger], commands: Collection[int]) -> BenchError | None:
    """The error that names all strangers, commanders first; None where there is none."""
    if not found:
        return None
    commanding = [one for one in found if one.can_id in commands]
    word = "commander" if commanding else "reporter"
    named = [
        f"foreign {'commander' if one.can_id in commands else 'reporter'} 0x{one.can_id & ID_MASK:03X} "
        f"from member {one.name} (pid {one.pid}), {one.count} {'frame' if one.count == 1 else 'frames'}"
        for one in [*commanding, *(one for one in found if one not in commanding)]
    ]
    more = f"; and {len(named) - MOST_NAMED} more" if len(named) > MOST_NAMED else ""
    return BenchError(
        "; ".join(named[:MOST_NAMED]) + more,
        code=f"foreign_{word}",
        key=(commanding or list(found))[0].name,
        hint="end that process, or give the bench a bus of its own: --session NAME",
    )

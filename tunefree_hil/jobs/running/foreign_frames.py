"""Detect processes that send command frames beside the controller, or reports beside the ECU."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager

from tunefree_hil.base.errors import BenchError
from tunefree_hil.bus.dbc.codec import Codec
from tunefree_hil.bus.tfhub.owner import ForeignSender, Owner

ID_MASK = 0x1FFFFFFF
MAX_NAMED = 5


@contextmanager
def watch_foreign_frames(owner: Owner | None, codec: Codec) -> Iterator[None]:
    """Fail an episode with 'foreign_commander' or 'foreign_reporter' when a foreign process sends a vehicle's id.

    The error of a node, if any, is its cause. Without an own hub (`owner` None) the senders are not known.
    """
    if owner is None:
        yield
        return
    owner.guard(codec.by_id)
    commands = {message.key for message in codec.commands}
    try:
        yield
    except BenchError as error:
        foreign = foreign_frame_error(_foreign_senders(owner), commands)
        if foreign is None:
            raise
        raise foreign from error
    foreign = foreign_frame_error(owner.foreign_senders(), commands)
    if foreign is not None:
        raise foreign


def _foreign_senders(owner: Owner) -> list[ForeignSender]:
    """Foreign senders known to the hub; none where the hub failed."""
    try:
        return owner.foreign_senders()
    except BenchError:
        return []


def foreign_frame_error(senders: Sequence[ForeignSender], commands: Collection[int]) -> BenchError | None:
    """An error that names the foreign senders, commanders first; None where there are none."""
    if not senders:
        return None
    commanding = [one for one in senders if one.can_id in commands]
    word = "commander" if commanding else "reporter"
    named = [
        f"foreign {'commander' if one.can_id in commands else 'reporter'} 0x{one.can_id & ID_MASK:03X} "
        f"from member {one.name} (pid {one.pid}), {one.count} {'frame' if one.count == 1 else 'frames'}"
        for one in [*commanding, *(one for one in senders if one not in commanding)]
    ]
    more = f"; and {len(named) - MAX_NAMED} more" if len(named) > MAX_NAMED else ""
    return BenchError(
        "; ".join(named[:MAX_NAMED]) + more,
        code=f"foreign_{word}",
        key=(commanding or list(senders))[0].name,
        hint="end that process, or give the bench a bus of its own: --session NAME",
    )

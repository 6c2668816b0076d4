"""The folder of a `gap`: which question it is about, what its search came to, and the answer, each written whole.

question.json   what was asked: hashes of logs, vehicle, model, the version; a folder is gone on with for no other
search.json     what the search came to (gap/kept.py): what costs time
gap.json        the answer (interfaces 9), last; gap.md, figures/, model/ are there before it
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil import __version__
from tunefree_hil.base.errors import InputError
from tunefree_hil.gap import kept
from tunefree_hil.jobs.run_folder import read_json, write_json, write_text
from tunefree_hil.learn.write_model import plain, require_new

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec
    from tunefree_hil.gap.kept import Kept
    from tunefree_hil.learn.drives import Drive

QUESTION, SEARCH, ANSWER = "question.json", "search.json", "gap.json"
MODEL, FIGURES, PAGE = "model", "figures", "gap.md"
QUESTION_SCHEMA = "tunefree.gap_question/1"
LOCK = "gap.lock"
UNTIL = ("locate", "name", "repair", "verify")


class Folder(NamedTuple):
    """An output folder that is ours."""

    path: Path

    @property
    def model(self) -> Path:
        """Where the repaired model goes."""
        return self.path / MODEL

    @property
    def figures(self) -> Path:
        """Where pictures go."""
        return self.path / FIGURES

    @property
    def page(self) -> Path:
        """The page for people."""
        return self.path / PAGE

    def search(self, named: bool) -> Kept | None:
        """What the search came to, None where it is still to be done. named: whether names are asked for; a search for
        names has also located.
        """
        path = self.path / SEARCH
        data = read_json(path) if path.is_file() else {}
        if data.get("schema") != kept.SCHEMA:
            return None  # there is none, or one that another version left
        found = kept.from_json(data)
        return found if found.named or not named else None

    def keep(self, found: Kept) -> Kept:
        """Keep what the search came to; the same as whoever goes on later reads it."""
        write_json(self.path / SEARCH, kept.as_json(found))
        return kept.from_json(read_json(self.path / SEARCH))

    def answer(self, until: str) -> dict[str, Any] | None:
        """The answer that is there, None where there is none that goes as far (in the order of UNTIL)."""
        path = self.path / ANSWER
        found = read_json(path) if path.is_file() else None
        return found if found is not None and UNTIL.index(found["until"]) >= UNTIL.index(until) else None

    def write_answer(self, data: Mapping[str, Any]) -> None:
        """The last file of all."""
        write_text(self.path / ANSWER, json.dumps(plain(data), indent=1, allow_nan=False) + "\n")


def require_ours(out: Path) -> None:
    """Raises InputError, before anything is read, for a folder that holds something else."""
    if not (out / QUESTION).is_file() and not (
        out.is_dir() and all(one.name.startswith(LOCK) for one in out.iterdir())
    ):
        require_new(out)


def question_of(
    drives: Sequence[Drive], older: Sequence[Drive], vehicle: VehicleSpec, model: ModelSpec
) -> dict[str, Any]:
    """What an answer depends on."""
    return {
        "schema": QUESTION_SCHEMA,
        "logs": [one.log_hash for one in drives],
        "older": [one.log_hash for one in older],
        "vehicle": f"sha256:{vehicle.hash}",
        "model": f"sha256:{model.hash}",
        "version": __version__,
    }


@contextmanager
def held_folder(out: Path, question: Mapping[str, Any]) -> Iterator[Folder]:
    """The folder of this question, held against other processes. Raises InputError for another question's."""
    from tunefree_hil.tune.store import alone

    out.mkdir(parents=True, exist_ok=True)
    with alone(out / LOCK):
        path = out / QUESTION
        if path.is_file():  # looked at only now: another process may have asked in between
            _require_same(out, read_json(path), question)
        else:
            write_json(path, question)
        yield Folder(out)


def _require_same(out: Path, before: Mapping[str, Any], question: Mapping[str, Any]) -> None:
    changed = [key for key, value in question.items() if before.get(key) != value]
    if changed:
        raise InputError(
            f"it is of another question: {', '.join(changed)} {'is' if len(changed) == 1 else 'are'} not the same",
            code="exists",
            file=str(out),
            key=changed[0],
            hint="choose another folder, or move it",
        )

"""The folder of a `gap`: which question it is about, what its search came to, and the answer, each written whole.

question.json   what was asked: hashes of logs, vehicle, model and its card, effects, the version; a folder that holds
                more than this is gone on with for no other
search.json     what the search came to (gap/result.py): what costs time
gap.json        the answer (interfaces 9), last; gap.md, figures/, model/ are there before it
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from tunefree_hil import __version__
from tunefree_hil.base.errors import InputError
from tunefree_hil.gap import result
from tunefree_hil.jobs.run_folder import read_json, write_json, write_text
from tunefree_hil.learn.model_folder import plain, require_new

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec
    from tunefree_hil.gap.result import Kept
    from tunefree_hil.learn.drives.drive import Drive

QUESTION, SEARCH, ANSWER = "question.json", "search.json", "gap.json"
MODEL, FIGURES, PAGE = "model", "figures", "gap.md"
QUESTION_SCHEMA, ANSWER_SCHEMA = "tunefree.gap_question/1", "tunefree.gap/1"
LOCK = "gap.lock"
WHOLE = {"verdict", "sentence", "model", "figures"}  # what no answer goes without
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
        try:
            found = result.from_json(_said_in(self.path / SEARCH))
        except ValueError:
            return None  # there is none, or one that another version or somebody's hand left
        return found if found.named or not named else None

    def keep(self, found: Kept) -> Kept:
        """Keep what the search came to; the same as whoever goes on later reads it."""
        write_json(self.path / SEARCH, result.as_json(found))
        return result.from_json(read_json(self.path / SEARCH))

    def answer(self, until: str) -> dict[str, Any] | None:
        """The answer that is there, with the paths that its files have now; None where there is none that goes as far
        (in the order of UNTIL).
        """
        found = _said_in(self.path / ANSWER)
        is_one = found.get("schema") == ANSWER_SCHEMA and found.keys() >= WHOLE and found.get("until") in UNTIL
        if not is_one or UNTIL.index(found["until"]) < UNTIL.index(until):
            return None
        if found["model"]:
            found["model"] = str(self._here(found["model"], 1).resolve())  # as whoever loads it says it
        found["figures"] = [str(self._here(one, 2)) for one in found["figures"]]
        for one in found.get("drives", ()):
            one["log"] = str(self._here(one["log"], 3))
        return found

    def _here(self, said: str, deep: int) -> Path:
        """Where a file of an answer lies in this folder, `deep` parts below it or below one of its rounds: the folder
        may have been moved since.
        """
        parts = Path(said).parts
        in_round = self.path.joinpath(*parts[-deep - 1 :])
        return in_round if in_round.exists() else self.path.joinpath(*parts[-deep:])

    def write_answer(self, data: Mapping[str, Any]) -> None:
        """The last file of all."""
        write_text(self.path / ANSWER, json.dumps(plain(data), indent=1, allow_nan=False) + "\n")


def _said_in(path: Path) -> dict[str, Any]:
    """The table in a file; an empty one where there is no file, or no JSON in it: both are made again."""
    try:
        return read_json(path) if path.is_file() else {}
    except InputError:
        return {}


def require_ours(out: Path) -> None:
    """Raises InputError, before anything is read, for a folder that holds something else."""
    if not (out / QUESTION).is_file() and not (out.is_dir() and _is_bare(out)):
        require_new(out)


def question_of(
    drives: Sequence[Drive], older: Sequence[Drive], vehicle: VehicleSpec, model: ModelSpec
) -> dict[str, Any]:
    """What an answer depends on."""
    card = Path(model.folder) / model.plant.card
    said = {"card": f"sha256:{hashlib.sha256(card.read_bytes()).hexdigest()}"} if card.is_file() else {}
    return said | {
        "schema": QUESTION_SCHEMA,
        "logs": [one.log_hash for one in drives],
        "older": [one.log_hash for one in older],
        "vehicle": f"sha256:{vehicle.hash}",
        "model": f"sha256:{model.hash}",
        "effects": f"sha256:{_sources_hash(model)}",
        "version": __version__,
    }


def _sources_hash(model: ModelSpec) -> str:
    """Of the catalogue's files and of those of the user's own that the model names: who is suspected is part of what
    is asked, and a file more is one more.
    """
    import tunefree_hil.effects

    named = (model.plant.kind, *(one.name for one in model.effects))
    own = {Path(name.rpartition(":")[0]) for name in named if ":" in name}
    catalogue = Path(tunefree_hil.effects.__file__).parent.glob("*.py")
    digest = hashlib.sha256()
    for file in (*sorted(catalogue), *sorted(own)):
        digest.update(file.name.encode() + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


@contextmanager
def held_folder(out: Path, question: Mapping[str, Any]) -> Iterator[Folder]:
    """The folder of this question, held against other processes. Raises InputError for another question's; one that
    came to nothing has left nothing that another could be mixed up with.
    """
    from tunefree_hil.tune.store import alone

    out.mkdir(parents=True, exist_ok=True)
    with alone(out / LOCK):
        path = out / QUESTION
        if path.is_file() and not _is_bare(out):  # looked at only now: another process may have asked in between
            _require_same(out, read_json(path), question)
        else:
            write_json(path, question)
        yield Folder(out)


def _is_bare(out: Path) -> bool:
    """Whether a folder holds a question and nothing that was found."""
    return all(one.name.startswith((QUESTION, LOCK)) for one in out.iterdir())


def _require_same(out: Path, before: Mapping[str, Any], question: Mapping[str, Any]) -> None:
    changed = [key for key in {**question, **before} if before.get(key) != question.get(key)]
    if changed:
        raise InputError(
            f"it is of another question: {', '.join(changed)} {'is' if len(changed) == 1 else 'are'} not the same",
            code="exists",
            file=str(out),
            key=changed[0],
            hint="choose another folder, or move it",
        )

"""The folder of a `gap`: the question, the result of the search, and the answer, each written in one piece.

question.json   the inputs: hashes of logs, vehicle, model and its card, effects, and the version; a folder that holds
                results is continued for the same question only
search.json     the result of the search (gap/result.py), which takes most of the time
gap.json        the answer (docs/reference/files.md), written last, after gap.md, figures/ and model/
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
from tunefree_hil.jobs.gap.options import STEPS
from tunefree_hil.jobs.run_folder import read_json, write_json, write_text
from tunefree_hil.learn.model_folder import plain_data, require_new_folder

if TYPE_CHECKING:
    from tunefree_hil.config.schema import ModelSpec, VehicleSpec
    from tunefree_hil.gap.result import SearchResult
    from tunefree_hil.learn.drives.drive import Drive

QUESTION, SEARCH, ANSWER = "question.json", "search.json", "gap.json"
MODEL, FIGURES, PAGE = "model", "figures", "gap.md"
QUESTION_SCHEMA, ANSWER_SCHEMA = "tunefree.gap_question/1", "tunefree.gap/1"
LOCK = "gap.lock"
REQUIRED_KEYS = {"verdict", "sentence", "model", "figures"}  # of every answer


class GapFolder(NamedTuple):
    """An output folder of `gap`."""

    path: Path

    @property
    def model(self) -> Path:
        """Folder of the repaired model."""
        return self.path / MODEL

    @property
    def figures(self) -> Path:
        """Folder of the figures."""
        return self.path / FIGURES

    @property
    def page(self) -> Path:
        """The page gap.md."""
        return self.path / PAGE

    def load_search(self, named: bool) -> SearchResult | None:
        """The stored result of the search; None where it has to be made.

        Args:
            named: Whether effects are wanted. A search for effects has the location, too.
        """
        try:
            search = result.from_json(_read_table(self.path / SEARCH))
        except ValueError:
            return None  # absent, of another version, or edited
        return search if search.has_candidates or not named else None

    def store_search(self, search: SearchResult) -> SearchResult:
        """Store the result of a search. Returns: the same as it is read when a run continues."""
        write_json(self.path / SEARCH, result.as_json(search))
        return result.from_json(read_json(self.path / SEARCH))

    def load_answer(self, until: str) -> dict[str, Any] | None:
        """The stored answer, with the current paths of its files.

        Args:
            until: The step (of STEPS) that the answer must have reached.

        Returns:
            None where there is no answer, or one that stopped earlier.
        """
        answer = _read_table(self.path / ANSWER)
        is_complete = answer.get("schema") == ANSWER_SCHEMA and answer.keys() >= REQUIRED_KEYS
        if not is_complete or answer.get("until") not in STEPS or STEPS.index(answer["until"]) < STEPS.index(until):
            return None
        if answer["model"]:
            answer["model"] = str(self._locate(answer["model"], 1).resolve())  # as ModelSpec.folder has it
        answer["figures"] = [str(self._locate(figure, 2)) for figure in answer["figures"]]
        for drive in answer.get("drives", ()):
            drive["log"] = str(self._locate(drive["log"], 3))
        return answer

    def _locate(self, written: str, depth: int) -> Path:
        """Where a file of an answer lies now, `depth` parts below this folder or below one of its rounds: the folder
        may have been moved since.
        """
        parts = Path(written).parts
        in_round = self.path.joinpath(*parts[-depth - 1 :])
        return in_round if in_round.exists() else self.path.joinpath(*parts[-depth:])

    def write_answer(self, data: Mapping[str, Any]) -> None:
        """Write gap.json."""
        write_text(self.path / ANSWER, json.dumps(plain_data(data), indent=1, allow_nan=False) + "\n")


def _read_table(path: Path) -> dict[str, Any]:
    """The table in a JSON file; empty where the file is absent or not JSON."""
    try:
        return read_json(path) if path.is_file() else {}
    except InputError:
        return {}


def require_gap_folder(out: Path) -> None:
    """Raise InputError for a folder that holds something else."""
    if not (out / QUESTION).is_file() and not (out.is_dir() and _is_empty(out)):
        require_new_folder(out)


def question_record(
    drives: Sequence[Drive], older: Sequence[Drive], vehicle: VehicleSpec, model: ModelSpec
) -> dict[str, Any]:
    """Content of question.json: everything that an answer depends on."""
    card = Path(model.folder) / model.plant.card
    card_hash = {"card": f"sha256:{hashlib.sha256(card.read_bytes()).hexdigest()}"} if card.is_file() else {}
    return card_hash | {
        "schema": QUESTION_SCHEMA,
        "logs": [drive.log_hash for drive in drives],
        "older": [drive.log_hash for drive in older],
        "vehicle": f"sha256:{vehicle.hash}",
        "model": f"sha256:{model.hash}",
        "effects": f"sha256:{_sources_hash(model)}",
        "version": __version__,
    }


def _sources_hash(model: ModelSpec) -> str:
    """Hash of the source files of all candidates: the catalogue, and the user's effects that the model names."""
    import tunefree_hil.effects

    named = (model.plant.kind, *(effect.name for effect in model.effects))
    user_files = {Path(name.rpartition(":")[0]) for name in named if ":" in name}
    catalogue = Path(tunefree_hil.effects.__file__).parent.glob("*.py")
    digest = hashlib.sha256()
    for file in (*sorted(catalogue), *sorted(user_files)):
        digest.update(file.name.encode() + hashlib.sha256(file.read_bytes()).digest())
    return digest.hexdigest()


@contextmanager
def lock_folder(out: Path, question: Mapping[str, Any]) -> Iterator[GapFolder]:
    """Lock the folder of this question against other processes.

    Raises:
        InputError: The folder holds results of another question.
    """
    from tunefree_hil.tune.store import exclusive_lock

    out.mkdir(parents=True, exist_ok=True)
    with exclusive_lock(out / LOCK):
        path = out / QUESTION
        if path.is_file() and not _is_empty(out):  # read under the lock: another process may have written it
            _require_same(out, read_json(path), question)
        else:
            write_json(path, question)
        yield GapFolder(out)


def _is_empty(out: Path) -> bool:
    """Whether a folder holds a question and no results."""
    return all(file.name.startswith((QUESTION, LOCK)) for file in out.iterdir())


def _require_same(out: Path, before: Mapping[str, Any], question: Mapping[str, Any]) -> None:
    changed = [key for key in {**question, **before} if before.get(key) != question.get(key)]
    if changed:
        verb = "differs" if len(changed) == 1 else "differ"
        raise InputError(
            f"holds the answer to another question: {', '.join(changed)} {verb}",
            code="exists",
            file=str(out),
            key=changed[0],
            hint="choose another folder, or move it",
        )

"""Finds a named vehicle, model, scenario, weights or bench file: beside the bench file, here, in the checkout."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from tunefree_hil.base.errors import InputError

CHECKOUT = Path(__file__).resolve().parents[2]


class Kind(NamedTuple):
    """A kind of file: its name in messages, the checkout's folder, and the file in a folder of its own ('' = none)."""

    word: str
    folder: str
    inside: str


KINDS = {
    "vehicle": Kind("vehicle", "dbc", "vehicle.toml"),
    "model": Kind("model", "bench_configs/models", "model.toml"),
    "scenario": Kind("scenario", "bench_configs/scenarios", ""),
    "weights": Kind("weights", "bench_configs/weights", ""),
    "bench": Kind("bench file", "bench_configs", ""),
}


def find(kind: str, name: str | Path, near: str | Path | None = None) -> Path:
    """The TOML file that `name` means: an explicit path (of the file or its folder), or a name.

    A name is looked for beside `near` (the bench file or its folder), in the working directory and in the checkout, as
    `name`, `name.toml` or, for what has a folder of its own, `name/vehicle.toml`. Raises InputError that lists the
    existing ones.
    """
    for place in places(kind, near):
        for candidate in _candidates(KINDS[kind], place / _at_home(Path(name))):
            if _is_file(candidate):
                return candidate.resolve()
    raise _miss(kind, str(name), near)


def places(kind: str, near: str | Path | None = None) -> list[Path]:
    """The folders that are looked into, in order; each also under the checkout's name of the kind's folder."""
    folder = KINDS[kind].folder
    roots = [_folder(Path(near))] if near is not None else []
    paths: list[Path] = []
    for root in [*roots, Path.cwd(), CHECKOUT]:
        paths += [place for place in (root, root / folder, root / Path(folder).name) if place not in paths]
    return paths


def _folder(near: Path) -> Path:
    return near.parent if near.is_file() else near


def _candidates(kind: Kind, path: Path) -> list[Path]:
    if kind.inside:
        return [path / kind.inside, path]
    return [path, path.parent / f"{path.name}.toml"]  # "/" has no name that with_name could change


def _at_home(path: Path) -> Path:
    """'~' as the home folder; that of an unknown user stays as it is written, and is not found."""
    try:
        return path.expanduser()
    except RuntimeError:
        return path


def _is_file(path: Path) -> bool:
    """Whether a file is there. One that no system could name (too long, a zero byte), or let us see, is not."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def available(kind: str, near: str | Path | None = None) -> list[str]:
    """The names of this kind in the folders that are looked into."""
    kind_name = KINDS[kind]
    names: set[str] = set()
    for place in places(kind, near):
        if place.name != Path(kind_name.folder).name or not place.is_dir():
            continue
        if kind_name.inside:
            names |= {found.parent.name for found in place.glob(f"*/{kind_name.inside}")}
        else:
            names |= {found.stem for found in place.glob("*.toml")}
    return sorted(names)


def nearest(name: str, known: Iterable[str]) -> str:
    """A hint: the name that was probably meant, or all known ones."""
    known = sorted(known)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"did you mean {close[0]}?" if close else f"there are {', '.join(known) or 'none'}"


def _miss(kind: str, name: str, near: str | Path | None) -> InputError:
    word = KINDS[kind].word
    known = available(kind, near)
    listed = ", ".join(known) or "none"
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    meant = f"did you mean {close[0]}? Else give" if close else "give"
    return InputError(
        f"there is no {word} {name!r}; there are {listed}",
        code=f"unknown_{kind}",
        key=kind,
        hint=f"{meant} the path of the {'folder' if KINDS[kind].inside else 'file'}",
    )

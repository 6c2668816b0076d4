"""No global state, no import before it is needed, whole files only."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunefree_hil.figures import style

MODULES = ("style", "scenario", "tuning.history", "tuning.scatter", "jitter", "bars")


def test_importing_the_figures_imports_no_matplotlib() -> None:
    lines = [f"import tunefree_hil.figures.{name}" for name in MODULES]
    lines += ["import sys", "assert 'matplotlib' not in sys.modules"]
    lines += ["from tunefree_hil.figures import bars", "bars.draw_bars({'tuned': {'a': 1.0}}).canvas.draw()"]
    lines += ["assert 'matplotlib' in sys.modules and 'matplotlib.pyplot' not in sys.modules"]
    ran = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr


def test_a_picture_appears_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "figures" / "a.png"
    assert style.save(style.new_figure(2.0, 1.0), path) == path
    before = path.read_bytes()
    assert before.startswith(b"\x89PNG")
    figure = style.new_figure(4.0, 2.0)

    def full_disk(part: Path, **_: object) -> None:
        part.write_bytes(b"\x89PNG half")
        raise OSError("no space left")

    monkeypatch.setattr(figure, "savefig", full_disk)
    with pytest.raises(OSError, match="no space"):
        style.save(figure, path)
    assert path.read_bytes() == before


def test_manual_and_tuned_keep_their_looks() -> None:
    found = style.looks(["as shipped", "tuned, seed 1", "manual, MRAC on", "rule-based"])
    assert found["tuned, seed 1"] == style.TUNED
    assert found["manual, MRAC on"] == style.MANUAL
    assert len({look.colour for look in found.values()}) == 4
    assert len({look.marker for look in found.values()}) == 4


def test_colours_can_be_told_apart_without_colour() -> None:
    """Manual and tuned differ in lightness as well (relative luminance, sRGB weights)."""

    def luminance(look: style.Look) -> float:
        red, green, blue = (int(look.colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
        return 0.2126 * red**2.2 + 0.7152 * green**2.2 + 0.0722 * blue**2.2

    assert (luminance(style.MANUAL) + 0.05) / (luminance(style.TUNED) + 0.05) > 1.3
    assert style.MANUAL.dash != style.TUNED.dash


@given(value=st.floats(-1e12, 1e12))
def test_numbers_are_short_and_right(value: float) -> None:
    text = style.number(value)
    assert len(text) <= 9
    assert float(text) == pytest.approx(value, rel=0.06)


def test_numbers_as_a_person_writes_them() -> None:
    texts = [style.number(value) for value in (0.0, 1e-4, 2.5e-5, 0.05, 0.26, 10.0, 1234.0, 123456.0)]
    assert texts == ["0", "1e-4", "2.5e-5", "0.05", "0.26", "10", "1234", "1.2e5"]

"""Each format in turn; skipped where its extra is not installed."""

from __future__ import annotations

import pytest

from tunefree_hil.base.errors import InputError
from tunefree_hil.bus.formats.find import PLACES, load_format
from tunefree_hil.bus.formats.rows import Format


@pytest.fixture(scope="module", params=tuple(PLACES))
def form(request: pytest.FixtureRequest) -> Format:
    try:
        return load_format(request.param)
    except InputError as error:
        pytest.skip(str(error))

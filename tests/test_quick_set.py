"""The quick set leaves out what `SLOW` names, and that is still there under its name."""

from __future__ import annotations

import pytest

from tests.conftest import REPOSITORY, SLOW


@pytest.mark.parametrize("name", SLOW)
def test_what_is_slow_is_there(name: str) -> None:
    path, _, function = name.partition("::")
    assert (REPOSITORY / path).exists()
    assert not function or f"def {function.split('[')[0]}" in (REPOSITORY / path).read_text(encoding="utf-8")


def test_nothing_slow_is_in_it(pytestconfig: pytest.Config, request: pytest.FixtureRequest) -> None:
    if pytestconfig.option.markexpr != "not slow":
        assert request.session.items
        return
    assert not [item.nodeid for item in request.session.items if item.nodeid.startswith(SLOW)]

"""The quick set leaves out what `SLOW` names, and that is still there under its name."""

from __future__ import annotations

import pytest

from tests.conftest import REPOSITORY, SLOW, WEEKLY


@pytest.mark.parametrize("name", [*SLOW, *WEEKLY])
def test_what_is_slow_is_there(name: str) -> None:
    path, _, function = name.partition("::")
    assert (REPOSITORY / path).exists()
    assert not function or f"def {function.split('[')[0]}" in (REPOSITORY / path).read_text(encoding="utf-8")


@pytest.mark.parametrize("name", WEEKLY)
def test_what_is_left_for_once_a_week_is_slow_and_has_a_sibling_in_ci(name: str) -> None:
    assert name.startswith(SLOW)
    path, _, function = name.partition("::")
    others = [one for one in WEEKLY if one.startswith(f"{path}::")]
    text = (REPOSITORY / path).read_text(encoding="utf-8")
    assert "[" in function or text.count("\ndef test_") > len(others)


def test_nothing_slow_is_in_it(pytestconfig: pytest.Config, request: pytest.FixtureRequest) -> None:
    if pytestconfig.option.markexpr != "not slow":
        assert request.session.items
        return
    assert not [item.nodeid for item in request.session.items if item.nodeid.startswith(SLOW)]

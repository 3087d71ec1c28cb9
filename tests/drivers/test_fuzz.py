"""Mutated files of every format: an answer or an error of ours, in time. A million: `tests.bench.bench_fuzz`."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.drivers.fuzz import ENDINGS, finding, mutated, warm_up

MUTATIONS = 20_000
QUICK = 4_000  # of them in the quick set
AT_ONCE = 20  # mutations a draw: drawing costs as much as reading
SLOWER = {"text": 8}  # what is read twice, and takes so many times as long, gets so many fewer


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the mutated files go; the corpus itself has been read in it."""
    path = tmp_path_factory.mktemp("fuzz")
    warm_up(path)
    return path


@pytest.mark.flaky(reruns=1)  # memory is that of the process, in which what tests before left may still work
@pytest.mark.parametrize("kind", ENDINGS)
def test_mutated(kind: str, folder: Path, pytestconfig: pytest.Config) -> None:
    count = (QUICK if pytestconfig.option.markexpr == "not slow" else MUTATIONS) // SLOWER.get(kind, 1)

    @settings(max_examples=max(1, count // len(ENDINGS) // AT_ONCE), deadline=None, database=None, derandomize=True)
    @given(st.integers(0, 1 << 40))
    def read(first: int) -> None:
        for number in range(first, first + AT_ONCE):
            assert finding(kind, mutated(kind, number), folder) == "", f"mutation {number} of {kind}"

    read()

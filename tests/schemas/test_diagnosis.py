"""Words of the diagnosis document."""

import pytest

from schemas.diagnosis import named_joints


@pytest.mark.parametrize(
    ("joints", "said"), [([], ""), ([2], "joint 2"), ([1, 3], "joints 1 and 3"), ([1, 2, 3], "joints 1, 2 and 3")]
)
def test_joints_are_listed_in_words(joints: list[int], said: str) -> None:
    assert named_joints(joints) == said

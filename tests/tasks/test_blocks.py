from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.blocks import FACES, GAP, MAX_TOP, Block, _mesh, sample_field


def number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_nan=False)


blocks = st.builds(
    Block,
    x=number(-5, 5),
    y=number(-5, 5),
    yaw=number(0, 360),
    length=number(1, 4),
    width=number(1, 4),
    height=number(1.8, 3),
    incline=number(0, 35),
    color=st.sampled_from(["red", "gray"]),
)


@given(blocks)
def test_the_tops_normal_has_the_stated_angle(block: Block) -> None:
    a, b, c = block.vertices[list(FACES[-1][:3])]
    normal = np.cross(b - a, c - b)
    assert np.degrees(np.arccos(normal[2] / np.linalg.norm(normal))) == pytest.approx(block.incline, abs=1e-4)


@given(blocks)
def test_faces_look_outwards(block: Block) -> None:
    vertices, triangles, normals = _mesh(block)
    middle = block.vertices.mean(0)
    for triangle in triangles:
        a, b, c = vertices[triangle].astype(float)
        assert np.cross(b - a, c - b) @ ((a + b + c) / 3 - middle) > 0
        assert normals[triangle[0]] @ ((a + b + c) / 3 - middle) > 0


@given(blocks, number(-9, 9), number(-9, 9))
def test_distance_is_that_to_the_nearest_point_of_the_outline(block: Block, x: float, y: float) -> None:
    corners = block.footprint
    ends = np.roll(corners, -1, axis=0)
    along = np.clip(((np.array([x, y]) - corners) * (ends - corners)).sum(1) / ((ends - corners) ** 2).sum(1), 0, 1)
    outline = np.linalg.norm(corners + along[:, None] * (ends - corners) - (x, y), axis=1).min()
    left_of_all = np.cross(np.c_[ends - corners, np.zeros(4)], np.c_[(x, y) - corners, np.zeros(4)])[:, 2].min() >= 0
    assert block.distance(np.array([[x, y]]))[0] == pytest.approx(-outline if left_of_all else outline, abs=1e-9)


def test_fields_keep_their_promises() -> None:
    for seed in range(20):
        field = sample_field(np.random.RandomState(seed), 20.0, 40, (8, 35), 0.5, (0.85, 1.1))
        assert field == sample_field(np.random.RandomState(seed), 20.0, 40, (8, 35), 0.5, (0.85, 1.1))
        for i, block in enumerate(field):
            assert block.vertices[:, 2].max() <= MAX_TOP + 1e-9
            assert block.vertices[4:, 2].min() > 0.3
            assert block.incline == 0 or 8 <= block.incline <= 35
            for other in field[:i]:
                assert other.distance(block.footprint).min() > GAP
    assert {block.color for block in field} == {"green", "red", "blue", "gray"}
    assert {block.kind for block in field} == {"flat block", "inclined block"}


def test_flatness_turns_at_five_degrees() -> None:
    assert Block(0, 0, 0, 2, 2, 1, 5.0, "red").name == "red flat block"
    assert Block(0, 0, 0, 2, 2, 1, 5.1, "red").name == "red inclined block"


def test_plain_values_make_the_same_block() -> None:
    block = Block(1, 2, 30, 3, 2, 1.5, 12, "blue", 0.9)
    assert Block(**block.to_dict()) == block

"""A decision's numbers hold for any number of components, and its words say what the numbers say."""

from __future__ import annotations

import itertools
import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from tensordict import TensorDict

from xqmap.errors import UserError
from xqmap.explanations import Candidate, Decision, contrast
from xqmap.explanations.candidate import label
from xqmap.explanations.scene import Scene
from xqmap.explanations.views import plots
from xqmap.explanations.views.words import listed, number, signed

VALUE = st.floats(-2, 2, allow_nan=False).map(lambda v: round(v, 3))


@st.composite
def decisions(draw: st.DrawFn, most: int = 8) -> Decision:
    count = draw(st.integers(1, most))
    names = tuple(f"part{k}" for k in range(count))
    rows = [draw(st.lists(VALUE, min_size=count, max_size=count)) for _ in range(count + 1)]
    rows[0] = max(rows, key=sum)
    candidates = [
        Candidate(
            "Selected" if i == 0 else label(i - 1), f"thing {i}", dict(zip(names, row, strict=True)), (i, i), None, i
        )
        for i, row in enumerate(rows)
    ]
    return Decision("toy", names, candidates, noise={})


def made(**values: tuple[float, ...]) -> Decision:
    """A decision over (flatness, color) of the landing task: label → values."""
    names = ("flatness", "color")
    things = {"Selected": "blue flat block", "A": "gray flat block", "B": "red inclined block"}
    return Decision(
        "landing",
        names,
        [
            Candidate(k, things[k], dict(zip(names, v, strict=True)), (i, i), None, i)
            for i, (k, v) in enumerate(values.items())
        ],
    )


@given(decisions())
def test_bars_sum_to_the_overall_value_and_rdx_to_the_gap(decision: Decision) -> None:
    for candidate in decision.candidates:
        assert candidate.overall == pytest.approx(sum(candidate.values[name] for name in decision.components))
    for a, b in decision.pairs:
        assert sum(decision.rdx(a, b).values()) == pytest.approx(decision[a].overall - decision[b].overall, abs=1e-9)
    assert len(decision.pairs) == math.comb(len(decision.candidates), 2)


@given(st.dictionaries(st.sampled_from("abcdefgh"), VALUE, min_size=1))
def test_msx_is_the_smallest_set_that_suffices(delta: dict[str, float]) -> None:
    total = sum(delta.values())
    plus, minus = contrast.msx(delta)
    positive, against = [n for n in delta if delta[n] > 0], -sum(v for v in delta.values() if v < 0)
    if total <= 1e-9:
        return
    assert set(plus) <= set(positive)
    assert sum(delta[n] for n in plus) > against
    smaller = itertools.combinations(positive, len(plus) - 1)
    assert all(sum(delta[n] for n in subset) <= against + 1e-12 for subset in smaller) or (
        against == 0 and len(plus) == 1
    )
    if against == 0:
        assert (len(plus), minus) == (1, [])
    else:
        needed = sum(delta[n] for n in plus) - min(delta[n] for n in plus)
        assert sum(-delta[n] for n in minus) >= needed - 1e-12
        assert all(delta[n] < 0 for n in minus)


def test_msx_breaks_ties_by_component_order() -> None:
    assert contrast.msx({"a": 0.5, "b": 0.5, "c": -0.4}) == (["a"], [])
    assert contrast.msx({"a": 0.5, "b": 0.5, "c": -0.3, "d": -0.4}) == (["a", "b"], ["d", "c"])


@given(st.dictionaries(st.sampled_from("abcd"), VALUE, min_size=1))
def test_at_its_flip_point_a_weight_makes_the_two_even(delta: dict[str, float]) -> None:
    for name, weight in contrast.flip_points(delta).items():
        assert weight >= 0
        total = sum((weight if n == name else 1) * value for n, value in delta.items())
        assert total == pytest.approx(0, abs=1e-6 * max(1, weight))


@given(st.dictionaries(st.sampled_from("abcd"), VALUE, min_size=1))
def test_flip_distance_is_the_length_of_the_smallest_joint_change(delta: dict[str, float]) -> None:
    norm = math.hypot(*delta.values())
    if norm < 1e-6:
        return
    total = sum(delta.values())
    change = {n: -total * v / norm**2 for n, v in delta.items()}
    assert sum((1 + change[n]) * v for n, v in delta.items()) == pytest.approx(0, abs=1e-9)
    assert math.hypot(*change.values()) == pytest.approx(abs(contrast.flip_distance(delta)))


@given(decisions())
@settings(max_examples=60)
def test_every_number_in_a_sentence_is_one_of_the_decisions(decision: Decision) -> None:
    said = decision.sentences()
    known = {number(c.overall) for c in decision.candidates} | {
        number(v) for c in decision.candidates for v in c.values.values()
    }
    for a, b in itertools.permutations([c.label for c in decision.candidates], 2):
        delta = decision.rdx(a, b)
        known |= {signed(v) for v in delta.values()} | {number(abs(sum(delta.values())))}
        known |= {number(w) for w in contrast.flip_points(delta).values()}
        if math.isfinite(contrast.flip_distance(delta)):
            known.add(number(contrast.flip_distance(delta)))
    for sentence in (said["shallow"], *said["contrastive"], said["robustness"]):
        for found in re.findall(r"[+-]?\d+\.\d+", sentence):
            assert found in known, (found, sentence)
        assert "{" not in sentence
        assert sentence[0].isupper() and sentence.endswith("."), sentence


@given(decisions())
@settings(max_examples=30)
def test_what_is_saved_is_read_back(decision: Decision) -> None:
    from xqmap.explanations.reading import parse

    again = Decision(**parse(json.loads(json.dumps(decision.to_dict())), "memory"))
    assert again.to_dict() == decision.to_dict()


def test_sentences_read_like_sentences() -> None:
    said = made(Selected=(0.9, 1.0), A=(1.0, 0.0), B=(0.1, 1.05)).sentences()
    assert said["shallow"] == (
        "I chose to land on the blue flat block: its overall value, 1.90, is the highest. Color contributes most "
        "(1.00)."
    )
    assert said["contrastive"][0] == (
        "I chose to land on the blue flat block rather than the gray flat block (A), because color speaks for it "
        "(+1.00), though "
        "flatness speaks against it (-0.10). If color counted 0.10 times as much, the gray flat block would be just "
        "as good."
    )
    both = made(Selected=(0.9, 1.0), A=(0.5, 0.5), B=(0.9, 1.0)).sentences()["contrastive"]
    assert "because color and flatness speak for it (+0.50 and +0.40)" in both[0]
    assert both[1].startswith("The blue flat block and the red inclined block (B) have the same overall value")


def test_honest_sentences() -> None:
    decision = made(Selected=(0.9, 1.0), A=(0.85, 1.0), B=(0.0, 0.0))
    decision.noise = {"flatness": 0.1, "color": 0.1}
    said = decision.sentences()
    assert "toss-up" in said["contrastive"][0]
    assert "closely followed by flatness (0.90)" in said["shallow"]
    decision.candidates[1].object_index = 0
    assert decision.sentences()["contrastive"][0] == (
        "The best spot for flatness (A) lies on the same object, the blue flat block: flatness agrees with my choice."
    )
    decision.candidates[2].object_index, decision.candidates[1].object = 0, "blue flat block"
    assert decision.sentences()["contrastive"][0].startswith(
        "The best spots for flatness (A) and color (B) lie on the same object"
    )
    for candidate in decision.candidates:
        candidate.pixel = (0, 0)
    assert "are the very spot I chose to land on" in decision.sentences()["contrastive"][0]


def test_the_best_other_object_is_spoken_of_where_all_agree_and_where_it_is_close() -> None:
    decision = made(Selected=(1.0, 1.0), A=(0.5, 0.0))
    decision.objects = [
        Candidate("green flat block", "green flat block", {"flatness": 0.98, "color": 1.0}, (5, 5), None, 7)
    ]
    assert len(decision.sentences()["contrastive"]) == 1
    decision.noise = {"flatness": 0.1}
    assert "the green flat block differ by 0.02" in decision.sentences()["contrastive"][1]
    decision.candidates[1].object_index = 0
    decision.noise = {}
    assert (
        "rather than the green flat block, because flatness speaks for it (+0.02)"
        in decision.sentences()["contrastive"][1]
    )


def test_things_of_the_same_name_are_told_apart() -> None:
    decision = made(Selected=(1.0, 1.0), A=(0.5, 0.0), B=(0.0, 0.5))
    decision.candidates[1].object = "blue flat block"
    assert "rather than another blue flat block (A), because" in decision.sentences()["contrastive"][0]
    for candidate in decision.candidates:
        candidate.object, candidate.object_index = "ground", None
    assert "the ground rather than another spot of the ground (A)" in decision.sentences()["contrastive"][0]


def test_a_file_whose_selected_candidate_is_not_the_best_is_not_praised() -> None:
    said = made(Selected=(0.5, 0.0), A=(1.0, 0.0), B=(0.0, 1.2)).sentences()
    assert said["shallow"] == (
        "I chose to land on the blue flat block, although its overall value, 0.50, is not the highest: the gray flat "
        "block (A) and "
        "the red inclined block (B) would be better."
    )
    assert said["contrastive"][1] == (
        "By these values the red inclined block (B) would be better than the blue flat block by 0.70: color speaks "
        "against my choice "
        "(-1.20), though flatness speaks for it (+0.50)."
    )


def test_one_map_for_the_whole_reward_claims_no_property() -> None:
    things = [
        Candidate("Selected", "blue flat block", {"reward": 1.9}, (0, 0), None, 0),
        Candidate("A", "blue flat block", {"reward": 1.9}, (0, 0), None, 0),
    ]
    decision = Decision("landing", ("reward",), things)
    decision.objects = [things[0], Candidate("ground", "ground", {"reward": 1.0}, (3, 3), None, None)]
    said = decision.sentences()
    assert "cannot say which property earned it" in said["shallow"]
    assert said["contrastive"] == [
        "I chose to land on the blue flat block rather than the ground, because its value is 0.90 higher. Through "
        "which property, one "
        "Q-Map for the whole reward cannot say."
    ]
    assert not any(word in str(said) for word in ("flatness", "color"))


def test_many_components_say_what_would_have_been_enough() -> None:
    names = ("size", "weight", "texture")
    rows = {"Selected": (1.0, 0.6, 0.0), "A": (0.3, 0.3, 0.4), "B": (0.9, 0.1, 0.9)}
    things = [
        Candidate(k, f"crate {k}", dict(zip(names, v, strict=True)), (i, i), None, i)
        for i, (k, v) in enumerate(rows.items())
    ]
    said = Decision("toy", names, things).sentences()["contrastive"]
    assert "On its own, size outweighs everything that speaks against it." in said[0]
    things[1].values = {"size": 0.7, "weight": 0.3, "texture": 0.4}
    said = Decision("toy", names, things).sentences()["contrastive"]
    assert "Were one of them missing, texture would tip the balance." in said[0]


def test_lists_and_labels() -> None:
    assert [listed(list("abc")[:n], {"and": "and"}) for n in (1, 2, 3)] == ["a", "a and b", "a, b and c"]
    assert [label(k) for k in (0, 1, 25, 26, 51, 52)] == ["A", "B", "Z", "AA", "AZ", "BA"]
    assert (number(-0.001), signed(0.001), signed(-0.5), signed(0.5)) == ("0.00", "0.00", "-0.50", "+0.50")


class Policy:
    """A policy that has fixed maps."""

    def __init__(self, maps: torch.Tensor, weights: torch.Tensor) -> None:
        self.maps, self.qmaps = maps, type("Weights", (), {"weights": weights})()

    def __call__(self, td: TensorDict) -> TensorDict:
        total = (self.maps * self.qmaps.weights[:, None]).sum(0).masked_fill(~td["action_mask"], -torch.inf)
        return td.update({"component_action_value": self.maps, "action": total.argmax()})


def small_scene() -> tuple[TensorDict, Scene]:
    image = torch.rand(4, 6, 5) + 0.1
    image[:3] *= 200
    mask = torch.ones(30, dtype=torch.bool)
    mask[7] = False
    cells = np.full((6, 5), -1)
    cells[0:2, 0:3], cells[3:5, 2:4] = 0, 1
    scene = Scene(["red cube", "blue bowl"], cells, "table", [(0, 0.5), (0, 0.6), (0, 1)], image[3].numpy())
    return TensorDict({"heightmap": image, "action_mask": mask}), scene


@given(st.integers(1, 5), st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_candidates_are_the_argmaxima_of_allowed_cells(count: int, seed: int) -> None:
    torch.manual_seed(seed)
    state, scene = small_scene()
    maps, weights = torch.rand(count, 30), torch.rand(count) + 0.5
    maps[:, 7] = 100.0
    names = [f"c{k}" for k in range(count)]
    decision = Decision.from_policy(Policy(maps, weights), state, scene, task="toy", components=names, scene_seed=3)
    assert [c.label for c in decision.candidates] == ["Selected", *(label(k) for k in range(count))]
    weighted = (maps * weights[:, None]).masked_fill(~state["action_mask"], -torch.inf)
    expected = [int(weighted.sum(0).argmax()), *weighted.argmax(-1).tolist()]
    assert [c.pixel for c in decision.candidates] == [(a // 5, a % 5) for a in expected]
    assert decision.selected.overall == pytest.approx(float(weighted.sum(0).max()), rel=1e-5)
    for pooled in decision.objects:
        inside = torch.from_numpy(scene.cells == (-1 if pooled.object_index is None else pooled.object_index)).flatten()
        if pooled.object_index is None:
            # The background away from objects: their edges speak for them too.
            inside = torch.tensor(
                [
                    min(abs(r - i) + abs(c - j) for i, j in np.argwhere(scene.cells >= 0)) > 2
                    for r in range(6)
                    for c in range(5)
                ]
            )
        assert pooled.overall == pytest.approx(float(weighted.sum(0)[inside].max()), rel=1e-5)
    plots.qmaps(decision)
    by_object = Decision.from_policy(Policy(maps, weights), state, scene, task="toy", components=names, level="object")
    assert by_object.selected.pixel == decision.selected.pixel
    for name, candidate in zip(names, by_object.alternatives, strict=True):
        assert candidate.values[name] == max(thing.values[name] for thing in by_object.objects)
    distance, _ = decision.robustness() or (math.inf, "")
    apart = (
        scene.cells != (-1 if decision.selected.object_index is None else decision.selected.object_index)
    ).flatten()
    each = [
        contrast.flip_distance(dict(zip(names, (weighted[:, expected[0]] - weighted[:, a]).tolist(), strict=True)))
        for a in range(30)
        if apart[a] and a != 7
    ]
    assert distance == pytest.approx(min(each), abs=1e-5)


def test_maps_are_saved_beside_the_decision_and_read_back(tmp_path: Path) -> None:
    state, scene = small_scene()
    torch.manual_seed(0)
    policy = Policy(torch.rand(2, 30), torch.ones(2))
    decision = Decision.from_policy(policy, state, scene, task="toy", components=["left", "right"])
    assert [path.name for path in decision.save(tmp_path / "decision.json")] == ["decision.json", "decision.npz"]
    again = Decision.load(tmp_path / "decision.json")
    assert again.maps is not None and decision.maps is not None
    np.testing.assert_allclose(again.maps, decision.maps, atol=1e-6)
    assert again.sentences() == decision.sentences()
    assert again.best_under({"left": 0.0, "right": 1.0}).pixel == decision["B"].pixel
    (tmp_path / "decision.npz").write_bytes(b"PK")
    with pytest.raises(UserError, match="not the maps of a decision"):
        Decision.load(tmp_path / "decision.json")
    other = Decision.from_policy(
        Policy(torch.rand(2, 30), torch.ones(2)), state, scene, task="toy", components=["left", "right"]
    )
    other.save(tmp_path / "other.json")
    (tmp_path / "other.npz").rename(tmp_path / "decision.npz")
    with pytest.raises(UserError, match="does not belong"):
        Decision.load(tmp_path / "decision.json")

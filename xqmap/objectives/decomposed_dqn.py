"""Temporal differences per reward component, with one argmax for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from tensordict import TensorDict, TensorDictBase, unravel_key
from tensordict.nn import TensorDictModuleBase, TensorDictParams, dispatch
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import TensorSpec
from torchrl.objectives.common import LossModule
from torchrl.objectives.utils import ValueEstimators, default_value_kwargs, distance_loss
from torchrl.objectives.value import TD0Estimator, TD1Estimator, TDLambdaEstimator, ValueEstimatorBase

from xqmap.models.policy import masked_argmax
from xqmap.models.qmaps import QMaps, values_at
from xqmap.objectives import cone, inputs
from xqmap.objectives.kept import Kept


class DecomposedDQNLoss(LossModule):
    """Double DQN on K reward components that share one greedy action (X-QMap, Lu et al. 2023, arXiv:2304.12958,
    equations 3–5).

    a⁺ = argmax_a' Σ_k w_k Q_k(s', a') by the online nets; y_k = r_k + γ (1 − terminated) Q̄_k(s', a⁺) by the target
    nets; the loss is Σ_k d(Q_k(s, a), y_k) over one batch for all k. All Q_k then value one policy. With K = 1 this is
    double DQN exactly.

    Q-Maps with a context have two parts, Q_k = now_k + γ · later_k: each learns its own, now_k the reward r_k and
    later_k what follows, (1 − terminated) Q̄_k(s', a⁺); the loss is the sum of both distances. Where later_k is told
    apart by horizon, F_k^h, what the decision after h more is expected to pay, learns (1 − terminated) now̄_k(s', a⁺)
    for h = 1 and (1 − terminated) γ F̄_k^{h−1}(s', a⁺) beyond; their distances are added.

    Values of :class:`~xqmap.models.qmaps.QMaps` at an action, and their gradients, are computed on the cells that they
    depend on (:mod:`xqmap.objectives.cone`); those of any other network are taken from all that it writes.

    Args:
        value_network: writes ``component_action_value`` ``[B, K, A]`` and ``action_value`` ``[B, A]``: what each of A
            actions is worth.

    Keyword Args:
        components: names of the K components, the network's own and in its order; the outputs are
            ``loss_<component>``.
        double_dqn: the online nets choose a⁺; otherwise the target nets do.
        delay_value: keep target nets (copies moved by a torchrl target updater); otherwise the online nets are their
            own target.
        loss_function: the distance d: ``"l1"``, ``"l2"`` or ``"smooth_l1"``.
        shared_argmax: False lets each component assume its own greedy future, y_k = r_k + γ max_a' Q̄_k(s', a'), as in
            HRA (van Seijen et al. 2017). The bars of such an agent value K different policies: a contrast, not an
            explanation.
        kept: what is known of stored next states, to be looked up before it is computed. Batches then say by ``index``
            and ``side`` which state they hold, as :class:`~xqmap.data.replay.Replay` does; whoever moves the target
            nets or stores other transitions tells ``kept``.
        reduction: ``"mean"``, ``"sum"`` or ``"none"`` over the batch.
        action_space: how the batch writes actions, ``"categorical"`` (indices, from 0) or ``"one-hot"``, or a spec of
            torchrl's; as in torchrl's ``DQNLoss``.

    Raises:
        ValueError: if the network has other components, or if a setting is none of those above.

    Examples:
        >>> loss = DecomposedDQNLoss(qmaps, components=("flatness", "color"))
        >>> loss.make_value_estimator(gamma=0.9)
        >>> losses = loss(batch)  # {"loss_flatness": ..., "loss_color": ..., "td_error_flatness": ..., ...}
        >>> sum(value for name, value in losses.items() if name.startswith("loss_")).backward()
    """

    @dataclass
    class _AcceptedKeys:
        """The keys that ``set_keys`` can change.

        Attributes:
            heightmap: the observation that the cells around an action are taken from.
            action: the action taken; on a map, row · W + column.
            action_mask: optional, the actions that a⁺ may be chosen from.
            component_action_value: the components' values.
            action_value: their weighted sum.
            reward: K rewards per step (with K = 1 the summed one does).
            done: end of a trajectory.
            terminated: end of an episode: nothing to bootstrap from.
            truncated: optional, end of a trajectory only; says what is missing of the two above.
            steps_to_next_obs: written by n-step transforms.
            priority: written by the loss: Σ_k |δ_k|, for prioritised replay.
            priority_weight: optional, how much each transition counts: written by prioritised replay.
            index: place of the transition in the storage; read only where something is kept of its next state.
            side: element of D4 that its maps are turned by; as ``index``.
        """

        heightmap: NestedKey = "heightmap"
        action: NestedKey = "action"
        action_mask: NestedKey = "action_mask"
        component_action_value: NestedKey = "component_action_value"
        action_value: NestedKey = "action_value"
        reward: NestedKey = "reward_components"
        done: NestedKey = "done"
        terminated: NestedKey = "terminated"
        truncated: NestedKey = "truncated"
        steps_to_next_obs: NestedKey = "steps_to_next_obs"
        priority: NestedKey = "td_error"
        priority_weight: NestedKey = "priority_weight"
        index: NestedKey = "index"
        side: NestedKey = "side"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys
    default_value_estimator = ValueEstimators.TD0

    value_network: TensorDictModuleBase
    value_network_params: TensorDictParams
    target_value_network_params: TensorDictParams

    def __init__(
        self,
        value_network: TensorDictModuleBase,
        *,
        components: Sequence[str],
        double_dqn: bool = True,
        delay_value: bool = True,
        loss_function: Literal["l1", "l2", "smooth_l1"] = "smooth_l1",
        shared_argmax: bool = True,
        kept: Kept | None = None,
        reduction: Literal["mean", "sum", "none"] = "mean",
        action_space: str | TensorSpec = "categorical",
    ) -> None:
        self._in_keys: list[NestedKey] | None = None
        self._out_keys: list[str] | None = None
        super().__init__()
        stated = next((m.components for m in value_network.modules() if hasattr(m, "components")), components)
        once = not isinstance(components, str) and len(set(components)) == len(components) > 0
        if not once or list(stated) != list(components):
            raise ValueError(f"components={components!r} must be names, each once, and the network's: {list(stated)}")
        for name, value, known in (
            ("reduction", reduction, ("mean", "sum", "none")),
            ("loss_function", loss_function, ("l1", "l2", "smooth_l1")),
        ):
            if value not in known:
                raise ValueError(f"{name}={value!r} is not one of {', '.join(known)}")
        self.components = tuple(components)
        self.double_dqn = double_dqn
        self.delay_value = delay_value
        self.loss_function = loss_function
        self.shared_argmax = shared_argmax
        self.kept = kept
        self.has_cone = cone.has_cone(value_network)
        # γ of Q-Maps in two parts; 0 where there is one.
        in_parts = cone.has_cone(value_network) and value_network.context is not None
        self.later_gamma = float(value_network.gamma) if in_parts else 0.0
        # Into how many parts they tell apart what follows.
        self.parts_ahead = value_network.horizon + 1 if in_parts else 0
        self.reduction = reduction
        self.one_hot = inputs.is_one_hot(action_space)
        self.convert_to_functional(value_network, "value_network", create_target_params=delay_value)

    def _forward_value_estimator_keys(self, **kwargs: NestedKey) -> None:
        if self._value_estimator is not None:
            self._name_keys(self._value_estimator)
        self._in_keys = None

    @property
    def in_keys(self) -> list[NestedKey]:
        """What a call by keyword needs."""
        if self._in_keys is None:
            k = self.tensor_keys
            following = [
                unravel_key(("next", key)) for key in (*self.value_network.in_keys, k.reward, k.done, k.terminated)
            ]
            self._in_keys = [k.action, *self.value_network.in_keys, *following]
        return self._in_keys

    @in_keys.setter
    def in_keys(self, values: list[NestedKey]) -> None:
        self._in_keys = values

    @property
    def out_keys(self) -> list[str]:
        """``loss_<component>``, then ``td_error_<component>`` and ``value_<component>`` (means, without gradient)."""
        if self._out_keys is None:
            self._out_keys = [f"{kind}_{name}" for kind in ("loss", "td_error", "value") for name in self.components]
        return self._out_keys

    @out_keys.setter
    def out_keys(self, values: list[str]) -> None:
        self._out_keys = values

    def make_value_estimator(self, value_type: ValueEstimators | None = None, **hyperparams: float) -> None:
        """Chooses how returns are estimated: TD(0) by default (with n-step batches too), TD(1) or TD(λ).

        torchrl's ``MultiStepTransform`` makes n-step batches with ``reward_keys=["reward_components"]`` and
        ``done_keys=["done"]``: left to itself it moves the next state and not ``terminated``, and the end of an episode
        would be bootstrapped from.

        Args:
            value_type: ``ValueEstimators.TD0``, ``TD1`` or ``TDLambda``.
            hyperparams: ``gamma``, ``lmbda``.

        Raises:
            ValueError: if the network has another γ.
        """
        value_type = value_type or self.default_value_estimator
        estimators: dict[ValueEstimators, type[ValueEstimatorBase]] = {
            ValueEstimators.TD0: TD0Estimator,
            ValueEstimators.TD1: TD1Estimator,
            ValueEstimators.TDLambda: TDLambdaEstimator,
        }
        if value_type not in estimators:
            raise NotImplementedError(f"{value_type} is not an estimator for Q-values; use TD0, TD1 or TDLambda")
        self.value_type = value_type
        if self.later_gamma and hyperparams.get("gamma") != self.later_gamma:
            raise ValueError(
                f"gamma={hyperparams.get('gamma')}, but the network's later part counts {self.later_gamma}"
            )
        settings = dict(default_value_kwargs(value_type)) | hyperparams
        self._value_estimator = estimators[value_type](**settings, value_network=None)
        self._name_keys(self._value_estimator)

    def _name_keys(self, estimator: ValueEstimatorBase) -> None:
        k = self.tensor_keys
        names = {"reward": k.reward, "done": k.done, "terminated": k.terminated}
        estimator.set_keys(value=k.component_action_value, steps_to_next_obs=k.steps_to_next_obs, **names)

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The loss of a batch of transitions.

        Numbers may be of any type and, where there is one per transition, of shape ``[B]`` or ``[B, 1]``; a batch may
        be ``[B, T]``, too.

        Args:
            tensordict: ``[B]`` transitions: the network's input, ``action`` ``[B]``, and under ``"next"`` the network's
                input, ``reward_components`` ``[B, K]``, ``done`` and ``terminated`` ``[B, 1]`` (one of them will do,
                with ``truncated`` or without); optionally ``priority_weight`` ``[B]``, by which each transition's loss
                is multiplied, ``steps_to_next_obs`` ``[B]`` and, under ``"next"``, ``action_mask`` ``[B, A]``. Gets
                ``td_error`` ``[B]`` written, nothing else.

        Returns:
            A TensorDict of ``loss_<component>``, ``td_error_<component>`` (mean |δ_k|) and ``value_<component>`` (mean
            Q_k(s, a)).

        Raises:
            ValueError: if an entry's shape is another; it is named. Or if an n-step batch is to teach a network what
                one decision pays.
        """
        k = self.tensor_keys
        action = inputs.actions(tensordict, k.action, self.one_hot)
        now, later = self._parts(tensordict, action, self.value_network_params)
        value = self.value_network.joined(now, later) if isinstance(self.value_network, QMaps) else now
        with torch.no_grad():
            target, expected = self._targets(tensordict)
            target = target.to(value)
        error = (target - value.detach()).abs()
        if later is None:
            loss = distance_loss(value, target, self.loss_function)
        else:
            reward = inputs.rewards(tensordict["next"], k.reward, self.components).to(value)
            loss = distance_loss(now, reward, self.loss_function)
            expected = expected.to(value)
            loss = loss + distance_loss(later.sum(-1), expected.sum(-1), self.loss_function)
            # What comes after the horizon is what is left of the whole.
            loss = loss + distance_loss(later, expected, self.loss_function)[..., :-1].sum(-1)
        if tensordict.get(k.priority_weight, None) is not None:
            loss = loss * inputs.numbers(tensordict, k.priority_weight).to(loss)[..., None]
        tensordict.set(k.priority, error.sum(-1))
        out: dict[str, Tensor] = {}
        for i, name in enumerate(self.components):
            column = loss[..., i]
            out[f"loss_{name}"] = (
                column.mean() if self.reduction == "mean" else column.sum() if self.reduction == "sum" else column
            )
            out[f"td_error_{name}"] = error[..., i].mean()
            out[f"value_{name}"] = value.detach()[..., i].mean()
        self._clear_weakrefs(tensordict, "value_network_params", "target_value_network_params")
        return TensorDict(out)

    def _network(self, states: TensorDictBase, params: TensorDictParams) -> TensorDictBase:
        """What the network writes for states ``[N]``."""
        with params.to_module(self.value_network, preserve_module_state=False):
            found = self.value_network(states.select(*self.value_network.in_keys))
        key, wanted = self.tensor_keys.component_action_value, (*states.batch_size, len(self.components))
        if found[key].shape[:-1] != wanted:
            names = ", ".join(self.components)
            raise ValueError(f"the network wrote {key} {list(found[key].shape)}, must be {[*wanted, 'A']}: {names}")
        return found

    def _parts(
        self, tensordict: TensorDictBase, action: Tensor, params: TensorDictParams
    ) -> tuple[Tensor, Tensor | None]:
        """What the actions ``[*]`` (or one-hot ``[*, A]``) in the states ``[*]`` pay, ``[*, K]``, and what can follow,
        ``[*, K, P]``; Q_k and None of a network that does not tell them apart.
        """
        lead, key = tensordict.batch_size, self.tensor_keys.heightmap
        states = tensordict.select(*self.value_network.in_keys).reshape(-1)
        action = action.reshape(-1, *action.shape[len(lead) :])
        if self.has_cone:
            assert isinstance(self.value_network, QMaps)
            action = inputs.index(action, states[key].shape[-2:].numel())
            with params.to_module(self.value_network, preserve_module_state=False):
                now, later = cone.parts(self.value_network, states[key], action)
            return now.reshape(*lead, -1), None if later is None else later.reshape(*lead, *later.shape[1:])
        maps = self._network(states, params)[self.tensor_keys.component_action_value]
        return values_at(maps, inputs.index(action, maps.shape[-1])).reshape(*lead, -1), None

    def _targets(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """y_k, ``[*, K]``, and what its future is made of, ``[*, K, P]``. Next states after which nothing comes are
        not looked at.
        """
        k, following = self.tensor_keys, tensordict["next"]
        reward = inputs.rewards(following, k.reward, self.components)
        done, terminated = inputs.ends(following, (k.done, k.terminated, k.truncated))
        future = reward.new_zeros(*reward.shape, 1 + self.parts_ahead)
        if self._value_estimator is None:
            self.make_value_estimator()
        if not bool(terminated.all()) and float(self._value_estimator.gamma) > 0:
            seen = following.select(*self.value_network.in_keys, k.action_mask, strict=False)
            if self.kept is not None:
                seen.update(tensordict.select(k.index, k.side))
            future[~terminated] = self._future(seen[~terminated]).to(future)
        batch = TensorDict({}, tensordict.batch_size).set(("next", k.reward), reward)
        batch.set(("next", k.done), done[..., None].expand_as(reward))
        batch.set(("next", k.terminated), terminated[..., None].expand_as(reward))
        if tensordict.get(k.steps_to_next_obs, None) is not None:
            if self.later_gamma:
                raise ValueError(f"{k.steps_to_next_obs}: of several steps nobody learns what one decision pays")
            steps = inputs.numbers(tensordict, k.steps_to_next_obs)
            batch.set(k.steps_to_next_obs, steps[..., None].expand_as(reward))
        if not self.parts_ahead:
            return self.value_estimator.value_estimate(batch, next_value=future[..., 0]), future[..., 1:]
        # One decision later each part is one decision nearer; what was last now lies in the last part.
        future[..., 1:] *= self.later_gamma
        target = self.value_estimator.value_estimate(batch, next_value=future.sum(-1))
        return target, torch.cat((future[..., :-2], future[..., -2:].sum(-1, keepdim=True)), -1)

    def _future(self, following: TensorDictBase) -> Tensor:
        """``[N, K, 1 + P]``: Q̄_k(s', a⁺), or max_a' Q̄_k(s', a') without the shared argmax, as what is paid and what can
        follow; looked up where it is kept.
        """
        k, kept, online = self.tensor_keys, self.kept, self.double_dqn and self.shared_argmax
        if kept is None:
            return self._valued(following, self._chosen(following) if online else None)
        place, side = following[k.index], following[k.side]
        choice = torch.full_like(place, -1)
        if online:
            edges = following[k.heightmap].shape[-2:]
            choice = kept.choices(place, side, edges)
            if bool((due := choice < 0).any()):
                choice[due] = self._chosen(following[due])
                kept.choose(place[due], side[due], edges, choice[due])
        if len(due := kept.unknown(place, side, choice)):
            value = self._valued(following[due], choice[due] if online else None)
            kept.value(place[due], side[due], choice[due], value)
        return kept.values(place, side, choice)

    def _chosen(self, following: TensorDictBase) -> Tensor:
        """``[N]``: a⁺ by the online nets."""
        k = self.tensor_keys
        total = self._network(following, self.value_network_params)[k.action_value]
        return masked_argmax(total, inputs.allowed(following, k.action_mask, total.shape[-1]))

    def _valued(self, following: TensorDictBase, choice: Tensor | None) -> Tensor:
        """``[N, K, 1 + P]``: what the target nets make of the choices ``[N]``, or, where there are none, of their
        own.
        """
        if choice is not None:
            return self._together(following, choice)
        k = self.tensor_keys
        found = self._network(following, self.target_value_network_params)
        maps = found[k.component_action_value]
        mask = inputs.allowed(following, k.action_mask, maps.shape[-1])
        if self.shared_argmax:
            best = masked_argmax(found[k.action_value], mask)[:, None].expand(-1, len(self.components))
        else:
            best = masked_argmax(maps, None if mask is None else mask[..., None, :])
        if not self.later_gamma:
            return maps.gather(-1, best[..., None])
        return torch.stack([self._together(following, cells)[:, i] for i, cells in enumerate(best.unbind(-1))], 1)

    def _together(self, following: TensorDictBase, choice: Tensor) -> Tensor:
        """``[N, K, 1 + P]``: what the target nets say that the choices ``[N]`` pay, and what can follow."""
        now, later = self._parts(following, choice, self.target_value_network_params)
        return now[..., None] if later is None else torch.cat((now[..., None], later), -1)

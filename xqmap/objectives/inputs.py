"""What a batch of transitions holds, brought into the shapes that the loss computes with, or refused.

Batches are ``[*]``, mostly ``[B]``; a number per transition may come as ``[*]`` or as ``[*, 1]``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data.utils import ACTION_SPACE_MAP


def is_one_hot(action_space: Any) -> bool:
    """Whether actions of this space (a spec of torchrl's, or its name) are one-hot; otherwise they are indices.

    Raises:
        ValueError: if they are neither.
    """
    kind = action_space if isinstance(action_space, str) else type(action_space)
    found = ACTION_SPACE_MAP.get(kind)
    if found not in ("categorical", "one_hot"):
        raise ValueError(f"action_space={kind!r} must be 'categorical' (indices) or 'one-hot'")
    return found == "one_hot"


def numbers(tensordict: TensorDictBase, key: NestedKey) -> Tensor:
    """``[*]``: a number for each transition."""
    value, lead = tensordict[key], tensordict.batch_size
    if value.shape not in (lead, (*lead, 1)):
        raise _unfit(key, value, f"{list(lead)} or {[*lead, 1]}")
    return value.reshape(lead)


def rewards(tensordict: TensorDictBase, key: NestedKey, components: Sequence[str]) -> Tensor:
    """``[*, K]``: a number for each transition and component."""
    value, wanted = tensordict[key], [*tensordict.batch_size, len(components)]
    if len(components) == 1:
        value = numbers(tensordict, key)[..., None]
    if list(value.shape) != wanted:
        raise _unfit(key, value, f"{wanted}, one for each of {', '.join(components)}")
    # Sums of them are not for half precision, nor for whole numbers.
    return value.to(torch.promote_types(value.dtype, torch.float32))


def ends(following: TensorDictBase, names: Sequence[NestedKey]) -> tuple[Tensor, Tensor]:
    """``[*]`` bool, twice: where a trajectory ends, and where it does because nothing follows.

    Args:
        following: what is under ``"next"``.
        names: the keys of ``done``, ``terminated`` and ``truncated``. What is missing of done = terminated | truncated
            is derived, as torchrl does; without ``truncated`` the other two are the same.
    """
    done, terminated, truncated = names
    flags = {key: numbers(following, key).bool() for key in names if key in following.keys(True)}
    if done not in flags and terminated not in flags:
        raise ValueError(f"the batch holds neither {done!r} nor {terminated!r} under 'next': where do episodes end?")
    cut = flags.get(truncated, torch.zeros_like(next(iter(flags.values()))))
    last = flags[terminated] if terminated in flags else flags[done] & ~cut
    return flags[done] if done in flags else last | cut, last


def actions(tensordict: TensorDictBase, key: NestedKey, one_hot: bool) -> Tensor:
    """``[*]`` int64 indices; one-hot actions come and stay as ``[*, A]``."""
    action, lead = tensordict[key], tensordict.batch_size
    if one_hot:
        if action.ndim != len(lead) + 1 or bool((action.long().sum(-1) != 1).any()):
            raise _unfit(key, action, f"one-hot {[*lead, 'A']}; for indices set action_space='categorical'")
        return action
    # A whole batch may have been cast; half precision has no exact indices from 2048 on.
    if action.dtype in (torch.float32, torch.float64) and torch.equal(action, action.round()):
        action = action.long()
    if action.shape not in (lead, (*lead, 1)) or action.is_floating_point() or action.dtype == torch.bool:
        raise _unfit(key, action, f"integers {list(lead)}; for one-hot actions set action_space='one-hot'")
    return action.reshape(lead).long()


def index(action: Tensor, count: int) -> Tensor:
    """``[N]`` int64: which of ``count`` actions each of ``[N]`` (or one-hot ``[N, count]``) is."""
    if action.ndim > 1:
        if action.shape[-1] != count:
            raise ValueError(f"one-hot actions of {action.shape[-1]} numbers, but the network values {count} actions")
        action = action.long().argmax(-1)
    if len(action) and not 0 <= int(action.min()) <= int(action.max()) < count:
        found = f"{int(action.min())} to {int(action.max())}"
        raise ValueError(f"actions from {found}, but the network values {count}: 0 to {count - 1}")
    return action


def allowed(following: TensorDictBase, key: NestedKey, count: int) -> Tensor | None:
    """``[*, A]``: which of ``count`` actions may be chosen; None: all."""
    mask = following.get(key, None)
    if mask is None:
        return None
    if mask.shape != (*following.batch_size, count):
        raise _unfit(key, mask, f"{[*following.batch_size, count]}")
    return mask


def _unfit(key: NestedKey, value: Tensor, wanted: str) -> ValueError:
    name = key if isinstance(key, str) else ".".join(key)
    return ValueError(f"{name} is {str(value.dtype).removeprefix('torch.')} {list(value.shape)}, must be {wanted}")

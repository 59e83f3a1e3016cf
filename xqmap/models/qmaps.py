"""The Q-Maps: one U-Net per reward component, their weighted sum, and the values at an action."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.nn import functional as F

from xqmap import keys
from xqmap.data.symmetry import elements, restore, transform
from xqmap.models.context import Context
from xqmap.models.unet import LocalGeometry, UNet

# Of the widest layers, in cells: about what a processor's cache holds.
_CELLS_IN_CACHE = 2**16


def values_at(maps: Tensor, action: Tensor) -> Tensor:
    """Maps ``[*, K, A]`` and actions ``[*]`` → the values there, ``[*, K]``."""
    return maps.gather(-1, action[..., None, None].expand(*maps.shape[:-1], 1)).squeeze(-1)


def pad_to_grid(heightmap: Tensor, stride: int) -> Tensor:
    """Empty cells below and to the right of ``[B, C, H, W]`` until ``stride`` divides H and W; the same tensor where it
    does.
    """
    below, right = (-edge % stride for edge in heightmap.shape[-2:])
    # torch copies the map even where there is nothing to add.
    return F.pad(heightmap, (0, right, 0, below)) if below or right else heightmap


def write_chosen(tensordict: TensorDictBase) -> TensorDictBase:
    """Writes ``chosen_component_value`` ``[*, K]`` and ``chosen_action_value`` ``[*, 1]`` for the ``action`` that is
    there.
    """
    action = tensordict[keys.ACTION]
    tensordict.set(keys.CHOSEN_COMPONENT_VALUE, values_at(tensordict[keys.COMPONENT_ACTION_VALUE], action))
    return tensordict.set(keys.CHOSEN_ACTION_VALUE, tensordict[keys.ACTION_VALUE].gather(-1, action[..., None]))


class QMaps(TensorDictModuleBase):
    """K separate U-Nets behind one fixed stem: heightmap in, one Q-Map per component out (X-QMap, Lu et al. 2023,
    section III).

    Reads ``heightmap`` ``[*, 4, H, W]`` and, where it is there, ``action`` ``[*]``. Writes ``component_action_value``
    ``[*, K, A]``, ``action_value`` ``[*, A]`` = Σ_k w_k Q_k, in evaluation mode and in a context
    ``component_part_value`` ``[*, K, P, A]`` (see :meth:`parts`), and for a given action ``chosen_component_value``
    ``[*, K]`` and ``chosen_action_value`` ``[*, 1]``.

    Args:
        components: names of the K components; the order of every K axis.
        stem: the geometry computed from the heightmap.
        unet: builds one U-Net from its number of input channels.
        weights: w_k by name, or in the order of ``components``; 1 each when not given.
        symmetric: in evaluation mode a map is the mean over the turned and mirrored heightmaps: the argmax over
            thousands of cells finds a single view's outliers, and no outlier is one from every side.
        context: sees the whole map. With it Q_k = now_k + γ · later_k: what a decision pays, from the cells around it
            alone, and what can follow, which depends on what else is there. Without, Q_k is one number.
        gamma: discount per decision; read only where there is a context.
    """

    def __init__(
        self,
        components: Sequence[str],
        stem: LocalGeometry,
        unet: Callable[[int], UNet],
        weights: Mapping[str, float] | Sequence[float] | None = None,
        symmetric: bool = False,
        context: Context | None = None,
        gamma: float = 0.0,
    ) -> None:
        super().__init__()
        self.context, self.gamma = context, gamma
        self.symmetric = symmetric
        self.in_keys = [keys.HEIGHTMAP]
        self.out_keys = [keys.COMPONENT_ACTION_VALUE, keys.ACTION_VALUE]
        self.components = tuple(components)
        self.stem = stem
        # A list, so that no component's name can clash with a module's own attributes.
        self.unets = nn.ModuleList(unet(stem.channels) for _ in self.components)
        if isinstance(weights, Mapping):
            if set(weights) != set(self.components):
                raise ValueError(f"weights for {list(weights)}, but the components are {list(self.components)}")
            weights = [weights[name] for name in self.components]
        weight = torch.tensor([1.0] * len(self.components) if weights is None else [float(w) for w in weights])
        if len(weight) != len(self.components):
            raise ValueError(f"{len(weight)} weights for the {len(self.components)} components {self.components}")
        self.register_buffer("weights", weight)

    @property
    def stride(self) -> int:
        """The pooling grid: heightmaps are padded to multiples of it."""
        return 2 ** max(unet.depth for unet in self._unets())

    @property
    def horizon(self) -> int:
        """How many of the next decisions are told apart in what follows; 0 where what follows is one part, or none."""
        ahead = [unet.ahead for unet in self._unets()]
        return ahead[0].value.out_channels if ahead and ahead[0] else 0

    def _unets(self) -> list[UNet]:
        return [unet for unet in self.unets if isinstance(unet, UNet)]

    def maps(self, heightmap: Tensor) -> Tensor:
        """``[B, 4, H, W]`` → the Q-Maps ``[B, K, H, W]``; sizes that the poolings do not divide are padded with empty
        cells.
        """
        return self._seen(heightmap, self._maps)

    def parts(self, heightmap: Tensor) -> Tensor:
        """``[B, 4, H, W]`` → ``[B, K, P, H, W]``, what the Q-Maps are the sum of: what a decision pays itself, then γ
        times what is expected of each of the next decisions, and of all later ones together. One part where nothing
        follows (γ = 0) or where what follows cannot be told apart (without a context).
        """
        return self._seen(heightmap, self._parts).unflatten(1, (len(self.components), -1))

    def from_side(self, heightmap: Tensor, side: int) -> Tensor:
        """``[B, 4, H, W]`` → the Q-Maps ``[B, K, H, W]`` as they are seen from one of the map's sides, an element of
        D4.
        """
        return restore(self._padded(transform(heightmap, side).contiguous(), self._maps), side)

    def _seen(self, heightmap: Tensor, see: Callable[[Tensor], Tensor]) -> Tensor:
        def padded(image: Tensor) -> Tensor:
            return self._padded(image, see)

        if self.training or not self.symmetric:
            return padded(heightmap)
        return self._from_all_sides(padded, heightmap)

    def _from_all_sides(self, see: Callable[[Tensor], Tensor], heightmap: Tensor) -> Tensor:
        sides = range(elements(*heightmap.shape[-2:]))
        return torch.stack([restore(see(transform(heightmap, side).contiguous()), side) for side in sides]).mean(0)

    def _padded(self, heightmap: Tensor, see: Callable[[Tensor], Tensor]) -> Tensor:
        rows, columns = heightmap.shape[-2:]
        heightmap = pad_to_grid(heightmap, self.stride)
        # Without gradients nothing has to be kept, so a processor goes map after map: the layers of one stay in its
        # cache.
        alone = heightmap.device.type == "cpu" and not torch.is_grad_enabled()
        parts = heightmap.split(max(1, _CELLS_IN_CACHE // heightmap[0, 0].numel())) if alone else (heightmap,)
        return torch.cat([see(part) for part in parts])[..., :rows, :columns]

    def _maps(self, heightmap: Tensor) -> Tensor:
        if self.context is None:
            image = self.geometry(heightmap)
            return torch.cat([unet(image) for unet in self.unets], dim=1)
        return self._parts(heightmap).unflatten(1, (len(self.components), -1)).sum(2)

    def _parts(self, heightmap: Tensor) -> Tensor:
        """``[B, K · P, H, W]``."""
        image = self.geometry(heightmap)
        if self.context is None:
            return torch.cat([unet(image) for unet in self.unets], dim=1)
        whole, parts = self.context(heightmap), []
        for unet in self._unets():
            features = unet.features(image)
            parts += [unet.value(features), self.gamma * unet.following(features, whole)]
        return torch.cat(parts, 1)

    def joined(self, now: Tensor, later: Tensor | None) -> Tensor:
        """``[*]``: Q_k of what is paid, ``[*]``, and what follows, ``[*, P]``: now_k + γ · Σ later_k; of one, without a
        context, that.
        """
        return now if later is None else now + self.gamma * later.sum(-1)

    def geometry(self, heightmap: Tensor) -> Tensor:
        """``[B, 4, H, W]`` → ``[B, C, H, W]``: what the U-Nets see."""
        device, precision = heightmap.device.type, self.weights.dtype
        if torch.is_autocast_enabled(device) and precision == torch.float32:
            # Once, not by each of the U-Nets.
            precision = torch.get_autocast_dtype(device)
        # Centimetres between metres: the stem never runs in reduced precision.
        with torch.no_grad(), torch.autocast(device, enabled=False):
            return self.stem(heightmap).to(precision, memory_format=torch.channels_last)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the maps, their sum, and the values at ``action`` where there is one."""
        image = tensordict.get(keys.HEIGHTMAP)
        lead = image.shape[:-3]
        flat = image.reshape(-1, *image.shape[-3:])
        if self.training or self.context is None:
            maps = self.maps(flat)
        else:
            # Only who explains asks what follows when, and never while learning.
            parts = self.parts(flat)
            maps = parts.sum(2)
            tensordict.set(keys.COMPONENT_PART_VALUE, parts.reshape(*lead, *parts.shape[1:3], -1))
        values = maps.reshape(*lead, len(self.components), -1)
        total = (values * self.weights[:, None]).sum(-2)
        tensordict.set(keys.COMPONENT_ACTION_VALUE, values)
        tensordict.set(keys.ACTION_VALUE, total)
        return tensordict if tensordict.get(keys.ACTION, None) is None else write_chosen(tensordict)

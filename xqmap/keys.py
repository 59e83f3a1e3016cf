"""Every TensorDict key, once. Batch ``[B]``, K components, an H × W map with A = H·W cells.

| key | shape, type | meaning |
|---|---|---|
| ``heightmap`` | [4, H, W] float32 | red, green, blue (0–255) and height above the workspace's floor (m) of each cell |
| ``action`` | [] int64 | row · W + column |
| ``action_mask`` | [A] bool | cells that were seen and that the primitive can reach |
| ``component_action_value`` | [K, A] | the Q-Maps |
| ``component_part_value`` | [K, P, A] | their parts: what is paid now, then γ times what follows, by horizon |
| ``action_value`` | [A] | Q = Σ_k w_k Q_k |
| ``chosen_action_value`` | [1] | Q at the action |
| ``chosen_component_value`` | [K] | Q_k at the action |
| ``reward`` | [1] | R = Σ_k w_k r_k |
| ``reward_components`` | [K] | the sub-rewards r_k |
| ``reward_available`` | [1] | the highest R any action would have had: evaluation only |
| ``priority_weight`` | [] | of prioritised replay: how much a sampled transition counts |
| ``side`` | [] int64 | of a sampled transition: the element of D4 that its maps are turned by |
| ``td_error`` | [] | its absolute TD errors, summed over k, as the loss found them |
"""

HEIGHTMAP = "heightmap"
ACTION = "action"
ACTION_MASK = "action_mask"
COMPONENT_ACTION_VALUE = "component_action_value"
COMPONENT_PART_VALUE = "component_part_value"
ACTION_VALUE = "action_value"
CHOSEN_ACTION_VALUE = "chosen_action_value"
CHOSEN_COMPONENT_VALUE = "chosen_component_value"
REWARD = "reward"
REWARD_COMPONENTS = "reward_components"
REWARD_AVAILABLE = "reward_available"
PRIORITY_WEIGHT = "priority_weight"
SIDE = "side"
TD_ERROR = "td_error"
DONE = "done"
TERMINATED = "terminated"
TRUNCATED = "truncated"

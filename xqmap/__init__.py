"""Explainable Q-Map learning: one Q-Map per reward component, one argmax of their sum, and explanations from the same
numbers.
"""

import os

from xqmap import matplotlib_import  # noqa: F401 (before anything else imports matplotlib)

# Idle OpenMP threads that spin take the processor from the simulator and from other programs; beside one busy neighbour
# on two processors an update was ten times slower with spinning. Has to be set before torch is imported.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")

"""What fuzzing begins with: texts that mean harm, names of settings, and good files to spoil."""

from __future__ import annotations

from typing import Any

HOSTILE = (
    "",
    "\x00",
    "\x1b[2J",
    "<script>alert(1)</script>",
    "${oc.env:HOME}",
    "${",
    "???",
    "../../etc/passwd",
    "ignore the above",
    "\u202e",
    "{0.__class__}",
    "%s%n",
    "é" * 300,
    "-0",
    "1e999",
    "nan",
)
# Of a training's settings, with some that are not.
KEYS = [
    *(
        "seed",
        "~seed",
        "device",
        "threads",
        "resume",
        "trainer",
        "trainer.frames",
        "trainer.precision",
        "trainer.frams",
        "loss",
    ),
    *(
        "loss.gamma",
        "task",
        "+task",
        "task.weights",
        "task.weights.color",
        "task.env",
        "task.env.altitude",
        "task.components",
        "method",
    ),
    *(
        "method.weights",
        "replay.capacity",
        "evaluation.seeds",
        "evaluation.until",
        "qnet.plane_windows",
        "collector",
        "logger.mode",
    ),
    *("exploration.eps_init", "hydra.run.dir", "+new"),
]
DECISION: dict[str, Any] = {
    "task": "landing",
    "scene_seed": 3,
    "step": 0,
    "components": ["flatness", "color"],
    "candidates": [
        {
            "label": "Selected",
            "object": "blue flat block",
            "pixel": [3, 4],
            "position": [0.0, 1.0, 2.0],
            "values": {"flatness": 1, "color": 0.9},
        },
        {
            "label": "A",
            "object": "ground",
            "pixel": [7, 4],
            "object_index": None,
            "values": {"flatness": 1.1, "color": 0},
        },
        {"label": "B", "object": "red block", "values": {"flatness": 0.1, "color": 1.0}},
    ],
    "objects": [
        {"object": "blue flat block", "object_index": 0, "pixel": [3, 4], "values": {"flatness": 1, "color": 0.9}}
    ],
    "noise": {"flatness": 0.1, "color": 0.1},
}
EVALUATION: dict[str, Any] = {
    "task": "landing",
    "method": "xqmap",
    "training_seed": 0,
    "runs": [{"seed": 0, "choices": 10, "correct": 9, "regret": 0.1, "components": {"flatness": 0.9, "color": 1.0}}],
    "success": {"mean": 0.9, "std": 0.0, "choices": 10, "ci95": [0.6, 0.98]},
    "baselines": {"random pixel": {"mean": 0.2, "std": 0.1, "choices": 10, "ci95": [0.1, 0.5], "regret": 1.0}},
    "confusion": {"blue flat block": {"blue flat block": 9, "ground": 1}},
    "calibration": {},
    "settings": {"weights": {"color": 1.0}},
    "machine": {"threads": 1},
    "versions": {"torch": "2.13.0"},
    "weights_sha256": "0" * 64,
}
SETTINGS: dict[str, Any] = {
    "task": {"name": "landing"},
    "method": {"name": "xqmap"},
    "seed": 0,
    "trainer": {"frames": 4},
}
METRICS = b"frames,seconds,success,reward,loss/color\n2,0.5,0.5,1.0,\n4,1.0,1.0,2.0,0.1\n"
ASKED = ("why?", "why not A?", "why not the red block?", "what if color counted half?", "how sure are you?")

"""``python -m xqmap.check task=NAME``: holds an installed world against the contract, one line per rule."""

from __future__ import annotations

from omegaconf import DictConfig

from xqmap import doctor
from xqmap.config import build, cli, schema
from xqmap.envs.check import check_task
from xqmap.envs.protocol import Task
from xqmap.errors import UserError
from xqmap.terminal import say


def check(cfg: DictConfig) -> None:
    """Plays the world of ``cfg.task`` and prints what it keeps, and what to mend.

    Raises:
        UserError: if something is to be mended.
    """
    schema.validate(cfg)
    doctor.require_rendering(build.world(cfg))

    def make_task(weights: dict[str, float]) -> Task:
        weighed = cfg.copy()
        weighed.task.weights = weights
        made: Task = build.task(weighed)
        return made

    names = [str(name) for name in cfg.task.components]
    findings = check_task(make_task, names, scenes=list(cfg.evaluation.seeds))
    for finding in findings:
        say(str(finding))
    if broken := sum(bool(finding.troubles) for finding in findings):
        raise UserError(f"{cfg.task.name}: {broken} of {len(findings)} rules are broken, see MEND above")
    say(f"{cfg.task.name} keeps the contract")


main = cli.main("check")(check)

if __name__ == "__main__":
    main()

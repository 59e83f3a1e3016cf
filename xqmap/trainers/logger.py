"""Where numbers go while training runs: ``metrics.csv``, and an offline wandb run beside it."""

from __future__ import annotations

import contextlib
import csv
import io
import logging
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from xqmap.errors import UserError, brief
from xqmap.files import write_atomically
from xqmap.trainers import wandb_environment

_logger = logging.getLogger(__name__)
_QUIET: dict[str, Any] = {"x_disable_stats": True, "console": "off", "silent": True}


class Log:
    """Writes each row of metrics to ``metrics.csv`` and to wandb.

    Args:
        directory: the run directory.
        cfg: the whole configuration; ``cfg.logger.mode`` is offline, online or disabled.
        columns: the metrics' names, with ``/`` between group and component.
        after: rows of an earlier part of this run up to this ``frames`` are kept.
        wandb_id: of the run to go on with; None for a new one.
    """

    def __init__(
        self, directory: Path, cfg: DictConfig, columns: list[str], after: int = 0, wandb_id: str | None = None
    ) -> None:
        self.columns = columns
        path = directory / "metrics.csv"
        kept = io.StringIO(newline="")
        writer = csv.DictWriter(kept, columns)
        writer.writeheader()
        writer.writerows(_rows(path, columns, after) if after else [])
        write_atomically(path, kept.getvalue().encode())
        self._file = open(path, "a", newline="", encoding="utf-8")  # noqa: SIM115 (lives as long as the log)
        self._csv = csv.DictWriter(self._file, columns)
        self._wandb: Any = None
        self.wandb_id = wandb_id
        mode = wandb_environment.mode(cfg.logger.mode)
        if mode != "disabled":
            self._start_wandb(directory, cfg, mode)

    def _start_wandb(self, directory: Path, cfg: DictConfig, mode: str) -> None:
        with _starting(directory, mode, "logger.mode=disabled does without") as wandb:
            from torchrl.record.loggers.wandb import WandbLogger  # imports wandb

            self._wandb = WandbLogger(
                exp_name=directory.name,
                offline=mode == "offline",
                mode=mode,
                save_dir=str(directory),
                project=cfg.logger.project,
                id=self.wandb_id,
                log_env_packages=False,
                config=OmegaConf.to_container(cfg, resolve=True),
                settings=wandb.Settings(**_QUIET),
            )
        self.wandb_id = self._wandb.experiment.id

    def row(self, values: dict[str, float]) -> None:
        """One step's metrics; must hold ``frames``. What is not known yet stays empty."""
        known = {name: value for name, value in values.items() if math.isfinite(value)}
        self._csv.writerow(known)
        self._file.flush()
        self._to_wandb(lambda experiment: experiment.log(known, step=int(values["frames"])))

    def picture(self, name: str, path: Path, frames: int) -> None:
        """A picture file, into wandb."""

        def send(experiment: Any) -> None:
            import wandb  # only once it was told to keep to itself

            experiment.log({name: wandb.Image(str(path))}, step=frames)

        self._to_wandb(send)

    def close(self) -> None:
        """Ends the wandb run, so that the next one in this process gets an id of its own; again, nothing."""
        self._file.close()
        self._to_wandb(lambda experiment: experiment.finish())
        self._wandb = None

    def _to_wandb(self, act: Callable[[Any], Any]) -> None:
        """Training does not end because its log does: wandb is left out from its first failure on."""
        if self._wandb is None:
            return
        try:
            act(self._wandb.experiment)
        except Exception as error:
            self._wandb = None
            _forget_wandb()
            _logger.warning(
                "wandb failed (%s: %s); training goes on, metrics.csv has every row", type(error).__name__, brief(error)
            )


def _forget_wandb() -> None:
    """Lets the next training of this process begin with a wandb process of its own; the present one may be gone."""
    import wandb  # only once it was told to keep to itself

    for end in (lambda: wandb.run and wandb.run.finish(), wandb.teardown):
        with contextlib.suppress(Exception):
            end()


def log_page(page: Path, directory: Path, source: str, settings: DictConfig) -> Path:
    """Keeps an HTML page as a wandb run of its own under ``directory``; returns the run's folder, which ``wandb sync``
    sends.

    Args:
        page: the file.
        directory: an existing one.
        source: what the page is about; ``report`` in the run's config, by which it is known from a training.
        settings: ``mode`` and ``project``, as of a training's log.

    Raises:
        UserError: if wandb does not start.
    """
    mode = wandb_environment.mode(settings.mode)
    with _starting(directory, mode, f"the page is in {page}") as wandb:
        run = wandb.init(
            mode=mode,
            dir=str(directory),
            project=settings.project,
            name=page.stem,
            config={"report": source},
            settings=wandb.Settings(**_QUIET),
        )
    run.log({"report": wandb.Html(str(page), inject=False)})
    run.finish()
    return Path(run.dir).parent


@contextlib.contextmanager
def _starting(directory: Path, mode: str, otherwise: str) -> Iterator[Any]:
    """The module, told to keep to itself and to ``directory`` before it is imported, while a run of it begins.

    Raises:
        UserError: if it does not; the line ends with what there is ``otherwise``.
    """
    with wandb_environment.own(directory, mode):
        import wandb  # only once it was told to keep to itself

        try:
            yield wandb
        except Exception as error:  # of its own, of pydantic, of the system
            _forget_wandb()
            raise UserError(f"logger.mode={mode}: wandb does not start ({brief(error)}); {otherwise}") from None


def _rows(path: Path, columns: list[str], after: int) -> list[dict[str, str]]:
    """The whole rows of an earlier part of the run; one that a crash cut off is left out."""
    if not path.exists():
        return []
    with open(path, newline="", encoding="utf-8", errors="replace") as file:
        rows = [row for row in csv.DictReader(file) if list(row) == columns and None not in row.values()]
    return [row for row in rows if row["frames"] and float(row["frames"]) <= after]

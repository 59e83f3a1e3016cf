"""The report as one page: works from disk, asks for nothing outside, prints, and can be read without its pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

from matplotlib.figure import Figure

from xqmap.evaluation import results, tables
from xqmap.evaluation.results import Row
from xqmap.evaluation.swept import grouped, label, swept
from xqmap.explanations.views import markup
from xqmap.reports import curves, facts, stories
from xqmap.reports.runs import Run

_HERE = Path(__file__).parent


@dataclass
class Report:
    """What the page shows.

    Attributes:
        source: the directory, as the person named it.
        runs: every training, finished or not.
        rows: the table.
        left_out: ``{path: why}`` of what is no run or could not be read.
    """

    source: str
    runs: list[Run]
    rows: list[Row]
    left_out: dict[Path, str] = field(default_factory=dict)

    @property
    def tasks(self) -> list[str]:
        """Of the trainings, by name."""
        return sorted({run.task for run in self.runs})

    def trained(self, task: str) -> list[Run]:
        """A task's trainings, in the order of :meth:`groups`."""
        return [run for members in self.groups(task).values() for run in members]

    def groups(self, task: str) -> dict[str, list[Run]]:
        """A task's trainings by the label of their method, in the table's order, then those that are not in it."""
        names = swept([run for run in self.runs if run.task == task]).get(task, [])
        found = grouped(
            (run for run in self.runs if run.task == task),
            lambda run: label(run.method, {name: run.settings.get(name) for name in names}),
        )
        # The table's order; what is not in it yet as it will be there.
        known = list(results.paper_figures().get(task, {}))
        order = [row.label for row in self.rows if row.task == task]

        def place(label: str) -> tuple[int, int]:
            method = found[label][0].method
            return _index(known, method), _index(order, label)

        return {label: found[label] for label in sorted(found, key=place)}

    def figures(self, task: str) -> Iterator[tuple[str, Figure, str]]:
        """A task's charts in the page's order: a short name, the chart, and what it shows."""
        groups, rows = self.groups(task), [row for row in self.rows if row.task == task]
        colors = {label: curves.COLORS[i % len(curves.COLORS)] for i, label in enumerate(groups)}
        if rows:
            yield (
                "choices",
                curves.intervals(rows, colors),
                f"Best choices in {task}: the dot is the mean, the line its 95 % interval.",
            )
        for metric, meaning in curves.METRICS.items():
            if figure := curves.learning(groups, metric, colors):
                yield metric, figure, f"{meaning}; against decisions and against minutes."
        if figure := curves.shares(groups):
            yield "time", figure, "Share of wall-clock in training, by what it was spent on."


def page(report: Report) -> str:
    """The whole page as HTML."""
    tasks = report.tasks
    sections = {"Results": _results(report)} | {task: _task(report, task) for task in tasks}
    sections |= {"Runs": facts.runs(report.runs), "Machines and versions": facts.machines(report.runs)}
    if report.left_out:
        sections["Left out"] = facts.left_out(report.left_out)
    title = f"xqmap: {_count(len(report.runs), 'training')} of {_count(len(tasks), 'task')}"
    links = "".join(f'<a href="#{_anchor(name)}">{escape(name)}</a>' for name in sections)
    body = "".join(
        f'<section id="{_anchor(name)}"><h2>{escape(name)}</h2>{content}</section>'
        for name, content in sections.items()
    )
    style, script = ((_HERE / name).read_text(encoding="utf-8") for name in ("report.css", "report.js"))
    head = f"<h1>{escape(title)}</h1><p class=soft>{escape(_summary(report))}</p><nav>{links}</nav>"
    return markup.document(title, f"<header>{head}</header><main>{body}</main>", style, script)


def _summary(report: Report) -> str:
    started = sorted(str(run.environment["started_at"])[:10] for run in report.runs if "started_at" in run.environment)
    running = sum(run.running for run in report.runs)
    unfinished = sum(not run.finished and not run.running for run in report.runs)
    parts = [
        f"{sum(run.decisions for run in report.runs):,} decisions in {sum(run.minutes for run in report.runs):,.1f} "
        "minutes of training"
    ]
    parts += [f"started {started[0]}" + (f" to {started[-1]}" if started[-1] != started[0] else "")] if started else []
    parts += [f"{_count(running, 'training')} still running"] if running else []
    parts += [f"{_count(unfinished, 'training')} did not finish"] if unfinished else []
    return ", ".join(parts) + f". Read from {report.source}."


def _results(report: Report) -> str:
    if not report.rows:
        return "<p>No training under this directory has been evaluated yet, so there is no table.</p>"
    parts = [f"<p class=lead>{escape(sentence).replace(' %', '&nbsp;%')}</p>" for sentence in _headlines(report.rows)]
    usual, others = ([row for row in report.rows if bool(row.sheet) == other] for other in (False, True))
    if usual:
        parts.append(
            _table(
                usual,
                "Choices whose reward was the highest that any action would have had, in scenes no training shows.",
            )
        )
    if others:
        parts += [
            "<h3>Other scenes</h3>",
            _table(others, "The same policies on evaluation sheets: other scenes, or more of them."),
        ]
    parts.append(
        "<p class=soft>The interval of one training is Wilson's for a proportion; of several it is a bootstrap over "
        "training seeds, never "
        "narrower than Wilson's for all choices together. Regret is the mean of highest reward available − reward "
        "taken. The column "
        "“paper” is what Lu et al. (ICDL 2023) print.</p>"
    )
    return "".join(parts)


def _table(rows: Sequence[Row], caption: str) -> str:
    head, *lines = tables.lines(rows)
    return markup.table(head, lines, caption, tables.words(head))


def _headlines(rows: Sequence[Row]) -> list[str]:
    said = []
    for members in grouped(
        (row for row in rows if row.training_seeds and not row.sheet), lambda row: row.task
    ).values():
        row = members[0]
        trained = "one training" if len(row.training_seeds) == 1 else f"{len(row.training_seeds)} trainings"
        paper = f"; the paper prints {row.paper}" if row.paper else ""
        measured = f"{tables.interval(*row.ci95)}; {row.choices} choices of {trained}{paper}"
        said.append(
            f"{row.task}: {row.label} made the best choice {tables.percent(row.mean)} of the time ({measured})."
        )
    return said


def _task(report: Report, task: str) -> str:
    rows, runs = [row for row in report.rows if row.task == task], report.trained(task)
    drawn = {name: markup.figure(figure, caption) for name, figure, caption in report.figures(task)}
    parts = [drawn.pop("choices", ""), facts.components(rows)]
    time = drawn.pop("time", "")
    if drawn:
        parts += [
            "<h3>Learning</h3><p class=soft>Line: mean over trainings. Band: from the lowest training to the highest. "
            "Returns, errors and "
            "losses are means over a twentieth of the curve.</p>",
            *drawn.values(),
        ]
    parts += ["<h3>Where the time went</h3>", time] if time else []
    parts += stories.film_strip(report.groups(task))
    parts += stories.decision(runs)
    parts += [facts.confusion(row) for row in rows if row.confusion and not row.sheet]
    if more := [facts.confusion(row) for row in rows if row.confusion and row.sheet]:
        parts.append(
            f"<details><summary>Chosen and best in other scenes: "
            f"{_count(len(more), 'table')}</summary>{''.join(more)}</details>"
        )
    parts += [facts.calibration(runs), facts.settings(runs)]
    return "".join(parts)


def _index(names: list[str], name: str) -> int:
    return names.index(name) if name in names else len(names)


def _anchor(name: str) -> str:
    return "section-" + "".join(c if c.isalnum() else "-" for c in name.lower())


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"

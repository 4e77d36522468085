"""The page of results: what was asked for, what the thesis reached, and what was measured, each seed of it.

It is made of the JSON that ``scripts/ablations.py`` and ``scripts/reproduce.py`` leave, and of the baselines' drives.
"""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.console import Console

from navsim.errors import counted
from navsim.files import atomic_write
from rl.ablations import COMPLEX, PLACES, ROWS, UNSEEN, UNSEEN_PATHS, rates_of
from rl.baselines import BASELINES, make_baseline
from rl.evaluation import evaluate
from rl.reproduce import caption
from rl.run import write_json
from rl.series import read_results

VARIANT = "fast"
"""The row of the best named variant, which ``make train`` trains."""
ENOUGH = 0.85
"""Success whose time is told."""


class Aim(NamedTuple):
    """One line of what was asked for."""

    what: str
    row: str
    place: str
    thesis: str
    least: str
    """Percent that must be reached, in the mean over the seeds."""
    aim: int


AIMS = (
    Aim("D3QN-I, depth and heading only", "base", COMPLEX, "88", "90", 97),
    Aim("D3QN-S, depth and heading only", "S", COMPLEX, "67", "85", 97),
    Aim("best variant", VARIANT, COMPLEX, "–", "93", 98),
    Aim("the same, D3QN-S", f"S-{VARIANT}", COMPLEX, "–", "–", 97),
    Aim("D3QN-I, depth and heading only", "base", UNSEEN, "–", "85", 95),
    Aim("best variant", VARIANT, UNSEEN, "–", "90", 97),
    Aim("the same, D3QN-S", f"S-{VARIANT}", UNSEEN, "–", "–", 97),
)
SHORT_WAYS = (("D3QN-I", "fast-plain-length-0.3-longer"), ("D3QN-S", "S-fast-plain-length-0.3-longer"))
"""The rows of those who were taught what a metre costs, and longest."""
_INPUTS = (("blind", "D3QN-I, heading only"), ("depth-only", "D3QN-I, depth only"))
_TIMED = (("D3QN-I", "base"), ("D3QN-S", "S"), ("best variant", VARIANT), ("its D3QN-S", f"S-{VARIANT}"))
_SHORT_NAMES = {COMPLEX: "`complex_eval`", UNSEEN: "the unseen rooms"}
_NAMES = {COMPLEX: "`complex_eval`, 100 paths", UNSEEN: f"200 unseen rooms, {UNSEEN_PATHS:,} paths"}

_NOT_RUN = "Not run yet: `python scripts/reproduce.py`, whose `--help` tells how long that takes.\n"


def drive_baselines(path: Path, console: Console | None = None) -> dict[str, Any]:
    """What the baselines reach in the same rooms; from the file, if it is there, as they do not change.

    Args:
        path: JSON file.
        console: where progress is shown; nowhere by default.

    Raises:
        ValueError: for a file that holds something else.
    """
    if path.exists():
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
            _ = [found[name][place]["spl"] for name in BASELINES for place in PLACES]
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{path} does not hold what the baselines reach; move it away") from error
        return found
    found = {
        name: {
            place: rates_of(evaluate(make_baseline(name), world, num_paths=paths, console=console))
            for place, (world, paths) in PLACES.items()
        }
        for name in BASELINES
    }
    write_json(path, found)
    return found


def write_results(results: Path, page: Path, console: Console | None = None) -> None:
    """Writes the page.

    Args:
        results: directory with ``ablations/``, ``reproduce/`` and ``baselines.json``; what is missing is said so.
        page: Markdown file.
        console: where progress is shown; nowhere by default.

    Raises:
        ValueError: for a file there that holds something else.
    """
    runs = [read_results(file, "row", "seed", "final") for file in sorted((results / "ablations").glob("*.json"))]
    tables = results / "reproduce" / "tables.md"
    text = results_page(
        runs,
        drive_baselines(results / "baselines.json", console),
        tables.read_text(encoding="utf-8") if tables.exists() else _NOT_RUN,
        sorted(file.stem for file in (results / "reproduce").glob("figure-*.png")),
    )
    with atomic_write(page) as file:
        file.write(text)


def results_page(
    runs: Sequence[dict[str, Any]], baselines: dict[str, Any], thesis_tables: str, thesis_figures: Sequence[str] = ()
) -> str:
    """The page as Markdown.

    Args:
        runs: of the ablations, as their files hold them.
        baselines: as :func:`drive_baselines` returns them.
        thesis_tables: the tables of ``rl.reproduce``.
        thesis_figures: its figures' file names, without their ending.
    """
    by_row = {name: sorted((run for run in runs if run["row"] == name), key=_seed) for name in ROWS}
    lines = [
        "# Results",
        "",
        "Of each seed the last weights, which nothing was chosen by, greedy. *Must* and *aim* are what this project",
        "set itself before it measured, for means of five seeds. Made by `scripts/results.py` of what",
        "`scripts/ablations.py` trained; [ablations.md](ablations.md) has the commands.",
        "",
        "## Beyond the thesis",
        "",
        "| | | thesis, % | must, % | aim, % | **mean, %** | each seed | worst seed under mean | SPL / success |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for aim in AIMS:
        lines.append(
            f"| {aim.what} | {_NAMES[aim.place]} | {aim.thesis} | {aim.least} | {aim.aim} "
            f"| {' | '.join(_measured(by_row[aim.row], aim.place))} |"
        )
    of_complex, of_unseen = (_share_of_success(baselines["oracle"][place]) for place in (COMPLEX, UNSEEN))
    lines += [
        "",
        "SPL should be at least 0.93 of success. The planning oracle, which has the map and drives by the same rules,",
        f"has {of_complex} in `complex_eval` and {of_unseen} in the unseen rooms, where not even the best plans found",
        "have 0.93;",
        "[measurements.md](measurements.md#where-paths-are-longer-than-they-need-be) tells where it is lost.",
        *_short_ways(by_row),
        *_networks_alone(by_row),
        "",
        f"The best variant is `{VARIANT}`, which `make train` trains: D3QN-I, {ROWS[VARIANT].what}.",
        "",
        f"**Time to {ENOUGH:.0%}** in `complex_eval`: minutes of processor time at the first evaluation that reaches",
        "it, each seed (must: 20 minutes on two cores; aim: 10): "
        + "; ".join(f"{name} {_times(by_row[row])}" for name, row in _TIMED)
        + ". Processors differ from seed to seed (ablations.md).",
        "",
        "![success by samples and by minutes of processor time](results/ablations/curves.png)",
        "",
        "## Beside the baselines, and what each input is worth",
        "",
        f"| | {_NAMES[COMPLEX]}, % | SPL | {_NAMES[UNSEEN]}, % | SPL |",
        "|---|---|---|---|---|",
    ]
    for name, found in baselines.items():
        cells = [f"{100 * found[place]['success_rate']:.1f} | {found[place]['spl']:.2f}" for place in (COMPLEX, UNSEEN)]
        lines.append(f"| {name} | {' | '.join(cells)} |")
    named = {(aim.row, aim.what): None for aim in AIMS}
    for row, what in [*((row, name) for row, name in _INPUTS), *named]:
        cells = [_mean_and_spl(by_row[row], place) for place in (COMPLEX, UNSEEN)]
        lines.append(f"| {what} | {' | '.join(cells)} |")
    lines += [
        "",
        "## The thesis's experiment",
        "",
        "Preset `thesis`: 400,000 steps, batches of 8, squared error, one room. Intervals are of the paths that were",
        "driven, all seeds together, and do not tell how seeds differ. The thesis's shares are of one of its two",
        "image sizes; of which, this project does not know. Made by `python scripts/reproduce.py`, which goes on with",
        "what is missing; [measurements.md](measurements.md#the-thesiss-own-settings) tells what differs and why.",
        "",
        thesis_tables.rstrip(),
    ]
    if thesis_figures:
        lines += ["", "### Figures 6.1 to 6.11", ""]
    for name in thesis_figures:
        told = caption(name)
        lines += [f"![{told}](results/reproduce/{name}.png)", "", f"{told}.", ""]
    return "\n".join(lines).rstrip() + "\n"


def _seed(run: dict[str, Any]) -> int:
    return run["seed"]


def _rates(runs: Sequence[dict[str, Any]], place: str, key: str = "success_rate") -> list[float]:
    return [run["final"][place][key] for run in runs]


def _measured(runs: Sequence[dict[str, Any]], place: str) -> list[str]:
    """Mean, each seed, how far the least is under the mean, and SPL as a share of success."""
    if not runs:
        return ["not run yet", "", "", ""]
    rates = [100 * rate for rate in _rates(runs, place)]
    mean = statistics.fmean(rates)
    spl = 100 * statistics.fmean(_rates(runs, place, "spl"))
    return [
        f"**{mean:.1f}**",
        ", ".join(f"{rate:.1f}" if place == UNSEEN else f"{rate:.0f}" for rate in rates),
        f"{mean - min(rates):.1f}",
        f"{spl / mean:.2f}" if mean else "–",
    ]


def _short_ways(by_row: dict[str, list[dict[str, Any]]]) -> list[str]:
    """How near the robots come to it that learnt what a metre costs, as symmetric policies."""
    told = []
    for name, row in SHORT_WAYS:
        runs = [run["symmetric"] for run in by_row[row] if "symmetric" in run]
        if not runs:
            continue
        places = []
        for place in (COMPLEX, UNSEEN):
            rate, spl = (statistics.fmean(run[place][key] for run in runs) for key in ("success_rate", "spl"))
            places.append(f"{spl / rate:.3f} of {100 * rate:.1f}% in {_SHORT_NAMES[place]}")
        told.append(f"{name} {' and '.join(places)} (row `{row}`, {counted(len(runs), 'seed')})")
    return [f"Where a metre costs something, symmetric policies have: {'; '.join(told)}."] if told else []


def _networks_alone(by_row: dict[str, list[dict[str, Any]]]) -> list[str]:
    """What the networks of symmetric policies do without the mirror image, as a paragraph."""
    told = []
    for name, row in (("D3QN-I", "base"), ("D3QN-S", "S")):
        runs = [run for run in by_row[row] if "alone" in run]
        if not runs or len(runs) < len(by_row[row]):
            continue
        means = [100 * statistics.fmean(run["alone"][place]["success_rate"] for run in runs) for place in PLACES]
        told.append(f"{name} {means[0]:.1f} in `complex_eval` and {means[1]:.1f} in the unseen rooms")
    if not told:
        return []
    return [
        "",
        "With depth and heading only, policies are symmetric ([measurements.md](measurements.md#a-symmetric-policy)).",
        f"The same weights alone reach, in percent: {'; '.join(told)}.",
    ]


def _share_of_success(measured: dict[str, float]) -> str:
    return f"{measured['spl'] / measured['success_rate']:.2f}"


def _mean_and_spl(runs: Sequence[dict[str, Any]], place: str) -> str:
    if not runs:
        return "not run yet | "
    return (
        f"{100 * statistics.fmean(_rates(runs, place)):.1f} ({len(runs)} seed{'s' * (len(runs) > 1)}) | "
        f"{statistics.fmean(_rates(runs, place, 'spl')):.2f}"
    )


def _times(runs: Sequence[dict[str, Any]]) -> str:
    """Minutes of processor time until each run's success was enough."""
    if not runs:
        return "not run yet"
    told = []
    for run in runs:
        curve = run["curve"]
        reached = [
            seconds
            for seconds, rate in zip(curve["processor_seconds"], curve["success_rate"], strict=True)
            if rate >= ENOUGH
        ]
        told.append(f"{reached[0] / 60:.0f}" if reached else "never")
    return ", ".join(told)

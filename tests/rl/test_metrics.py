"""The metrics of driven paths, against independent formulas; how they are kept and shown."""

from __future__ import annotations

import io
import math

import numpy as np
import pytest
from rich.console import Console
from scipy.stats import binomtest

from rl.metrics import Evaluation, PathResult, comparison_table, wilson_interval


def result(outcome: str, driven: float, shortest: float, actions=(1,)) -> PathResult:
    return PathResult(
        start_index=0,
        goal_index=0,
        goal=(1.0, 0.0),
        outcome=outcome,
        reward=0.5,
        shortest_path_length=shortest,
        trajectory=np.array([[0.0, 0.0, 0.0], [driven, 0.0, 0.0]]),
        actions=np.array(actions, dtype=np.int64),
    )


@pytest.mark.parametrize(("successes", "trials"), [(0, 5), (1, 5), (5, 5), (37, 100), (99, 100), (333, 1000)])
def test_wilsons_interval_is_scipys(successes, trials):
    expected = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    assert wilson_interval(successes, trials) == pytest.approx((expected.low, expected.high), abs=1e-12)


@pytest.mark.parametrize(("successes", "trials"), [(0, 0), (3, 2), (-1, 4)])
def test_a_proportion_that_is_none_is_refused(successes, trials):
    with pytest.raises(ValueError, match=f"{successes} of {trials}"):
        wilson_interval(successes, trials)


def test_spl_of_cases_worked_out_by_hand():
    assert result("success", driven=4.0, shortest=3.0).spl == pytest.approx(0.75)
    assert result("success", driven=2.9, shortest=3.0).spl == 1.0  # never more than one
    assert result("collision", driven=3.0, shortest=3.0).spl == 0.0
    assert result("success", driven=0.04, shortest=0.0).spl == 1.0  # it began on the goal's disc
    assert result("success", driven=4.0, shortest=math.inf).spl == 1.0  # it pushed its way free
    paths = (result("success", 4.0, 3.0), result("timeout", 9.0, 3.0), result("success", 3.0, 3.0))
    assert Evaluation("p", "w", 0, paths).spl == pytest.approx((0.75 + 0.0 + 1.0) / 3)


def test_aggregates_are_means_over_all_paths():
    paths = (
        result("success", 4.0, 3.0, actions=[1, 4, 4]),
        result("collision", 1.0, 3.0, actions=[2]),
        result("success", 4.0, 3.0, actions=[]),
        result("timeout", 4.0, 3.0, actions=[4, 4, 4, 4]),
    )
    evaluation = Evaluation("p", "w", 0, paths)
    assert (evaluation.success_rate, evaluation.collision_rate, evaluation.timeout_rate) == (0.5, 0.25, 0.25)
    assert evaluation.mean_steps == 2.0
    assert evaluation.mean_reward == 0.5
    np.testing.assert_allclose(evaluation.action_distribution, [0, 1 / 8, 1 / 8, 0, 6 / 8, 0, 0])


def test_a_path_without_a_way_survives_json():
    evaluation = Evaluation("p", "w", 0, (result("collision", driven=1.0, shortest=math.inf),))
    (path,) = Evaluation.from_json(evaluation.to_json()).paths
    assert path.shortest_path_length == math.inf


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("{", "Expecting"),
        ("[]", ""),
        ('{"format": 2}', "format is 2"),
        ('{"format": 1}', "'paths'"),
        ('{"format": 1, "paths": []}', "it has no paths"),
    ],
)
def test_a_file_that_is_no_evaluation_is_named(tmp_path, text, reason):
    path = tmp_path / "broken.json"
    path.write_text(text)
    with pytest.raises(ValueError, match=rf"broken\.json cannot be read as an evaluation: .*{reason}"):
        Evaluation.load(path)
    with pytest.raises(ValueError, match=r"none\.json cannot be read"):
        Evaluation.load(tmp_path / "none.json")


def test_the_table_shows_rates_with_their_intervals():
    paths = (result("success", 4.0, 3.0), result("timeout", 9.0, 3.0))
    screen = Console(file=io.StringIO(), width=120)
    screen.print(comparison_table([Evaluation("mine", "hall", 0, paths), Evaluation("yours", "hall", 0, paths[:1])]))
    text = screen.file.getvalue()
    assert "hall" in text
    assert "50 (9–91)" in text
    assert "100 (21–100)" in text
    assert "0.38" in text


def test_names_with_brackets_are_shown_whole():
    paths = (result("success", 4.0, 3.0),)
    screen = Console(file=io.StringIO(), width=120)
    screen.print(comparison_table([Evaluation(f"run[lr={rate}]", f"hall[{rate}]", 0, paths) for rate in (1, 2)]))
    assert "hall[1], hall[2], 1 path " in screen.file.getvalue()
    assert all(name in screen.file.getvalue() for name in ("run[lr=1]", "run[lr=2]"))


def test_long_names_leave_the_numbers_of_the_table_whole():
    paths = tuple(result("collision", 4.0, 3.0) for _ in range(100))
    policy, worlds = "thesis-I-complex_train+simple_train-seed0", ["complex_eval", "generate:clutter,count=200"]
    screen = Console(file=io.StringIO(), width=80)
    screen.print(comparison_table([Evaluation(policy, world, 0, paths) for world in worlds]))
    text = screen.file.getvalue()
    assert "…" not in text
    assert text.count("100 (96–100)") == 2
    assert text.count("+0.50") == 2

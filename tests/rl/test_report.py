"""The report: self-contained, complete, and the same numbers as in the evaluations."""

from __future__ import annotations

import base64
import io
import json
import shutil
from dataclasses import replace
from html.parser import HTMLParser

import imageio.v3 as imageio
import numpy as np
import pytest
import torch
from matplotlib.colors import to_hex

from navsim.draw import OUTCOME_COLOURS
from navsim.sensor import KINECT
from navsim.task import Task
from navsim.world import World
from navsim.worldfile import load_world, save_world
from rl.baselines import make_baseline
from rl.config import TrainConfig
from rl.evaluation import evaluate
from rl.figures import action_distribution, choose_examples, example_paths, training_curves
from rl.learner import make_actor
from rl.metrics import Evaluation, PathResult
from rl.policies import load_policy
from rl.report import _depth_stack, _evaluations, write_report
from rl.run import METRICS, Run, RunError

WORLD = World.from_dict(
    {
        "format": 1,
        "name": "hall <1>",
        "size": [5, 5],
        "obstacles": [{"box": {"at": [0.5, 0.4], "size": [0.5, 0.5], "height": 0.8}}],
        "starts": [{"at": [-1.8, 0.4], "yaw_deg": 0}, {"at": [-1.8, -1.5], "yaw_deg": 0}],
        "goals": [[1.8, 0.4], [1.8, -1.5]],
    }
)


def metrics_rows():
    for step in (4000, 8000, 12000):
        row = dict.fromkeys(METRICS, 0.5) | {"step": step, "episodes": step // 50, "seconds": step / 800}
        yield row | {"success_rate": None if step == 4000 else step / 20000, "loss": 0.1 / step}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    directory = tmp_path_factory.mktemp("runs") / "tiny"
    save_world(WORLD, directory.parent / "hall.yaml")
    torch.manual_seed(0)
    run = Run.create(TrainConfig(out=directory, eval_world=str(directory.parent / "hall.yaml"), seed=7))
    run.save_policy("policy", make_actor(run.config).state_dict())
    for row in metrics_rows():
        run.metrics.append(row)
    run.evaluations.append(
        {
            "step": 12000,
            "seconds": 15.0,
            "processor_seconds": 28.0,
            "world": "hall",
            "success_rate": 0.5,
            "collision_rate": 0.5,
            "timeout_rate": 0.0,
        }
        | {"spl": 0.4, "reward": 1.0, "steps": 40.0}
    )
    for name, policy in (("D3QN-I", "straight"), ("random", "random"), ("reactive", "reactive")):
        evaluate(make_baseline(policy), WORLD, name=name).save(directory / "evaluation" / f"{name}.json")
    return run


@pytest.fixture
def no_film(monkeypatch):
    """Drawing films takes long; one is made for ``page``."""

    def film(path, *_, **__):
        path.write_bytes(b"a film")
        return path

    monkeypatch.setattr("rl.report.animate_episode", film)


class Page(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.sources, self.links, self.cells, self.text, self._open = [], [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self._open.append(tag)
        values = dict(attributes)
        self.sources += [values["src"]] if "src" in values else []
        self.links += [values["href"]] if "href" in values else []
        if tag == "tr":
            self.cells.append([])
        if tag == "td":
            self.cells[-1].append("")

    def handle_data(self, data):
        self.text.append(data)
        if self.cells and self.cells[-1] and {"td", "small"} & set(self._open[-2:]):
            self.cells[-1][-1] += data.strip() + " "

    def handle_endtag(self, tag):
        while self._open and self._open.pop() != tag:
            pass


@pytest.fixture(scope="module")
def page(run):
    path = write_report(run)
    assert path == run.directory / "report.html"
    return Page(path.read_text(encoding="utf-8"))


def test_the_report_needs_nothing_but_itself(page):
    assert page.links == []
    assert all(source.startswith("data:") for source in page.sources)


def test_pictures_and_animation_are_embedded(page, run):
    kinds = [source.partition(";")[0] for source in page.sources]
    assert kinds.count("data:image/png") == 6
    assert kinds.count("data:video/mp4") == 1
    for source in page.sources:
        content = base64.b64decode(source.partition(",")[2])
        if source.startswith("data:image/png"):
            image = imageio.imread(io.BytesIO(content))
            assert image.shape[1] > 600
            assert image.std() > 5
        else:
            assert content == (run.directory / "episode.mp4").read_bytes()
            assert len(imageio.imread(io.BytesIO(content), extension=".mp4")) > 15


def test_the_table_has_the_numbers_of_the_evaluations(page, run):
    rows = {row[0].strip(): [cell.strip() for cell in row[1:]] for row in page.cells if row}
    assert list(rows) == ["D3QN-I", "random", "reactive"]
    for name, cells in rows.items():
        evaluation = Evaluation.load(run.directory / "evaluation" / f"{name}.json")
        low, high = evaluation.interval("success")
        assert cells[0].split() == [f"{evaluation.success_rate:.0%}", f"{100 * low:.0f}–{100 * high:.0f}"]
        assert cells[3] == f"{evaluation.spl:.2f}"


def test_settings_versions_and_seed_are_there(page):
    text = " ".join(" ".join(page.text).split())
    for words in (
        "Seed 7",
        "learning_rate 0.0005",
        "camera.width 80",
        "task.max_steps 500",
        f"torch {torch.__version__}",
    ):
        assert words in text


def test_names_from_files_are_text_and_not_markup(page, run):
    assert "hall &lt;1&gt;" in (run.directory / "report.html").read_text(encoding="utf-8")


@pytest.mark.usefixtures("no_film")
def test_of_several_rooms_all_are_counted_and_the_first_is_drawn(run, tmp_path):
    source = "generate:blocks,size=4,density=0.06,count=2"
    several = Run.create(TrainConfig(out=tmp_path / "several", eval_world=source, world=(source,)))
    several.save_policy("policy", make_actor(several.config).state_dict())
    result = evaluate(make_baseline("straight"), source, name="D3QN-I", num_paths=4)
    result.save(several.directory / "evaluation" / "D3QN-I.json")
    page = Page(write_report(several).read_text(encoding="utf-8"))
    text = " ".join(page.text)
    assert f"{result.count('success')} of 4 goals in {source}, rooms that it has never seen" in text
    assert "Every path of D3QN-I in blocks-0001" in text


def test_a_run_that_was_not_finished_says_so(run, tmp_path):
    unfinished = Run.create(TrainConfig(out=tmp_path / "young"))
    with pytest.raises(RunError, match=r"no evaluation of its policy; .* navsim train --resume --report --out .*young"):
        write_report(unfinished)


@pytest.mark.usefixtures("no_film")
def test_what_chose_the_weights_is_told_beside_the_last_ones(run, tmp_path):
    copied = Run(shutil.copytree(run.directory, tmp_path / "chosen"))
    evaluate(make_baseline("straight"), WORLD, name="D3QN-I last").save(
        copied.directory / "evaluation" / "D3QN-I last.json"
    )
    copied.evaluations.append(copied.evaluations.rows()[-1])
    page = Page(write_report(copied).read_text(encoding="utf-8"))
    assert [row[0].strip() for row in page.cells if row] == ["D3QN-I", "D3QN-I last", "random", "reactive"]
    text = " ".join(" ".join(page.text).split())
    count = len(copied.evaluations.rows())
    assert f"D3QN-I has the weights of the best of {count} evaluations, which drove the same paths; nothing" in text


@pytest.mark.usefixtures("no_film")
@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"margin": 0.0}, {"m stricter": 0, "These images are ideal": 0, "The images are ideal": 0}),
        ({"margin": 0.06, "sensor": KINECT}, {"0.06 m stricter": 1, "These images are ideal": 2, "The images are": 1}),
    ],
    ids=["by-the-rules", "stricter-with-noise"],
)
def test_captions_tell_of_stricter_rules_and_of_images_that_the_robot_did_not_see(run, tmp_path, settings, told):
    copy = shutil.copytree(run.directory, tmp_path / "run")
    config = replace(run.config, **settings)
    (copy / "config.json").write_text(json.dumps(config.to_dict()), encoding="utf-8")
    text = " ".join(Page(write_report(Run(copy)).read_text(encoding="utf-8")).text)
    assert {words: text.count(words) for words in told} == told


@pytest.mark.usefixtures("no_film")
def test_a_room_that_was_trained_in_is_known_by_the_runs_copy_of_it(run, tmp_path):
    source = tmp_path / "hall.yaml"
    save_world(WORLD, source)
    other = Run.create(replace(run.config, world=(str(source),), eval_world=str(source), out=tmp_path / "run"))
    other.save_policy("policy", make_actor(other.config).state_dict())
    shutil.copytree(run.directory / "evaluation", other.directory / "evaluation")
    source.unlink()
    assert "never seen" not in write_report(other).read_text(encoding="utf-8")


@pytest.mark.usefixtures("no_film")
def test_a_run_without_versions_says_so(run, tmp_path):

    copy = tmp_path / "copy"
    shutil.copytree(run.directory, copy)
    (copy / "versions.json").write_text("{")
    with pytest.raises(RunError, match=r"versions\.json cannot be read"):
        write_report(Run.open(copy))
    assert json.loads((run.directory / "versions.json").read_text())


def path(outcome: str, length: float, start: int = 0, actions=(1, 1)) -> PathResult:
    trajectory = np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0]])
    return PathResult(start, 0, (1.0, 1.0), outcome, 0.0, 1.0, trajectory, np.array(actions, dtype=np.int64))


def test_examples_are_long_successes_from_different_starts_and_one_of_each_failure():
    paths = [path("success", 1, 0), path("success", 5, 1), path("success", 4, 1), path("success", 3, 2)]
    failures = [path("collision", 2), path("collision", 6), path("timeout", 9)]
    chosen = choose_examples(Evaluation("p", "w", 0, (*paths, *failures)))
    assert chosen == [paths[1], paths[3], failures[1], failures[2]]
    assert choose_examples(Evaluation("p", "w", 0, tuple(paths))) == [paths[1], paths[3], paths[0], paths[2]]
    assert choose_examples(Evaluation("p", "w", 0, tuple(failures))) == [failures[1], failures[2], failures[0]]
    assert choose_examples(Evaluation("p", "w", 0, tuple(paths[:1]))) == paths[:1]


def test_example_paths_say_what_became_of_them():
    figure = example_paths(WORLD, [path("success", 1.0), path("timeout", 2.0)], Task())
    assert [axes.get_title() for axes in figure.axes] == [
        "start 0 to goal 0\nsuccess after 2 steps, 1.0 m",
        "start 0 to goal 0\ntimeout after 2 steps, 2.0 m",
    ]


def test_action_bars_are_the_policys_and_marks_the_baselines():
    mine = Evaluation("mine", "w", 0, (path("success", 1, actions=[0, 0, 1, 6]),))
    other = Evaluation("other", "w", 0, (path("success", 1, actions=[4, 4]),))
    (axes,) = action_distribution([mine, other]).axes
    assert [bar.get_height() for bar in axes.patches] == [0.5, 0.25, 0, 0, 0, 0, 0.25]
    assert axes.lines[0].get_ydata().tolist() == [0, 0, 0, 0, 1, 0, 0]


def test_the_q_values_of_a_robot_with_a_memory_are_those_that_it_acted_by(monkeypatch):
    policy, acted, drawn = load_policy("pretrained:I"), [], []

    def watched(state):
        acted.append(policy(state)["action_value"][0].numpy().copy())
        return state

    watched.in_keys, watched.trained_as = policy.in_keys, policy.trained_as
    path = evaluate(watched, "complex_eval", num_paths=1).paths[0]
    monkeypatch.setattr("rl.report.draw_depth_stack", lambda *given, interval: drawn.append(given[3]))
    steps = range(3, path.steps, 6)
    for step in steps:
        _depth_stack(policy, policy.trained_as, load_world("complex_eval"), path, step)
    np.testing.assert_allclose(drawn, [acted[step] for step in steps], atol=0.005)


def test_training_curves_have_a_line_for_training_and_points_for_evaluations(run):
    ends, reward, max_q, loss = training_curves(run.metrics.rows(), run.evaluations.rows()).axes
    line, points = ends.lines[:2]
    assert to_hex(line.get_color()).upper() == OUTCOME_COLOURS["success"]
    np.testing.assert_allclose(line.get_ydata(), [np.nan, 0.4, 0.6])
    assert (points.get_xdata().tolist(), points.get_ydata().tolist()) == ([12000.0], [0.5])
    assert reward.lines[1].get_ydata().tolist() == [1.0]
    assert max_q.lines[0].get_ydata().tolist() == [0.5] * 3
    np.testing.assert_allclose(loss.lines[0].get_ydata(), [0.1 / 4000, 0.1 / 8000, 0.1 / 12000], rtol=1e-5)


@pytest.mark.usefixtures("no_film")
def test_evaluations_that_somebody_else_has_put_there_are_not_in_the_report(run, tmp_path):
    other = shutil.copytree(run.directory, tmp_path / "other")
    strange = evaluate(make_baseline("straight"), "simple_eval", name="A stranger", num_paths=1)
    strange.save(other / "evaluation" / "A stranger.json")
    assert [evaluation.policy for evaluation in _evaluations(Run(other))] == ["D3QN-I", "random", "reactive"]

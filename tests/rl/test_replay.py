"""The replay beside one that stores every transition whole and sums n-step returns with a loop."""

from __future__ import annotations

import warnings
from copy import deepcopy
from dataclasses import dataclass, field

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule
from tensordict import TensorDict, lazy_stack
from torchrl.collectors import Collector
from torchrl.envs.transforms import MultiStepTransform

from navsim.robot import MIRRORED_ACTIONS
from rl.env import NavEnv
from rl.replay import FrameStore, make_replay

HEIGHT, WIDTH = 3, 2
GAMMA = 0.9


class Environments:
    """N endless streams of random steps, as an environment and a TorchRL collector produce them."""

    def __init__(
        self, count: int, *, seed: int = 0, end_probability: float = 0.2, shades: int = 256, interval: int = 1
    ) -> None:
        self.random = np.random.default_rng(seed)
        self.count = count
        self.end_probability = end_probability
        self.shades = shades
        self.interval = interval
        self.reset()

    def _images(self) -> np.ndarray:
        return self.random.integers(0, self.shades, (self.count, 1, HEIGHT, WIDTH), np.uint8)

    def _headings(self) -> np.ndarray:
        return self.random.uniform(-3, 3, (self.count, 1)).astype(np.float32)

    def _commands(self) -> np.ndarray:
        return self.random.uniform(-1, 1, (self.count, 2)).astype(np.float32)

    def _surroundings(self) -> np.ndarray:
        return self.random.uniform(0, 2, (self.count, 36)).astype(np.float32)

    def reset(self) -> None:
        """Begins new episodes everywhere, without a word to whoever records."""
        self.images = np.repeat(self._images(), 3 * self.interval + 1, axis=1)
        self.heading, self.command = self._headings(), self._commands()
        self.surroundings = self._surroundings()

    def _step(self) -> dict:
        terminated, truncated = self.random.random((2, self.count, 1)) < self.end_probability / 2
        done = terminated | truncated
        next_images = np.concatenate([self.images[:, 1:], self._images()], axis=1)
        next_heading, next_command, next_surroundings = self._headings(), self._commands(), self._surroundings()
        step = {
            "depth": self.images[:, :: self.interval],
            "heading": self.heading,
            "command": self.command,
            "surroundings": self.surroundings,
            "action": self.random.integers(0, 7, self.count),
            "next": {
                "depth": next_images[:, :: self.interval],
                "heading": next_heading,
                "command": next_command,
                "surroundings": next_surroundings,
                "reward": self.random.normal(size=(self.count, 1)).astype(np.float32),
                "done": done,
                "terminated": terminated,
                "truncated": truncated,
            },
        }
        self.reset()
        self.images = np.where(done[..., None, None], self.images, next_images)
        self.heading = np.where(done, self.heading, next_heading)
        self.command = np.where(done, self.command, next_command)
        self.surroundings = np.where(done, self.surroundings, next_surroundings)
        return step

    def rollout(self, steps: int) -> TensorDict:
        return torch.stack([TensorDict(self._step(), [self.count]) for _ in range(steps)], dim=1)


KEYS = [
    "depth",
    "heading",
    "command",
    "surroundings",
    "action",
    *(("next", key) for key in ("depth", "heading", "command", "surroundings", "reward", "done", "terminated")),
]


@dataclass
class NaiveReplay:
    """What a replay with n-step returns should hold, in lists of whole steps."""

    capacity: int
    n_step: int
    streams: list[list[dict]] = field(default_factory=list)
    released: int = 0
    ring: dict[int, dict] = field(default_factory=dict)
    written: int = 0

    def extend(self, batch: TensorDict) -> None:
        self.streams = self.streams or [[] for _ in range(len(batch))]
        arrays = {key: batch[key].numpy().copy() for key in KEYS}
        for i, stream in enumerate(self.streams):
            for t in range(batch.shape[1]):
                step = {key: array[i, t] for key, array in arrays.items()}
                if stream and not np.array_equal(stream[-1]["next", "heading"], step["heading"]):
                    stream[-1]["next", "done"] = np.array([True])  # no step follows this one
                stream.append(step)
        transitions = []
        while self.released < len(self.streams[0]) - self.n_step:
            transitions += [self.n_step_transition(stream[self.released :]) for stream in self.streams]
            self.released += 1
        for transition in transitions[-self.capacity :]:
            self.ring[self.written % self.capacity] = transition
            self.written += 1

    def n_step_transition(self, steps: list[dict]) -> dict:
        reward, count = 0.0, 0
        for last in steps[: self.n_step]:
            reward += GAMMA**count * last["next", "reward"]
            count += 1
            if last["next", "done"]:
                break
        after = {key: last[key] for key in KEYS if key[0] == "next"}
        return {**steps[0], **after, ("next", "reward"): reward, "steps_to_next_obs": np.array([count])}

    def read(self) -> TensorDict:
        rows = [self.ring[index] for index in range(len(self.ring))]
        columns = {key: torch.from_numpy(np.stack([row[key] for row in rows])) for key in rows[0]}
        return TensorDict(columns, [len(rows)])


def assert_same_content(data: TensorDict, expected: TensorDict) -> None:
    assert data.batch_size == expected.batch_size
    for key in (*(key for key in KEYS if key in data.keys(True)), "steps_to_next_obs"):
        torch.testing.assert_close(data[key], expected[key], rtol=1e-5, atol=1e-6)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**16),
    environments=st.integers(1, 3),
    n_step=st.integers(1, 4),
    capacity=st.integers(1, 40),
    end_probability=st.sampled_from([0.0, 0.2, 0.9]),
    shades=st.sampled_from([1, 2, 256]),
    interval=st.integers(1, 3),
    others=st.sets(st.sampled_from(["command", "surroundings"])),
    batches=st.lists(st.tuples(st.integers(1, 6), st.booleans(), st.booleans()), min_size=1, max_size=10),
)
def test_content_is_that_of_a_replay_that_stores_everything(
    seed, environments, n_step, capacity, end_probability, shades, interval, others, batches
):
    """Also where the ring wraps, where images are equal by chance, and where the collector is reset."""
    world = Environments(environments, seed=seed, end_probability=end_probability, shades=shades, interval=interval)
    replay = make_replay(
        capacity,
        HEIGHT,
        WIDTH,
        batch_size=5,
        n_step=n_step,
        gamma=GAMMA,
        inputs=("depth", "heading", *others),
        frame_interval=interval,
    )
    naive = NaiveReplay(capacity, n_step)
    for length, reset_before, reset_within in batches:
        if reset_before:
            world.reset()
        batch = world.rollout(length)
        if reset_within:
            world.reset()
            batch = torch.cat([batch, world.rollout(length)], dim=1)
        replay.extend(batch)
        naive.extend(batch)
        batch.zero_()  # collectors may reuse their memory
        assert len(replay) == len(naive.ring)
        if len(replay):
            assert {"command", "surroundings"} & set(replay[:].keys()) == others
            assert_same_content(replay[:], naive.read())
    if len(replay):
        sample = replay.sample()
        assert_same_content(sample, naive.read()[sample["index"]])


class AnyUse(RuleBasedStateMachine):
    """Collecting, resets that nobody tells of, sampling, saving and restoring, in any order."""

    @initialize(
        seed=st.integers(0, 2**16),
        environments=st.integers(1, 3),
        n_step=st.integers(1, 4),
        capacity=st.integers(5, 30),
        prioritized=st.booleans(),
        interval=st.integers(1, 3),
    )
    def begin(self, seed, environments, n_step, capacity, prioritized, interval):
        self.world = Environments(environments, seed=seed, shades=4, interval=interval)
        self.make = lambda: make_replay(
            capacity,
            HEIGHT,
            WIDTH,
            batch_size=5,
            n_step=n_step,
            gamma=GAMMA,
            prioritized=prioritized,
            inputs=("depth", "heading", "command", "surroundings"),
            frame_interval=interval,
        )
        self.replay, self.naive = self.make(), NaiveReplay(capacity, n_step)

    @rule(length=st.integers(1, 12))
    def collect(self, length):
        batch = self.world.rollout(length)
        self.replay.extend(batch)
        self.naive.extend(batch)

    @rule()
    def reset_the_environments(self):
        self.world.reset()

    @rule()
    def go_on_from_a_checkpoint(self):
        saved = deepcopy(self.replay.state_dict())
        self.replay = self.make()
        self.replay.load_state_dict(saved)

    @precondition(lambda self: len(self.replay))
    @rule()
    def sample(self):
        sample = self.replay.sample()
        assert_same_content(sample, self.naive.read()[sample["index"]])
        sample["td_error"] = sample["next", "reward"].abs()
        self.replay.update_tensordict_priority(sample)

    @invariant()
    def holds_what_a_replay_that_stores_everything_holds(self):
        assert len(self.replay) == len(self.naive.ring)
        if len(self.replay):
            assert_same_content(self.replay[:], self.naive.read())


TestAnyUse = AnyUse.TestCase
TestAnyUse.settings = settings(max_examples=12, stateful_step_count=15, deadline=None)


@pytest.mark.parametrize("shape", [(6,), (2, 6), (2, 3, 6)])
def test_every_batch_dimension_but_the_last_counts_environments(shape):
    world = Environments(int(np.prod(shape[:-1])))
    batch = world.rollout(6)
    replay = make_replay(100, HEIGHT, WIDTH, batch_size=5, gamma=GAMMA)
    replay.extend(batch.reshape(shape))
    naive = NaiveReplay(100, 1)
    naive.extend(batch)
    assert_same_content(replay[:], naive.read())


def test_a_stream_that_is_joined_in_the_middle_is_stored_exactly():
    world = Environments(2, end_probability=0.0)
    world.rollout(7)
    batch = world.rollout(5)
    replay = make_replay(100, HEIGHT, WIDTH, batch_size=5)
    replay.extend(batch)
    torch.testing.assert_close(replay[:]["depth"], batch["depth"][:, :4].transpose(0, 1).flatten(0, 1))


def test_a_stream_that_breaks_between_lazily_stacked_batches_is_cut():
    """What TorchRL's ``Collector`` extends a replay with that it is given."""
    world, naive = Environments(2, end_probability=0.0), NaiveReplay(100, 3)
    replay = make_replay(100, HEIGHT, WIDTH, batch_size=5, n_step=3, gamma=GAMMA)
    for _ in range(2):
        batch = world.rollout(6)
        replay.extend(lazy_stack(list(batch.unbind(1)), 1))
        naive.extend(batch)
        world.reset()
    assert replay[:]["steps_to_next_obs"].min() == 1
    assert_same_content(replay[:], naive.read())


def test_torchrl_alone_bootstraps_from_terminal_steps_and_the_replay_does_not():
    """The reason for ``done_keys=[]``: a return that ends in a terminal step must not be bootstrapped."""
    done = torch.tensor([[[False], [False], [True], [False], [False], [False], [False]]])
    data = TensorDict({"next": {"done": done, "terminated": done, "reward": torch.ones(1, 7, 1)}}, [1, 7])
    flags = []
    for transform in (MultiStepTransform(3, GAMMA), MultiStepTransform(3, GAMMA, done_keys=[])):
        flags.append(transform.inv(data)["next", "terminated"].flatten().tolist())
    assert flags == [[False, False, True, False], [True, True, True, False]]

    world = Environments(1, end_probability=0.0)
    batch = world.rollout(3)
    batch["next", "done"][0, 2] = batch["next", "terminated"][0, 2] = True
    world.reset()
    replay = make_replay(10, HEIGHT, WIDTH, batch_size=1, n_step=3)
    replay.extend(batch)
    replay.extend(world.rollout(3))
    assert replay[:]["next", "terminated"].flatten().tolist() == [True, True, True]
    assert replay[:]["steps_to_next_obs"].tolist() == [[3], [2], [1]]


def test_fifty_thousand_transitions_fit_in_350_megabytes_and_large_images_in_1200():
    world = Environments(50, end_probability=0.08)  # episodes of 12 steps; larger images take the same numbers
    replay = make_replay(50_000, HEIGHT, WIDTH, batch_size=64, n_step=3)
    for _ in range(70):
        replay.extend(world.rollout(20))
    assert len(replay) == 50_000
    images = len(replay.transform[0]._frames)
    records = replay.storage.get(slice(None)).bytes()
    assert images * 80 * 64 + records < 350e6
    assert images * 160 * 128 + records < 1.2e9


def test_room_grows_where_episodes_are_short():
    world = Environments(2, end_probability=1.0)
    replay = make_replay(200, HEIGHT, WIDTH, batch_size=5)
    naive = NaiveReplay(200, 1)
    for _ in range(30):
        batch = world.rollout(10)
        replay.extend(batch)
        naive.extend(batch)
    assert len(replay.transform[0]._frames) > 350
    assert_same_content(replay[:], naive.read())


def test_frame_store_gives_numbers_nobody_holds_and_grows_when_all_are_held():
    store = FrameStore(expected=4, most=4, height=1, width=1)
    held: dict[int, int] = {}
    random = np.random.default_rng(0)
    for value in range(400):
        for number in random.permutation(list(held))[: max(0, len(held) - random.integers(30, 60))]:
            del held[int(number)]
        (number,) = store.reserve(1, lambda: [np.array(list(held), int)])
        assert int(number) not in held
        store[np.array([number])] = np.array([[[value % 256]]])
        held[int(number)] = value % 256
        numbers = np.array(list(held))
        assert store[numbers].flatten().tolist() == list(held.values())
    assert 40 < len(store) < 120


@pytest.mark.parametrize("prioritized", [False, True])
@pytest.mark.parametrize("through_disk", [False, True])
def test_a_restored_replay_goes_on_as_the_saved_one(prioritized, through_disk, tmp_path):
    def make(seed: int):
        generator = torch.Generator().manual_seed(seed)
        return make_replay(
            60, HEIGHT, WIDTH, batch_size=8, n_step=3, prioritized=prioritized, mirror=True, generator=generator
        )

    world = Environments(3)
    saved, restored = make(1), make(2)
    for _ in range(9):
        saved.extend(world.rollout(4))
        prioritise(saved)
    if through_disk:
        saved.dumps(tmp_path)
        restored.loads(tmp_path)
    else:
        restored.load_state_dict(saved.state_dict())
    for _ in range(30):
        batch = world.rollout(5)
        for replay in (saved, restored):
            replay.extend(batch.clone())
        one, other = saved.sample(), restored.sample()
        assert (one == other).all()
        for replay in (saved, restored):
            prioritise(replay)


def prioritise(replay) -> None:
    sample = replay.sample()
    sample["td_error"] = sample["next", "reward"].abs()
    replay.update_tensordict_priority(sample)


def test_an_empty_replay_can_be_saved_and_one_of_another_image_size_is_refused():
    world = Environments(2)
    saved, restored = (make_replay(60, HEIGHT, WIDTH, batch_size=8, n_step=3) for _ in range(2))
    restored.load_state_dict(saved.state_dict())
    saved.extend(world.rollout(2))
    restored.load_state_dict(saved.state_dict())
    batch = world.rollout(5)
    for replay in (saved, restored):
        replay.extend(batch)
    assert (saved[:] == restored[:]).all()
    with pytest.raises(ValueError, match="made with height=3, and this one with 64"):
        make_replay(60, 64, 80, batch_size=8, n_step=3).load_state_dict(saved.state_dict())
    older = saved.state_dict()
    del older["_transforms"]["transforms.0._extra_state"]["made_with"]
    restored.load_state_dict(older)
    assert (saved[:] == restored[:]).all()
    with pytest.raises(ValueError, match="2 x 3 pixels, this one is for 80 x 64"):
        make_replay(60, 64, 80, batch_size=8, n_step=3).load_state_dict(older)


def test_only_images_that_were_stored_are_saved():
    replay = make_replay(1_000, HEIGHT, WIDTH, batch_size=8)
    replay.extend(Environments(1).rollout(50))
    images = replay.transform.state_dict()["transforms.0._extra_state"]["frames"]["images"]
    assert images.untyped_storage().nbytes() < 70 * HEIGHT * WIDTH


def test_samples_are_reproducible_by_generator_and_by_global_seed():
    def samples(seed: int, *, prioritized: bool, generator: torch.Generator | None) -> torch.Tensor:
        torch.manual_seed(seed)
        replay = make_replay(60, HEIGHT, WIDTH, batch_size=8, prioritized=prioritized, generator=generator)
        replay.extend(Environments(2).rollout(20))
        return torch.stack([replay.sample()["index"] for _ in range(3)])

    for prioritized in (False, True):
        first = samples(0, prioritized=prioritized, generator=None)
        assert torch.equal(first, samples(0, prioritized=prioritized, generator=None))
        assert not torch.equal(first, samples(1, prioritized=prioritized, generator=None))
        own = [samples(seed, prioritized=prioritized, generator=torch.Generator().manual_seed(5)) for seed in (0, 1)]
        assert torch.equal(*own)


def test_prioritised_samples_follow_the_errors():
    replay = make_replay(50, HEIGHT, WIDTH, batch_size=20_000, prioritized=True)
    replay.extend(Environments(1).rollout(41))
    errors = torch.linspace(0.1, 4.0, 40) ** 2
    data = TensorDict({"index": torch.arange(40), "td_error": errors.unsqueeze(1)}, [40])
    replay.update_tensordict_priority(data)

    sample = replay.sample()

    expected = errors**0.3 / (errors**0.3).sum()
    observed = torch.bincount(sample["index"], minlength=40) / 20_000
    torch.testing.assert_close(observed, expected, rtol=0, atol=0.006)
    weights = (expected / expected.min()) ** -0.4
    torch.testing.assert_close(sample["priority_weight"], weights[sample["index"]], rtol=1e-4, atol=1e-4)

    replay.extend(Environments(1).rollout(5))  # new transitions get the greatest priority so far
    assert replay.sampler._sum_tree[40] == pytest.approx(float(errors.max()) ** 0.3)


def test_half_of_a_mirrored_sample_is_the_mirror_image():
    world = Environments(1)
    plain, mirrored = (
        make_replay(
            50,
            HEIGHT,
            WIDTH,
            batch_size=9,
            mirror=mirror,
            inputs=("depth", "heading", "command", "surroundings"),
            generator=torch.Generator().manual_seed(3),
        )
        for mirror in (False, True)
    )
    batch = world.rollout(40)
    for replay in (plain, mirrored):
        replay.extend(batch)
    expected, sample = plain.sample(), mirrored.sample()
    for i in range(4):
        expected["action"][i] = MIRRORED_ACTIONS[int(expected["action"][i])]
        for part in (expected, expected["next"]):
            part["depth"][i] = torch.from_numpy(np.flip(part["depth"][i].numpy(), axis=-1).copy())
            part["heading"][i] *= -1
            part["command"][i] *= torch.tensor([1.0, -1.0])
            part["surroundings"][i] = torch.from_numpy(part["surroundings"][i].numpy()[::-1].copy())
    assert (sample == expected).all()
    assert_same_content(mirrored[:][20:], plain[:][20:])
    assert (mirrored.storage[:] == plain.storage[:]).all()  # what is stored stays as it is


def test_data_that_cannot_be_stored_is_refused():
    for setting in ({"capacity": 0}, {"batch_size": 0}, {"n_step": 0}, {"frame_interval": 0}):
        (name,) = setting
        with pytest.raises(ValueError, match=f"{name} of a replay must be at least 1; got 0"):
            make_replay(**{"capacity": 10, "height": HEIGHT, "width": WIDTH, "batch_size": 2, **setting})
    replay = make_replay(10, HEIGHT, WIDTH, batch_size=2)
    replay.extend(Environments(2).rollout(3))
    with pytest.raises(ValueError, match="knows 2 environments, and now got 3"):
        replay.extend(Environments(3).rollout(3))
    with pytest.raises(ValueError, match="moved on by one step"):
        replay.extend(Environments(2).rollout(3).set("depth", torch.zeros(2, 3, 4, HEIGHT, WIDTH, dtype=torch.uint8)))
    with pytest.raises(ValueError, match=r"look like one step of 4 environments; .*extend\(step.unsqueeze\(-1\)\)"):
        make_replay(10, HEIGHT, WIDTH, batch_size=2).extend(Environments(4, end_probability=0.0).rollout(1)[:, 0])
    with pytest.raises(
        ValueError, match=r"\(5, 3\) looks like 5 steps of 3 environments: .* as torch.stack\(steps, -1\)"
    ):
        make_replay(10, HEIGHT, WIDTH, batch_size=2).extend(Environments(3).rollout(5).transpose(0, 1))
    with pytest.raises(RuntimeError, match="SharedFrames keeps replay-buffer write state"):
        make_replay(10, HEIGHT, WIDTH, batch_size=2).share()
    apart = make_replay(10, HEIGHT, WIDTH, batch_size=2, frame_interval=2)
    with pytest.raises(ValueError, match=r"moved on by one step.*with 2 steps from one image to the next"):
        apart.extend(Environments(2, end_probability=0.0).rollout(5))
    begun_in_the_middle = Environments(2, end_probability=0.0, interval=2)
    begun_in_the_middle.rollout(5)
    with pytest.raises(ValueError, match=r"begins with images that differ.* give a collector of several .* sync=True"):
        make_replay(10, HEIGHT, WIDTH, batch_size=2, frame_interval=2).extend(begun_in_the_middle.rollout(3))


def test_what_does_not_fit_the_replay_is_told():
    with pytest.raises(ValueError, match="inputs must be some of depth, heading"):
        make_replay(100, batch_size=8, inputs=("depth", "heading", "surrounding"))
    with pytest.raises(ValueError, match=r"inputs must be several names, such as \('depth',\); got the text 'depth'"):
        make_replay(100, batch_size=8, inputs="depth")
    with pytest.raises(ValueError, match="half of each sample cannot be mirrored where it is of 1"):
        make_replay(100, batch_size=1, mirror=True)
    batch = Environments(2).rollout(3)
    other = make_replay(100, height=HEIGHT + 1, width=WIDTH, batch_size=8)
    with pytest.raises(
        ValueError, match=r"depth images of shape \(4, 4, 2\).* got \(4, 3, 2\): give make_replay the height"
    ):
        other.extend(batch)
    replay = make_replay(100, height=HEIGHT, width=WIDTH, batch_size=8)
    with pytest.raises(ValueError, match=r"uint8; got torch.float32: divide by 255 in the network"):
        replay.extend(batch.clone().set("depth", batch["depth"].float()))
    with pytest.raises(ValueError, match=r"transitions need \('next', 'depth'\); a collector leaves it out"):
        replay.extend(batch.exclude(("next", "depth")))
    with pytest.raises(ValueError, match="a transition alone has no place in a stream"):
        replay.extend(batch[0, 0])
    with pytest.raises(ValueError, match=r"fed by batches \(N, T\): extend\(step.unsqueeze\(-1\)\)"):
        replay.add(batch[:, 0])
    of_unequal_processes = lazy_stack([Environments(2).rollout(3), Environments(3).rollout(3)])
    with pytest.raises(ValueError, match=r"shape \(2, -1, 3\) not all parts are alike: .* as many robots"):
        replay.extend(of_unequal_processes)
    assert len(replay) == 0


def test_batches_of_processes_that_take_turns_are_warned_about_and_resets_are_not():
    replay = make_replay(100, height=HEIGHT, width=WIDTH, batch_size=4)
    processes = [Environments(2, seed=seed, end_probability=0.0) for seed in (1, 2)]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for process in (*processes, processes[0]):  # each begins once, and the first is seen again once
            replay.extend(process.rollout(4))
    with pytest.warns(UserWarning, match="in the midst of episodes that are not those .* give it sync=True"):
        replay.extend(processes[1].rollout(4))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        replay.extend(processes[0].rollout(4))  # once is enough

    replay = make_replay(100, height=HEIGHT, width=WIDTH, batch_size=4)
    going_on = Environments(2, end_probability=0.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for seed in range(5):
            replay.extend(Environments(2, seed=seed, end_probability=0.0).rollout(4))  # as env.rollout(4) begins anew
        for _ in range(5):
            replay.extend(going_on.rollout(4))


def test_padding_is_refused_and_whole_trajectories_are_taken_by_the_collector():
    batch = Environments(2).rollout(6)
    batch["collector", "mask"] = torch.ones(2, 6, dtype=torch.bool)
    replay = make_replay(100, height=HEIGHT, width=WIDTH, batch_size=4)
    replay.extend(batch)
    batch["collector", "mask"][0, 4:] = False  # as trajs_per_batch and split_trajs fill episodes up
    with pytest.raises(ValueError, match=r"of 12 steps 2 are padding .* preemptive_threshold, .* \(replay_buffer=\)"):
        replay.extend(batch)
    assert len(replay) == 10
    replay = make_replay(500, batch_size=4)
    filling = Collector(
        NavEnv("complex_train", 3, seed=0),
        None,
        frames_per_batch=60,
        total_frames=360,
        trajs_per_batch=3,
        replay_buffer=replay,
    )
    for _ in filling:
        pass
    assert len(replay) > 0
    assert replay[:]["depth"].flatten(1).any(dim=1).all()


def test_an_emptied_replay_has_nothing_of_before():
    replay = make_replay(100, height=HEIGHT, width=WIDTH, batch_size=8, n_step=3, prioritized=True)
    replay.extend(Environments(2).rollout(12))
    replay.empty()
    batch = Environments(3).rollout(10)  # of another number, too
    replay.extend(batch)
    fresh = make_replay(100, height=HEIGHT, width=WIDTH, batch_size=8, n_step=3)
    fresh.extend(batch)
    for key in ("depth", "action", ("next", "reward"), ("next", "depth")):
        torch.testing.assert_close(replay[:][key], fresh[:][key])


@pytest.mark.parametrize("frame_interval", [1, 3])
def test_images_go_on_where_a_collector_calls_its_last_step_truncated(frame_interval):
    env = NavEnv("complex_train", 3, seed=0, frame_interval=frame_interval)
    replay = make_replay(1000, batch_size=4, n_step=2, frame_interval=frame_interval)
    collected = []
    for batch in Collector(env, None, frames_per_batch=30, total_frames=90, set_truncated=True):
        collected.append(batch.clone())
        replay.extend(batch)
    steps = torch.cat([batch["depth"] for batch in collected], dim=1)
    known = steps[:, :-2].flatten(0, 1)  # the last two wait for their return
    assert len(replay) == len(known)
    assert {bytes(stack.numpy()) for stack in known} == {bytes(stack.numpy()) for stack in replay[:]["depth"]}
    assert replay[:]["steps_to_next_obs"].max() == 2


@pytest.mark.parametrize(
    "changes", [{"capacity": 80}, {"n_step": 2}, {"frame_interval": 2}, {"inputs": ("depth", "heading", "command")}]
)
def test_the_state_of_another_replay_is_refused_and_changes_nothing(changes):
    made_with = {"capacity": 50, "height": HEIGHT, "width": WIDTH, "batch_size": 4, "n_step": 3}
    replay = make_replay(**made_with)
    replay.extend(Environments(2).rollout(10))
    other = make_replay(**made_with | changes)
    before = other.state_dict()
    name = next(iter(changes))
    with pytest.raises(ValueError, match=rf"the saved replay was made with {name}=.*; make it with the same arguments"):
        other.load_state_dict(replay.state_dict())
    assert len(other) == 0
    assert other.state_dict()["_storage"] == before["_storage"]


def test_what_is_read_by_its_index_is_not_mirrored():
    replay = make_replay(50, height=HEIGHT, width=WIDTH, batch_size=8, mirror=True)
    replay.extend(Environments(2).rollout(12))
    whole = replay[:]
    for index in (0, 3, len(replay) - 1):
        assert (replay[index] == whole[index]).all()
        assert (replay[index : index + 1][0] == whole[index]).all()
    sample = replay.sample()
    assert "depth" in sample
    stored = {tuple(row.flatten().tolist()) for row in whole["depth"][:, -1]}
    assert not all(tuple(row.flatten().tolist()) in stored for row in sample["depth"][:4, -1])

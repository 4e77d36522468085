"""The navigation task as a TorchRL environment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from tensordict import TensorDict, TensorDictBase
from torch.utils._pytree import tree_map
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from navsim.camera import DepthCamera
from navsim.randomization import Randomization
from navsim.robot import NUM_ACTIONS, TURTLEBOT2, Robot
from navsim.sensor import SensorModel
from navsim.simulator import Observation, Simulator
from navsim.task import Path, Task
from navsim.worldsource import TRAINING_SEED, WorldSource, worlds_from
from rl.observation import NUM_FRAMES, history_length, stack_of
from rl.surroundings import REACH, SECTORS, Surroundings

if TYPE_CHECKING:
    from navsim.plan import PlanPictures


class NavEnv(EnvBase):
    """N robots that look for their goals, as one batched TorchRL environment.

    What a step holds, with its shape (N robots, H x W pixels):

    ==============================  ==========================  ====================================================
    ``depth``                       uint8 ``(N, 4, H, W)``      oldest image first, the current one last; 255 = 5 m,
                                                                0 = no return. An episode's first image is repeated.
    ``heading``                     float32 ``(N, 1)``          bearing of the goal, radians in (-pi, pi], + is left
    ``command``                     float32 ``(N, 2)``          linear (m/s) and angular (rad/s) command in force
    ``action``                      int64 ``(N,)``              one of seven, see ``navsim.robot.ACTIONS``
    ``reward``                      float32 ``(N, 1)``
    ``done``, ``terminated``,       bool ``(N, 1)``             ``truncated``: the time limit; ``terminated``: the goal
    ``truncated``                                               or a collision
    ``success``, ``collision``      bool ``(N, 1)``             why it ended
    ``bumper``, ``too_near``        bool ``(N, 1)``             what collided in this step: the bumper hit something, a
                                                                pixel is nearer than the task's ``collision_depth``
    ``surroundings``                float32 ``(N, 36)``         if asked for: metres, at most 2, to the nearest thing
                                                                remembered in each direction, see ``rl.surroundings``
    ``pose``                        float32 ``(N, 3)``          x, y (m), yaw (rad): for analysis, not for policies
    ==============================  ==========================  ====================================================

    Finished robots are reset one by one through ``"_reset"``, as every TorchRL collector does; ``reset(paths=...)``
    begins the episodes that ``Simulator.reset`` names so. Robots that ``"_step"`` leaves out, as
    ``rollout(..., break_when_all_done=True)`` does with those that have arrived, stay as they are; TorchRL then repeats
    their last steps, rewards and all, which neither sums nor a replay should count, and cannot do so in its
    ``SerialEnv`` and ``ParallelEnv`` of environments of several robots. To act less often, give ``task`` a longer
    ``control_period``: ``FrameSkipTransform`` goes on after an episode's end.

    Args:
        world: a world, the path of a world file (or the name of a shipped one), or generated rooms such as
            ``"generate:clutter,count=200"`` (see ``navsim.worldsource``); or a sequence of these. With several worlds,
            every episode draws its own.
        num_envs: number of robots, N.
        camera: image size and everything else about the camera.
        task: rewards, ends and time limit.
        robot: its size and limits.
        sensor: noise, lost returns and latency of the depth images; none by default.
        randomization: what each episode draws anew of camera, wheels, sensor and start; nothing by default.
        frame_interval: steps from one image of the stack to the next.
        surroundings: whether robots remember what stood around them.
        seed: of everything drawn at random; ``set_seed`` replaces it. Fresh entropy by default. Generated rooms are
            told apart by a seed in their source; those without are the rooms that a run of seed 0 trains in.
        device: where tensors are put; the simulation runs on the CPU.

    Raises:
        navsim.WorldError: for a world file that cannot be used.
        ValueError: for settings that cannot be used.

    >>> env = NavEnv("complex_train", num_envs=2, seed=0)
    >>> env.rollout(3, break_when_any_done=False)["depth"].shape
    torch.Size([2, 3, 4, 64, 80])
    """

    batch_locked = True

    def __init__(
        self,
        world: WorldSource | Sequence[WorldSource],
        num_envs: int = 1,
        *,
        camera: DepthCamera | None = None,
        task: Task | None = None,
        robot: Robot = TURTLEBOT2,
        sensor: SensorModel | None = None,
        randomization: Randomization | None = None,
        frame_interval: int = 1,
        surroundings: bool = False,
        seed: int | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        super().__init__(device=device, batch_size=torch.Size([num_envs]))
        if frame_interval < 1:
            raise ValueError(f"frame_interval must be at least 1; got {frame_interval}")
        self.frame_interval = frame_interval
        worlds = worlds_from(world, default_seed=TRAINING_SEED)
        self.simulator = Simulator(
            worlds,
            num_envs,
            camera=camera or DepthCamera(),
            task=task or Task(),
            robot=robot,
            sensor=sensor,
            randomization=randomization,
            seed=seed,
            draw_worlds=len(worlds) > 1,
        )
        height, width = self.simulator.camera.height, self.simulator.camera.width
        self._history = torch.zeros((num_envs, history_length(frame_interval), height, width), dtype=torch.uint8)
        self.surroundings: Surroundings | None = None
        if surroundings:
            self.surroundings = Surroundings(
                num_envs,
                self.simulator.camera,
                robot=self.simulator.robot,
                lossy=self.simulator.sensor.loses_returns,
            )
        self._pictures: PlanPictures | None = None
        self._make_specs(num_envs, height, width)

    def _make_specs(self, n: int, height: int, width: int) -> None:
        flag = Binary(n=1, shape=(n, 1), dtype=torch.bool)
        self.observation_spec = Composite(
            depth=Bounded(0, 255, shape=(n, NUM_FRAMES, height, width), dtype=torch.uint8),
            heading=Bounded(-math.pi, math.pi, shape=(n, 1), dtype=torch.float32),
            command=Unbounded(shape=(n, 2), dtype=torch.float32),
            pose=Unbounded(shape=(n, 3), dtype=torch.float32),
            success=flag.clone(),
            collision=flag.clone(),
            bumper=flag.clone(),
            too_near=flag.clone(),
            shape=(n,),
        ).to(self.device)
        if self.surroundings is not None:
            self.observation_spec["surroundings"] = Bounded(
                0.0, REACH, shape=(n, SECTORS), dtype=torch.float32, device=self.device
            )
        self.action_spec = Categorical(NUM_ACTIONS, shape=(n,), dtype=torch.int64).to(self.device)
        self.reward_spec = Unbounded(shape=(n, 1), dtype=torch.float32).to(self.device)
        self.done_spec = Composite(done=flag.clone(), terminated=flag.clone(), truncated=flag.clone(), shape=(n,)).to(
            self.device
        )

    def _reset(
        self, tensordict: TensorDictBase | None = None, *, paths: Sequence[Path | None] | None = None
    ) -> TensorDictBase:
        mask = None
        if tensordict is not None and "_reset" in tensordict:
            mask = tensordict["_reset"].reshape(-1).cpu().numpy()
        observation = self.simulator.reset(mask, paths)
        if self.surroundings is not None:
            self.surroundings.begin(observation.depth, self.simulator.image_poses, mask)
        depth = torch.from_numpy(observation.depth)
        if mask is None:
            self._history = depth.unsqueeze(1).repeat(1, self._history.shape[1], 1, 1)
        else:
            self._history = self._history.clone()  # the last step's tensors may still be somebody's data
            chosen = torch.from_numpy(np.flatnonzero(mask))
            self._history[chosen] = depth[chosen].unsqueeze(1)
        false = torch.zeros((*self.batch_size, 1), dtype=torch.bool)
        return self._pack(
            observation,
            success=false,
            collision=false.clone(),
            bumper=false.clone(),
            too_near=false.clone(),
            done=false.clone(),
            terminated=false.clone(),
            truncated=false.clone(),
        )

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        asked = tensordict.get("_step", None)
        mask = None if asked is None or asked.all() else asked.reshape(-1).cpu().numpy()
        moved = self.simulator.step(tensordict["action"].cpu().numpy(), mask)
        if self.surroundings is not None:
            self.surroundings.see(moved.depth, self.simulator.image_poses, mask)
        history = torch.cat([self._history[:, 1:], torch.from_numpy(moved.depth).unsqueeze(1)], dim=1)
        terminated, truncated = _column(moved.terminated), _column(moved.truncated)
        flags = {
            "success": _column(moved.success),
            "collision": _column(moved.collision),
            "bumper": _column(moved.bumper),
            "too_near": _column(moved.too_near),
            "done": terminated | truncated,
            "terminated": terminated,
            "truncated": truncated,
        }
        if mask is not None:  # the robots that are left out keep their images and what is said of their episodes
            held = torch.from_numpy(np.flatnonzero(~mask))
            history[held] = self._history[held]
            for key, flag in flags.items():
                if (before := tensordict.get(key, None)) is not None:
                    flag[held] = before.cpu()[held]
        self._history = history
        observation = Observation(moved.depth, moved.heading, moved.pose)
        return self._pack(observation, reward=_column(moved.reward), **flags)

    def _pack(self, observation: Observation, **others: torch.Tensor) -> TensorDict:
        entries = {
            "depth": stack_of(self._history),
            "heading": _column(observation.heading),
            "command": torch.from_numpy(self.simulator.commands.astype(np.float32)),
            "pose": torch.from_numpy(observation.pose),
            **others,
        }
        if self.surroundings is not None:
            entries["surroundings"] = torch.from_numpy(self.surroundings.nearest(self.simulator.poses))
        return TensorDict(entries, batch_size=self.batch_size, device=self.device)

    def maybe_reset(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Begins new episodes where they have ended: what ``EnvBase.maybe_reset`` returns, in a third of its time.

        ``EnvBase`` merges the reset robots' entries into those of the others. There is nothing to merge: ``_reset``
        returns what all robots perceive, and no flag is set of a robot whose episode goes on.
        """
        done = tensordict.get("done")
        if not done.any():
            return tensordict
        ended = TensorDict({"_reset": done.clone()}, batch_size=self.batch_size, device=self.device)
        return tensordict.update(self._reset(ended))

    def render(self, size: int = 320) -> np.ndarray:
        """What goes on, seen from above: each robot in its world, what it sees of it, and its goal.

        TorchRL's ``PixelRenderTransform`` calls it, and its ``VideoRecorder`` makes films of that.

        Args:
            size: pixels of a side; each world is as large as fits.

        Returns:
            RGB, uint8 ``(N, size, size, 3)``.
        """
        if self._pictures is None or self._pictures.size != size:
            from navsim.plan import PlanPictures  # here, since matplotlib takes longer to import than all the rest

            self._pictures = PlanPictures(self.simulator, size)
        return self._pictures.draw(self._history[:, -1].numpy())

    def _set_seed(self, seed: int | None) -> None:
        self.simulator.reseed(seed)

    def state_dict(self, *args, **kwargs) -> dict:
        """All that the future depends on: robots, episodes, generators, image stacks, memories.

        Tensors and plain values only, which ``torch.load`` reads.
        """
        state = {"simulator": self.simulator.state_dict(), "frames": self._history.clone()}
        if self.surroundings is not None:
            state["surroundings"] = self.surroundings.state_dict()
        return tree_map(_as_tensor, state)

    def load_state_dict(self, state_dict: dict, strict: bool = True, *args, **kwargs) -> None:
        """Goes on exactly where ``state_dict`` was taken; of an empty one, which TorchRL's ``Collector`` keeps of an
        environment like this, nothing is changed.

        Nor is it where ``strict`` is False, as when TorchRL's ``EnvCreator`` hands what transforms have gathered, and
        half of the state of an environment that it has made to try it, to all that it makes: they would drive alike.

        Raises:
            ValueError: for a state of an environment with another number of robots, other worlds, images, sensors or
                memory; then nothing is changed.
        """
        if not state_dict or not strict:
            return
        own, given = tuple(self._history.shape), tuple(state_dict["frames"].shape)
        if own != given:
            raise ValueError(
                f"the state's images are of shape {given} (robots, images, height, width), and this environment's of "
                f"{own}: create it with the same num_envs, camera and frame_interval"
            )
        if (self.surroundings is not None) != ("surroundings" in state_dict):
            kept = "no" if self.surroundings is not None else "a"
            raise ValueError(f"the state holds {kept} memory of the surroundings: create it with the same surroundings")
        self.simulator.load_state_dict(tree_map(_as_array, state_dict["simulator"]))
        self._history = state_dict["frames"].clone()
        if self.surroundings is not None:
            self.surroundings.load_state_dict(tree_map(_as_array, state_dict["surroundings"]))


def _as_tensor(value: Any) -> Any:
    return torch.from_numpy(value) if isinstance(value, np.ndarray) else value


def _as_array(value: Any) -> Any:
    return value.numpy() if isinstance(value, torch.Tensor) else value


def _column(values: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(values).unsqueeze(-1)

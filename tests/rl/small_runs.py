"""Training runs of seconds, for tests."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from navsim.camera import DepthCamera
from rl.config import PRESETS, TrainConfig

HALL = Path(__file__).with_name("hall.yaml")


def small_config(out: Path, **settings: Any) -> TrainConfig:
    """Settings of a run in ``out`` with small images, few robots in a small room and a small replay."""
    small = replace(
        PRESETS["memoryless"],
        camera=DepthCamera(width=20, height=12),
        world=(str(HALL),),
        eval_world=str(HALL),
        rearrangements=1,
        total_steps=768,
        num_envs=8,
        steps_per_batch=32,
        warmup_steps=128,
        n_step=5,
        batch_size=16,
        steps_per_update=16,
        replay_capacity=512,
        log_interval=256,
        eval_interval=384,
        checkpoint_interval=384,
        num_threads=1,
        autocast="float32",
        out=out,
    )
    return replace(small, **settings)


def tiny_config(out: Path, **settings: Any) -> TrainConfig:
    """The smallest images, and 16 robots."""
    tiny = {
        "camera": DepthCamera(width=14, height=10),
        "total_steps": 512,
        "num_envs": 16,
        "steps_per_update": 32,
        "log_interval": 64,
    }
    return small_config(out, **{**tiny, **settings})

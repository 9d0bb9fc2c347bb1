"""Named configurations: data, one for each task and algorithm.

They lie in ``configs/ALGO.toml``: what holds for all tasks, then what a task has differently.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict, dataclass, field, fields, replace
from importlib import resources
from typing import Any

from trocar.errors import InvalidOption, UnknownTask, refuse
from trocar.registration import NAMESPACE, RATES, TASKS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ALGORITHMS = ("ddpg", "her", "her-demo", "ppo")
"""DDPG, DDPG with hindsight replay, the same with demonstrations, PPO."""

_PARTS = {
    ("ddpg", "her", "her-demo"): (
        *("buffer_size", "learning_starts", "updates", "tau", "averaged", "noise"),
    ),
    ("her", "her-demo"): ("random_actions", "goals", "action_l2"),
    ("her-demo",): (
        *("demos", "demo_batch", "policy_weight", "clone_weight", "q_filter"),
        *("curriculum", "curriculum_success"),
    ),
    ("ppo",): ("passes", "gae_lambda", "clip_range"),
}
"""The algorithms that only some of the fields are for, and these."""


@dataclass(frozen=True)
class Config:
    """All that decides a training run, but its seed."""

    task: str
    """Id without namespace, e.g. ``NeedlePick-v0``."""
    algo: str
    """One of :data:`ALGORITHMS`."""
    task_options: dict[str, Any] = field(default_factory=dict)
    """The task's options, where they are not its defaults."""
    epochs: int = 50
    epoch_episodes: int = 40
    """Episodes of an epoch, over all environments."""
    eval_episodes: int = 50
    """Episodes of the evaluation after each epoch, of the same seeds each time."""
    envs: int = 2
    """Environments that collect into one replay buffer."""

    inputs: tuple[str, ...] = ("observation", "desired_goal")
    """What of the observation the networks see."""
    norm_eps: float = 0.01
    """Least standard deviation by which inputs are divided, in their own units."""
    norm_clip: float = 5.0
    """Largest normalised input."""
    hidden: tuple[int, ...] = (256, 256, 256)
    """Widths of hidden layers, of actor and critic."""
    learning_rate: float = 1e-3
    gamma: float = 0.98
    batch_size: int = 256
    train_every: int = 50
    """Steps of each environment between two trainings."""

    buffer_size: int = 1_000_000
    """Most transitions that are kept."""
    learning_starts: int = 0
    """Steps of uniformly random actions, over all environments, before the first training."""
    updates: int = 40
    """Gradient steps in a training."""
    tau: float = 0.05
    """Part by which target networks move: after each update (``ddpg``) or training (``her``)."""
    averaged: bool = False
    """Whether the target actor acts: a moving average, as ``tau`` says, of the one that is trained.
    Source: Polyak and Juditsky, Acceleration of Stochastic Approximation by Averaging, 1992."""
    noise: float = 0.2
    """Standard deviation of the noise on actions while exploring."""
    random_actions: float = 0.0
    """Part of actions that are uniformly random while exploring."""
    goals: int = 4
    """Hindsight goals for each goal that was given."""
    action_l2: float = 0.0
    """Weight of the mean squared action in the policy's loss."""

    demos: int = 0
    """Episodes of demonstrations that are run; those that succeed are learnt from."""
    demo_batch: int = 0
    """How many of a batch are from demonstrations."""
    policy_weight: float = 1.0
    """Weight of DDPG's loss of the policy, beside that of cloning."""
    clone_weight: float = 0.0
    """Weight of the sum of squared differences from demonstrated actions."""
    q_filter: bool = True
    """Whether to clone only actions that the critic rates above the policy's own."""

    curriculum: int = 0
    """Levels of a curriculum from snapshots: into how many parts demonstrations are cut, for
    episodes to begin between them (:mod:`trocar.rl.curriculum`). 0: they begin as the task's do."""
    curriculum_success: float = 0.5
    """Part of the latest episodes from a level that must succeed, with the noise of exploring,
    before they begin one earlier."""

    passes: int = 10
    """PPO: passes over what was collected."""
    gae_lambda: float = 0.95
    """PPO: of the advantage's estimate."""
    clip_range: float = 0.2
    """PPO: most that the ratio of probabilities may move."""

    @property
    def task_id(self) -> str:
        """The Gymnasium id."""
        return f"{NAMESPACE}/{self.task}"

    @property
    def steps(self) -> int:
        """Steps of an episode that lasts to its end."""
        nominal = RATES.get(self.task, 5)
        return round(TASKS[self.task] * self.task_options.get("rate", nominal) / nominal)

    @property
    def epoch_steps(self) -> int:
        """Steps of an epoch, over all environments."""
        return self.epoch_episodes * self.steps

    def to_json(self) -> str:
        """As text, which :meth:`from_json` reads."""
        return json.dumps(asdict(self), indent=2)

    @classmethod
    def from_json(cls, text: str) -> Config:
        """The configuration that :meth:`to_json` wrote."""
        return _checked(cls(**_tuples(json.loads(text))))

    def but(self, **changes: Any) -> Config:
        """With other values.

        Raises:
            ValueError: There is no such field, or it has another type.
        """
        for name, value in changes.items():
            _check_field(name, value)
        return _checked(replace(self, **_tuples(changes)))


def load(task: str, algo: str) -> Config:
    """The configuration of a task and algorithm.

    Args:
        task: Id with or without namespace and version, e.g. ``NeedlePick``.
        algo: One of :data:`ALGORITHMS`.

    Raises:
        ValueError: One of them is unknown, or they do not go together.
    """
    task = task_name(task)
    if algo not in ALGORITHMS:
        raise refuse(InvalidOption, "algo", algo, f"allowed are {list(ALGORITHMS)}")
    text = resources.files(__package__).joinpath(f"configs/{algo}.toml").read_text()
    tables = tomllib.loads(text)
    return Config(task, algo).but(**(tables["all"] | tables.get(task, {})))


def task_name(task: str) -> str:
    """The id without namespace of a task that may be named in short."""
    name = task.removeprefix(f"{NAMESPACE}/")
    for known in (name, f"{name}-v0"):
        if known in TASKS:
            return known
    raise refuse(UnknownTask, "task", task, f"allowed are {list(TASKS)}")


def _tuples(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: tuple(value) if isinstance(value, list) else value for name, value in values.items()
    }


def _check_field(name: str, value: Any) -> None:
    known = {known.name: known for known in fields(Config)}
    if name not in known or name in ("task", "algo"):
        raise refuse(
            InvalidOption, name, value, f"allowed are {sorted({*known} - {'task', 'algo'})}"
        )
    # Annotations are text here.
    kinds: dict[str, Any] = {"int": int, "float": (int, float), "bool": bool, "dict": dict}
    kind = str(known[name].type).partition("[")[0]
    wanted = kinds.get(kind, (list, tuple))
    if not isinstance(value, wanted) or (isinstance(value, bool) and kind != "bool"):
        raise refuse(InvalidOption, name, value, f"expected {known[name].type}")


def _checked(config: Config) -> Config:
    """The configuration, if its values go together."""

    def check(holds: bool, name: str, allowed: str) -> None:
        if not holds:
            raise refuse(InvalidOption, name, getattr(config, name), allowed)

    defaults = {known.name: known.default for known in fields(Config)}
    for algorithms, names in _PARTS.items():
        for name in names if config.algo not in algorithms else ():
            allowed = f"{config.algo} does not use it: it is for {list(algorithms)}"
            check(getattr(config, name) == defaults[name], name, allowed)
    goals = config.task != "ActiveTrack-v0"
    if not goals:
        allowed = "the task has no goals: allowed are ['ddpg', 'ppo']"
        check(config.algo in ("ddpg", "ppo"), "algo", allowed)
    counts = ("epochs", "epoch_episodes", "eval_episodes", "envs", "batch_size", "train_every")
    for name in counts:
        check(getattr(config, name) >= 1, name, "allowed are numbers from 1 on")
    collected = config.envs * config.train_every
    allowed = f"{config.envs} envs of it must divide an epoch of {config.epoch_steps} steps"
    check(config.epoch_steps % collected == 0, "train_every", allowed)
    if config.algo == "ppo":
        allowed = f"allowed is what divides the {collected} steps that are collected"
        check(collected % config.batch_size == 0, "batch_size", allowed)
    if config.algo.startswith("her"):
        allowed = f"episodes must have ended: allowed are multiples of {config.steps}"
        check(config.train_every % config.steps == 0, "train_every", allowed)
    if config.algo == "her-demo":
        check(config.demos >= 1, "demos", "allowed are numbers from 1 on")
        allowed = f"allowed are numbers from 1 to {config.batch_size - 1}"
        check(1 <= config.demo_batch < config.batch_size, "demo_batch", allowed)
        allowed = f"allowed are 0, for none, and 2 to {config.steps} levels"
        check(config.curriculum in (0, *range(2, config.steps + 1)), "curriculum", allowed)
        allowed = "allowed are numbers above 0, up to 1"
        check(0.0 < config.curriculum_success <= 1.0, "curriculum_success", allowed)
    known = {"observation", "achieved_goal", "desired_goal"}
    check(bool(config.inputs) and {*config.inputs} <= known, "inputs", f"allowed are {known}")
    return config

"""Named configurations: data, one for each task and algorithm.

They lie in ``configs/ALGO.toml``: what holds for all tasks, then what a task has differently.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, replace
from importlib import resources
from typing import Any

from trocar.errors import InvalidOption, refuse
from trocar.registration import NAMESPACE, SERVED, TASKS, schedule
from trocar.rl.features import CONTACT, WORDS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

BASELINES = ("ddpg", "her", "her-demo", "ppo")
"""Stable-Baselines3's DDPG, the same with hindsight replay, with demonstrations too; its PPO."""

OWN = ("td3-demo", "td3-her", "bc", "dagger")
"""TD3 with hindsight goals and demonstrations, the same without demonstrations; behaviour cloning,
and DAgger."""

ALGORITHMS = (*BASELINES, *OWN)

_TD3 = ("td3-demo", "td3-her")
_CLONING = ("td3-demo", "bc", "dagger")
_PARTS = {
    (*BASELINES, *_TD3): (
        *("learning_rate", "gamma", "train_every", "curriculum", "curriculum_success"),
    ),
    ("ddpg", "her", "her-demo", *_TD3): (
        *("buffer_size", "learning_starts", "updates", "tau", "noise"),
    ),
    ("ddpg", "her", "her-demo"): ("averaged",),
    ("her", "her-demo", *_TD3): ("random_actions",),
    ("her", "her-demo"): ("goals", "action_l2"),
    ("her-demo", *_TD3): ("policy_weight",),
    ("her-demo", "td3-demo"): ("demo_batch", "clone_weight", "q_filter"),
    _TD3: (
        "hindsight",
        "warm_up",
        "ramp",
        "target_noise",
        "policy_every",
        "averaging",
        "critic_updates",
        "critics",
        "n_steps",
    ),
    ("td3-demo",): ("demo_hindsight", "own_demos"),
    _CLONING: ("clone_updates", "clone_rate", "demo_noise"),
    ("ppo",): ("passes", "gae_lambda", "clip_range"),
}
"""The algorithms that only some of the fields are for, and these."""

BEST = {
    **dict.fromkeys(TASKS, "dagger"),
    **dict.fromkeys(("NeedleReach-v0", "EcmReach-v0", "MisOrient-v0", "StaticTrack-v0"), "td3-her"),
    "ActiveTrack-v0": "bc",
}
"""The algorithm that is best for each task, as far as is known."""


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
    enough: float = 0.0
    """Success in an evaluation after which training ends; 0: it ends after its epochs."""
    envs: int = 2
    """Environments that collect into one replay buffer."""

    inputs: tuple[str, ...] = ("observation", "desired_goal")
    """What the networks see: arrays of the observation, or ``relative`` features made from them."""
    contact: bool = False
    """Whether they also see what touches the fingers."""
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
    """Gradient steps in a training; ``td3``: of the critics."""
    tau: float = 0.05
    """Part by which target networks move: after each update, or each training (``her``)."""
    averaged: bool = False
    """Whether the target actor acts: a moving average, as ``tau`` says, of the one that is trained.
    Source: Polyak and Juditsky, Acceleration of Stochastic Approximation by Averaging, 1992."""
    noise: float = 0.2
    """Standard deviation of the noise on actions while exploring; ``td3``: its mean, since that of
    an episode is drawn between 0 and twice as much."""
    random_actions: float = 0.0
    """Part of actions that are uniformly random while exploring."""
    goals: int = 4
    """Hindsight goals for each goal that was given."""
    action_l2: float = 0.0
    """Weight of the mean squared action in the policy's loss."""

    demos: int = 0
    """Episodes of demonstrations that are run; those that succeed are learnt from. Algorithms that
    learn from none need some for a curriculum."""
    demo_noise: float = 0.0
    """Mean standard deviation of the noise on what the expert does while it demonstrates; an
    episode's is drawn between 0 and twice as much. What it wanted to do is cloned."""
    demo_batch: int = 0
    """How many of a batch are from demonstrations."""
    policy_weight: float = 1.0
    """Weight of the critic's value in the policy's loss, beside that of cloning."""
    clone_weight: float = 0.0
    """Weight of cloning: of the sum of squared differences from demonstrated actions; ``td3-demo``:
    of the mean absolute difference."""
    q_filter: bool = True
    """Whether to clone only actions that the critic rates above the policy's own."""

    curriculum: int = 0
    """Levels of a curriculum from snapshots: into how many parts demonstrations are cut, for
    episodes to begin between them (:mod:`trocar.rl.curriculum`). 0: they begin as the task's do."""
    curriculum_success: float = 0.5
    """Part of the latest episodes from a level that must succeed, with the noise of exploring,
    before they begin one earlier."""

    hindsight: float = 0.0
    """Part of transitions that get a goal which their episode reached later."""
    demo_hindsight: float = 0.0
    """The same part, of demonstrated transitions."""
    warm_up: int = 0
    """Episodes that are played before the policy begins to follow the critics."""
    ramp: int = 0
    """Episodes after that in which ``policy_weight`` grows to what it is."""
    target_noise: float = 0.0
    """Standard deviation of the noise on actions of targets, cut off at twice as much."""
    policy_every: int = 1
    """Updates of the critics for each of the policy."""
    averaging: float = 1.0
    """Part by which the average of the policy, which is scored, moves with each of its updates."""
    critic_updates: int = 0
    """Updates of the critics before the first episode is played."""
    critics: int = 2
    """How many there are. Two, drawn anew for each batch, rate it. Source: Chen et al., Randomized
    Ensembled Double Q-Learning, ICLR 2021."""
    n_steps: int = 1
    """Steps whose rewards make a critic's target, before its own value of what follows."""
    own_demos: bool = False
    """Whether episodes of its own that succeed become demonstrations: what it did is cloned, with
    the noise of exploring."""
    clone_updates: int = 0
    """Gradient steps of cloning: before the first epoch, and with DAgger in each."""
    clone_rate: float = 1e-3
    """Learning rate of cloning at first; it falls to 0."""

    passes: int = 10
    """PPO: passes over what was collected."""
    gae_lambda: float = 0.95
    """PPO: of the advantage's estimate."""
    clip_range: float = 0.2
    """PPO: most that the ratio of probabilities may move."""

    @property
    def words(self) -> tuple[str, ...]:
        """All that the networks see."""
        return (*self.inputs, CONTACT) if self.contact else self.inputs

    @property
    def options(self) -> dict[str, Any]:
        """The task's options, with what the networks need to see."""
        asked = {"observation": ["state", CONTACT]} if self.contact else {}
        return asked | self.task_options

    @property
    def task_id(self) -> str:
        """The Gymnasium id."""
        return f"{NAMESPACE}/{self.task}"

    @property
    def steps(self) -> int:
        """Steps of an episode that lasts to its end."""
        steps, nominal = schedule(self.task)
        return round(steps * float(self.task_options.get("rate", nominal)) / nominal)

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


def load(task: str, algo: str | None = None) -> Config:
    """The configuration of a task and algorithm.

    Args:
        task: Id with or without namespace and version, e.g. ``NeedlePick``.
        algo: One of :data:`ALGORITHMS`; the best one known for the task if ``None``.

    Raises:
        ValueError: One of them is unknown, or they do not go together.
    """
    task = task_name(task)
    algo = algo or BEST.get(task)
    if algo is None:
        allowed = f"no algorithm is known to be best for {task}: name one of {list(ALGORITHMS)}"
        raise refuse(InvalidOption, "algo", algo, allowed)
    if algo not in ALGORITHMS:
        raise refuse(InvalidOption, "algo", algo, f"allowed are {list(ALGORITHMS)}")
    text = resources.files(__package__).joinpath(f"configs/{algo}.toml").read_text()
    tables = tomllib.loads(text)
    return Config(task, algo).but(**(tables["all"] | tables.get(task, {})))


def task_name(task: str) -> str:
    """The id without namespace of a task that may be named in short."""
    name = task.removeprefix(f"{NAMESPACE}/")
    for known in (name, f"{name}-v0"):
        if known in TASKS or known in SERVED:
            return known
    schedule(name)
    return name


def _tuples(values: dict[str, Any]) -> dict[str, Any]:
    """Lists as tuples, and inputs that are a single word as one."""
    values = {
        name: tuple(value) if isinstance(value, list) else value for name, value in values.items()
    }
    if isinstance(values.get("inputs"), str):
        values["inputs"] = (values["inputs"],)
    return values


def _check_field(name: str, value: Any) -> None:
    known = {known.name: known for known in fields(Config)}
    if name not in known or name in ("task", "algo"):
        raise refuse(
            InvalidOption, name, value, f"allowed are {sorted({*known} - {'task', 'algo'})}"
        )
    # Annotations are text here.
    kinds: dict[str, Any] = {"int": int, "float": (int, float), "bool": bool, "dict": dict}
    kind = str(known[name].type).partition("[")[0]
    wanted = kinds.get(kind, (list, tuple, str) if name == "inputs" else (list, tuple))
    if not isinstance(value, wanted) or (isinstance(value, bool) and kind != "bool"):
        raise refuse(InvalidOption, name, value, f"expected {known[name].type}")


Check = Callable[[bool, str, str], None]
"""Refuses a field, saying what is allowed, unless something holds."""


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
    if config.task == "ActiveTrack-v0":
        allowed = "the task has no goals: allowed are ['ddpg', 'ppo', 'td3-her', 'bc', 'dagger']"
        check(not config.algo.startswith("her") and config.algo != "td3-demo", "algo", allowed)
        check(config.curriculum == 0, "curriculum", "the task has no goals: allowed is 0")
    counts = (
        "epoch_episodes",
        "eval_episodes",
        "envs",
        "batch_size",
        "train_every",
        "policy_every",
    )
    for name in counts if config.algo == "bc" else (*counts, "epochs"):
        check(getattr(config, name) >= 1, name, "allowed are numbers from 1 on")
    _check_curriculum(config, check)
    if config.algo in BASELINES:
        _check_baseline(config, check)
    else:
        _check_own(config, check)
    allowed = f"allowed are {list(WORDS[:-1])}"
    check(bool(config.inputs) and {*config.inputs} <= {*WORDS[:-1]}, "inputs", allowed)
    check(0.0 <= config.enough <= 1.0, "enough", "allowed are numbers from 0 to 1")
    return config


def _check_baseline(config: Config, check: Check) -> None:
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
        _check_demos(config, check)


def _check_demos(config: Config, check: Check) -> None:
    allowed = f"allowed are numbers from 1 to {config.batch_size - 1}"
    check(1 <= config.demo_batch < config.batch_size, "demo_batch", allowed)


def _check_curriculum(config: Config, check: Check) -> None:
    if config.curriculum or config.algo in ("her-demo", *_CLONING):
        check(config.demos >= 1, "demos", "allowed are numbers from 1 on")
    else:
        check(config.demos == 0, "demos", f"{config.algo} needs some for a curriculum only")
    allowed = f"allowed are 0, for none, and 2 to {config.steps} levels"
    check(config.curriculum in (0, *range(2, config.steps + 1)), "curriculum", allowed)
    allowed = "allowed are numbers above 0, up to 1"
    check(0.0 < config.curriculum_success <= 1.0, "curriculum_success", allowed)


def _check_own(config: Config, check: Check) -> None:
    allowed = f"{config.epoch_episodes} episodes of an epoch must be a multiple of it"
    check(config.epoch_episodes % config.envs == 0, "envs", allowed)
    if config.algo in _CLONING:
        check(config.clone_updates >= 1, "clone_updates", "allowed are numbers from 1 on")
        check(0.0 <= config.demo_noise <= 1.0, "demo_noise", "allowed are numbers from 0 to 1")
    if config.algo == "td3-demo":
        _check_demos(config, check)
    if config.algo == "td3-her":
        check(config.learning_starts >= 1, "learning_starts", "allowed are numbers from 1 on")
    check(config.critics >= 2, "critics", "allowed are numbers from 2 on")
    check(config.n_steps >= 1, "n_steps", "allowed are numbers from 1 on")
    for name in ("hindsight", "demo_hindsight", "averaging", "tau"):
        check(0.0 <= getattr(config, name) <= 1.0, name, "allowed are numbers from 0 to 1")
    if config.task == "ActiveTrack-v0":
        check(config.hindsight == 0.0, "hindsight", "the task has no goals: allowed is 0")

"""A curriculum from snapshots: episodes begin on the way of a demonstration, ever earlier.

Some demonstrations are run again when training begins, and snapshots keep the states on their ways:
the same seeds and actions lead to the same states. At first, episodes begin where little is left to
do; where the policy succeeds often enough, they begin a level earlier, until they begin where the
task's own do. Sources: resets to demonstrated states, Nair et al., ICRA 2018; from the end to the
beginning, Florensa et al., Reverse Curriculum Generation, CoRL 2017.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from trocar.rl.config import Config
from trocar.rl.episodes import Episodes
from trocar.sb3 import TrocarVecEnv
from trocar.snapshot import Snapshot
from trocar.vector import TrocarVectorEnv

WAYS = 32
"""Demonstrations whose states are kept."""

COUNTED = 20
"""Latest episodes from a level that decide whether others begin a level earlier."""


class Curriculum:
    """Decides where episodes begin.

    At level k of n, k/n of the steps to a demonstration's success have been made. Half of the
    episodes begin at the present level, the others at that or a later one; those of level 0 begin
    as the task's do. An episode has as many steps less as were made before it begins.

    Attributes:
        level: The present level.
        ways: The states of each level; none of level 0.
        random: What decides.
    """

    def __init__(
        self, envs: TrocarVectorEnv, demos: Episodes, config: Config, random: np.random.Generator
    ) -> None:
        """Runs demonstrations of the same task and options again."""
        self.level = config.curriculum - 1
        self.ways = _ways(envs, demos, config.curriculum)
        self.random = random
        self._enough = config.curriculum_success
        self._counted: deque[bool] = deque(maxlen=COUNTED)

    def draw(self) -> tuple[int, Snapshot | None]:
        """The level of an episode, and the state that it begins with; none at level 0."""
        present = self.random.random() < 0.5
        level = self.level if present else int(self.random.integers(self.level, len(self.ways)))
        if level == 0:
            return 0, None
        states = self.ways[level]
        return level, states[int(self.random.integers(len(states)))]

    def count(self, level: int, success: bool) -> None:
        """Lets an episode count; with enough that succeed, others begin a level earlier."""
        if level != self.level:
            return
        self._counted.append(success)
        if len(self._counted) == COUNTED and np.mean(self._counted) >= self._enough:
            self.level = max(self.level - 1, 0)
            self._counted.clear()

    def progress(self) -> dict[str, Any]:
        """All that decides where episodes will begin, but the generator, for a checkpoint."""
        return {"level": self.level, "counted": list(self._counted)}

    def go_on(self, progress: dict[str, Any]) -> None:
        """Goes on from what :meth:`progress` gave."""
        self.level = progress["level"]
        self._counted = deque(progress["counted"], maxlen=COUNTED)


class CurriculumVecEnv(TrocarVecEnv):
    """Environments of Stable-Baselines3 whose episodes begin where a curriculum says.

    Attributes:
        curriculum: The curriculum.
    """

    def __init__(self, envs: TrocarVectorEnv, demos: Episodes, config: Config) -> None:
        """Takes over environments."""
        super().__init__(envs)
        self.curriculum = Curriculum(envs, demos, config, np.random.default_rng())
        self._begun_at = np.zeros(envs.num_envs, np.int64)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Sets the seeds of the first episodes, and of where later ones begin."""
        self.curriculum.random = np.random.default_rng(seed)
        return super().seed(seed)

    def reset(self) -> Any:
        """Begins episodes as the task's begin."""
        self._begun_at[:] = 0
        return super().reset()

    def step_wait(self) -> VecEnvStepReturn:
        """As without curriculum; where an episode ended, the next one begins where it says."""
        observations, rewards, dones, infos = super().step_wait()
        rows = np.flatnonzero(dones)
        for row in rows.tolist():
            self.curriculum.count(int(self._begun_at[row]), infos[row]["is_success"])
        if rows.size:
            observations = self._begin(rows)
        return observations, rewards, dones, infos

    def _begin(self, rows: NDArray[np.int64]) -> Any:
        """Begins episodes in these environments; the latest observations of all."""
        observations: Any = None
        for row in rows.tolist():
            level, state = self.curriculum.draw()
            self._begun_at[row] = level
            self.reset_infos[row] = {"level": level}
            if state is None:
                mask = np.arange(self.num_envs) == row
                random = self.curriculum.random
                seeds = [int(random.integers(2**62)) if chosen else None for chosen in mask]
                observations, _ = self.envs.reset(seed=seeds, options={"reset_mask": mask})
            else:
                observations = self.envs.restore(state, [row])
        return observations

    def progress(self) -> dict[str, Any]:
        """All that decides where episodes will begin, for a checkpoint."""
        told = self.curriculum.progress() | {"begun_at": self._begun_at.copy()}
        return told | {"random": self.curriculum.random.bit_generator.state}

    def go_on(self, progress: dict[str, Any]) -> None:
        """Goes on from what :meth:`progress` gave."""
        self.curriculum.go_on(progress)
        self._begun_at[:] = progress["begun_at"]
        self.curriculum.random.bit_generator.state = progress["random"]


def _ways(envs: TrocarVectorEnv, demos: Episodes, levels: int) -> list[list[Snapshot]]:
    """The states of each level; none of level 0."""
    ways: list[list[Snapshot]] = [[] for _ in range(levels)]
    for episode in range(min(WAYS, len(demos))):
        envs.reset(seed=[int(demos.seed[episode])] * envs.num_envs)
        length = _length(demos, episode)
        states = [round(length * level / levels) for level in range(levels)]
        for step, action in enumerate(demos.action[episode, :length]):
            for level in range(1, levels):
                if states[level] == step:
                    ways[level].append(envs.snapshot([0]))
            envs.send(action[None], [0])
            envs.recv()
    return ways


def _length(demos: Episodes, episode: int) -> int:
    """Steps until its goal is reached for good."""
    failing = np.flatnonzero(~demos.success[episode, : demos.length[episode]])
    return int(failing[-1]) + 1 if failing.size else 1

"""Policies of Stable-Baselines3 as ONNX files for ``trocar rollout``, ``render`` and the viewer."""

from __future__ import annotations

import inspect
import io
import json
import os
from collections.abc import Mapping, Sequence
from contextlib import closing
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from torch import nn

import trocar
from trocar._extras import missing_extra
from trocar.env import TrocarEnv
from trocar.errors import InvalidRequest, refuse

OPSET = 18
"""Version of ONNX's operators."""

INPUTS = ("observation", "achieved_goal", "desired_goal")
"""Arrays that policies of ONNX files may read."""

TOLERANCE = 1e-4
"""Greatest difference of an action between the file and the model."""

PASSIVE = (
    *("Monitor", "OrderEnforcing", "PassiveEnvChecker"),
    *("RecordEpisodeStatistics", "RecordVideo", "TimeLimit"),
)
"""Wrappers of single environments that change neither observations nor actions."""

SAMPLES = 16
"""Observations with which the file is compared to the model."""

SCALED = "scaled"
"""The word of the option ``observation`` for a state and goals that are scaled by their ranges."""

STATES = ("state", "perceived")
"""Words of the option ``observation`` for an unscaled state."""

Ranges = Mapping[str, tuple[Any, Any]]
"""Centre and half-width of the range of each element, by the names of inputs."""


def export(
    model: BaseAlgorithm, path: str | os.PathLike[str], *, env: VecEnv | None = None
) -> Path:
    """Writes the deterministic policy of a model of Stable-Baselines3 as an ONNX file.

    The file has the format of Trocar's own policies: its metadata hold the task, the options and
    the version of Trocar. ``VecNormalize`` becomes a part of the network. So does the scaling of
    ``observation=("scaled",)``: the file takes unscaled arrays, and its options ask for them. The
    actions of the file are compared with the actions of the model before the function returns.

    Args:
        model: A model of SAC, TD3, DDPG, PPO or A2C, with or without hindsight replay.
        path: The file.
        env: Environments of the task; ``None`` for the environments of the model.

    Raises:
        ValueError: The model has no environments of Trocar, or observes pictures or arrays that a
            wrapper made.
        ModuleNotFoundError: ``onnx`` is not installed.
    """
    try:
        import onnx
        from onnx.reference import ReferenceEvaluator
    except ImportError as error:
        raise missing_extra(error, "rl", "trocar.sb3.export") from error
    env = model.get_env() if env is None else env
    if env is None:
        raise refuse(InvalidRequest, "env", None, "the model has no environments; give env=…")
    task, options, server = _task(env)
    keys = _keys(model)
    options, ranges = _unscaled(task, options, server)
    network = _Acting(model, keys, env, ranges).to("cpu").eval()
    samples = _samples(model, keys)
    inputs = {key: _plain(rows, ranges.get(key)) for key, rows in samples.items()}
    content = io.BytesIO()
    torch.onnx.export(
        network,
        tuple(torch.from_numpy(inputs[key][:1]) for key in keys),
        content,  # type: ignore[arg-type]
        input_names=keys,
        output_names=["action"],
        opset_version=OPSET,
        dynamo=False,
    )
    written = onnx.load_model_from_string(content.getvalue())
    metadata = {
        "trocar.task": task,
        "trocar.options": json.dumps(options),
        "trocar.version": trocar.__version__,
    }
    onnx.helper.set_model_props(written, metadata)
    onnx.checker.check_model(written)
    _compare(ReferenceEvaluator(written), model, env, samples, inputs)
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(written, str(target))
    return target


class _Acting(nn.Module):
    """The deterministic policy of a model: arrays by name to an action in [-1, 1]."""

    def __init__(
        self, model: BaseAlgorithm, keys: Sequence[str], env: VecEnv, ranges: Ranges
    ) -> None:
        super().__init__()
        policy: Any = model.policy
        # Tensors of the latest distribution cannot be copied; a deterministic policy has none.
        parts = (getattr(each, "action_dist", None) for each in (policy, _actor(policy)))
        self.policy: Any = deepcopy(policy, {id(part): part for part in parts})
        self.keys = tuple(keys)
        self.is_dict = isinstance(model.observation_space, spaces.Dict)
        self.ranges = {
            key: tuple(torch.tensor(each, dtype=torch.float32) for each in ends)
            for key, ends in ranges.items()
        }
        normal = _normal(env)
        self.normal = {key: _statistics(normal, key, self.is_dict) for key in self.keys}

    def forward(self, *arrays: torch.Tensor) -> torch.Tensor:
        """An action of shape (1, action dim) for arrays of shape (1, …)."""
        named = {}
        for key, array in zip(self.keys, arrays, strict=True):
            if key in self.ranges:
                centre, half = self.ranges[key]
                array = (array - centre) / half
            statistics = self.normal[key]
            if statistics is not None:
                mean, deviation, clip = statistics
                array = ((array - mean) / deviation).clamp(-clip, clip)
            named[key] = array
        seen = named if self.is_dict else named["observation"]
        return _action(self.policy, seen).clamp(-1.0, 1.0)


def _actor(policy: Any) -> Any:
    """The network that acts; ``None`` if a policy has a single network."""
    return getattr(policy, "actor", None)


def _action(policy: Any, seen: Any) -> torch.Tensor:
    """The deterministic action of a policy, without the distribution that ONNX cannot express."""
    actor = _actor(policy)
    action: torch.Tensor
    if actor is None:
        features = policy.extract_features(seen, policy.pi_features_extractor)
        latent = policy.mlp_extractor.forward_actor(features)
        action = policy.action_net(latent)
        return action
    features = actor.extract_features(seen, actor.features_extractor)
    if hasattr(actor, "latent_pi"):
        return torch.tanh(actor.mu(actor.latent_pi(features)))
    action = actor.mu(features)
    return action


def _task(env: VecEnv) -> tuple[str, dict[str, Any], str | None]:
    """Id without namespace and options of the task of environments, and the name of their server.

    Raises:
        InvalidRequest: The environments are not Trocar's, or single environments have wrappers.
    """
    from trocar.sb3 import TrocarVecEnv

    inner = env.unwrapped
    if isinstance(inner, TrocarVecEnv):
        connection = inner.envs._connection
        request = connection._request
        return request["task"], dict(request["options"]), connection._server
    spec = inner.get_attr("spec")[0] if inner.has_attr("spec") else None
    if spec is None or "task" not in spec.kwargs:
        allowed = "expected environments of trocar.sb3.make_vec, or of Gymnasium's ids trocar/…"
        raise refuse(InvalidRequest, "env", type(inner).__name__, allowed)
    names = [each.name for each in spec.additional_wrappers if each.name not in PASSIVE]
    if names:
        allowed = "expected environments without other wrappers, which an ONNX file cannot contain"
        raise refuse(InvalidRequest, "env", names, allowed)
    own = inspect.signature(TrocarEnv.__init__).parameters
    options = {name: value for name, value in spec.kwargs.items() if name not in own}
    return spec.kwargs["task"], options, spec.kwargs.get("server")


def _unscaled(
    task: str, options: Mapping[str, Any], server: str | None
) -> tuple[dict[str, Any], Ranges]:
    """The options without the word ``scaled``, and the ranges by which it scaled."""
    words = options.get("observation", ())
    words = [words] if isinstance(words, str) else list(words)
    if SCALED not in words:
        return dict(options), {}
    words.remove(SCALED)
    if not any(word in STATES for word in words):
        words.insert(0, "state")
    plain = {**options, "observation": words}
    with closing(TrocarEnv(task, server=server, **plain)) as env:
        state, goal = _range(env.task_spec.observation), _range(env.task_spec.goal or ())
    return plain, {"observation": state, "achieved_goal": goal, "desired_goal": goal}


def _range(elements: Sequence[Any]) -> tuple[Any, Any]:
    """Centres and half-widths of the ranges of elements; 1 for a range of zero width."""
    low = np.array([element.min for element in elements], np.float64)
    high = np.array([element.max for element in elements], np.float64)
    half = (high - low) / 2.0
    return (low + high) / 2.0, np.where(half > 0.0, half, 1.0)


def _plain(rows: Any, ends: tuple[Any, Any] | None) -> Any:
    """Rows of scaled numbers as the file takes them, float32."""
    if ends is None:
        return rows
    centre, half = ends
    return (rows * half + centre).astype(np.float32)


def _keys(model: BaseAlgorithm) -> list[str]:
    """Names of the arrays that a model observes.

    Raises:
        InvalidRequest: A file of a policy cannot have such an input, or the actions are no numbers
            from -1 to 1.
    """
    space = model.observation_space
    keys = list(space.spaces) if isinstance(space, spaces.Dict) else ["observation"]
    unknown = [key for key in keys if key not in INPUTS]
    if unknown:
        allowed = f"a policy's file can have {', '.join(INPUTS)}, and no pictures"
        raise refuse(InvalidRequest, "observation", unknown, allowed)
    parts = [space[key] for key in keys] if isinstance(space, spaces.Dict) else [space]
    if any(not isinstance(part, spaces.Box) or len(part.shape) != 1 for part in parts):
        raise refuse(InvalidRequest, "observation", str(space), "expected rows of numbers")
    action: Any = model.action_space
    if not isinstance(action, spaces.Box) or (action.low != -1).any() or (action.high != 1).any():
        raise refuse(InvalidRequest, "action", str(action), "expected numbers from -1 to 1")
    return [key for key in INPUTS if key in keys]


def _normal(env: VecEnv) -> VecNormalize | None:
    """The normalisation of observations, if a wrapper has one.

    Raises:
        InvalidRequest: Another wrapper changes observations.
    """
    normal = None
    inner: Any = env
    while hasattr(inner, "venv"):
        if isinstance(inner, VecNormalize):
            normal = inner if inner.norm_obs else normal
        elif inner.observation_space != inner.venv.observation_space:
            allowed = "expected no wrapper that changes observations, except VecNormalize"
            raise refuse(InvalidRequest, "env", type(inner).__name__, allowed)
        inner = inner.venv
    return normal


def _statistics(
    normal: VecNormalize | None, key: str, is_dict: bool
) -> tuple[torch.Tensor, torch.Tensor, float] | None:
    """Mean, standard deviation and limit of normalised numbers of an array."""
    if normal is None or (is_dict and key not in (normal.norm_obs_keys or ())):
        return None
    running: Any = normal.obs_rms
    running = running[key] if is_dict else running
    deviation = np.sqrt(running.var + normal.epsilon)
    mean, scale = (torch.tensor(each, dtype=torch.float32) for each in (running.mean, deviation))
    return mean, scale, float(normal.clip_obs)


def _samples(model: BaseAlgorithm, keys: Sequence[str]) -> dict[str, Any]:
    """Observations of the space, by the names of inputs."""
    random = np.random.default_rng(0)
    space: Any = model.observation_space
    parts: dict[str, Any] = {
        key: space[key] if isinstance(space, spaces.Dict) else space for key in keys
    }
    return {
        key: random.uniform(
            np.maximum(part.low, -1.0), np.minimum(part.high, 1.0), (SAMPLES, *part.shape)
        ).astype(np.float32)
        for key, part in parts.items()
    }


def _compare(
    evaluator: Any,
    model: BaseAlgorithm,
    env: VecEnv,
    samples: dict[str, Any],
    inputs: dict[str, Any],
) -> None:
    """Compares the actions of a file for its inputs and of its model for the same samples.

    Raises:
        InvalidRequest: They differ, as those of a policy with operations of its own.
    """
    normal = _normal(env)
    for row in range(SAMPLES):
        one = {key: rows[row : row + 1] for key, rows in samples.items()}
        seen: Any = one if isinstance(model.observation_space, spaces.Dict) else one["observation"]
        seen = seen if normal is None else normal.normalize_obs(seen)
        expected, _ = model.predict(seen, deterministic=True)
        found = evaluator.run(None, {key: rows[row : row + 1] for key, rows in inputs.items()})[0]
        if not np.allclose(found, np.clip(expected, -1.0, 1.0), atol=TOLERANCE):
            allowed = "the file's actions differ from the model's; the policy class is unknown"
            raise refuse(InvalidRequest, "model", type(model.policy).__name__, allowed)

"""Policies as ONNX: for ``trocar rollout --policy FILE.onnx``, and whatever else reads it."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import onnx
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from torch import nn

import trocar
from trocar.rl.algorithms import AveragedPolicy
from trocar.rl.config import Config
from trocar.rl.normalise import Normalised

OPSET = 18


class Acting(nn.Module):
    """The deterministic policy of a model: inputs by name to an action in [-1, 1]."""

    def __init__(self, model: BaseAlgorithm) -> None:
        super().__init__()
        self.policy: Any = model.policy
        self.keys = self.extractor.keys
        self.is_dict = self.extractor.is_dict

    @property
    def actor(self) -> Any:
        """The network that acts; ``None`` where it is a part of the policy's only one."""
        own = getattr(self.policy, "actor", None)
        return self.policy.acting if isinstance(self.policy, AveragedPolicy) else own

    @property
    def extractor(self) -> Normalised:
        """What it sees."""
        extractor = (self.actor or self.policy).features_extractor
        assert isinstance(extractor, Normalised)
        return extractor

    def forward(self, *inputs: torch.Tensor) -> torch.Tensor:
        """An action of shape (1, action dim) for inputs of shape (1, …)."""
        seen: Any = dict(zip(self.keys, inputs, strict=True)) if self.is_dict else inputs[0]
        features = self.extractor(seen)
        if self.actor is not None:
            action = self.actor.mu(features)
        else:
            latent = self.policy.mlp_extractor.forward_actor(features)
            action = self.policy.action_net(latent)
        clamped: torch.Tensor = action.clamp(-1.0, 1.0)
        return clamped


def export(model: BaseAlgorithm, config: Config, path: str | os.PathLike[str]) -> Path:
    """Writes the deterministic policy of a model as an ONNX file.

    Inputs are those of ``observation``, ``achieved_goal`` and ``desired_goal`` that it uses, of
    shape (1, dimension), float32; the output ``action`` has shape (1, action dim), in [-1, 1]. The
    file's metadata name the task, its options and the version of Trocar.

    Args:
        model: A trained model.
        config: What it was trained with.
        path: The file.
    """
    model.policy.to("cpu")
    acting = Acting(model).eval()
    space = model.observation_space
    boxes = {key: space[key] if acting.is_dict else space for key in acting.keys}  # type: ignore[index]
    samples = tuple(torch.zeros(1, *box.shape) for box in boxes.values())  # type: ignore[misc]
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    torch.onnx.export(
        acting,
        samples,
        str(target),
        input_names=list(boxes),
        output_names=["action"],
        opset_version=OPSET,
        dynamo=False,
    )
    told = onnx.load(str(target))
    metadata = {
        "trocar.task": config.task,
        "trocar.options": json.dumps(config.task_options),
        "trocar.version": trocar.__version__,
    }
    onnx.helper.set_model_props(told, metadata)
    onnx.checker.check_model(told)
    onnx.save(told, str(target))
    return target

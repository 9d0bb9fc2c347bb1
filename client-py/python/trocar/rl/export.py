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
from trocar.errors import InvalidRequest, refuse
from trocar.rl.algorithms import AveragedPolicy
from trocar.rl.config import Config
from trocar.rl.features import CONTACT, STATE, Inputs
from trocar.rl.networks import Policy
from trocar.rl.normalise import Normalised

OPSET = 18


class Acting(nn.Module):
    """The deterministic policy of a model: arrays by name to an action in [-1, 1]."""

    def __init__(self, model: BaseAlgorithm | Policy) -> None:
        super().__init__()
        self.policy: Any = model if isinstance(model, Policy) else model.policy
        source = model if isinstance(model, Policy) else self.extractor
        self.inputs: Inputs = source.inputs

    @property
    def actor(self) -> Any:
        """The network that acts; ``None`` where it is a part of the policy's only one."""
        own = getattr(self.policy, "actor", None)
        return self.policy.acting if isinstance(self.policy, AveragedPolicy) else own

    @property
    def extractor(self) -> Normalised:
        """What a model of Stable-Baselines3 sees."""
        extractor = (self.actor or self.policy).features_extractor
        assert isinstance(extractor, Normalised)
        return extractor

    def forward(self, *arrays: torch.Tensor) -> torch.Tensor:
        """An action of shape (1, action dim) for arrays of shape (1, …)."""
        named = dict(zip(self.inputs.keys, arrays, strict=True))
        if isinstance(self.policy, Policy):
            action: torch.Tensor = self.policy(self.inputs(named))
            return action
        features = self.extractor(named)
        if self.actor is not None:
            action = self.actor.mu(features)
        else:
            latent = self.policy.mlp_extractor.forward_actor(features)
            action = self.policy.action_net(latent)
        return action.clamp(-1.0, 1.0)


def card_of(path: Path) -> dict[str, Any]:
    """The card that :func:`export` wrote into an ONNX file.

    Raises:
        ValueError: It has none.
    """
    told = {each.key: each.value for each in onnx.load(str(path)).metadata_props}
    if "trocar.card" not in told:
        allowed = "expected a policy with a card: python -m trocar.rl export RUN --card"
        raise refuse(InvalidRequest, "policy", str(path), allowed)
    card: dict[str, Any] = json.loads(told["trocar.card"])
    return card


def export(
    model: BaseAlgorithm | Policy,
    config: Config,
    path: str | os.PathLike[str],
    card: dict[str, Any] | None = None,
) -> Path:
    """Writes the deterministic policy of a model as an ONNX file.

    Inputs are those of ``observation``, ``achieved_goal`` and ``desired_goal`` that it uses, of
    shape (1, dimension), float32; features are computed inside. The output ``action`` has shape
    (1, action dim), in [-1, 1]. The file's metadata name the task, its options and the version of
    Trocar.

    Args:
        model: A trained model.
        config: What it was trained with.
        path: The file.
        card: What else is known of it, as :func:`trocar.rl.cards.card` tells it.
    """
    acting = Acting(model).to("cpu").eval()
    sizes = acting.inputs.sizes
    widths = sizes | {STATE: sizes[STATE] + sizes[CONTACT]}
    samples = tuple(torch.zeros(1, widths[key]) for key in acting.inputs.keys)
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    torch.onnx.export(
        acting,
        samples,
        str(target),
        input_names=acting.inputs.keys,
        output_names=["action"],
        opset_version=OPSET,
        dynamo=False,
    )
    told = onnx.load(str(target))
    metadata = {
        "trocar.task": config.task,
        "trocar.options": json.dumps(config.options),
        "trocar.version": trocar.__version__,
    }
    if card is not None:
        metadata["trocar.card"] = json.dumps(card)
    onnx.helper.set_model_props(told, metadata)
    onnx.checker.check_model(told)
    onnx.save(told, str(target))
    return target

"""Policies on arms that speak CRTK: a simulated world, ROS 2, a real robot.

``python -m trocar.dvrk.deploy NeedlePick --task NeedlePick-v0`` runs a policy in a live world. What
it does there it does with the names of ``dvrk_python`` alone, so that the same runner drives a da
Vinci. The page "From a policy to the robot" (docs/deploy.md) has the steps and the risks.
"""

from __future__ import annotations

from trocar.dvrk.deploy.limits import Limits, Stopped
from trocar.dvrk.deploy.policy import Policy, load
from trocar.dvrk.deploy.robot import Robot, installed, live
from trocar.dvrk.deploy.runner import Episode, Runner
from trocar.dvrk.deploy.task import Task

__all__ = [
    "Episode",
    "Limits",
    "Policy",
    "Robot",
    "Runner",
    "Stopped",
    "Task",
    "installed",
    "live",
    "load",
]

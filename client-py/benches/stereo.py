"""How well the endoscope's two lenses locate a block by its colour: 12 episodes of PegTransfer.

``python client-py/benches/stereo.py`` prints errors against the simulator's truth, mm.
"""

from __future__ import annotations

import numpy as np

from trocar.dvrk.deploy import Task, live
from trocar.dvrk.deploy.__main__ import COLOURS
from trocar.dvrk.deploy.pictures import Lens, locate

EPISODES = 12


def main() -> None:
    """Locates the block at the beginning of each episode."""
    robot = live(Task.open("PegTransfer-v0"))
    errors = []
    for seed in range(EPISODES):
        robot.reset(seed)
        left, right, _, camera = robot.pictures()
        place = locate(left, right, COLOURS["block"], Lens(), camera)
        if place is None:
            print(f"seed {seed}: not seen")
            continue
        truth = np.array(robot.world.live.object("block")[:3])
        errors.append(1e3 * camera.rotation.T @ (place - truth))
    robot.close()
    across = np.linalg.norm(np.array(errors)[:, :2], axis=1)
    along = np.array(errors)[:, 2]
    print(f"{len(errors)} of {EPISODES} located, in pictures of {left.shape[1]} x {left.shape[0]}")
    print(f"across the view: mean {across.mean():.2f}, most {across.max():.2f} mm")
    rms = np.sqrt(np.mean(along**2))
    print(f"along the view: rms {rms:.2f}, most {np.abs(along).max():.2f} mm")


if __name__ == "__main__":
    main()

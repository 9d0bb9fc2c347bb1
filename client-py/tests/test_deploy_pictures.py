"""Where coloured things are, by rendered pictures of the endoscope's lenses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from trocar.dvrk.deploy import Policy, Runner, Task, live
from trocar.dvrk.deploy.__main__ import COLOURS, colours
from trocar.dvrk.deploy.geometry import Pose
from trocar.dvrk.deploy.observation import Layout
from trocar.dvrk.deploy.pictures import Colour, Lens, find, largest_region, locate
from trocar.dvrk.deploy.sources import Pictures
from trocar.errors import InvalidOption


def test_the_largest_region_hangs_together_by_its_sides() -> None:
    drawn = """
        ##..#...
        .#..#.#.
        ..###.#.
        #......#
    """
    mask = np.array([[mark == "#" for mark in line] for line in drawn.split()])
    rows, columns = largest_region(mask)
    assert sorted(zip(rows.tolist(), columns.tolist(), strict=True)) == [
        (0, 4), (1, 4), (2, 2), (2, 3), (2, 4),
    ]  # fmt: skip
    assert len(largest_region(np.zeros((3, 3), np.bool_))[0]) == 0


def test_a_colour_is_found_in_light_and_shade_but_no_other() -> None:
    picture = np.full((100, 200, 3), 120, np.uint8)
    picture[10:20, 150:160] = (200, 30, 30)
    picture[20:30, 150:160] = (70, 10, 10)
    picture[60:90, 20:50] = (30, 40, 200)
    point = find(picture, Colour((214.0, 31.0, 33.0)))
    assert point is not None
    assert point == pytest.approx([(155.0 - 100.0) / 50.0, (20.0 - 50.0) / 50.0])
    assert find(picture, Colour((30.0, 200.0, 40.0))) is None


def test_a_point_is_where_the_rays_of_both_lenses_meet() -> None:
    lens = Lens()
    point = np.array([0.01, -0.02, 0.2])
    seen = [
        np.array([side * lens.baseline / 2.0 - point[0], -point[1]]) / (point[2] * lens.tangent)
        for side in (1.0, -1.0)
    ]
    assert lens.triangulate(*seen) == pytest.approx(point)
    with pytest.raises(ValueError, match="do not meet"):
        lens.triangulate(seen[1], seen[0])


def test_the_block_is_located_by_a_rendered_pair(server: str) -> None:
    """Millimetres across the view and several along it: the lenses are 4.2 mm apart."""
    task = Task.open("PegTransfer-v0", server=server)
    robot = live(task, server=server)
    try:
        for seed in range(2):
            robot.reset(seed)
            left, right, _, camera = robot.pictures()
            place = locate(left, right, COLOURS["block"], Lens(), camera)
            assert place is not None
            truth = np.array(robot.world.live.object("block")[:3])
            off = camera.rotation.T @ (place - truth)
            assert np.linalg.norm(off[:2]) < 2.5e-3
            assert abs(off[2]) < 8e-3
    finally:
        robot.close()


def test_the_endoscope_turns_to_what_is_red_in_its_picture(server: str) -> None:
    """By pictures alone; what is seen is what the simulator knows, but for what hides it."""
    task = Task.open("StaticTrack-v0", server=server)
    robot = live(task, server=server)
    seen: list[Any] = []

    def towards(observed: Any, _: int) -> Any:
        expected = robot.world.live.observation()[0]
        seen.append((observed["observation"], expected))
        return [*np.clip(8.0 * observed["observation"][7:9], -1.0, 1.0), 0.0]

    source = Pictures(robot.pictures, Layout(task), COLOURS, robot.goal)
    runner = Runner(task, Policy("servo", towards), robot, source=source, enables=True, max_steps=5)
    try:
        episode = runner.run(0)
    finally:
        robot.close()
    assert episode.outcome in ("success", "failure"), episode.why
    assert all(np.abs(one[7:9] - other[7:9]).max() < 0.05 for one, other in seen)
    first, last = (np.linalg.norm(seen[index][1][7:9]) for index in (0, -1))
    assert last < first - 0.05


def test_things_without_a_colour_are_refused(server: str) -> None:
    layout = Layout(Task.open("NeedlePick-v0", server=server))

    def none() -> Any:
        blank = np.zeros((4, 4, 3), np.uint8)
        return blank, blank, 0.0, Pose.identity()

    with pytest.raises(InvalidOption, match="the colour of needle: --colour needle=R,G,B"):
        Pictures(none, layout, COLOURS, lambda: None)
    assert colours(["needle=1,2,3"], ["needle"])["needle"].rgb == (1.0, 2.0, 3.0)
    with pytest.raises(InvalidOption, match="three numbers"):
        colours(["needle=1,2"], ["needle"])

"""Where the endoscope is by a board of AprilTags that is drawn into rendered pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from trocar.dvrk import World
from trocar.dvrk.deploy import Task
from trocar.dvrk.deploy.board import CV_FROM_CAMERA, Board, Tag, drawn, main, sheet
from trocar.dvrk.deploy.geometry import Numbers, Pose, rotation_vector
from trocar.dvrk.deploy.observation import Layout, Reading
from trocar.dvrk.deploy.pictures import Colour, Lens, Picture
from trocar.dvrk.deploy.robot import LiveRobot
from trocar.dvrk.deploy.sources import Pictures
from trocar.errors import InvalidOption

LENS = Lens()
SIDE = 720
"""Height and width of pictures, pixels."""

MIDDLE, APART, SIZE = (0.55, 0.0, 0.692), (0.11, 0.1), 0.015
FINER = 4
"""How many times finer the tags are drawn than the picture."""

PAPER = 0.8
"""How light paper is."""


def tags() -> dict[int, Tag]:
    """Four tags around the pegs."""
    told = sheet(np.array(MIDDLE), APART, SIZE)["tags"]
    return {tag["id"]: Tag(tag["size"], Pose.of_numbers(tag["pose"])) for tag in told}


def with_tags(picture: Picture, lens: Pose) -> Picture:
    """A picture of a lens, with the tags where they would be seen."""
    size = FINER * SIDE
    focal, middle = 0.5 * size / LENS.tangent, 0.5 * size - 0.5
    matrix = np.array([[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]])
    cv_from_scene = (lens @ Pose(CV_FROM_CAMERA, np.zeros(3))).inverse()
    fine: Any = cv2.resize(picture, (size, size))
    for number, tag in tags().items():
        paper = drawn({number: tag})
        edge = Tag(1.5 * tag.size, tag.pose).corners()
        seen = (edge @ cv_from_scene.rotation.T + cv_from_scene.position) @ matrix.T
        end = len(paper) - 0.5
        corners = np.array([[-0.5, -0.5], [end, -0.5], [end, end], [-0.5, end]], np.float32)
        onto = cv2.getPerspectiveTransform(corners, (seen[:, :2] / seen[:, 2:]).astype(np.float32))
        mask = cv2.warpPerspective(np.full_like(paper, 255), onto, (size, size)) > 127
        fine[mask] = PAPER * cv2.warpPerspective(paper, onto, (size, size))[mask][:, None]
    return np.asarray(cv2.resize(fine, (SIDE, SIDE), interpolation=cv2.INTER_AREA))


def pair(robot: LiveRobot) -> tuple[Picture, Picture, float, Pose]:
    """Pictures of both lenses with the tags, their stamp, and where the camera really is."""
    left, right, stamp, camera = robot.pictures()
    aside: Numbers = camera.rotation @ np.array([0.5 * LENS.baseline, 0.0, 0.0])
    lenses = [Pose(camera.rotation, camera.position + side * aside) for side in (1.0, -1.0)]
    return with_tags(left, lenses[0]), with_tags(right, lenses[1]), stamp, camera


@pytest.fixture
def robot(server: str) -> Any:
    task = Task.open("PegTransfer-v0", server=server)
    view = {"camera": "stereo", "image_size": (SIDE, SIDE)}
    made = LiveRobot(World(task.spec.id, server=server, homing="in_place", view=view), task)
    yield made
    made.close()


def test_the_board_tells_where_the_camera_is(robot: LiveRobot) -> None:
    robot.reset(0)
    left, right, _, camera = pair(robot)
    found = Board(tags()).camera(left, right, LENS)
    assert found is not None
    away = 1e3 * np.linalg.norm(found.position - camera.position)
    turned = np.degrees(np.linalg.norm(rotation_vector(found.rotation @ camera.rotation.T)))
    print(f"the camera is {away:.2f} mm and {turned:.2f} degrees off")
    assert away < 0.5
    assert turned < 0.1
    assert Board({**tags(), 0: tags()[1], 1: tags()[0]}).camera(left, left[:, ::-1], LENS) is None


def test_a_block_is_located_without_being_told_where_the_camera_is(
    robot: LiveRobot, server: str
) -> None:
    layout = Layout(Task.open("PegTransfer-v0", server=server))
    blue = {"block": Colour((29.0, 106.0, 207.0))}
    shown: list[Any] = []
    source = Pictures(lambda: shown[-1], layout, blue, robot.goal, board=Board(tags()))
    for seed in range(3):
        robot.reset(seed)
        *seen, camera = pair(robot)
        shown.append((*seen, None))
        reading = Reading()
        source.read(reading)
        off = camera.rotation.T @ (
            reading.objects["block"].position - robot.world.live.object("block")[:3]
        )
        print(f"the block is {1e3 * off} mm off: left, up, forward")
        assert np.linalg.norm(off[:2]) < 2.5e-3
        assert abs(off[2]) < 8e-3


def test_a_sheet_can_be_printed_and_read_again(tmp_path: Path) -> None:
    assert main(["--at", "0.55,0,0.692", "--apart", "0.11,0.1", "--out", str(tmp_path / "a")]) == 0
    board = Board.read(tmp_path / "a.json")
    assert board.tags[2].corners()[0] == pytest.approx([0.596, -0.041, 0.692])
    paper = cv2.imread(str(tmp_path / "a.png"), cv2.IMREAD_GRAYSCALE)
    assert paper is not None
    # 110 mm and a tag of 18 mm, with half of one around: 12,000 pixels in a metre.
    assert paper.shape[1] == pytest.approx(12_000 * 0.137, abs=1)
    assert main(["--at", "0,0", "--out", str(tmp_path / "b")]) == 2


@pytest.mark.parametrize(
    ("told", "what"),
    [
        ({"family": "16h5", "tags": []}, "family"),
        (
            {"family": "36h11", "tags": [{"id": 7, "size": -1.0, "pose": [0, 0, 0, 0, 0, 0, 1]}]},
            "7",
        ),
        ({"family": "36h11", "tags": [{"id": 7}]}, "pose"),
        ({"family": "36h11", "tags": []}, "at least 3"),
        ([], "--board"),
    ],
)
def test_files_that_say_something_else_are_refused(tmp_path: Path, told: Any, what: str) -> None:
    path = tmp_path / "board.json"
    path.write_text(json.dumps(told))
    with pytest.raises(InvalidOption, match=what):
        Board.read(path)

"""Runs a policy on arms: reads, decides, sends set-points, and stops where something is wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from trocar.dvrk.deploy.action import Actions, Aim
from trocar.dvrk.deploy.geometry import Numbers, Pose, between, smooth
from trocar.dvrk.deploy.limits import JumpFilter, Limits, Stopped, Watchdog, outside
from trocar.dvrk.deploy.log import Log
from trocar.dvrk.deploy.observation import Layout, Reading
from trocar.dvrk.deploy.policy import Policy
from trocar.dvrk.deploy.sources import Source, Topics, checked_goal, read
from trocar.dvrk.deploy.task import Task
from trocar.errors import InvalidAction

LEAN = 0.2
"""How far jaws may point elsewhere at the beginning than where the task's do, rad."""

HOMING = 30.0
"""How long arms may take until they are enabled, and until they are homed, s."""


@dataclass(frozen=True)
class Episode:
    """What came of an episode."""

    seed: int
    outcome: str
    """``success``, ``failure``, ``dry run`` or ``stopped``."""
    why: str
    """Why it was stopped; empty otherwise."""
    steps: int
    """Actions that were computed."""
    distance: float
    """How far the achieved goal is from the desired one at the end, as measured; else NaN."""
    path: Path | None
    """The file that has it all."""


class Runner:
    """Runs a policy of a task on a robot.

    Args:
        task: The task.
        policy: What chooses the actions.
        robot: The arms; see :class:`trocar.dvrk.deploy.Robot`.
        source: Where objects and goals come from; ``None`` for the robot's topics.
        limits: What keeps the arms safe.
        is_dry: Whether actions are computed and written down, and nothing is commanded.
        enables: Whether arms are enabled and homed; else they must be.
        to_start: Whether PSMs are moved to where episodes begin; else they must be in the box, jaws
            down.
        max_steps: Steps of an episode; ``None`` for the task's.
        told: What is called after each step, with words for people.

    Raises:
        trocar.errors.InvalidRequest: The policy is of another task.
        trocar.errors.Unsupported: No robot measures what the task observes, or does what it asks.
    """

    def __init__(
        self,
        task: Task,
        policy: Policy,
        robot: Any,
        *,
        source: Source | None = None,
        limits: Limits | None = None,
        is_dry: bool = False,
        enables: bool = False,
        to_start: bool = False,
        max_steps: int | None = None,
        told: Callable[[str], object] | None = None,
    ) -> None:
        policy.check(task.spec)
        self.task, self.policy, self.robot = task, policy, robot
        self.limits = limits or Limits()
        self.layout, self._actions = Layout(task), Actions(task)
        self._source = source or Topics(robot, self.layout)
        self._is_dry, self._enables, self._told = is_dry, enables, told
        self._to_start = to_start
        self._max_steps = max_steps or task.spec.max_steps
        self._set_points = max(1, round(task.spec.seconds_per_step * self.limits.rate))
        self._jaws: dict[str, float] = {}
        self._seen_at: dict[str, tuple[float, Numbers]] = {}
        self._speeds: dict[str, float] = {}

    def run(self, seed: int, folder: Path | None = None) -> Episode:
        """Runs an episode. Whatever ends it, the arms hold.

        Args:
            seed: Which episode it is, of a simulator; a number for the log, of a robot.
            folder: Where its file is written; ``None`` for none.
        """
        log = Log(self.task, self.policy.name, seed)
        outcome, why, distance = "stopped", "", float("nan")
        self._jaws, self._seen_at, self._speeds = {}, {}, {}
        try:
            self.robot.reset(seed)
            self._prepare()
            last = self._play(log)
            distance = self._distance(last)
            outcome = "dry run" if self._is_dry else self._judged(last)
        except Stopped as error:
            why = str(error)
        except BaseException as error:
            why = f"{type(error).__name__}: {error}"
            raise
        finally:
            self._hold()
            log.close(outcome, why)
            path = log.write(folder) if folder is not None else None
        return Episode(seed, outcome, why, log.steps, distance, path)

    # ---- An episode ----

    def _prepare(self) -> None:
        """Sees to it that arms are ready, topics alive, the goal and the arms where they may be."""
        for name, arm in self._arms():
            if self._enables and not self._is_dry:
                if not (arm.enable(HOMING) and arm.home(HOMING)):
                    raise Stopped(f"{name} is not enabled and homed after {HOMING:.0f} s")
            elif not self._is_dry:
                self._check_state(name, arm)
        if self._to_start and not self._is_dry:
            self._go_to_start()
        first = self._wait_for_topics()
        goal = checked_goal(first.goal, self.task)
        if self.task.moves_camera:
            return
        for name, wrist in first.wrists.items():
            self._refuse(outside(f"{name}/measured_cp", wrist.position, self._box(name, 2e-3)))
            along = float(wrist.rotation[:, 2] @ self.task.starts[name].rotation[:, 2])
            lean = float(np.arccos(np.clip(along, -1.0, 1.0)))
            if lean > LEAN:
                raise Stopped(
                    f"{name}/measured_cp: its jaws point {lean:.2f} rad away from where those of "
                    f"{self.task.spec.id} begin, allowed are {LEAN}: turn them, or give --to-start"
                )
        if goal is not None:
            boxes = [self._box(name) for name in self.task.arms]
            # Tips are as low as jaws are long below the lowest wrist.
            low = np.min([box[0] for box in boxes], axis=0) - [0.0, 0.0, 0.0112]
            high = np.max([box[1] for box in boxes], axis=0)
            self._refuse(outside("goal", goal, np.array([low, high])))

    def _go_to_start(self) -> None:
        """Moves PSMs to where episodes begin, jaws closed."""
        for name, start in self.task.starts.items():
            arm = self.robot.arms[name]
            frame = (self.robot.frames[name].inverse() @ start).frame(self.robot.kdl)
            if not arm.move_cp(frame).wait() or not arm.jaw.move_jp(np.zeros(1)).wait():
                raise Stopped(f"{name} did not come to where episodes begin")

    def _play(self, log: Log) -> Reading:
        watchdog, jumps = Watchdog(self.limits.stale), JumpFilter(self.limits)
        rate = self.robot.rate(self.limits.rate)
        for step in range(self._max_steps):
            reading = self._read()
            watchdog.check(reading.stamps, self.robot.now())
            for name, arm in self._arms():
                if not self._is_dry:
                    self._check_state(name, arm)
            seen = self.layout.seen(reading)
            try:
                action = self.policy(seen, len(self.task.spec.action))
            except InvalidAction as error:
                raise Stopped(str(error)) from error
            jumped = jumps.check(reading.objects, self.robot.now())
            log.step(self.robot.now(), reading, seen, action, jumped)
            aims = {} if jumped else self._aims(reading, action)
            for part in range(1, self._set_points + 1):
                if not self._is_dry:
                    self._servo(aims, smooth(part / self._set_points), log)
                rate.sleep()
                watchdog.check(self._stamps(log), self.robot.now())
            if self._told is not None:
                self._told(self._words(step, reading, jumped))
        last = self._read()
        log.step(self.robot.now(), last, self.layout.seen(last), None, "")
        return last

    def _aims(self, reading: Reading, action: Any) -> dict[str, tuple[Aim, Aim]]:
        """From where to where each arm goes in a step."""
        aims = {}
        parts = np.split(np.asarray(action, np.float64), len(self.task.arms))
        for (name, arm), numbers in zip(self._arms(), parts, strict=True):
            start, base = self._now(name, arm, reading)
            aim = self._actions.aim(name, base, numbers)
            if aim.wrist is not None and start.wrist is not None:
                wrist = self.limits.confine(aim.wrist, start.wrist, self._box(name))
                aim = Aim(wrist, aim.jaw)
            elif aim.joints is not None and start.joints is not None:
                aim = Aim(joints=self.limits.confine_joints(aim.joints, start.joints))
            aims[name] = (start, aim)
        return aims

    def _now(self, name: str, arm: Any, reading: Reading) -> tuple[Aim, Aim]:
        """Where an arm was sent, and from where increments count: there, unless it is held up."""
        if self.task.moves_camera:
            joints = np.asarray(read(f"{name}/setpoint_js", arm.setpoint_js)[0], np.float64)
            now = Aim(joints=joints, camera=reading.camera)
            return now, now
        measured = reading.wrists[name]
        sent = self._in_scene(name, read(f"{name}/setpoint_cp", arm.setpoint_cp)[0])
        jaw = self._jaws.get(name, reading.jaws[name])
        off = float(np.linalg.norm(sent.position - measured.position))
        # A late arm is off, too, but is on its way.
        coming = self._speeds.get(name, 0.0) * self.task.spec.seconds_per_step
        is_held_up = off > max(self.limits.held_up, coming) or self._is_dry
        return Aim(sent, jaw), Aim(measured if is_held_up else sent, jaw)

    def _servo(self, aims: dict[str, tuple[Aim, Aim]], share: float, log: Log) -> None:
        for name, (start, end) in aims.items():
            arm = self.robot.arms[name]
            if end.joints is not None and start.joints is not None:
                joints = start.joints + share * (end.joints - start.joints)
                arm.servo_jp(joints)
                log.command(name, self.robot.now(), joints)
            elif end.wrist is not None and start.wrist is not None:
                wrist = between(start.wrist, end.wrist, share)
                jaw = start.jaw + share * (end.jaw - start.jaw)
                self._jaws[name] = jaw
                arm.servo_cp((self.robot.frames[name].inverse() @ wrist).frame(self.robot.kdl))
                arm.jaw.servo_jp(np.array([jaw]))
                numbers = [*wrist.position, *wrist.rotation.ravel(), jaw]
                log.command(name, self.robot.now(), np.array(numbers))

    # ---- What is read ----

    def _read(self) -> Reading:
        reading = Reading()
        for name, arm in self._arms():
            if self.task.moves_camera:
                frame, stamp = read(f"{name}/local/measured_cp", arm.local.measured_cp)
                reading.camera = Pose.of_frame(frame)
                reading.stamps[f"{name}/local/measured_cp"] = stamp
            else:
                frame, stamp = read(f"{name}/measured_cp", arm.measured_cp)
                reading.wrists[name] = self._in_scene(name, frame)
                reading.stamps[f"{name}/measured_cp"] = stamp
                jaw, *_, stamp = read(f"{name}/jaw/measured_js", arm.jaw.measured_js)
                reading.jaws[name] = float(jaw[0])
                reading.stamps[f"{name}/jaw/measured_js"] = stamp
            if self.layout.needs_joints or self.task.moves_camera:
                joints, *_, stamp = read(f"{name}/measured_js", arm.measured_js)
                reading.joints[name] = np.asarray(joints, np.float64)
                reading.stamps[f"{name}/measured_js"] = stamp
        self._source.read(reading)
        reading.goal = checked_goal(reading.goal, self.task)
        return reading

    def _stamps(self, log: Log) -> dict[str, float]:
        """The stamps of the arms' poses, which are looked at with every set-point."""
        stamps = {}
        for name, arm in self._arms():
            topic = "local/measured_cp" if self.task.moves_camera else "measured_cp"
            get = arm.local.measured_cp if self.task.moves_camera else arm.measured_cp
            frame, stamps[f"{name}/{topic}"] = read(f"{name}/{topic}", get)
            pose = Pose.of_frame(frame) if self.task.moves_camera else self._in_scene(name, frame)
            stamp = stamps[f"{name}/{topic}"]
            log.measured(name, stamp, pose)
            before, place = self._seen_at.get(name, (stamp, pose.position))
            if stamp > before:
                way = float(np.linalg.norm(pose.position - place))
                self._speeds[name] = way / (stamp - before)
            self._seen_at[name] = (stamp, pose.position)
        return stamps

    def _wait_for_topics(self) -> Reading:
        """The first reading of which every stamp is new: a topic that repeats one is dead."""
        rate = self.robot.rate(self.limits.rate)
        deadline = self.robot.now() + self.limits.patience
        stamps: dict[str, float] = {}
        while True:
            try:
                reading = self._read()
                stamps = stamps or dict(reading.stamps)
                old = [topic for topic, at in reading.stamps.items() if at <= stamps[topic]]
                if not old:
                    return reading
                why = f"{old[0]} is stale: all its messages have one stamp"
            except Stopped as error:
                why = str(error)
            if self.robot.now() > deadline:
                raise Stopped(f"{why}, for {self.limits.patience} s")
            rate.sleep()

    # ---- What is made of it ----

    def _arms(self) -> Iterator[tuple[str, Any]]:
        return ((name, self.robot.arms[name]) for name in self.task.arms)

    def _in_scene(self, name: str, frame: Any) -> Pose:
        return self.robot.frames[name] @ Pose.of_frame(frame)  # type: ignore[no-any-return]

    def _box(self, name: str, spare: float = 0.0) -> Numbers:
        """Where a wrist may be sent, m, larger by so much on each side."""
        box = self.limits.box
        corners = self.task.boxes[name] if box is None else np.reshape(box, (2, 3))
        return np.array([corners[0] - spare, corners[1] + spare])

    def _refuse(self, why: str) -> None:
        if why:
            raise Stopped(why)

    def _check_state(self, name: str, arm: Any) -> None:
        if not arm.is_enabled():
            told = arm.operating_state() if hasattr(arm, "operating_state") else "another state"
            raise Stopped(f"{name} is not ENABLED but {told}: enable it, or give --home")
        if hasattr(arm, "is_homed") and not arm.is_homed():
            raise Stopped(f"{name} is not homed: home it, or give --home")

    def _hold(self) -> None:
        if self._is_dry:
            return
        for _, arm in self._arms():
            with suppress(TimeoutError, RuntimeError, RuntimeWarning):
                if hasattr(arm, "hold"):
                    arm.hold()
                arm.is_enabled()  # which gives the command at once where there is a queue

    def _distance(self, last: Reading) -> float:
        if last.goal is None:
            return float("nan")
        return float(np.linalg.norm(self.layout.achieved(last) - last.goal))

    def _judged(self, last: Reading) -> str:
        """By the simulator, else by what was measured."""
        is_success = self.robot.is_success()
        if is_success is None and last.goal is not None:
            desired = np.array(last.goal, np.float32)
            achieved = self.layout.achieved(last)
            is_success = bool(self.task.spec.compute_success(achieved, desired))
        return "success" if is_success else "failure"

    def _words(self, step: int, reading: Reading, jumped: str) -> str:
        ages = [self.robot.now() - stamp for stamp in reading.stamps.values()]
        words = f"step {step + 1}/{self._max_steps}"
        distance = self._distance(reading)
        if np.isfinite(distance):
            words += f", goal {distance:.4f} away"
        words += f", oldest stamp {1e3 * max(ages):.0f} ms old"
        return f"{words}; {jumped}: the arms hold" if jumped else words

"""An arm's test in the manner of dVRK's own: nothing in it knows of Trocar."""

import argparse
import math
import sys
import time

import crtk
import dvrk
import numpy
import PyKDL


class Test:
    """What is tested of an arm."""

    def __init__(self, ral, name, period):
        self.ral, self.period = ral, period
        self.arm = dvrk.psm(ral, name)
        time.sleep(0.2)

    def home(self):
        self.ral.check_connections()
        if not self.arm.enable(10):
            print("! not enabled within 10 seconds")
        if not self.arm.home(10):
            print("! not homed within 10 seconds")
        self.prepare()
        goal = numpy.copy(self.arm.setpoint_jp()[0])
        self.arm.move_jp(goal).wait()

    def prepare(self):
        stamp = 0.0
        while stamp == 0.0:
            joints, stamp = self.arm.setpoint_jp(wait_timeout=5.0)
        goal = numpy.copy(joints)
        goal[:4] = [0.0, 0.0, 0.12, 0.0]
        self.arm.move_jp(goal).wait()

    def servo_jp(self):
        start = numpy.copy(self.arm.setpoint_jp()[0])
        goal, velocity = numpy.copy(start), numpy.zeros(start.size)
        amplitude, duration = math.radians(5.0), 5.0
        samples = duration / self.period
        rate = self.ral.create_rate(1.0 / self.period)
        for i in range(int(samples)):
            angle = i * math.radians(360.0) / samples
            goal[:2] = start[:2] + amplitude * (1.0 - math.cos(angle))
            velocity[:2] = amplitude * math.sin(angle)
            self.arm.servo_jp(goal, velocity)
            now = self.ral.to_sec(self.ral.now())
            _, measured = self.arm.measured_jp()
            _, setpoint = self.arm.setpoint_jp()
            if measured == 0 or abs(now - measured) > 10.0 or measured != setpoint:
                print("! invalid data")
            rate.sleep()

    def move_jp(self):
        start = numpy.copy(self.arm.setpoint_jp()[0])
        amplitude = math.radians(10.0)
        goal = numpy.copy(start)
        for sign in (1, -1):
            goal[0], goal[1] = start[0] + sign * amplitude, start[1] - sign * amplitude
            self.arm.move_jp(goal).wait()
        self.arm.move_jp(start).wait()

    def servo_cp(self):
        self.prepare()
        start = PyKDL.Frame()
        cp, _ = self.arm.setpoint_cp()
        start.p, start.M = cp.p, cp.M
        goal = PyKDL.Frame()
        goal.p, goal.M = cp.p, cp.M
        samples = 5.0 / self.period
        rate = self.ral.create_rate(1.0 / self.period)
        for i in range(int(samples)):
            by = 0.02 * (1.0 - math.cos(i * math.radians(360.0) / samples))
            goal.p[0] = start.p[0] + by
            goal.p[1] = start.p[1] + by
            self.arm.servo_cp(goal)
            setpoint, stamp = self.arm.setpoint_cp()
            if stamp == 0:
                print("! no Cartesian data")
            if (goal.p - setpoint.p).Norm() > 0.002:
                print("! kinematic error at", i)
            rate.sleep()

    def move_cp(self):
        self.prepare()
        start, _ = self.arm.setpoint_cp()
        for axis in (0, 1):
            for by in (-0.05, 0.05, 0.0):
                goal = PyKDL.Frame(start)
                goal.p[axis] = start.p[axis] + by
                self.arm.move_cp(goal).wait()
                setpoint, _ = self.arm.setpoint_cp()
                if (goal.p - setpoint.p).Norm() > 1e-5:
                    print("! the goal was not reached")

    def jaw(self):
        for _ in range(2):
            self.arm.jaw.close().wait()
            self.arm.jaw.open().wait()

    def run(self):
        self.home()
        for name in ("servo_jp", "move_jp", "servo_cp", "move_cp", "jaw"):
            if name == "move_cp":
                self.prepare()
            start = time.time()
            getattr(self, name)()
            print(f"{name}: {time.time() - start:.9f}")


if __name__ == "__main__":
    arguments = crtk.ral.parse_argv(sys.argv[1:])
    parser = argparse.ArgumentParser()
    parser.add_argument("-a", "--arm", required=True, choices=["ECM", "PSM1", "PSM2"])
    parser.add_argument("-p", "--period", type=float, default=0.01)
    given = parser.parse_args(arguments)
    layer = crtk.ral("arm_test")
    layer.on_shutdown(lambda: print("shut down"))
    layer.spin_and_execute(Test(layer, given.arm, given.period).run)

"""Scenarios for the unmodified ur_rtde wheel; runs in a process of its own, speaks JSON lines."""

import json
import math
import sys
import time
from collections.abc import Callable
from typing import Any

import dashboard_client
import rtde_control
import rtde_io
import rtde_receive

from tests.machine_speed import stretched_s

HOST = ""


def say(**facts: Any) -> None:
    sys.stdout.write(json.dumps(facts) + "\n")
    sys.stdout.flush()


def pause(**facts: Any) -> None:
    say(**facts)
    sys.stdin.readline()


def until(condition: Callable[[], bool]) -> bool:
    end = time.monotonic() + stretched_s(20.0)
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.005)
    return True


def off(joints: list[float], axis: int, rad: float) -> list[float]:
    return [q + (rad if i == axis else 0.0) for i, q in enumerate(joints)]


def gap(a: list[float], b: list[float]) -> float:
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def moves() -> None:
    receive, control = rtde_receive.RTDEReceiveInterface(HOST), rtde_control.RTDEControlInterface(HOST)
    start = receive.getActualQ()
    found: dict[str, Any] = {}

    def arrived(joints: list[float], within_rad: float = 1e-9) -> bool:
        return until(lambda: gap(receive.getActualQ(), joints) < within_rad)

    near = off(start, 0, 0.3)
    found["moveJ"] = control.moveJ(near, 1.05, 1.4) and arrived(near)
    pose = receive.getActualTCPPose()
    up = [pose[0], pose[1], pose[2] + 0.05, *pose[3:]]
    found["moveL"] = control.moveL(up, 0.25, 1.2) and until(
        lambda: gap(receive.getActualTCPPose(), up) < 1e-8
    )
    found["moveJ_IK"] = control.moveJ_IK(pose, 1.05, 1.4) and arrived(near)
    found["moveL_FK"] = control.moveL_FK(off(near, 1, 0.05), 0.25, 1.2) and arrived(off(near, 1, 0.05))
    path = [[*start, 0.5, 1.0, 0.0], [*near, 0.5, 1.0, 0.0]]
    found["path"] = control.moveJ(path) and arrived(
        near, 1e-5
    )  # the wheel prints six digits into the program
    found["async"] = control.moveJ(start, 0.2, 0.5, True)
    found["async ran"] = until(lambda: control.getAsyncOperationProgress() >= 0)
    found["async ended"] = until(lambda: control.getAsyncOperationProgress() < 0) and arrived(start)
    control.moveJ(off(start, 0, 3.0), 0.2, 0.5, True)
    until(lambda: abs(receive.getActualQd()[0]) > 0.01)
    control.stopJ(4.0)
    found["stopJ"] = (
        until(lambda: not any(receive.getActualQd())) and 0 < receive.getActualQ()[0] - start[0] < 3
    )
    control.speedJ([0.1, 0, 0, 0, 0, 0], 1.0)
    found["speedJ"] = until(lambda: abs(receive.getActualQd()[0] - 0.1) < 1e-9)
    control.speedStop(10.0)
    found["speedStop"] = until(lambda: not any(receive.getActualQd()))
    target = off(receive.getActualQ(), 5, 0.05)
    for _ in range(200):
        control.servoJ(target, 0.5, 0.5, 0.002, 0.1, 300)
        time.sleep(0.002)
    found["servoJ"] = until(lambda: gap(receive.getActualQ(), target) < 1e-3)
    found["servoStop"] = control.servoStop()
    found["teach"] = control.teachMode() and control.endTeachMode()
    say(**found)
    control.stopScript()
    control.disconnect()
    receive.disconnect()


def answers() -> None:
    receive, control = rtde_receive.RTDEReceiveInterface(HOST), rtde_control.RTDEControlInterface(HOST)
    control.setTcp([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    until(lambda: gap(control.getForwardKinematics(), receive.getActualTCPPose()) < 1e-12)
    q, pose = receive.getActualQ(), receive.getActualTCPPose()
    found: dict[str, Any] = {
        "fk": gap(control.getForwardKinematics(), pose),
        "fk of q": gap(control.getForwardKinematics(q, [0, 0, 0.1, 0, 0, 0]), pose),
        "ik": gap(control.getInverseKinematics(pose), q),
        "ik far": control.getInverseKinematicsHasSolution([5.0, 0, 0, 0, 0, 0]),
        "tcp": control.getTCPOffset(),
        "pose trans": control.poseTrans([1.0, 0, 0, 0, 0, 0], [0, 2.0, 0, 0, 0, 0.5]),
        "outside": control.isJointsWithinSafetyLimits(off(q, 0, 9.0)),
    }
    found["stale"] = control.getActualToolFlangePose()  # answers at once, with the command before

    def flange_to_tip() -> float:
        return math.dist(control.getActualToolFlangePose()[:3], pose[:3])

    until(lambda: abs(flange_to_tip() - 0.1) < 1e-6)
    found["flange to tip"] = flange_to_tip()
    found["unreachable"] = control.getInverseKinematics([5.0, 0, 0, 0, 0, 0])
    found["script died"] = until(lambda: not control.isProgramRunning())
    control.reuploadScript()
    found["back"] = until(control.isProgramRunning)
    control.setWatchdog(20.0)
    found["watchdog bit"] = until(lambda: not control.isProgramRunning())
    say(**found)
    control.disconnect()
    receive.disconnect()


def dashboard() -> None:
    board = dashboard_client.DashboardClient(HOST)
    board.connect()
    found: dict[str, Any] = {
        "version": board.polyscopeVersion(),
        "serial": board.getSerialNumber(),
        "model": board.getRobotModel(),
        "remote": board.isInRemoteControl(),
        "mode": board.robotmode(),
        "safety": board.safetymode(),
        "state": board.programState(),
    }
    board.stop()
    board.quit()
    io, receive = rtde_io.RTDEIOInterface(HOST), rtde_receive.RTDEReceiveInterface(HOST)
    io.setStandardDigitalOut(3, True)
    found["output"] = until(lambda: receive.getDigitalOutState(3))
    io.setSpeedSlider(0.5)
    found["slider"] = until(lambda: receive.getTargetSpeedFraction() == 0.5)
    say(**found)
    io.disconnect()
    receive.disconnect()


def stopped_in_a_move() -> None:
    receive, control = rtde_receive.RTDEReceiveInterface(HOST), rtde_control.RTDEControlInterface(HOST)
    start = receive.getActualQ()
    pause(ready=True)
    arrived = control.moveJ(off(start, 0, 1.0), 0.05, 0.5)
    seen_s = receive.getTimestamp()  # the two interfaces have a connection each; this one may be behind
    until(lambda: receive.getTimestamp() > seen_s + 0.3)
    pause(
        arrived=arrived,
        protective=receive.isProtectiveStopped(),
        emergency=receive.isEmergencyStopped(),
        gone=receive.getActualQ()[0] - start[0],
    )
    control.reuploadScript()
    until(control.isProgramRunning)
    home = control.moveJ(start, 1.0, 2.0)
    say(home=home and until(lambda: gap(receive.getActualQ(), start) < 1e-9))
    control.disconnect()
    receive.disconnect()


def second_client() -> None:
    try:
        rtde_control.RTDEControlInterface(HOST)
    except RuntimeError as refusal:
        say(refused=str(refusal))
    else:
        say(refused="")


def receive_only() -> None:
    receive = rtde_receive.RTDEReceiveInterface(HOST)
    pause(connected=receive.isConnected())
    lost = until(lambda: not receive.isConnected())
    pause(lost=lost)
    say(again=receive.reconnect() and receive.isConnected(), q=receive.getActualQ())
    receive.disconnect()


if __name__ == "__main__":
    HOST = sys.argv[1]
    scenarios = (moves, answers, dashboard, stopped_in_a_move, second_client, receive_only)
    {scenario.__name__: scenario for scenario in scenarios}[sys.argv[2]]()

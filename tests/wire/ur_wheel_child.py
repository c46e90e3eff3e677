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


def print_facts(**facts: Any) -> None:
    sys.stdout.write(json.dumps(facts) + "\n")
    sys.stdout.flush()


def wait_for_parent(**facts: Any) -> None:
    print_facts(**facts)
    sys.stdin.readline()


def wait_until(condition: Callable[[], bool]) -> bool:
    end = time.monotonic() + stretched_s(20.0)
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.005)
    return True


def offset_joints(joints: list[float], axis: int, rad: float) -> list[float]:
    return [q + (rad if i == axis else 0.0) for i, q in enumerate(joints)]


def joint_distance(a: list[float], b: list[float]) -> float:
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


def moves() -> None:
    receive, control = rtde_receive.RTDEReceiveInterface(HOST), rtde_control.RTDEControlInterface(HOST)
    start = receive.getActualQ()
    found: dict[str, Any] = {}

    def has_arrived(joints: list[float], within_rad: float = 1e-9) -> bool:
        return wait_until(lambda: joint_distance(receive.getActualQ(), joints) < within_rad)

    near = offset_joints(start, 0, 0.3)
    found["moveJ"] = control.moveJ(near, 1.05, 1.4) and has_arrived(near)
    pose = receive.getActualTCPPose()
    up = [pose[0], pose[1], pose[2] + 0.05, *pose[3:]]
    found["moveL"] = control.moveL(up, 0.25, 1.2) and wait_until(
        lambda: joint_distance(receive.getActualTCPPose(), up) < 1e-8
    )
    found["moveJ_IK"] = control.moveJ_IK(pose, 1.05, 1.4) and has_arrived(near)
    found["moveL_FK"] = control.moveL_FK(offset_joints(near, 1, 0.05), 0.25, 1.2) and has_arrived(
        offset_joints(near, 1, 0.05)
    )
    path = [[*start, 0.5, 1.0, 0.0], [*near, 0.5, 1.0, 0.0]]
    found["path"] = control.moveJ(path) and has_arrived(
        near, 1e-5
    )  # the wheel prints six digits into the program
    found["async"] = control.moveJ(start, 0.2, 0.5, True)
    found["async ran"] = wait_until(lambda: control.getAsyncOperationProgress() >= 0)
    found["async ended"] = wait_until(lambda: control.getAsyncOperationProgress() < 0) and has_arrived(start)
    control.moveJ(offset_joints(start, 0, 3.0), 0.2, 0.5, True)
    wait_until(lambda: abs(receive.getActualQd()[0]) > 0.01)
    control.stopJ(4.0)
    found["stopJ"] = (
        wait_until(lambda: not any(receive.getActualQd())) and 0 < receive.getActualQ()[0] - start[0] < 3
    )
    control.speedJ([0.1, 0, 0, 0, 0, 0], 1.0)
    found["speedJ"] = wait_until(lambda: abs(receive.getActualQd()[0] - 0.1) < 1e-9)
    control.speedStop(10.0)
    found["speedStop"] = wait_until(lambda: not any(receive.getActualQd()))
    target = offset_joints(receive.getActualQ(), 5, 0.05)
    for _ in range(200):
        control.servoJ(target, 0.5, 0.5, 0.002, 0.1, 300)
        time.sleep(0.002)
    found["servoJ"] = wait_until(lambda: joint_distance(receive.getActualQ(), target) < 1e-3)
    found["servoStop"] = control.servoStop()
    found["teach"] = control.teachMode() and control.endTeachMode()
    print_facts(**found)
    control.stopScript()
    control.disconnect()
    receive.disconnect()


def answers() -> None:
    receive, control = rtde_receive.RTDEReceiveInterface(HOST), rtde_control.RTDEControlInterface(HOST)
    control.setTcp([0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    wait_until(lambda: joint_distance(control.getForwardKinematics(), receive.getActualTCPPose()) < 1e-12)
    q, pose = receive.getActualQ(), receive.getActualTCPPose()
    found: dict[str, Any] = {
        "fk": joint_distance(control.getForwardKinematics(), pose),
        "fk of q": joint_distance(control.getForwardKinematics(q, [0, 0, 0.1, 0, 0, 0]), pose),
        "ik": joint_distance(control.getInverseKinematics(pose), q),
        "ik far": control.getInverseKinematicsHasSolution([5.0, 0, 0, 0, 0, 0]),
        "tcp": control.getTCPOffset(),
        "pose trans": control.poseTrans([1.0, 0, 0, 0, 0, 0], [0, 2.0, 0, 0, 0, 0.5]),
        "outside": control.isJointsWithinSafetyLimits(offset_joints(q, 0, 9.0)),
    }
    found["stale"] = control.getActualToolFlangePose()  # answers at once, with the command before

    def flange_to_tip() -> float:
        return math.dist(control.getActualToolFlangePose()[:3], pose[:3])

    wait_until(lambda: abs(flange_to_tip() - 0.1) < 1e-6)
    found["flange to tip"] = flange_to_tip()
    found["unreachable"] = control.getInverseKinematics([5.0, 0, 0, 0, 0, 0])
    found["script died"] = wait_until(lambda: not control.isProgramRunning())
    control.reuploadScript()
    found["back"] = wait_until(control.isProgramRunning)
    control.setWatchdog(20.0)
    found["watchdog bit"] = wait_until(lambda: not control.isProgramRunning())
    print_facts(**found)
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
    found["output"] = wait_until(lambda: receive.getDigitalOutState(3))
    io.setSpeedSlider(0.5)
    found["slider"] = wait_until(lambda: receive.getTargetSpeedFraction() == 0.5)
    print_facts(**found)
    io.disconnect()
    receive.disconnect()


def stopped_in_a_move() -> None:
    receive, control = rtde_receive.RTDEReceiveInterface(HOST), rtde_control.RTDEControlInterface(HOST)
    start = receive.getActualQ()
    wait_for_parent(ready=True)
    arrived = control.moveJ(offset_joints(start, 0, 1.0), 0.05, 0.5)
    seen_s = receive.getTimestamp()  # the two interfaces have a connection each; this one may be behind
    wait_until(lambda: receive.getTimestamp() > seen_s + 0.3)
    wait_for_parent(
        arrived=arrived,
        protective=receive.isProtectiveStopped(),
        emergency=receive.isEmergencyStopped(),
        gone=receive.getActualQ()[0] - start[0],
    )
    control.reuploadScript()
    wait_until(control.isProgramRunning)
    home = control.moveJ(start, 1.0, 2.0)
    print_facts(home=home and wait_until(lambda: joint_distance(receive.getActualQ(), start) < 1e-9))
    control.disconnect()
    receive.disconnect()


def second_client() -> None:
    try:
        rtde_control.RTDEControlInterface(HOST)
    except RuntimeError as refusal:
        print_facts(refused=str(refusal))
    else:
        print_facts(refused="")


def receive_only() -> None:
    receive = rtde_receive.RTDEReceiveInterface(HOST)
    wait_for_parent(connected=receive.isConnected())
    lost = wait_until(lambda: not receive.isConnected())
    wait_for_parent(lost=lost)
    print_facts(again=receive.reconnect() and receive.isConnected(), q=receive.getActualQ())
    receive.disconnect()


if __name__ == "__main__":
    HOST = sys.argv[1]
    scenarios = (moves, answers, dashboard, stopped_in_a_move, second_client, receive_only)
    {scenario.__name__: scenario for scenario in scenarios}[sys.argv[2]]()

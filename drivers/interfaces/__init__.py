"""What a procedure may ask of a device. Protocols for the type checker, frozen dataclasses for the borders.

One module for each family of devices; all names can be imported from this package.

Optional abilities are Protocols of their own, one per flag of the capabilities:

=============================  ==========================
flag                           Protocol
=============================  ==========================
``moves_joints``               ``Robot.move_joints``
``jogs_single_axes``           ``JogsAxes``
``reads_encoder_counts``       ``ReadsEncoderCounts``
``reads_mastering``            ``ReadsMastering``
``writes_mastering``           ``MasteringStore``
``writes_tool_frame``          ``ToolFrameStore``
``writes_user_frame``          ``UserFrameStore``
``tells_active_frames``        ``KnowsActiveFrames``
``tells_mode``                 ``KnowsMode``
``tells_speed_override``       ``KnowsSpeedOverride``
``shows_position_data``        ``TellsPositionData``
``keeps_position_history``     ``KeepsPositionHistory``
``measures_poses``             ``MeasuresPoses``
=============================  ==========================

SI units. Every call ends within the deadline of the driver's configuration or raises a DeviceError.
"""

from cellcal.drivers.interfaces.device import (
    Alarm,
    AlarmKind,
    Condition,
    Device,
    DoubtsIdentity,
    Identity,
    Readiness,
)
from cellcal.drivers.interfaces.gauge import (
    DistanceGauge,
    GaugeCapabilities,
    LengthReading,
)
from cellcal.drivers.interfaces.operator import (
    Answer,
    GuidesPerson,
    Instruction,
    Operator,
    Question,
)
from cellcal.drivers.interfaces.probe import (
    ContactEdge,
    ContactReading,
    ProbeCapabilities,
    TouchProbe,
)
from cellcal.drivers.interfaces.robot import (
    ActiveFrames,
    ComparesJoints,
    Counts,
    JogsAxes,
    JointReading,
    Joints,
    KeepsPositionHistory,
    KnowsActiveFrames,
    KnowsMode,
    KnowsSpeedOverride,
    MasteringData,
    MasteringStore,
    PositionCure,
    PositionHistory,
    ReadsEncoderCounts,
    ReadsMastering,
    Robot,
    RobotCapabilities,
    ShownExternalAxis,
    TellsPositionData,
    ToolFrameStore,
    UserFrameStore,
)
from cellcal.drivers.interfaces.tracker import (
    Air,
    MeasuresPoses,
    PointReading,
    PoseReading,
    Tracker,
    TrackerCapabilities,
)

__all__ = [
    "ActiveFrames",
    "Air",
    "Alarm",
    "AlarmKind",
    "Answer",
    "ComparesJoints",
    "Condition",
    "ContactEdge",
    "ContactReading",
    "Counts",
    "Device",
    "DistanceGauge",
    "DoubtsIdentity",
    "GaugeCapabilities",
    "GuidesPerson",
    "Identity",
    "Instruction",
    "JogsAxes",
    "JointReading",
    "Joints",
    "KeepsPositionHistory",
    "KnowsActiveFrames",
    "KnowsMode",
    "KnowsSpeedOverride",
    "LengthReading",
    "MasteringData",
    "MasteringStore",
    "MeasuresPoses",
    "Operator",
    "PointReading",
    "PoseReading",
    "PositionCure",
    "PositionHistory",
    "ProbeCapabilities",
    "Question",
    "Readiness",
    "ReadsEncoderCounts",
    "ReadsMastering",
    "Robot",
    "RobotCapabilities",
    "ShownExternalAxis",
    "TellsPositionData",
    "ToolFrameStore",
    "TouchProbe",
    "Tracker",
    "TrackerCapabilities",
    "UserFrameStore",
]

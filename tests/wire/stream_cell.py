"""A cell file with an ABB and a KUKA whose joints come by a stream, too."""

STREAM_CELL = """\
[cell]
name = "joint streams"
data_dir = "{folder}"

[[robot]]
name = "abb"
driver = "abb_web_services"
address = "{address}"
port = 8080
model = "abb_irb1600_6_12"
motion = "commanded"
serial = "1600-500123"
deadline_s = 3.0
speed_limit_rad_s = 0.5
step_s = 0.5
settle_s = 0.02

[robot.egm]
listen = "{second_address}"
window_s = 0.4  # a test machine may be too busy for 0.2
silent_s = 1.5
late_s = 0.5

{floor}
[[robot]]
name = "kuka"
driver = "kuka_variables"
address = "{address}"
model = "kuka_kr10r1420"
motion = "commanded"
serial = "864231"
fastest_axis_deg_s = 410.0
deadline_s = 2.0
speed_limit_rad_s = 0.5
step_s = 0.5
settle_s = 0.02

[robot.rsi]
listen = "{second_address}"
port = 49152
window_s = 0.4  # a test machine may be too busy for 0.2
silent_s = 1.5
late_s = 0.5

{floor}
[fake]
seed = 1
time_factor = {time_factor}
control_port = 0
"""

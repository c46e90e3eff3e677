"""URScript files with every oddity that public ones show; knows nothing of the reader."""

import numpy as np

SUFFIX = ".script"
_OPENERS = (
    "  global _hidden_verificationVariable=0",
    "  set_gravity([0.0, 0.0, 9.82])",
    "  set_target_payload(0.000000, [0.000000, 0.000000, 0.000000], [0.0, 0.0, 0.0, 0.0, 0.0, 0.0])",
    "  set_tool_communication(False, 115200, 0, 1, 1.5, 3.5)",
    "  step_count_b868544a = 0.0",
    '  textmsg("p[0.1, 0.2, 0.3, 0, 0, 0] is no pose here # nor a comment")',
    "  # movel(p[0.9, 0.9, 0.9, 0, 0, 0], a=1.2) switched off; Größe",
    "  thread Step_Counter():\n    while (True):\n      step_count = step_count + 1.0\n      sync()\n    end\n  end\n"
    "  run Step_Counter()",
    "  local speed_vec = [0.0, 0.0, -0.01, 0.0, 0.0, 0.0]\n  speedl(speed_vec, 0.5, 0.1)",
    "  if (norm(x - 1) <= 1E-3 and not done):\n    halt\n  elif (True):\n    sync()\n  else:\n    sleep(.1)\n  end",
    "  force_mode(p[0.0,0.0,0.0,0.0,0.0,0.0], [0,0,1,0,0,0], [0.0,0.0,-5.0,0.0,0.0,0.0], 2, [.1,.1,.15,.35,.35,.35])",
    "  rq = rpc_factory(\"xmlrpc\", 'http://127.0.0.1:41416')\n  rq.open(0x1F)",
    "  matrix = [[1, 2], [3.5, -4]]\n  pick = matrix[0,1] % 2",
    "  movel(pose_add(get_actual_tcp_pose(), p[0, 0, 0.1, 0, 0, 0]), a=1.2, v=0.25)",
)


def generate(seed: int) -> bytes:
    """Return a program; the same seed gives the same bytes."""
    rng = np.random.default_rng([seed, 11])
    lines = ["def cell_program():"]
    lines += rng.choice(_OPENERS, size=int(rng.integers(1, 6)), replace=False).tolist()
    if rng.random() < 0.8:
        lines.append(f"  set_tcp({_pose_text(rng, _twelve_digits)})")
    if rng.random() < 0.5:
        lines.append(f"  Plane_1 = {_pose_text(rng, _twelve_digits)}")
        lines.append(
            f"  movel(pose_trans(Plane_1, {_pose_text(rng, _typed_digits)}), a=1.2, v=0.25, t=0, r=0.002)"
        )
    count = int(rng.integers(1, 9))
    for i in range(1, count + 1):
        lines += _waypoint_lines(rng, i)
    for i in range(1, count + 1):
        lines.append(f'  $ {i} "MoveJ"\n  $ {i + 1} "Waypoint_{i}" "breakAfter"')
        lines.append(_move_instruction(rng, i))
    lines += [_free_move(rng) for _ in range(int(rng.integers(0, 5)))]
    lines += ["end", "cell_program()"][: int(rng.integers(1, 3))]
    ending = "\r\n" if rng.random() < 0.3 else "\n"
    text = "\n".join(lines).replace("\n", ending) + (ending if rng.random() < 0.8 else "")
    return text.encode("utf-8")


def _waypoint_lines(rng: np.random.Generator, i: int) -> list[str]:
    word = ("global ", "local ", "")[int(rng.integers(3))]
    blank = ("", " ", "  ")[int(rng.integers(3))]
    return [
        f"  {word}Waypoint_{i}_p{blank}={blank}{_pose_text(rng, _twelve_digits)}",
        f"  {word}Waypoint_{i}_q{blank}={blank}{_joints_text(rng, _double_digits)}",
    ]


def _move_instruction(rng: np.random.Generator, i: int) -> str:
    kind = int(rng.integers(5))
    if kind == 0:
        return f"  movel(Waypoint_{i}_p, a=1.2, v=0.25)"
    if kind == 1:
        return f"  movej(Waypoint_{i}_q, 1.4, 1.05)"
    if kind == 2:
        return f"  movel(pose_trans(Waypoint_{i}_p, p[0, 0, -0.1, 0, 0, 0]), a=1.2)"
    name = f"Waypoint_{i}"
    return f"  movej(get_inverse_kin({name}_p, qnear={name}_q), a=1.3962634015954636, v=1.0471975511965976)"


def _free_move(rng: np.random.Generator) -> str:
    style = (_typed_digits, _twelve_digits, _double_digits)[int(rng.integers(3))]
    pose, other, joints = _pose_text(rng, style), _pose_text(rng, style), _joints_text(rng, style)
    lines = (
        f"\tmovel({pose}, a=1.2, v=0.25)  # typed",
        f"  movej({joints}, a=1.4, v=1.05, r=0)",
        f"  movej(get_inverse_kin({pose}, qnear={joints}), a=1.4, v=1.05)",
        f"  movec({pose}, {other}, a=0.3, v=0.1, r=0.01, mode=1)",
        f"  movep(\n    {pose},\n    a=1.2, v=0.25)",
        f"  servoj({joints}, \\\n    t=0.008, lookahead_time=0.1, gain=300)",
        f"  here = get_forward_kin({joints})",
    )
    return lines[int(rng.integers(len(lines)))]


def _pose_text(rng: np.random.Generator, style: object) -> str:
    length = rng.normal(size=3) * 0.5
    axis = rng.normal(size=3)
    kind = int(rng.integers(6))
    angle = (0.0, np.pi, 2 * np.pi - 1e-9, rng.uniform(0, np.pi), rng.uniform(np.pi, 2 * np.pi), 1e-7)[kind]
    return "p" + _list_text(rng, [*length, *(axis / np.linalg.norm(axis) * angle)], style)


def _joints_text(rng: np.random.Generator, style: object) -> str:
    return _list_text(rng, list(rng.uniform(-6.2, 6.2, size=6)), style)


def _list_text(rng: np.random.Generator, values: list[float], style: object) -> str:
    comma = (",", ", ", " ,  ")[int(rng.integers(3))]
    return "[" + comma.join(style(float(value), rng) for value in values) + "]"  # type: ignore[operator]


def _twelve_digits(value: float, _: np.random.Generator) -> str:
    return f"{value:.12f}".replace("0.", ".", 1) if abs(value) < 1 else f"{value:.12f}"


def _double_digits(value: float, rng: np.random.Generator) -> str:
    value = (value, value * 1e-5, round(value, 3), 0.0)[int(rng.integers(4))]
    text = repr(value)
    return text.replace("e-0", "E-").replace("e-", "E-") if "e" in text else text


def _typed_digits(value: float, rng: np.random.Generator) -> str:
    kind = int(rng.integers(5))
    if kind == 0:
        return f"{round(value)}"
    return (f"{value:.3f}", f"{value:+.4f}", f"{value:.1f}", f"{value:.6f}")[kind - 1]

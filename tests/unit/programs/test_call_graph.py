"""What is set around a routine, held against a plain walk along the calls."""

import random

import pytest

from cellcal.drivers.programs.call_graph import reached_settings


def walk_calls(begin, further):
    found, open_ = set(), list(begin)
    while open_:
        for new in further[open_.pop()]:
            if new not in found:
                found.add(new)
                open_.append(new)
    return found


@pytest.mark.parametrize("seed", range(200))
def test_what_is_set_below_and_around_a_routine_is_what_a_walk_finds(seed):
    rng = random.Random(seed)
    count = rng.randint(1, 12)
    calls = [{rng.randrange(count) for _ in range(rng.randint(0, 2))} for _ in range(count)]
    own = [{rng.choice("1234")} if rng.random() < 0.3 else set() for _ in range(count)]
    callers = [{one for one in range(count) if routine in calls[one]} for routine in range(count)]
    below, above = reached_settings(calls, own)
    for routine in range(count):
        under = {value for one in {routine, *walk_calls([routine], calls)} for value in own[one]}
        over = walk_calls([routine], callers)
        around = {value for one in over | walk_calls(over, calls) for value in own[one]}
        for marks, values in ((below[routine], under), (above[routine], around)):
            assert [value for value, _ in marks] == sorted(values)[:2]
            assert all(value in own[who] for value, who in marks)


def test_a_chain_deeper_than_python_recurses_is_followed():
    count = 20_000
    below, above = reached_settings(
        [[k + 1] for k in range(count - 1)] + [[]], [["1"]] + [[]] * (count - 2) + [["2"]]
    )
    assert below[0] == (("1", 0), ("2", count - 1))
    assert above[count - 1] == below[0]

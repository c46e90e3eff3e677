"""Tours over poses with detours: in a plane with walls, where every way can be seen."""

from itertools import pairwise

import numpy as np
import pytest

from cellcal.procedures.motion.detours import known_way, ways_through

START = (0.0, 0.0)


def crosses_wall(one, other, wall):
    (a, b), (p, q) = (np.asarray(one), np.asarray(other)), np.asarray(wall)
    side = lambda u, v, w: np.cross(np.append(v - u, 0.0), np.append(w - u, 0.0))[2]  # noqa: E731
    return side(a, b, p) * side(a, b, q) < 0 and side(p, q, a) * side(p, q, b) < 0


def free_of(walls):
    return lambda here, there, wound: (
        None if any(crosses_wall(here, there, wall) for wall in walls) else wound
    )


def tour_legs(ways):
    return list(pairwise([np.array(START), *(corner for way in ways for corner in way)]))


def test_the_way_back_to_where_a_pose_is_free_from_is_cut_short():
    """In a comb with three cells a tour goes down into one after the other; the last one opens from the first."""
    shut = [((2.0, -1.0), (2.0, -9.0)), ((-9.0, -1.0), (9.0, -1.0))]  # from below no way leads anywhere else
    down = (1.0, -5.0)

    def arrive_at(here, there, wound):
        hatch = tuple(there) == down and tuple(here) == START
        return wound if hatch or free_of(shut)(here, there, wound) is not None else None

    poses = np.array([(0.0, 5.0), (5.0, 5.0), (5.0, 0.5), down])
    ways = ways_through(START, poses, arrive_at)
    assert {tuple(way[-1]) for way in ways} == {tuple(pose) for pose in poses}
    last = next(way for way in ways if tuple(way[-1]) == down)
    assert len(last) <= 2, "straight to where the hatch is, and down"
    assert len(ways_through((9.0, 9.0), poses, free_of(shut))) == 3, "what is shut off is left out"


def test_a_straight_way_that_winds_the_wire_otherwise_is_not_taken():
    """Round a post in the middle: what is straight across it would leave the wire on the wrong side."""
    post = np.array([0.0, 5.0])

    def arrive_at(here, there, wound):
        turn = [np.arctan2(*(np.asarray(at) - post)[::-1]) for at in (here, there)]
        turned = (turn[1] - turn[0] + np.pi) % (2 * np.pi) - np.pi
        return None if abs(wound + turned) > 1.3 * np.pi else float(wound + turned)

    ring = post + 5.0 * np.array([(np.sin(a), -np.cos(a)) for a in np.arange(0.5, 6.0, 0.5)])
    wound, here = 0.0, np.array(START)
    for way in ways_through(START, ring, arrive_at):
        for corner in way:
            wound = arrive_at(here, corner, wound)
            assert wound is not None, "no leg of the tour winds too far"
            here = corner


@pytest.mark.parametrize("seed", range(20))
def test_every_leg_of_a_tour_is_free_and_what_can_be_reached_is_reached(seed):
    generator = np.random.default_rng(seed)
    walls = generator.uniform(-10, 10, (6, 2, 2))
    poses = generator.uniform(-10, 10, (15, 2))
    ways = ways_through(START, poses, free_of(walls))
    assert not any(crosses_wall(a, b, wall) for a, b in tour_legs(ways) for wall in walls)
    reached = {tuple(way[-1]) for way in ways}
    assert len(reached) == len(ways)
    unreached = [pose for pose in poses if tuple(pose) not in reached]
    places = [np.array(START), *(way[-1] for way in ways)]
    assert all(free_of(walls)(place, pose, 0.0) is None for pose in unreached for place in places)


def test_a_known_way_back_takes_the_shorter_of_two():
    ways = [[(1.0, 0.0)], [(1.0, 1.0)], [(0.0, 1.0)], [(0.0, 0.0), (5.0, 0.0)]]
    assert known_way(START, ways, (5.0, 0.0), (1.0, 0.0)) == ((0.0, 0.0), (1.0, 0.0))

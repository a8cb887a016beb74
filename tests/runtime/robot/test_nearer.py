"""A slow way to a place is straight, and ends there."""

import numpy as np

from jiti.runtime.robot.loop import RETURN_STEP, nearer


def test_all_joints_arrive_together_and_none_goes_faster_than_it_may():
    start, place = {"a": 0.0, "b": 10.0, "c": -50.0}, {"a": 30.0, "b": 9.0, "c": -50.0}
    way = [start]
    for _ in range(15):
        way.append(nearer(way[-1], place))
    angles = np.array([list(one.values()) for one in way])
    np.testing.assert_allclose(angles, np.linspace(angles[0], list(place.values()), 16), atol=1e-9)
    assert np.abs(np.diff(angles, axis=0)).max() <= RETURN_STEP + 1e-9
    assert nearer(place, place) == place

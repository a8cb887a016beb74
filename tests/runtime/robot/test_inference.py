"""The process of policy and critic decides as simulation does, with the same code and the same numbers."""

from time import monotonic, sleep

import numpy as np
import pytest

from jiti.errors import UsageError
from jiti.runtime.guidance import Guidance, Guide
from jiti.runtime.robot.inference import Brain, Facts, Inference, open_agent
from jiti.runtime.rollout.decide import decide
from tests.builders import robot_agents
from tests.runtime.candidates.conftest import TOLD, checkpoint, inputs, tiny_critic, tiny_flow

pytest.importorskip("lerobot", reason="pip install 'jiti[robot,learn]'")
pytestmark = pytest.mark.filterwarnings("ignore")
"""lerobot and what it imports warn of themselves."""
FULL, NONE = Guidance("full", candidates=4), Guidance("none")
SEEN = {"observation.state": np.linspace(-40, 40, 6, dtype=np.float32)}


@pytest.fixture(scope="module")
def brain(tmp_path_factory) -> Brain:
    """A tiny policy and a critic of an arm with six joints, random weights."""
    folder = tmp_path_factory.mktemp("so100")
    policy = checkpoint(tiny_flow(**inputs(state=6, scene=0, action=6)), folder / "policy")
    critic = tiny_critic(folder / "critic", size=6, action=6)
    return Brain(str(policy), str(critic), (FULL,), TOLD)


def answered(inference: Inference):
    end = monotonic() + 60
    while (answer := inference.answer()) is None:
        assert monotonic() < end
        sleep(0.01)
    return answer


@pytest.mark.slow
def test_a_decision_is_the_one_of_simulation(brain):
    agent = open_agent(brain, SEEN)
    guide = Guide(FULL, 3, agent.sampler.noise_shape)
    with Inference(brain) as inference:
        facts = inference.open(SEEN)
        assert facts == Facts(execute=min(agent.sampler.executed, agent.sampler.chunk // 2), history=1)
        inference.begin(3, FULL)
        for frame in range(3):
            inference.ask([SEEN], frame)
            there = answered(inference)
            chunk, here = decide(agent, guide, [SEEN], TOLD, frame)
            np.testing.assert_allclose(there.chunk, chunk, rtol=1e-5, atol=1e-5)
            assert there.decided.decision.chosen == here.decision.chosen
            assert there.decided.decision.values == pytest.approx(here.decision.values, rel=1e-4)
            assert there.round_trip_s > there.decided.decision.sample_s
        inference.begin(3, FULL)
        inference.ask([SEEN], 0)
        assert answered(inference).decided.decision.decision == 0, "a new episode counts anew"


def test_a_policy_of_another_arm_is_refused_when_it_is_opened(brain):
    with pytest.raises(UsageError, match=r"observation.state of shape \(6,\)"):
        open_agent(brain, {"observation.state": np.zeros(8, np.float32)})


def test_what_makes_the_agent_refuse_is_told_to_who_asked():
    inference = Inference(Brain("p", None, (Guidance("full"),), TOLD), robot_agents.without_critic)
    with inference, pytest.raises(UsageError, match="needs a critic"):
        inference.open(SEEN)


def test_it_ends_though_a_decision_is_under_way():
    with Inference(Brain("p", None, (NONE,), TOLD), robot_agents.stall) as inference:
        inference.open(SEEN)
        for seed in range(2):
            inference.begin(seed, NONE)
            inference.ask([SEEN], 0)
            if seed == 0:
                answered(inference)
    assert not inference._process.is_alive()

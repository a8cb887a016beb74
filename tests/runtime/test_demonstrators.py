"""Each expert succeeds, and its care or its fault shows in the predicates, on the trace of a whole demonstration."""

import numpy as np
import pytest

from jiti.errors import UsageError
from jiti.runtime.sim.demonstrators import demonstrator_for, is_careful
from jiti.runtime.sim.episode import run_episode
from jiti.runtime.sim.monitor import Monitor
from jiti.runtime.sim.scene import Scene
from jiti.tasks.catalogue import load_catalogue

pytestmark = pytest.mark.sim

CATALOGUE = load_catalogue()
SIMULATED = [task.task_id for task in CATALOGUE if task.bddl]
ALWAYS = ("elegant/T0", "elegant/T2", "elegant/T5")
"""Tasks that the default run demonstrates: one a kind of ITC; `-m slow` has the rest."""
TRIES = 3
"""Seeds of which the first good one counts: the rates are measured over fifty, by benchmarks/demonstrations.py."""


def demonstrate(scene: Scene, quality: float, seed: int):
    scene.reset(seed)
    monitor = Monitor(scene)
    actor = demonstrator_for(scene, seed, quality)
    actions: list[np.ndarray] = []

    def step(action: np.ndarray) -> None:
        actions.append(action)
        scene.step(action)

    outcome = run_episode(monitor, actor, step)
    assert all(a.shape == (7,) and np.abs(a).max() <= 1 for a in actions)
    assert outcome.steps == len(actions) + 1
    return outcome, monitor.trace()


@pytest.mark.parametrize("task_id", [t if t in ALWAYS else pytest.param(t, marks=pytest.mark.slow) for t in SIMULATED])
def test_care_is_elegant_and_its_lack_is_not(task_id):
    with Scene(CATALOGUE.task(task_id)) as scene:
        for quality in (1.0, 0.0):
            good = 0
            for seed in range(300, 300 + TRIES):
                outcome, trace = demonstrate(scene, quality, seed)
                (verdict,) = outcome.verdicts.values()
                assert 0 <= verdict.step <= trace.last
                good += outcome.success and outcome.elegant == (quality == 1.0)
                if good:
                    break
            assert good, (task_id, quality, outcome)


@pytest.mark.slow
def test_a_seed_gives_the_same_demonstration():
    with Scene(CATALOGUE.task("elegant/T2")) as scene:
        first, _ = demonstrate(scene, 0.5, 7)
        demonstrate(scene, 0.5, 8)
        again, _ = demonstrate(scene, 0.5, 7)
    assert again == first


@pytest.mark.parametrize("quality", [0.0, 0.3, 0.5, 1.0])
def test_quality_is_the_share_that_is_meant_to_be_elegant(quality):
    for first in (0, 17, 1000):
        for count in (10, 50):
            careful = sum(is_careful(seed, quality) for seed in range(first, first + count))
            assert abs(careful - quality * count) <= 3
    assert len({tuple(is_careful(seed, 0.5) for seed in range(k, k + 8)) for k in range(50)}) > 8  # no short period


@pytest.mark.slow
def test_the_same_start_is_done_in_different_ways():
    with Scene(CATALOGUE.task("elegant/T2")) as scene:
        paths = []
        for seed in (0, 50, 100):  # LIBERO's first state each time, as it is
            scene.reset(seed, "file")
            actor = demonstrator_for(scene, seed, 1.0)
            path = []
            while (action := actor.act()) is not None:
                scene.step(action)
                path.append(scene.world_T_eef[:3, 3])
            paths.append(np.array(path))
    assert len({len(path) for path in paths}) == 3
    shortest = min(len(path) for path in paths)
    assert np.abs(paths[0][:shortest] - paths[1][:shortest]).max() > 0.02


def test_a_task_without_an_expert_says_who_there_is():
    from dataclasses import replace

    with (
        Scene(replace(CATALOGUE.task("elegant/T2"), task_id="lab/bowl")) as scene,
        pytest.raises(UsageError, match="there is no scripted expert for lab/bowl; there are some for: elegant/T0"),
    ):
        demonstrator_for(scene, 0, 1.0)

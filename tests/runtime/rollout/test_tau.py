"""tau: calibrated on episodes of its own, kept with the critic, taken only for what it was measured on."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jiti.errors import SourceError, UsageError
from jiti.runtime.guidance import Guidance
from jiti.runtime.rollout.run import all_rollouts, run_rollouts
from jiti.runtime.rollout.tau import (
    CALIBRATION_SEED,
    Calibration,
    calibrate,
    disjoint_seed,
    load_calibrations,
    save_calibration,
    stored_tau,
    tau_path,
)
from jiti.runtime.sim.libero import bddl_fingerprint, pack_fingerprint
from tests.builders.rollout_agents import wandering
from tests.runtime.rollout.conftest import NONE, STEPS, write_critic

SCENE = bddl_fingerprint("libero_goal/put_the_bowl_on_the_plate")
FOUND = Calibration(
    0.5,
    0.3,
    0.29,
    5,
    "p",
    "c",
    ("elegant/T2",),
    "jitter",
    pack_fingerprint("primitive"),
    (),
    STEPS,
    (100, 110),
    10,
    200,
    bddl=(SCENE,),
)


@pytest.mark.sim
def test_it_is_the_jump_that_the_wished_share_of_unguided_decisions_exceeds(plan, tmp_path):
    apart = replace(plan, seed=50)
    found = calibrate([apart], tmp_path, rate=0.4, window=2, episodes=4, workers=1, make_agent=wandering)
    assert (found.window, found.seeds, found.episodes, found.decisions) == (2, (50, 54), 4, 20)
    played = all_rollouts(tmp_path / "elegant-T2")
    jumps = np.array([c.delta_q for r in played for c in r.choices])
    assert np.mean(jumps > found.tau) == pytest.approx(0.4)
    assert (found.rate, found.measured) == (0.4, np.mean(jumps > found.tau))
    assert (found.most_steps, found.cameras) == (STEPS, ())
    assert not any(c.triggered for r in played for c in r.choices)
    assert not list(tmp_path.rglob("*.mcap"))
    # What was played is what the base policy does: the critic only looked on.
    base = replace(apart, guidances=(NONE,))
    alone = run_rollouts(base, tmp_path / "none", episodes=1, workers=1, record=False, make_agent=wandering)
    assert alone[0].itcs == played[0].itcs
    # And where JITI plays these states with it, it triggers as often until it changes something.
    guided = replace(base, guidances=(Guidance("jiti", "worst", 1, 2, found.tau),))
    again = run_rollouts(guided, tmp_path / "jiti", episodes=4, workers=1, record=False, make_agent=wandering)
    assert sum(r.interventions for r in again) == 8


def test_it_is_taken_only_for_what_it_was_measured_on(plan, tmp_path):
    from jiti.runtime.rollout.plan_file import fingerprint

    policy, critic = fingerprint(tmp_path / "policy"), fingerprint(tmp_path / "critic")
    path = tau_path(str(plan.critic), tmp_path / "out")
    assert path == tmp_path / "critic" / "tau.json"
    assert stored_tau(path, plan, window=5, episodes=50) == (None, "there is none yet")
    fits = replace(FOUND, policy=policy, critic=critic)
    save_calibration(path, fits)
    assert stored_tau(path, plan, window=5, episodes=50) == (fits, "")
    assert fingerprint(tmp_path / "critic") == critic
    for said, other, episodes in (
        ("window 5 and not 4", plan, 50),
        ("start jitter and not file", replace(plan, start="file"), 50),
        (f"most_steps {STEPS} and not 600", replace(plan, most_steps=600), 50),
        ("seeds 100 to 109 are among", replace(plan, seed=60), 41),
        ("seeds 100 to 109 are among", replace(plan, seed=109), 1),
    ):
        found, why = stored_tau(path, other, window=4 if "window" in said else 5, episodes=episodes)
        assert found is None
        assert said in why
    for gone, said in (
        ({"bddl": ()}, "in an unknown scene and not libero_goal/put"),
        ({"assets": "primitive"}, "assets"),
    ):
        assert said in replace(fits, **gone).unlike(plan, 5, policy, critic, 50)
    for first in (50, 110):
        assert stored_tau(path, replace(plan, seed=first), window=5, episodes=50)[0] == fits
    # Without cameras no one looked at pictures, so more of them change nothing; with some it depends on which.
    assert stored_tau(path, replace(plan, cameras=("front",)), window=5, episodes=50)[0] == fits
    looking = replace(fits, cameras=("front",))
    for cameras, said in ((("front",), ""), (("front", "wrist"), "front and not front, wrist"), ((), "and not none")):
        assert said in looking.unlike(replace(plan, cameras=cameras), 5, policy, critic, 50)
        assert bool(said) == bool(looking.unlike(replace(plan, cameras=cameras), 5, policy, critic, 50))
    (tmp_path / "policy" / "model.safetensors").write_bytes(b"trained on")
    assert "calibrated with policy" in stored_tau(path, plan, window=5, episodes=50)[1]


def test_the_newest_counts_and_weights_that_are_gone_are_forgotten(tmp_path):
    path = tmp_path / "tau.json"
    other_rate, again = replace(FOUND, rate=0.5, tau=0.1), replace(FOUND, tau=0.6)
    for one in (FOUND, other_rate, again):
        save_calibration(path, one)
    assert load_calibrations(path) == [other_rate, again]
    new_critic = replace(FOUND, critic="other")
    save_calibration(path, new_critic)
    assert load_calibrations(path) == [new_critic]
    path.write_text("{}")
    with pytest.raises(SourceError, match=r"is damaged.*Delete it"):
        load_calibrations(path)


def test_short_and_long_episodes_keep_a_tau_each(tmp_path):
    path = tmp_path / "tau.json"
    many = [FOUND, replace(FOUND, most_steps=600), replace(FOUND, cameras=("front", "wrist"))]
    for one in many:
        save_calibration(path, one)
    assert load_calibrations(path) == many


def test_a_file_that_does_not_say_what_tau_depends_on_counts_for_none(tmp_path):
    path = tmp_path / "tau.json"
    path.write_text('{"version": 1, "calibrations": [{"tau": 0.5, "rate": 0.3}]}')
    assert load_calibrations(path) == []
    save_calibration(path, FOUND)
    assert load_calibrations(path) == [FOUND]
    path.write_text('{"version": 9, "calibrations": []}')
    with pytest.raises(SourceError, match="version 9"):
        load_calibrations(path)


def test_its_seeds_are_never_those_evaluated():
    for first in (0, CALIBRATION_SEED - 50, CALIBRATION_SEED - 49, CALIBRATION_SEED, CALIBRATION_SEED + 20, 10**6):
        evaluated = range(first, first + 50)
        start = disjoint_seed(evaluated, 20)
        assert not set(evaluated) & set(range(start, start + 20))


def test_what_cannot_be_calibrated_is_said(plan, tmp_path):
    with pytest.raises(UsageError, match=r"0\.339"):
        calibrate([plan], tmp_path, rate=1.0, window=5)
    with pytest.raises(UsageError, match="--critic"):
        calibrate([replace(plan, critic=None, guidances=(NONE,))], tmp_path, window=5)


def test_a_critic_that_cannot_be_written_to_leaves_its_tau_with_the_rollouts(tmp_path, monkeypatch):
    critic = write_critic(tmp_path / "read-only")
    assert tau_path(str(critic), tmp_path) == critic / "tau.json"
    # Not by its mode, which root may ignore.
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path) != critic or not mode & os.W_OK)
    assert tau_path(str(critic), tmp_path) == tmp_path / "tau.json"
    assert tau_path("someone/critic", tmp_path) == tmp_path / "tau.json"

"""A run's TOML file: what it says is taken, what is wrong is named with its line and the nearest name."""

from pathlib import Path

import pytest

from jiti.critic.settings import Settings
from jiti.critic.settings_file import changed, differences, read_settings, settings_from, settings_to
from jiti.errors import UsageError


def test_the_defaults_are_the_papers():
    made = Settings()
    assert (made.network.chunk, made.loss.td_offset, made.loss.alpha, made.loss.soft_update) == (10, 10, 5.0, 5e-3)
    assert (made.run.steps, made.run.batch, made.optimizer.clip, made.loss.action_gap) == (20_000, 32, 0.5, 0.5)
    rates = made.optimizer
    assert (rates.critic_lr, rates.actor_lr, rates.backbone_lr) == (1e-5, 1e-5, 3e-6)
    assert (rates.temperature_lr, rates.multiplier_lr) == (2e-5, 1e-4)
    assert not made.loss.lagrange


def test_a_file_and_what_is_saved_beside_a_checkpoint_are_read_back(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text('[loss]\nalpha = 1\nvariant = "public"\n[data]\ngamma = 0.9\n')
    made = read_settings(path)
    assert (made.loss.alpha, made.loss.variant, made.data.gamma) == (1, "public", 0.9)
    assert settings_from(settings_to(made)) == made
    assert differences(made, Settings()) == ["data.gamma", "loss.alpha", "loss.variant"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[loss]\n\nalfa = 1\n", r"line 3: \[loss\] has no key 'alfa'; did you mean 'alpha'\?"),
        ("[los]\nalpha = 1\n", r"line 1: there is no section \[los\]; did you mean 'loss'\?"),
        ("[loss]\nalpha = 'much'\n", "line 2: loss.alpha is 'much'; it must be a number"),
        ("[run]\nsteps = true\n", "line 2: run.steps is True; it must be a whole number"),
        ("[loss]\nalpha = -1\n", "line 1: loss.alpha is -1; it must be at least 0"),
        ("[loss]\nvariant = 'mine'\n", "loss.variant is 'mine'; it must be one of: paper, public"),
        ('[network]\noctaves = 2\nbackbone = "some/model"\n', "network.octaves is for the built-in transformer"),
        ("[network]\nwidth = 30\n", "network.width is 30; it must be a multiple of network.heads"),
        ("[run]\nseed = 4294967296\n", "line 1: run.seed is 4294967296; it must be from 0 to 4294967295"),
        ("steps = 5\n", r"there is no section \[steps\]"),
        ("[loss\n", "is no TOML"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, text, message):
    path = tmp_path / "run.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match=message):
        read_settings(path)


def test_a_file_that_is_not_there_is_named(tmp_path):
    with pytest.raises(UsageError, match=r"nothing\.toml cannot be read"):
        read_settings(tmp_path / "nothing.toml")


def test_a_recipe_is_taken_by_its_name():
    made = read_settings(Path("state"))
    assert made.data.decided_share == 0.5
    assert "loss.td_offset" not in differences(made, Settings())


def test_a_recipe_is_changed_key_by_key():
    recipe = read_settings(Path("state"))
    made = changed(recipe, {"loss": {"alpha": 7.0}, "run": {"steps": 9}})
    assert (made.loss.alpha, made.run.steps) == (7.0, 9)
    assert differences(made, recipe) == ["loss.alpha", "run.steps"]
    with pytest.raises(UsageError, match="did you mean 'alpha'"):
        changed(recipe, {"loss": {"alpah": 7.0}})


def test_a_file_of_a_recipes_name_is_taken_before_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("state").write_text("[run]\nsteps = 7\n")
    assert read_settings(Path("state")).run.steps == 7

"""The cache of features: right rows in the right order, computed once, also after a stop, by several workers."""

import numpy as np
import pytest
import torch  # noqa: TID253  these tests are about tensors

from jiti.critic.dataset import read_elegant, state_columns
from jiti.critic.features import base, cache
from jiti.critic.features.cache import feature_cache, open_cache
from jiti.errors import SourceError, UsageError


class Doubled:
    """Two tokens: the state, and its double."""

    name, size, tokens, fingerprint, needs = "policy:fake", 3, 2, "ab" * 32, ("observation.state",)

    def __init__(self) -> None:
        self.frames = 0
        self.breaks_after = 10**9
        self.spoils = -1

    def features(self, batch):
        state = batch["observation.state"]
        if self.frames >= self.breaks_after:
            raise KeyboardInterrupt
        rows = torch.stack([state, 2 * state], 1)
        if self.frames <= self.spoils < self.frames + len(state):
            rows[self.spoils - self.frames] = torch.nan
        self.frames += len(state)
        return rows


@pytest.fixture
def fake(monkeypatch):
    made = Doubled()
    monkeypatch.setattr(cache, "open_extractor", lambda *_args, **_options: made)
    monkeypatch.setattr(cache, "SHARD_FRAMES", 100)
    return made


def states(root):
    return state_columns(root, ("observation.state",))["observation.state"]


def test_states_are_kept_in_the_datasets_order(make_toy, tmp_path):
    data = read_elegant(make_toy(files=3))
    made = feature_cache(data, "state", folder=tmp_path / "cache")
    frames = np.array([5, 900, 5, 0])
    np.testing.assert_array_equal(made.read(frames)[:, 0].numpy(), states(data.root)[frames])
    assert (made.tokens, made.size, made.rows.shape[0]) == (1, 3, data.frames)


def test_features_are_computed_once_and_a_stopped_run_goes_on(toy, tmp_path, fake):
    data = read_elegant(toy)
    fake.breaks_after = 350
    with pytest.raises(KeyboardInterrupt):
        feature_cache(data, "policy:fake", folder=tmp_path / "cache")
    (folder,) = (tmp_path / "cache").iterdir()
    with pytest.raises(SourceError, match=r"not complete.*again"):
        open_cache(folder)
    fake.breaks_after, fake.frames = 10**9, 0
    made = feature_cache(data, "policy:fake", folder=tmp_path / "cache")
    assert fake.frames == data.frames - 300  # three shards of 100 frames were whole
    expected = torch.from_numpy(np.stack([states(toy), 2 * states(toy)], 1)).bfloat16().float()
    torch.testing.assert_close(made.read(np.arange(data.frames)), expected, rtol=0, atol=0)
    feature_cache(data, "policy:fake", folder=tmp_path / "cache")
    assert fake.frames == data.frames - 300


def test_other_data_or_another_extractor_has_another_cache(make_toy, tmp_path, fake):
    first = feature_cache(read_elegant(make_toy("a")), "policy:fake", folder=tmp_path / "cache").folder
    other = feature_cache(read_elegant(make_toy("b", files=2)), "policy:fake", folder=tmp_path / "cache").folder
    fake.fingerprint = "cd" * 32
    third = feature_cache(read_elegant(make_toy("c")), "policy:fake", folder=tmp_path / "cache").folder
    assert len({first, other, third}) == 3


def test_features_that_are_not_numbers_are_refused_by_frame(toy, tmp_path, fake):
    fake.spoils = 123
    with pytest.raises(SourceError, match="features of 1 frames are not numbers, the first at index 123"):
        feature_cache(read_elegant(toy), "policy:fake", folder=tmp_path / "cache")


def test_an_extractor_that_gives_other_sizes_is_named(toy, tmp_path, fake):
    fake.size = 4
    with pytest.raises(SourceError, match=r"policy:fake gave features of shape \(100, 2, 3\)"):
        feature_cache(read_elegant(toy), "policy:fake", folder=tmp_path / "cache")


@pytest.mark.slow
def test_several_workers_make_the_same_bytes(toy, tmp_path, monkeypatch):
    monkeypatch.setattr(cache, "SHARD_FRAMES", 100)
    data = read_elegant(toy)
    one = feature_cache(data, "state", folder=tmp_path / "one")
    several = feature_cache(data, "state", folder=tmp_path / "several", workers=2)
    assert (one.folder / "features.bin").read_bytes() == (several.folder / "features.bin").read_bytes()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("magic:x", "no such kind. There are: state, and smolvla:"),
        ("state:x", "state stands alone"),
        ("smolvla", "needs a folder or Hub id: smolvla:lerobot/smolvla_base"),
    ],
)
def test_a_name_that_means_nothing_is_answered_with_those_that_do(name, message):
    with pytest.raises(UsageError, match=message):
        base.open_extractor(name, {})


def test_state_features_need_a_state():
    with pytest.raises(UsageError, match=r"needs observation\.state .*there are: action"):
        base.open_extractor("state", {"action": (7,)})

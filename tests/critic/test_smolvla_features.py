"""Features of SmolVLA's prefix, and a critic with a Hugging Face backbone on them, all with random weights."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs pip install 'jiti[learn]'")
pytest.importorskip("lerobot", reason="needs pip install 'jiti[learn]'")

from jiti.critic.features import open_extractor  # noqa: E402
from jiti.errors import UsageError  # noqa: E402
from tests.critic.same_features import same_in_any_batch  # noqa: E402
from tests.critic.with_pictures import FRONT, SIDE, STATE, WRIST, elegant_with_pictures  # noqa: E402

# lerobot and transformers warn of their own dependencies.
pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(autouse=True)
def one_seed():
    torch.manual_seed(0)


@pytest.fixture(scope="module")
def smolvla(tmp_path_factory):
    pytest.importorskip("num2words", reason="needs pip install num2words")
    from tests.builders.tiny_smolvla import build_smolvla, build_vlm

    folder = tmp_path_factory.mktemp("models")
    vlm = build_vlm(folder / "vlm")
    return vlm, build_smolvla(folder / "smolvla", vlm)


PICTURES = {STATE: (8,), FRONT: (SIDE, SIDE, 3), WRIST: (SIDE, SIDE, 3), "action": (7,)}


def seen(frames=3):
    pictures = {key: torch.rand(frames, 3, SIDE, SIDE) for key in (FRONT, WRIST)}
    said = ["put the bowl on the plate", "put", "the plate"][:frames]
    return {STATE: torch.randn(frames, 8), **pictures, "task": said}


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_smolvla_gives_cameras_words_and_state(smolvla):
    extractor = open_extractor(f"smolvla:{smolvla[1]}", PICTURES)
    assert extractor.tokens == 4
    batch = seen()
    whole = same_in_any_batch(extractor, batch)
    other = extractor.features(batch | {FRONT: torch.rand(3, 3, SIDE, SIDE)})
    assert not torch.allclose(whole[:, 0], other[:, 0])
    assert not torch.allclose(whole, extractor.features(batch | {"task": ["a", "b", "c"]}))
    # State is what nothing else looks at.
    moved = extractor.features(batch | {STATE: torch.randn(3, 8)})
    assert torch.allclose(whole[:, :3], moved[:, :3], atol=1e-5)
    assert not torch.allclose(whole[:, 3], moved[:, 3])


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_all_tokens_of_smolvla_have_the_means_of_the_few(smolvla):
    few = open_extractor(f"smolvla:{smolvla[1]}", PICTURES)
    every = open_extractor(f"smolvla:{smolvla[1]}#all", PICTURES)
    batch = seen()
    tokens = same_in_any_batch(every, batch)
    means = few.features(batch)
    side = (every.tokens - 1 - 48) // 2
    assert torch.allclose(tokens[:, :side].mean(1), means[:, 0], atol=1e-5)
    words = tokens[:, 2 * side : -1]
    there = (words.abs().sum(-1, keepdim=True) > 0).sum(1)
    assert torch.allclose(words.sum(1) / there, means[:, 2], atol=1e-5)
    assert there.flatten().tolist() != [48] * 3
    with pytest.raises(UsageError, match="all"):
        open_extractor(f"smolvla:{smolvla[1]}#some", PICTURES)
    with pytest.raises(UsageError, match="needs pictures"):
        open_extractor(f"smolvla:{smolvla[1]}", {STATE: (8,), "action": (7,)})


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_critic_on_a_hugging_face_backbone_learns_from_smolvla_and_is_opened_again(smolvla, tmp_path):
    from jiti.critic.critic import load_critic
    from jiti.critic.settings_file import settings_from
    from jiti.critic.train import train

    vlm, policy = smolvla
    root = elegant_with_pictures(tmp_path / "elegant")
    name = f"smolvla:{policy}"
    settings = settings_from(
        {
            "data": {"features": name},
            "network": {"backbone": str(vlm), "actor_width": 16},
            "run": {"steps": 3, "batch": 4, "check_every": 3, "log_every": 1},
        }
    )
    trained = train(root, tmp_path / "run", settings, features_dir=tmp_path / "features")
    assert trained.step == 3
    critic = load_critic(tmp_path / "run")
    again = load_critic(tmp_path / "run")
    extractor = open_extractor(name, PICTURES)
    features = extractor.features(seen()).clone()
    chunks = np.random.default_rng(0).uniform(-1, 1, (3, 8, 10, 7))
    values = critic.values(features, chunks)
    assert values.shape == (2, 3, 8)
    assert torch.isfinite(values).all()
    assert torch.equal(values, again.values(features, chunks))

"""A dataset that lerobot wrote, read by lerobot and by us."""

from pathlib import Path

import numpy as np
import pytest

from jiti.episodes.episode import Episode, ImageBatch, numbers
from jiti.episodes.lerobot_reader import LeRobotReader
from jiti.episodes.video import decode_frames
from jiti.episodes.video_decode import SampleDecoder, to_rgb
from tests.builders.lerobot import (
    FRONT,
)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # lerobot's and datasets' own, while they import
@pytest.mark.parametrize("use_videos", [True, False])
def test_a_dataset_that_lerobot_wrote(tmp_path: Path, use_videos: bool) -> None:
    """Its frames and numbers are those that lerobot's own reader gives, and those that were recorded."""
    pytest.importorskip("lerobot", reason="lerobot is not installed: pip install 'jiti[learn]'")
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    features = {
        FRONT: {
            "dtype": "video" if use_videos else "image",
            "shape": (96, 128, 3),
            "names": ["height", "width", "channels"],
        },
        "observation.state": {"dtype": "float32", "shape": (2,), "names": ["frame", "episode"]},
        "action": {"dtype": "float32", "shape": (1,), "names": ["x"]},
    }
    root = tmp_path / "d"
    written = LeRobotDataset.create("jiti/test", 20, features, root=root, use_videos=use_videos)
    # Noise, because lerobot's settings for AV1 drop changes between flat pictures.
    noise = np.random.default_rng(0).integers(0, 256, (3, 14, 12, 16, 3), np.uint8).repeat(8, 2).repeat(8, 3)
    lengths = (14, 9, 11)
    for e, length in enumerate(lengths):
        for i in range(length):
            state = np.array([i, e], np.float32)
            written.add_frame(
                {FRONT: noise[e, i], "observation.state": state, "action": -state[:1], "task": f"task {e % 2}"}
            )
        written.save_episode()
    written.finalize()

    theirs = LeRobotDataset("jiti/test", root=root, video_backend="pyav")
    ours = LeRobotReader(root)
    assert ours.problems == []
    row = 0
    for e, length in enumerate(lengths):
        episode = ours.open(f"episode_{e:06d}")
        assert episode.problems == []
        assert episode.task == f"task {e % 2}"
        assert numbers(episode, "observation.state")[1].tolist() == [[i, e] for i in range(length)]
        assert numbers(episode, "action")[1].tolist() == [[-i] for i in range(length)]
        pictures = dict(decode_frames(episode, FRONT, range(length)))
        sent = _sent(episode)
        for i in range(length):
            reference = theirs[row][FRONT].permute(1, 2, 0).numpy() * 255
            assert np.abs(pictures[i] - reference).max() <= 1
            assert np.abs(sent[i].astype(int) - pictures[i]).max() <= 1
            assert np.abs(pictures[i].astype(int) - noise[e, i]).mean() < 20
            row += 1


def _sent(episode: Episode) -> list[np.ndarray]:
    """All pictures of the front camera as a viewer gets them."""
    batches = [batch for batch in episode.read([FRONT]) if isinstance(batch, ImageBatch)]
    decoder = SampleDecoder(batches[0].encoding)
    samples = [sample for batch in batches for sample in batch.data]
    out = [to_rgb(frame) for i, sample in enumerate(samples) for _, frame in decoder.decode(sample, i)]
    return out + [to_rgb(frame) for _, frame in decoder.flush()]

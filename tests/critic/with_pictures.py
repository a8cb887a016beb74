"""A small D_elegant with two cameras, as LeRobot's own writer leaves one."""

import json

import numpy as np

STATE = "observation.state"
FRONT, WRIST = "observation.images.front", "observation.images.wrist"
SIDE = 32


def elegant_with_pictures(root):
    """Six short episodes with two cameras, half of them elegant, as LeRobot's own writer leaves them."""
    import pyarrow as pa
    import pyarrow.parquet as pq
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    from jiti.curate.returns import mc_returns

    def numbers(size, dtype="float32"):
        return {"dtype": dtype, "shape": (size,), "names": None}

    picture = {"dtype": "image", "shape": (SIDE, SIDE, 3), "names": ["height", "width", "channels"]}
    features = {STATE: numbers(8), "action": numbers(7), FRONT: picture, WRIST: picture}
    features |= {"next.reward": numbers(1), "elegance.annotated": numbers(1, "bool"), "elegance.mc_return": numbers(1)}
    made = LeRobotDataset.create("local/elegant", fps=20, root=root, use_videos=False, features=features)
    rng = np.random.default_rng(0)
    length, window = 16, slice(8, 14)
    for episode in range(6):
        annotated = np.zeros(length, bool)
        annotated[window] = True
        reward = (annotated * (episode % 2)).astype(np.float32)
        returns = mc_returns(reward, np.array([0, length]), 0.98)
        for frame in range(length):
            made.add_frame(
                {
                    STATE: rng.normal(size=8).astype(np.float32),
                    "action": rng.uniform(-1, 1, 7).astype(np.float32),
                    FRONT: rng.integers(0, 255, (SIDE, SIDE, 3), np.uint8),
                    WRIST: rng.integers(0, 255, (SIDE, SIDE, 3), np.uint8),
                    "next.reward": reward[[frame]],
                    "elegance.annotated": annotated[[frame]],
                    "elegance.mc_return": returns[[frame]].astype(np.float32),
                    "task": "put the bowl on the plate",
                }
            )
        made.save_episode()
    made.finalize()
    (root / "meta/jiti").mkdir()
    (root / "meta/jiti/curate.json").write_text(json.dumps({"gamma": 0.98, "fps": 20}))
    columns = {
        "episode_index": pa.array(range(6), pa.int64()),
        "episode_id": [f"recorded_{n}" for n in range(6)],
        "fingerprint": [f"{n:016x}" for n in range(6)],
        "task_id": ["elegant/T2"] * 6,
        "split": ["train"] * 4 + ["validation"] * 2,
        "frames": pa.array([length] * 6, pa.int64()),
    }
    pq.write_table(pa.table(columns), root / "meta/jiti/episodes.parquet")
    return root

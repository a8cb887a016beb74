"""One training in a process of its own, which ends when the one that asked for it does:
`python -m jiti.runtime.benchmark.trainer JOB.json`."""

import json
import os
import sys
import threading
import time
from pathlib import Path
from typing import Any

from jiti.progress import Progress

WATCH_S = 1.0


def end_with(parent: int) -> None:
    """End this process, without a word, once that one is gone: what it was at is done again, by another."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def told() -> Progress:
    """Tells the log what share is done."""
    said = 0.0

    def tell(share: float, _what: str) -> None:
        nonlocal said
        if share - said >= 0.01:
            said = share
            print(f"share:{share:.3f}", flush=True)

    return tell


def train_policy(arguments: list[str]) -> None:
    """lerobot's own command."""
    from lerobot.scripts.lerobot_train import main as lerobot_train

    sys.argv = ["lerobot-train", *arguments]
    lerobot_train()


def train_critic(job: dict[str, Any]) -> None:
    """`jiti train-critic`, with settings that differ from the recipe's."""
    from jiti.critic.settings_file import changed, read_settings
    from jiti.critic.train import train

    settings = changed(read_settings(Path(job["recipe"])), job["settings"])
    out, features = Path(job["out"]), Path(job["features"])
    trained = train(Path(job["dataset"]), out, settings, features_dir=features, progress=told())
    print(trained)
    Path(job["result"]).write_text(json.dumps({"step": trained.step, **trained.best}))


def main(path: str) -> None:
    """Do the job of a file. Its errors are the end of the log."""
    job = json.loads(Path(path).read_text())
    end_with(job["parent"])
    import torch

    torch.set_num_threads(1)
    from jiti.errors import JitiError

    try:
        if job["kind"] == "policies":
            train_policy(job["arguments"])
        elif job["kind"] == "critics":
            train_critic(job)
        else:
            from jiti.runtime.benchmark.values import make_values

            critic, dataset, out, features = (Path(job[name]) for name in ("critic", "dataset", "out", "features"))
            Path(job["result"]).write_text(json.dumps(make_values(critic, dataset, out, features, told())))
    except JitiError as error:
        print(f"jiti: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main(sys.argv[1])

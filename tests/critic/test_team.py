"""Several processes train one critic: they do what one would, and wait for each other as long as features take."""

import os
import socket
import subprocess
import sys

import pytest
import torch  # noqa: TID253  these tests are about tensors
from safetensors.torch import load_file

from jiti.critic.team import PATIENCE, Team, usable_device
from jiti.errors import UsageError

TOML = """
[network]
width = 16
heads = 2
actor_width = 16
chunk = 4
[loss]
td_offset = 4
variant = "public"
lagrange = true
[optimizer]
critic_lr = 1e-3
actor_lr = 1e-3
[run]
steps = 4
batch = 16
check_every = 2
log_every = 1
device = "cpu"
"""
WAITING = """
import torch
from jiti.critic.team import Team
Team("cpu")
group = torch.distributed.distributed_c10d._get_default_group()
print(group._get_backend(torch.device("cpu")).options._timeout.total_seconds())
"""


def together(arguments: list[str]) -> list[str]:
    """What two processes of a group print, as `accelerate launch` starts them."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    group = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "OMP_NUM_THREADS": "1"}
    started = [
        subprocess.Popen(
            [sys.executable, *arguments],
            env={**os.environ, **group, "RANK": rank, "LOCAL_RANK": rank, "ACCELERATE_USE_CPU": "true"},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in ("0", "1")
    ]
    said = [process.communicate(timeout=300) for process in started]
    assert [process.returncode for process in started] == [0, 0], said
    return [out for out, _ in said]


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_two_processes_do_what_one_would(toy):
    folder = toy.parent
    (folder / "run.toml").write_text(TOML)

    def line(out: str) -> list[str]:
        given = ["--config", str(folder / "run.toml"), "--cache", str(folder / "features")]
        return ["-m", "jiti", "train-critic", str(toy), "--out", str(folder / out), *given]

    together(line("two"))
    subprocess.run([sys.executable, *line("one")], check=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    one, two = (load_file(folder / name / "checkpoints/step-00000004/training.safetensors") for name in ("one", "two"))
    assert one.keys() == two.keys()
    for name in one:
        torch.testing.assert_close(two[name], one[name], atol=2e-5, rtol=1e-3, msg=name)


@pytest.mark.slow
def test_processes_wait_for_each_other_as_long_as_features_take():
    assert [float(said) for said in together(["-c", WAITING])] == [PATIENCE.total_seconds()] * 2


def test_a_batch_that_processes_cannot_share_is_refused():
    team = Team("cpu")
    team.size = 3
    with pytest.raises(UsageError, match="3 processes cannot share"):
        team.check_batch(32)


def test_a_device_that_there_is_not_is_refused():
    assert usable_device("auto").type in ("cpu", "cuda")
    with pytest.raises(UsageError, match=r"run\.device magic cannot be used.*Pass cpu or auto"):
        usable_device("magic")

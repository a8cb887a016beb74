"""The processes that train one critic, one a GPU, as `accelerate launch` starts them; one, where it did not."""

import os
from contextlib import AbstractContextManager, nullcontext
from datetime import timedelta
from typing import Any

import torch  # noqa: TID253  imported by training only
from torch import Tensor  # noqa: TID253

from jiti.errors import UsageError

PATIENCE = timedelta(days=1)
"""How long a process waits for another. Our choice: one of them computes the features that all read then, which may
take hours; torch itself gives up after ten minutes (NCCL) or thirty (gloo)."""


def usable_device(wanted: str) -> torch.device:
    """The device of `run.device`. Raises UsageError for one that there is not."""
    chosen = ("cuda" if torch.cuda.is_available() else "cpu") if wanted == "auto" else wanted
    try:
        device = torch.device(chosen)
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:
        raise UsageError(f"run.device {wanted} cannot be used: {str(error)[:150]}. Pass cpu or auto.") from error
    return device


class Team:
    """Which process this is, its device, and what processes do together.

    Gradients are averaged by hand instead of by torch's wrapper, which wants one forward pass for each backward one:
    a step has three losses over two networks.
    """

    def __init__(self, device: str = "auto") -> None:
        self._accelerator: Any = None
        if int(os.environ.get("WORLD_SIZE", "1")) > 1:
            from accelerate import Accelerator, InitProcessGroupKwargs

            on_cpu = device == "cpu" or not torch.cuda.is_available()
            self._accelerator = Accelerator(cpu=on_cpu, kwargs_handlers=[InitProcessGroupKwargs(timeout=PATIENCE)])
            self.device: torch.device = self._accelerator.device
        else:
            self.device = usable_device(device)
        self.size: int = self._accelerator.num_processes if self._accelerator else 1
        self.rank: int = self._accelerator.process_index if self._accelerator else 0

    @property
    def leads(self) -> bool:
        """Whether this process writes files and speaks."""
        return self.rank == 0

    def check_batch(self, batch: int) -> None:
        """Raises UsageError for a batch that processes cannot share evenly."""
        if batch % self.size:
            raise UsageError(f"run.batch is {batch}; {self.size} processes cannot share it evenly. Make it a multiple.")

    def share(self, whole: Any) -> Any:
        """This process's part of an array or tensor, along its first axis."""
        part = len(whole) // self.size
        return whole[self.rank * part : (self.rank + 1) * part]

    def average_gradients(self, parameters: list[torch.nn.Parameter]) -> None:
        """Give every process the mean of all processes' gradients."""
        if self._accelerator is None:
            return
        given = [p for p in parameters if p.grad is not None]
        flat = torch.cat([p.grad.flatten() for p in given if p.grad is not None])
        mean: Tensor = self._accelerator.reduce(flat, reduction="mean")
        for parameter, part in zip(given, mean.split([p.numel() for p in given]), strict=True):
            parameter.grad = part.view_as(parameter)

    def precision(self, wanted: str) -> AbstractContextManager[Any]:
        """Where bfloat16 is used: as asked, or on GPUs (`auto`)."""
        if wanted == "bfloat16" or (wanted == "auto" and self.device.type == "cuda"):
            return torch.autocast(self.device.type, torch.bfloat16)
        return nullcontext()

    def wait(self) -> None:
        """Until all processes are here."""
        if self._accelerator is not None:
            self._accelerator.wait_for_everyone()

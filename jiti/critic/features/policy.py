"""Features from any policy of lerobot: what a named part of it gives while it looks at an observation.

`policy:PATH_OR_HUB_ID#MODULE` names a module as `named_modules` does. It must come before any noise in the policy,
as an encoder does, for the same observation must give the same features. The policy's run ends there.
"""

import hashlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from jiti.critic.features.base import Batch, Shapes
from jiti.critic.features.opened_policy import OpenedPolicy, open_policy
from jiti.errors import UsageError

if TYPE_CHECKING:
    import torch

VERSION = 1
"""Of this code: raise it when features change."""
MODULES = {"state_flow": "average.encoder", "act": "model.encoder"}
"""The part that stands for a policy's view of an observation, by the policy's type; of others the user names it. Of
lerobot's `diffusion` none does: its encoder of pictures gets the pictures of several times and cameras as one batch."""


class PolicyFeatures:
    """Output of one module at its first call, as tokens."""

    def __init__(self, name: str, opened: OpenedPolicy, module: str, shapes: Shapes) -> None:
        self.name = name
        self.needs = opened.needs
        self._opened = opened
        self._policy: Any = opened.policy
        self._module = self._policy.get_submodule(module)
        about = f"policy {VERSION} {module} {opened.fingerprint} {sorted(opened.renamed.items())}"
        self.fingerprint = hashlib.sha256(about.encode()).hexdigest()
        # Where the frames of a batch are in the output shows when their number changes.
        two, three = (self._output(_blank(opened, shapes, frames)).shape for frames in (2, 3))
        axes = [axis for axis, (a, b) in enumerate(zip(two, three, strict=False)) if (a, b) == (2, 3)]
        if len(two) != len(three) or len(axes) != 1:
            raise UsageError(
                f"{name}: {module} gives shapes {tuple(two)} and {tuple(three)} for two and three frames; features "
                "need one axis for frames. Name another module."
            )
        self._frames = axes[0]
        self.tokens, self.size = self._as_tokens(self._output(_blank(opened, shapes, 2))).shape[1:]

    def features(self, batch: Batch) -> "torch.Tensor":
        """(B, tokens, size) float32."""
        return self._as_tokens(self._output(batch))

    def _output(self, batch: Batch) -> "torch.Tensor":
        return first_output(self._opened, self._module, batch)

    def _as_tokens(self, output: "torch.Tensor") -> "torch.Tensor":
        """(B, D), (B, L, D) or maps (B, C, H, W), with the frames' axis anywhere, as (B, tokens, size)."""
        output = output.float().movedim(self._frames, 0)
        if output.ndim == 2:
            return output.unsqueeze(1)
        return output.flatten(2).transpose(1, 2) if output.ndim == 4 else output


def first_output(opened: OpenedPolicy, module: Any, batch: Batch) -> Any:
    """What a module gives at its first call while the policy decides on a batch; the rest of the policy is not run.

    The first tensor of it, where it gives a tuple; a mapping is given as it is. Raises UsageError where the policy does
    not call the module.
    """
    import torch

    seen: list[Any] = []

    def stop(_module: Any, _inputs: Any, output: Any) -> None:
        seen.append(output)
        raise _Seen

    policy: Any = opened.policy
    hook = module.register_forward_hook(stop)
    try:
        with torch.inference_mode():
            policy.reset()
            policy.select_action(opened.prepared(batch))
    except _Seen:
        pass
    finally:
        hook.remove()
        policy.reset()
    if not seen:
        raise UsageError("the policy acts without calling that module. Name one that it calls for each observation.")
    output = seen[0]
    return output[0] if isinstance(output, (tuple, list)) else output


class _Seen(Exception):
    """Ends a policy's run where all that was asked for is known."""


def open_extractor(argument: str, shapes: Shapes, device: str) -> PolicyFeatures:
    """`argument` is a checkpoint's folder or Hub id, and `#` and a module's name. Raises UsageError."""
    source, _, module = argument.partition("#")
    opened = open_policy(source, shapes, device)
    policy: Any = opened.policy
    module = module or MODULES.get(policy.config.type, "")
    known = dict(policy.named_modules())
    if not module or module not in known:
        some = [name for name in known if name and name.count(".") < 2]
        said = f"there is no module {module}" if module else f"say which module of {policy.config.type} is meant"
        raise UsageError(
            f"--features policy:{argument}: {said}, as policy:{source}#MODULE. Some: {', '.join(some[:20])}."
        )
    return PolicyFeatures(f"policy:{argument}", opened, module, shapes)


def _blank(opened: OpenedPolicy, shapes: Shapes, frames: int) -> Mapping[str, Any]:
    """Observations of zeros, to see what comes out; pictures of the policy's own size."""
    import torch

    seen: Any = opened.policy.config
    sizes = {key: tuple(seen.image_features[name].shape) for key, name in opened.renamed.items()}
    sizes |= {key: tuple(shapes[key]) for key in opened.needs if key in shapes and key not in sizes}
    return {key: torch.zeros(frames, *size) for key, size in sizes.items()} | {"task": [""] * frames}

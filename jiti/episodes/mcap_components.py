"""Which numbers of a message are components of a numeric stream, and what they are called.

A component's name is the path of its fields, `pose.position.x`, and `data[3]` inside arrays. Where a message names
its elements (joints, transforms), the name stands in place of the index: `gripper.position`.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from jiti.episodes.mcap_layout import Number, Numbers, Text, Tree

MAX_ARRAY = 64
"""Longest array whose elements become components. Our choice: longer ones are scans and maps, not states."""
MAX_VECTOR = 1024
"""The same for arrays that are all there is in a message, or whose elements are named. Our choice: two whole robots."""

_LEFT_OUT = {"header", "stamp", "timestamp", "seq", "sequence", "sequence_number", "sequencenumber", "layout"}
"""Times, counters, and the layout of ROS's multi-arrays, in lower case."""
_TIME_KEYS = {"sec", "secs", "seconds", "nsec", "nsecs", "nanosec", "nanoseconds", "nanos"}
_LABEL_LISTS = ("name", "names", "joint_names")
_VALUES = ("value", "values", "data")
"""Fields that add nothing to the name of what they hold."""
_LABELS = ("name", "joint_name", "child_frame_id", "key")

Leaf = Number | float


class Components:
    """The components of one message."""

    def __init__(self, tree: Tree) -> None:
        self.names: list[str] = []
        self.leaves: list[Leaf] = []
        """By name: a place, or the value itself (JSON)."""
        self.labels: list[Text] = []
        """The strings that went into names."""
        self._walk(tree, "")
        self._make_unique()

    def _add(self, name: str, leaf: Leaf) -> None:
        self.names.append(name)
        self.leaves.append(leaf)

    def _walk(self, tree: Tree, prefix: str) -> None:
        names, named = _named_lists(tree)
        fields = [(key, value) for key, value in tree.items() if _wanted(key, value)]
        alone = not prefix and sum(_is_numeric(value) for _, value in fields) == 1
        for key, value in fields:
            path = f"{prefix}{key}"
            if key in named:
                for label, leaf in zip(names, _leaves(value), strict=True):
                    self._add(f"{prefix}{_text(label)}" if key in _VALUES else f"{prefix}{_text(label)}.{key}", leaf)
                self.labels += [label for label in names if isinstance(label, Text)]
            elif _is_number(value):
                self._add(path, value)
            elif isinstance(value, Mapping):
                self._walk(value, f"{path}.")
            elif isinstance(value, Numbers | list):
                self._array(value, path, prefix, MAX_VECTOR if alone else MAX_ARRAY)

    def _array(self, value: Numbers | list, path: str, prefix: str, limit: int) -> None:
        count = value.length if isinstance(value, Numbers) else len(value)
        if count > limit:
            return
        if isinstance(value, Numbers) or all(_is_number(item) for item in value):
            for index, leaf in enumerate(_leaves(value)):
                self._add(f"{path}[{index}]", leaf)
            return
        for index, item in enumerate(value):
            if not isinstance(item, Mapping):
                continue
            label = next((item[key] for key in _LABELS if _text(item.get(key))), None)
            if label is None:
                self._walk(item, f"{path}[{index}].")
            else:
                if isinstance(label, Text):
                    self.labels.append(label)
                self._walk(item, f"{prefix}{_text(label)}.")

    def _make_unique(self) -> None:
        if len(set(self.names)) == len(self.names):
            return
        seen: dict[str, int] = {}
        for index, name in enumerate(self.names):
            seen[name] = seen.get(name, 0) + 1
            if seen[name] > 1:
                self.names[index] = f"{name}#{seen[name]}"


def _named_lists(tree: Tree) -> tuple[Sequence[Any], set[str]]:
    """The list of names in a message and the fields with one number a name: ROS's JointState and its like."""
    for key in _LABEL_LISTS:
        names = tree.get(key)
        if isinstance(names, list) and 0 < len(names) <= MAX_VECTOR and all(_text(name) for name in names):
            named = {k for k, v in tree.items() if _wanted(k, v) and _length(v) == len(names)}
            return names, named
    return (), set()


def _length(value: Any) -> int:
    if isinstance(value, Numbers):
        return value.length
    return len(value) if isinstance(value, list) and all(_is_number(item) for item in value) else -1


def _wanted(key: str, value: Any) -> bool:
    name = key.lower()
    if name in _LEFT_OUT or "covariance" in name:
        return False
    return not (isinstance(value, Mapping) and value and value.keys() <= _TIME_KEYS)


def _is_number(value: Any) -> bool:
    return isinstance(value, Number | int | float)


def _is_numeric(value: Any) -> bool:
    return _is_number(value) or isinstance(value, Mapping | Numbers | list)


def _leaves(value: Numbers | list) -> Iterator[Leaf]:
    return iter(value.split() if isinstance(value, Numbers) else value)


def _text(value: Any) -> str:
    return value.text if isinstance(value, Text) else value if isinstance(value, str) else ""


def text_in(tree: Tree) -> str | None:
    """The first string of a message that is not a name of a frame: what a text topic says."""
    for key, value in tree.items():
        if key not in ("frame_id", "header") and (text := _text(value).strip()):
            return text
    return None

"""The keys of a person who records: those that stop an arm, and one that records an episode anew."""

from jiti.runtime.robot.stops import Stops

ANEW = "r"
_SAME = ("R", "\x7f", "\b")
"""Backspace is one of two characters, by the terminal."""


class Keys(Stops):
    _anew = False

    def press(self, key: str) -> None:
        super().press(ANEW if key in _SAME else key)

    def pressed(self) -> list[str]:
        pressed = super().pressed()
        self._anew = self._anew or ANEW in pressed
        return pressed

    def anew(self) -> bool:
        """Whether an episode was to be recorded anew since this was asked last; `look` reads the keys."""
        asked, self._anew = self._anew, False
        return asked

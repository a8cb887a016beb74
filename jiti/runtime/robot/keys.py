"""The keys of a person who records: those that stop an arm, and one that records an episode anew."""

from jiti.runtime.robot.stops import Stops

AGAIN = ("r", "R", "\x7f", "\b")
"""Backspace is one of two characters, by the terminal."""


class Keys(Stops):
    _again = False

    def again(self) -> bool:
        """Whether an episode was to be recorded anew since this was asked last; `look` reads the keys."""
        asked, self._again = self._again, False
        return asked

    def pressed(self) -> list[str]:
        pressed = super().pressed()
        self._again = self._again or any(key in pressed for key in AGAIN)
        return pressed

"""Keys of a terminal and signals, and that all is as before afterwards."""

import os
import pty
import signal
import sys
import termios

import pytest

from jiti.runtime.robot.stops import SIGNALS, Stopped, Stops


@pytest.fixture
def terminal(monkeypatch):
    ours, theirs = pty.openpty()
    with open(theirs, closefd=True) as file:  # noqa: PTH123 - a descriptor
        monkeypatch.setattr(sys, "stdin", file)
        yield ours, theirs
    os.close(ours)


def press(stops, ours, key):
    os.write(ours, key)
    return any(stops.look() for _ in range(1000))


def test_space_stops_enter_ends_the_episode_and_others_do_nothing(terminal):
    ours, theirs = terminal
    before = termios.tcgetattr(theirs)
    with Stops() as stops:
        assert not stops.look()
        assert not press(stops, ours, b"x")
        assert press(stops, ours, b"\n")
        assert press(stops, ours, b"\r"), "what a terminal sends, whatever Python makes of its settings"
        with pytest.raises(Stopped, match="Space") as stopped:
            press(stops, ours, b" ")
        assert stopped.value.exit_code == 0
    assert termios.tcgetattr(theirs) == before


def test_a_terminal_that_is_gone_stops_it(monkeypatch):
    ours, theirs = pty.openpty()
    with open(theirs, closefd=True) as file:  # noqa: PTH123 - a descriptor
        monkeypatch.setattr(sys, "stdin", file)
        with Stops() as stops:
            os.close(ours)
            with pytest.raises(Stopped, match="terminal is gone"):
                stops.look()


def guarded_and_looked_at(stops, number, heard):
    with stops.guarded():
        os.kill(os.getpid(), number)  # raises nothing here
        heard.append(number)
        stops.look()
        heard.append(number)


def test_what_would_end_or_suspend_the_program_is_listened_to():
    assert {signal.SIGQUIT, signal.SIGTSTP, signal.SIGTTIN} < set(SIGNALS)


@pytest.mark.parametrize("number", SIGNALS)
def test_a_signal_waits_for_a_look_while_guarded_and_raises_at_once_otherwise(number):
    before = signal.getsignal(number)
    with Stops(keys=False) as stops:
        heard: list[int] = []
        with pytest.raises(Stopped) as stopped:
            guarded_and_looked_at(stops, number, heard)
        assert heard == [number], "raised by the look, not before it, and not after it"
        assert stopped.value.exit_code == 128 + number
        with pytest.raises(Stopped, match=number.name), stops.guarded():
            os.kill(os.getpid(), number)  # at the end, where nothing looked
        with pytest.raises(Stopped):
            os.kill(os.getpid(), number)
    assert signal.getsignal(number) == before


def test_a_space_of_the_page_is_not_lost_whenever_it_comes(monkeypatch):
    """Between the look for it and the end of that look, say."""
    stops = Stops(keys=False)
    typed = stops._typed

    def pressed_meanwhile() -> str:
        stops.press(" ")
        stops.press("\n")
        return typed()

    monkeypatch.setattr(stops, "_typed", pressed_meanwhile)
    with pytest.raises(Stopped):
        stops.look()
    monkeypatch.setattr(stops, "_typed", typed)
    for ask in (stops.look, stops.key, stops.pressed):
        with pytest.raises(Stopped, match="Space"):
            ask()

"""Frame truth: the frame that the annotator names is the frame that it shows, whatever the recording."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.browser.conftest import Screen
from tests.builders.lerobot import AV1_LONG_GOP, H264, H264_B_FRAMES, Encoder, write_v3
from tests.builders.mcap import Camera, write_mcap

pytestmark = pytest.mark.browser

UNEVEN_S = np.cumsum(np.tile([0.033, 0.040, 0.020, 0.101, 0.033], 60)) - 0.033
"""A camera whose rate varies from 10 to 50 Hz."""


def check_frames(screen: Screen, frames: list[int], shown: Callable[[int], list[int]]) -> None:
    """Go to each frame by keys, and read the number in the pictures that are shown there."""
    screen.ready()
    for frame in frames:
        screen.press("Home", *["Shift+ArrowRight"] * (frame // 10), *["ArrowRight"] * (frame % 10))
        screen.wait(frame=frame).wait_numbers(shown(frame))


@pytest.mark.parametrize(
    "images", [("jpeg", "h264", "av1"), pytest.param(("png", "raw"), marks=pytest.mark.slow)], ids="+".join
)
def test_every_picture_coding_shows_the_frame_that_is_named(serve, screen, tmp_path: Path, images: list[str]) -> None:
    cameras = {f"/camera/{image}": Camera(image=image, gop=250) for image in images}
    write_mcap(tmp_path / "episode.mcap", cameras=cameras, duration_s=10)
    page = screen(serve("annotate", "episode.mcap").url)
    check_frames(page, [0, 1, 299, 137], lambda frame: [frame] * len(images))


@pytest.mark.slow
def test_variable_rate_and_a_camera_that_starts_late(serve, screen, tmp_path: Path) -> None:
    cameras = {
        "/camera/front": Camera(image="h264", gop=250, times_s=UNEVEN_S),
        "/camera/wrist": Camera(rate_hz=15, start_s=4.0, shade=150),
    }
    recording = write_mcap(tmp_path / "episode.mcap", cameras=cameras, duration_s=12)
    front, wrist = (recording.times_ns[name] for name in cameras)

    def shown(frame: int) -> list[int]:
        held = int(np.searchsorted(wrist, front[frame], side="right")) - 1
        return [frame] if held < 0 else [frame, held]

    page = screen(serve("annotate", "episode.mcap").url)
    late = int(np.searchsorted(front, wrist[0]))
    check_frames(page, [0, late - 1, late, 250, 299], shown)


@pytest.mark.parametrize(
    "encoder",
    [pytest.param(H264, marks=pytest.mark.slow), pytest.param(H264_B_FRAMES, marks=pytest.mark.slow), AV1_LONG_GOP],
    ids=lambda encoder: encoder.name,
)
def test_lerobot_with_several_episodes_a_file(serve, screen, tmp_path: Path, encoder: Encoder) -> None:
    write_v3(tmp_path / "dataset", (40, 25, 60), encoder=encoder, size=(320, 240), number_step=1000)
    page = screen(serve("annotate", "dataset").url)
    for episode, frames in enumerate(([0, 39], [0, 24, 11], [59, 30])):
        if episode:
            page.press("n")
        page.wait(episode=f"episode_{episode:06d}")
        page.until(
            lambda e=episode: (page.page.evaluate("document.body.dataset.recording") or "").startswith(
                f"episode_{e:06d}"
            )
        )
        check_frames(page, frames, lambda frame, e=episode: [e * 1000 + frame])


@pytest.mark.slow
def test_a_codec_that_browsers_do_not_play_shows_through_a_copy(serve, screen, tmp_path: Path) -> None:
    write_mcap(tmp_path / "episode.mcap", cameras={"/camera/front": Camera(image="h265", gop=30)}, duration_s=4)
    page = screen(serve("annotate", "episode.mcap").url)
    check_frames(page, [0, 119, 61], lambda frame: [frame])

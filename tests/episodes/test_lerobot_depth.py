"""Depth of LeRobot datasets, in millimetres."""

from pathlib import Path
from typing import Any

import av
import numpy as np
import pyarrow as pa
import pytest

from jiti.episodes.lerobot_depth import DepthCode, png16
from jiti.episodes.lerobot_reader import LeRobotReader
from jiti.episodes.video import decode_frames
from jiti.episodes.video_decode import SampleDecoder
from tests.builders.lerobot import (
    FRONT,
    IMAGES,
    WRIST,
    episode_table,
    read_info,
    write_info,
    write_tables,
    write_v3,
)


def test_depth_video_becomes_millimetres(tmp_path: Path) -> None:
    """Codes as lerobot 0.6 writes them: lossless HEVC of 12-bit grey."""
    root = write_v3(tmp_path / "d", (6,), cameras=(FRONT, WRIST))
    codes = np.random.default_rng(0).integers(0, 4096, (6, 48, 64)).astype(np.uint16)
    path = root / f"videos/{WRIST}/chunk-000/file-000.mp4"
    with av.open(str(path), "w") as container:
        options = {"x265-params": "lossless=1:log-level=error"}
        stream: Any = container.add_stream("libx265", rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "gray12le"
        for code in codes:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(code, format="gray12le")))
        container.mux(stream.encode())
    info = read_info(root)
    settings = {"is_depth_map": True, "video.depth_min": 0.1, "video.depth_max": 5.0, "video.shift": 1.0}
    info["features"][WRIST] |= {"info": settings, "shape": [48, 64, 1]}
    write_info(root, info)

    episode = LeRobotReader(root).open("episode_000000")
    stream = episode.streams[WRIST]
    assert (stream.kind, stream.encoding, stream.shape, stream.count) == ("depth", "png", (48, 64), 6)
    expected = DepthCode(0.1, 5.0, 1.0).millimetres()[codes]
    (batch,) = episode.read([WRIST])
    decoder = SampleDecoder("png")
    for sample, depth in zip(batch.data, expected, strict=True):  # type: ignore[union-attr]
        (picture,) = decoder.decode(sample, 0)
        assert np.array_equal(picture[1].to_ndarray(), depth)
    assert episode.clock.reference == FRONT
    assert len(list(decode_frames(episode, WRIST, range(6)))) == 6
    assert sum(map(len, batch.data)) <= episode.image_bytes  # type: ignore[union-attr]


def test_depth_codes_match_lerobots_scale() -> None:
    """The ends are the limits; halfway lies the geometric mean of the shifted limits."""
    table = DepthCode().millimetres()
    halfway = round(1000 * ((0.01 + 3.5) * (10 + 3.5)) ** 0.5 - 3500)
    assert table[[0, 4095]].tolist() == [10, 10000]
    assert table[2047] < halfway < table[2048]
    linear = DepthCode(use_log=False).millimetres()
    assert linear[[0, 4095]].tolist() == [10, 10000]


def test_depth_pictures_in_parquet(tmp_path: Path) -> None:
    root = write_v3(tmp_path / "d", (3,), encoder=IMAGES)
    depth = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64)
    tiff = _tiff(depth)
    cells = [{"bytes": data, "path": None} for data in (png16(depth), tiff, png16(depth))]
    table = episode_table(0, 3, 0, 0, 30, (FRONT,))
    table = table.set_column(table.column_names.index(FRONT), FRONT, pa.array(cells))
    write_tables(root / "data/chunk-000/file-000.parquet", [table])
    info = read_info(root)
    info["features"][FRONT] |= {"info": {"is_depth_map": True}, "shape": [48, 64, 1]}
    write_info(root, info)
    episode = LeRobotReader(root).open("episode_000000")
    assert episode.streams[FRONT].kind == "depth"
    assert episode.clock.reference == FRONT
    samples = [s for b in episode.read([FRONT]) for s in b.data]  # type: ignore[union-attr]
    decoder = SampleDecoder("png")
    assert all(np.array_equal(decoder.decode(s, 0)[0][1].to_ndarray(), depth) for s in samples)
    assert len(samples) == 3


def _tiff(depth: np.ndarray) -> bytes:
    codec: Any = av.CodecContext.create("tiff", "w")
    codec.height, codec.width = depth.shape
    codec.pix_fmt, codec.framerate = "gray16le", 30
    codec.options = {"compression_algo": "raw"}
    packets = codec.encode(av.VideoFrame.from_ndarray(depth, format="gray16le")) + codec.encode(None)
    return b"".join(bytes(packet) for packet in packets)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # lerobot's own, while it imports
@pytest.mark.parametrize("code", [DepthCode(), DepthCode(use_log=False), DepthCode(0.2, 4.0, 1.5)])
def test_depth_codes_are_lerobots(code: DepthCode) -> None:
    depth_utils = pytest.importorskip(
        "lerobot.datasets.depth_utils", reason="lerobot is not installed: pip install 'jiti[learn]'"
    )
    codes = np.arange(4096, dtype=np.uint16).reshape(64, 64)
    settings = {"depth_min": code.min_m, "depth_max": code.max_m, "shift": code.shift_m, "use_log": code.use_log}
    theirs = depth_utils.dequantize_depth(codes, **settings, output_tensor=False)
    assert np.abs(theirs.reshape(-1).astype(int) - code.millimetres()).max() <= 1

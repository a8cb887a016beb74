"""Where a video can be entered: key frames, told from the bytes of a sample alone."""

import re
from collections.abc import Iterator

_NAL = re.compile(rb"\x00\x00\x01(?=.)", re.DOTALL)
_H264_ENTRY = {5, 7}
"""IDR slice and sequence parameter set (ITU-T H.264, Table 7-1); intra-refresh streams have the second only."""
_H265_ENTRY = {*range(16, 22), 33}
"""IRAP pictures and sequence parameter set (ITU-T H.265, Table 7-1)."""
_AV1_SEQUENCE_HEADER = 1
"""OBU_SEQUENCE_HEADER (AV1 specification, 6.2.2)."""


def is_key_frame(encoding: str, data: bytes) -> bool:
    """Whether a decoder can start at this sample: Annex B for H.264 and H.265, OBUs for AV1, a frame for VP9.

    Pictures that are coded on their own (`jpeg`, `png`, `raw`) are key frames all.
    """
    match encoding:
        case "h264":
            return any(data[m.end()] & 0x1F in _H264_ENTRY for m in _NAL.finditer(data))
        case "h265":
            return any(data[m.end()] >> 1 & 0x3F in _H265_ENTRY for m in _NAL.finditer(data))
        case "av1":
            return _AV1_SEQUENCE_HEADER in obu_types(data)
        case "vp9":
            return _is_vp9_key(data)
    return True


def obu_types(data: bytes) -> Iterator[int]:
    """Types of the OBUs in a temporal unit (AV1 specification, 5.3); stops where the bytes make no sense."""
    at = 0
    while at < len(data):
        header = data[at]
        at += 2 if header & 0b100 else 1
        yield header >> 3 & 0xF
        if not header & 0b10:
            return
        size = 0
        for shift in range(0, 56, 7):
            if at >= len(data):
                return
            byte = data[at]
            at += 1
            size |= (byte & 0x7F) << shift
            if not byte & 0x80:
                break
        at += size


def _is_vp9_key(data: bytes) -> bool:
    """Read the uncompressed header (VP9 specification, 6.2): marker, profile, show_existing_frame, frame_type."""
    if not data or data[0] >> 6 != 0b10:
        return False
    bits = f"{data[0]:08b}"[2:]
    bits = bits[3:] if bits[:2] == "11" else bits[2:]
    return bits[0] == "0" and bits[1] == "0"

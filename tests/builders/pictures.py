"""Pictures that carry their own frame number, readable by a person and from a screenshot."""

import numpy as np

BITS = 16
BORDER_RGB = (255, 0, 255)


def numbered(number: int, width: int = 320, height: int = 240, *, shade: int = 90) -> np.ndarray:
    """An RGB picture (height, width, 3) uint8: magenta border, `BITS` black and white blocks across the middle."""
    picture = np.full((height, width, 3), shade, np.uint8)
    border = max(4, height // 30)
    for edge in (np.s_[:border], np.s_[-border:], np.s_[:, :border], np.s_[:, -border:]):
        picture[edge] = BORDER_RGB
    for bit in range(BITS):
        left, right = (round(width * (0.1 + 0.8 * k / BITS)) for k in (bit, bit + 1))
        picture[round(height * 0.4) : round(height * 0.6), left:right] = 255 if number >> bit & 1 else 0
    return picture


def read_number(picture: np.ndarray) -> int:
    """The number in a picture (height, width, 3) that `numbered` made, at any scale and after any codec."""
    height, width = picture.shape[:2]
    row = picture[round(height * 0.48) : round(height * 0.52)].mean(axis=(0, 2))
    bits = [row[round(width * (0.1 + 0.8 * (k + 0.5) / BITS))] > 128 for k in range(BITS)]
    return sum(1 << k for k, bit in enumerate(bits) if bit)


def find_pictures(screenshot: np.ndarray) -> list[np.ndarray]:
    """The bordered pictures in a screenshot (height, width, 3), left to right; views must stand side by side."""
    r, g, b = (screenshot[..., k].astype(int) for k in range(3))
    magenta = (r > 180) & (b > 180) & (g < 90)
    columns = np.flatnonzero(magenta.sum(0) > 4)
    found = []
    for run in np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1):
        if len(run) > 40:
            rows = np.flatnonzero(magenta[:, run].sum(1) > 4)
            found.append(screenshot[rows[0] : rows[-1] + 1, run[0] : run[-1] + 1])
    return found

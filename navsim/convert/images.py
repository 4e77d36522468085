"""Pictures as arrays: whatever Pillow reads, within reason."""

from __future__ import annotations

import io
import os
import re
import warnings

import numpy as np
from PIL import Image

from navsim.convert.errors import ConversionError
from navsim.convert.textfile import read_bytes

MOST_PIXELS = 16_000_000
"""Of a map: 4000 by 4000."""
LONGEST_HEADER = 4096
"""Bytes of a PGM's header, comments included: Pillow reads it byte by byte."""
_PNM_HEADER = re.compile(rb"P[1-7f](?:\s+|#[^\r\n]*[\r\n])*\d+(?:\s+|#[^\r\n]*[\r\n])*\d+")


def read_image(
    path: str | os.PathLike[str], luminance: tuple[float, float, float] | None = None
) -> tuple[np.ndarray, np.ndarray | None]:
    """A picture's brightness ``(H, W)`` float, 0 to 255, and opacity ``(H, W)``, None where it has none; top row first.

    Args:
        path: of the picture.
        luminance: what red, green and blue contribute to brightness; a third each by default.

    Raises:
        ConversionError: when it cannot be read, or is excessive.
    """
    content, file = read_bytes(path), str(path)
    if content[:1] == b"P" and not _PNM_HEADER.match(content[:LONGEST_HEADER]):
        text = f"says no width and height within its first {LONGEST_HEADER} bytes; save it as PGM or PNG once more"
        raise ConversionError(file, 0, text)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(content), formats=("PPM", "PNG", "BMP", "TIFF", "JPEG", "GIF")) as image:
                if image.width * image.height > MOST_PIXELS:
                    size = f"{image.width} x {image.height}"
                    raise ConversionError(file, 0, f"has {size} pixels, more than {MOST_PIXELS}; scale it down")
                return _brightness(image, luminance)
    except ConversionError:
        raise
    except Image.DecompressionBombError:
        raise ConversionError(file, 0, f"has more than {MOST_PIXELS} pixels; scale it down") from None
    except Exception as error:  # Pillow's readers fail in more ways than they document
        kind = type(error).__name__
        raise ConversionError(file, 0, f"is not a picture that can be read ({kind}); save it as PGM or PNG") from None


def _brightness(
    image: Image.Image, luminance: tuple[float, float, float] | None
) -> tuple[np.ndarray, np.ndarray | None]:
    has_opacity = "A" in image.getbands() or "transparency" in image.info
    if image.mode.startswith(("I", "F")):
        values = np.asarray(image, dtype=np.float64)
        largest = 65535.0 if values.max(initial=0.0) > 255.0 else 255.0
        return values * (255.0 / largest), None
    if image.mode in ("1", "L") and not has_opacity:  # of three equal colours the mean is each
        return np.asarray(image.convert("L"), dtype=np.float64), None
    colours = np.asarray(image.convert("RGBA" if has_opacity else "RGB"))
    opacity = colours[..., 3].astype(np.float64) if has_opacity else None
    if luminance is None:
        return colours[..., :3].sum(axis=2, dtype=np.float64) / 3.0, opacity
    return colours[..., :3] @ np.array(luminance), opacity

"""Pictures as arrays: whatever Pillow reads, within reason."""

from __future__ import annotations

import io
import os
import warnings

import numpy as np
from PIL import Image

from navsim.convert.errors import ConversionError
from navsim.convert.textfile import read_bytes

MOST_PIXELS = 36_000_000
"""Of a map: 6000 by 6000."""


def read_image(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray | None]:
    """A picture's brightness ``(H, W)`` float, 0 to 255, and opacity ``(H, W)``, None where it has none; top row first.

    Raises:
        ConversionError: when it cannot be read, or is excessive.
    """
    content, file = read_bytes(path), str(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(content), formats=("PPM", "PNG", "BMP", "TIFF", "JPEG", "GIF")) as image:
                if image.width * image.height > MOST_PIXELS:
                    size = f"{image.width} x {image.height}"
                    raise ConversionError(file, 0, f"has {size} pixels, more than {MOST_PIXELS}; scale it down")
                return _brightness(image)
    except ConversionError:
        raise
    except Image.DecompressionBombError:
        raise ConversionError(file, 0, f"has more than {MOST_PIXELS} pixels; scale it down") from None
    except Exception as error:  # Pillow's readers fail in more ways than they document
        kind = type(error).__name__
        raise ConversionError(file, 0, f"is not a picture that can be read ({kind}); save it as PGM or PNG") from None


def _brightness(image: Image.Image) -> tuple[np.ndarray, np.ndarray | None]:
    has_opacity = "A" in image.getbands() or "transparency" in image.info
    if image.mode.startswith(("I", "F")):
        values = np.asarray(image, dtype=np.float64)
        largest = 65535.0 if values.max(initial=0.0) > 255.0 else 255.0
        return values * (255.0 / largest), None
    colours = np.asarray(image.convert("RGBA" if has_opacity else "RGB"), dtype=np.float64)
    return colours[..., :3].mean(axis=2), colours[..., 3] if has_opacity else None

"""Contrast of colours as WCAG 2.2 defines it, and their difference in colour-blind vision."""

import numpy as np

SIGHTS = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    ),
    "deuteranopia": np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    ),
    "tritanopia": np.array(
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.303900],
        ]
    ),
}
"""Matrices that map linear light to its appearance in each kind of vision, at full severity.

Source: Machado, Oliveira, Fernandes, IEEE TVCG 15(6), 2009.
"""
_XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)


def contrast(one, other):
    """Return the contrast of two sRGB colours (0 to 1): 1 if equal, 21 for black on white."""
    dark, light = sorted((_luminance(one), _luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def difference(one, other, sight):
    """Return the CIELAB distance of two sRGB colours, as ``sight`` sees them (at most 100)."""
    return float(np.linalg.norm(_lab(one, sight) - _lab(other, sight)))


def _luminance(color):
    return float(np.array([0.2126, 0.7152, 0.0722]) @ _linear(color))


def _linear(color):
    """Return the linear light of an sRGB colour, without its alpha."""
    return np.array(
        [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in color[:3]]
    )


def _lab(color, sight):
    seen = _XYZ @ np.clip(SIGHTS[sight] @ _linear(color), 0, 1) / _XYZ.sum(axis=1)
    x, y, z = np.where(seen > 216 / 24389, np.cbrt(seen), seen * 841 / 108 + 4 / 29)
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])

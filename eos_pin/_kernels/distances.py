"""Distances between line segments and solids, for many pairs and postures at once; coordinates are the first axis.

A capsule is a segment with a radius, a sphere a segment without length: the radii are subtracted afterwards.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from eos_pin._arrays import Array


def segment_to_segment(a0: Array, a1: Array, b0: Array, b1: Array) -> Float[Array, "*pairs"]:
    """Distance of two segments, by their end points (3, …)."""
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    a, b, c = _dot(u, u), _dot(u, v), _dot(v, v)
    d, e = _dot(u, w), _dot(v, w)
    det = a * c - b * b
    # Where the segments are parallel, or one is a point, any s is as good as another.
    safe = det > 1e-12 * np.maximum(a * c, 1e-300)
    s = np.where(safe, np.clip((b * e - c * d) / np.where(safe, det, 1.0), 0.0, 1.0), 0.0)
    t = np.clip((b * s + e) / np.maximum(c, 1e-300), 0.0, 1.0)
    s = np.clip((b * t - d) / np.maximum(a, 1e-300), 0.0, 1.0)
    gap = w + s * u - t * v
    return np.sqrt(_dot(gap, gap))


def segment_to_box(a: Array, b: Array, half: Array) -> Float[Array, "*pairs"]:
    """Distance of a segment from a box about the origin, along the axes; minus the depth where they meet.

    The slope of the squared distance along the segment is piecewise linear and grows; its zero lies between two
    neighbours of the points where the segment crosses the planes of the faces.

    Args:
        a: One end, (3, …).
        b: The other end.
        half: Half sizes of the box, (3, …).
    """
    d = b - a
    moving = np.abs(d) > 1e-12
    slope = np.where(moving, d, 1.0)
    low, high, at_low, at_high = np.zeros(a.shape[1:]), np.ones(a.shape[1:]), _rise(a, d, half, 0.0), None
    at_high = _rise(a, d, half, 1.0)
    for i in range(3):
        for side in (-1.0, 1.0):
            t = np.where(moving[i], (side * half[i] - a[i]) / slope[i], 0.0)
            inside = (t > low) & (t < high)
            rise = _rise(a, d, half, t)
            up = inside & (rise >= 0.0)
            down = inside & (rise <= 0.0)
            low, at_low = np.where(down & ~up, t, low), np.where(down & ~up, rise, at_low)
            high, at_high = np.where(up, t, high), np.where(up, rise, at_high)
    span = at_high - at_low
    t = low + (high - low) * np.clip(np.where(span > 0.0, -at_low / np.where(span > 0.0, span, 1.0), 0.5), 0.0, 1.0)
    t = np.where(at_low >= 0.0, low, np.where(at_high < 0.0, high, t))
    x = np.abs(a + t * d) - half
    outside = np.maximum(x, 0.0)
    distance = np.sqrt(_dot(outside, outside))
    if (distance > 0.0).all():
        return distance
    # The segment runs through the box: how far its deepest of a few points is from the nearest face.
    depth = np.min([(np.abs(a + t * d) - half).max(axis=0) for t in np.linspace(0.0, 1.0, 9)], axis=0)
    return np.where(distance > 1e-12, distance, np.minimum(depth, 0.0))


def _rise(a: Array, d: Array, half: Array, t: Array | float) -> Array:
    """Half the slope of the squared distance at a + t d."""
    x = a + t * d
    return _dot(x - np.clip(x, -half, half), d)


def _dot(a: Array, b: Array) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]

"""Durations and sizes as people say them."""

from __future__ import annotations


def duration(seconds: float) -> str:
    """45 s, 3 min, 1 h 20 min.

    >>> duration(44.6), duration(5000.0)
    ('45 s', '1 h 23 min')
    """
    if seconds < 60.0:
        return f"{max(seconds, 1.0):.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def gigabytes(count: float) -> str:
    """Bytes as GB, or as MB below 100 MB.

    >>> gigabytes(2.5e9), gigabytes(3e6)
    ('2.5 GB', '3 MB')
    """
    return f"{count / 1e9:.1f} GB" if count >= 1e8 else f"{count / 1e6:.0f} MB"
